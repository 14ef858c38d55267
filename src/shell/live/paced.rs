//! A recorded or simulated flight as a live source, at its own frame rate.

use super::live_source::{CaptureInfo, LiveError, LiveSource};
use crate::mavlink::component::Trust;
use crate::shell::link::Inbound;
use crate::shell::simulate::FlightTelemetry;
use crate::shell::sources::{Frame, FrameSource, SourceError};
use crate::shell::support::clock::now_us;
use crossbeam_channel::Sender;
use mavlink_core::MAVLinkMessageRaw;
use std::boxed::Box;
use std::iter::Peekable;
use std::thread;
use std::time::Duration;

/// A reader that is later than this lets the flight's clock wait for it, microseconds.
const LATE_US: i64 = 100_000;
/// The link that a simulated vehicle speaks over; no open link has this number.
const SIMULATED: u8 = u8::MAX;

/// Opens a flight at its beginning.
pub type Rewind = Box<dyn FnMut() -> Result<Box<dyn FrameSource>, SourceError>>;

/// Gives every frame of a flight when it is due.
pub struct Paced {
    rewind: Rewind,
    repeat: bool,
    telemetry: Option<(FlightTelemetry, Sender<Inbound>)>,
    flight: Option<PacedFlight>,
}

/// A flight under way.
struct PacedFlight {
    source: Box<dyn FrameSource>,
    vehicle: Option<Peekable<FlightTelemetry>>,
    /// Our time of the flight's time 0.
    start_us: Option<i64>,
    /// A frame that is not due yet.
    ahead: Option<Frame>,
    spare: Frame,
}

impl Paced {
    /// The flight that `rewind` opens, again and again with `repeat`; with the telemetry of its vehicle where there is one.
    pub fn new(
        rewind: Rewind,
        repeat: bool,
        telemetry: Option<(FlightTelemetry, Sender<Inbound>)>,
    ) -> Self {
        Self { rewind, repeat, telemetry, flight: None }
    }
}

impl LiveSource for Paced {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<CaptureInfo, LiveError> {
        let flight = match &mut self.flight {
            Some(flight) => flight,
            none => none.insert(PacedFlight {
                source: (self.rewind)()?,
                vehicle: self.telemetry.as_ref().map(|(vehicle, _)| vehicle.clone().peekable()),
                start_us: None,
                ahead: None,
                spare: Frame::default(),
            }),
        };
        if flight.ahead.is_none() {
            let mut next = std::mem::take(&mut flight.spare);
            if !flight.source.next_frame(&mut next)? {
                if !self.repeat {
                    return Err(LiveError::Ended);
                }
                self.flight = None;
                return Err(LiveError::Timeout);
            }
            flight.ahead = Some(next);
        }
        let Some(ahead) = &mut flight.ahead else { return Err(LiveError::Timeout) };
        let now = now_us();
        let start = flight.start_us.get_or_insert(now - ahead.time_us);
        *start = (*start).max(now - ahead.time_us - LATE_US);
        let due = *start + ahead.time_us;
        let wait = Duration::from_micros(u64::try_from(due - now).unwrap_or(0));
        thread::sleep(wait.min(timeout));
        if let (Some(vehicle), Some((_, heard))) = (&mut flight.vehicle, &self.telemetry) {
            let now = now_us();
            while let Some((time, raw)) = vehicle.next_if(|(time, _)| *start + time <= now) {
                let time_us = *start + time;
                let frame = MAVLinkMessageRaw::V2(raw);
                // Where nobody hears any more, nothing is lost.
                let _ =
                    heard.try_send(Inbound { link: SIMULATED, time_us, trust: Trust::Open, frame });
            }
        }
        if wait > timeout {
            return Err(LiveError::Timeout);
        }
        ahead.time_us = due;
        std::mem::swap(frame, ahead);
        flight.spare = flight.ahead.take().unwrap_or_default();
        Ok(CaptureInfo::default())
    }
}
