//! Detector thread: takes the newest frame and sends its detections to the main loop.

use super::image_health::ImageHealth;
use super::mailbox::Mailbox;
use crate::detector::{Detections, DetectorStage};
use crate::mavlink::messages::Blind;
use crate::model::Model;
use crate::shell::error::Error;
use crate::shell::pipeline::PipelineError;
use crate::shell::pipeline::{DetectorArgs, MaskFile, Memory};
use crate::shell::sources::Frame;
use crate::shell::support::clock::now_us;
use crossbeam_channel::Sender;
use std::string::String;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Poll timeout; bounds the time to shut down.
const SLICE: Duration = Duration::from_millis(100);

/// Most bytes of the detector: the service's unit has 512 MB for everything. Frames of 3840x2160 take 232 MB.
const MOST_BYTES: usize = 400_000_000;

/// A frame and its detections.
#[derive(Debug)]
pub struct ProcessedFrame {
    /// Frame that was processed.
    pub frame: Arc<Frame>,
    /// Detections of the frame.
    pub found: Detections,
    /// Why nothing can be seen, if so.
    pub blind: Blind,
    /// Time at which the detector began, microseconds.
    pub begun_us: i64,
    /// Time at which each stage ended, microseconds.
    pub ended_us: [i64; DetectorStage::ALL.len()],
}

/// The result, or a line in the log.
fn heard<T>(result: Result<T, PipelineError>) -> Option<T> {
    result.inspect_err(|error| tracing::warn!("{error}; watching without it")).ok()
}

/// Runs the detector on frames until `stop`. A frame of another size than the one before gets a new detector.
///
/// # Errors
/// [`PipelineError::Detector`] for a frame that the detector cannot be made for, [`PipelineError::Memory`] for one that is
/// too large.
pub fn run(
    model: &Model<'_>,
    args: &DetectorArgs,
    mailbox: &Mailbox,
    pulse: &AtomicU64,
    seen: &Sender<ProcessedFrame>,
    stop: &AtomicBool,
) -> Result<(), Error> {
    let mut sight = ImageHealth::default();
    let mut next: Option<Arc<Frame>> = None;
    let mut number = 0;
    // A mask is not needed to watch: without it there are more false alarms.
    let mask = args.mask.as_deref().and_then(|path| heard(MaskFile::load(path)));
    let take = || {
        pulse.fetch_add(1, Ordering::Relaxed);
        mailbox.take(SLICE)
    };
    while !stop.load(Ordering::Relaxed) {
        let Some(mut frame) = next.take().or_else(take) else { continue };
        let size = (frame.width, frame.height);
        let config = args.config(model, size.0, size.1)?;
        let bytes = config.bytes_len().saturating_add(config.words_len().saturating_mul(4));
        if bytes > MOST_BYTES {
            let (width, height) = size;
            return Err(PipelineError::Memory { width, height, bytes, most: MOST_BYTES }.into());
        }
        let mut memory = Memory::new(&config);
        tracing::info!(width = size.0, height = size.1, bytes = memory.len_bytes(), "detector");
        let refused = |source| PipelineError::Detector {
            input: String::from("source"),
            frame: number,
            source,
        };
        let mut detector = memory.detector(model, config).map_err(refused)?;
        if let Some(mask) = mask.as_ref().and_then(|m| heard(m.for_frames(size.0, size.1))) {
            detector.set_mask(mask);
        }
        loop {
            number += 1;
            let begun_us = now_us();
            let blind = sight.assess(&frame);
            let mut ended_us = [0; DetectorStage::ALL.len()];
            let mut observer = |stage: DetectorStage| {
                if let Some(ended_us) = ended_us.get_mut(stage as usize) {
                    *ended_us = now_us();
                }
            };
            let mut found = Detections::default();
            detector
                .process_observed(frame.view(), frame.time_us, &mut found, &mut observer)
                .map_err(|source| PipelineError::Detector {
                    input: String::from("source"),
                    frame: number,
                    source,
                })?;
            let looked = ProcessedFrame { frame, found, blind, begun_us, ended_us };
            if seen.send(looked).is_err() {
                return Ok(());
            }
            frame = loop {
                if stop.load(Ordering::Relaxed) {
                    return Ok(());
                }
                if let Some(frame) = take() {
                    break frame;
                }
            };
            if (frame.width, frame.height) != size {
                next = Some(frame);
                break;
            }
        }
    }
    Ok(())
}
