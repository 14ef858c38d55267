//! The autopilot: which one is served, whether it is there, and what it sends about the vehicle.
//!
//! The first vehicle that is heard is *home*: it is served whenever it is there. When it is silent a vehicle that was
//! never heard beside it (home after a restart with another system id, say) is served until home comes back; one that
//! was heard beside it flies on its own and is never served.

use super::cadence::Cadence;
use super::clock::ClockOffset;
use super::commands::PayloadFields;
use super::gimbal::Gimbal;
use super::heartbeat::is_vehicle;
use super::rotation::{from_euler, quaternion};
use super::{Component, ComponentEvent, Destination, Priority, Sender};
use crate::mavlink::dialect::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, COMMAND_LONG_DATA, GLOBAL_POSITION_INT_DATA,
    HIGHRES_IMU_DATA, MavCmd, SCALED_IMU_DATA, SYSTEM_TIME_DATA, TIMESYNC_DATA,
};
use crate::mavlink::messages::text::{self, AutopilotNews};
use crate::mavlink::messages::{Payload, Vehicle};
use fixed::types::I16F16;
use mavlink_core::{MavlinkVersion, MessageData};

/// Without any message for this long the autopilot is lost, microseconds: two heartbeats missed, and all its telemetry.
const LOST_US: i64 = 2_500_000;

/// Least time between two texts that the autopilot is lost, microseconds: a bad radio link would fill the screen.
const LOST_TEXT_US: i64 = 10_000_000;

/// Number of other vehicles that are remembered.
pub(super) const OTHERS: usize = 16;

/// Messages may overtake one another by this much without meaning a restart.
const RESTART_MS: u32 = 2_000;

/// An attitude or position older than this is requested again.
const STALE_US: i64 = 1_500_000;

/// Attitudes that come less often than this are asked for again, microseconds from one to the next: 8 a second.
const SLOW_US: i64 = 125_000;

/// After a quaternion of the attitude its angles are not needed for this long, microseconds: the two may come at different
/// rates.
const SAME_US: i64 = 80_000;

/// HIGHRES_IMU_UPDATED_FLAGS of the three axes of the gyroscope.
const GYROSCOPE: u16 = 0b11_1000;

/// The autopilot we belong to.
#[derive(Debug, Clone, Copy)]
pub struct Autopilot {
    /// MAVLink system id of the autopilot, 1 to 255.
    pub system_id: u8,
    /// MAVLink component id of the autopilot, usually 1.
    pub component_id: u8,
    /// Its MAV_AUTOPILOT: 3 ArduPilot, 12 PX4.
    pub kind: u8,
    /// The link it is heard over.
    pub link: u8,
    /// When its last message came.
    heard_us: i64,
    boot_ms: Option<u32>,
    quaternion_us: Option<i64>,
    attitude: Cadence,
    position_us: Option<i64>,
}

impl Autopilot {
    fn new(from: Sender, kind: u8, now_us: i64) -> Self {
        Self {
            system_id: from.system,
            component_id: from.component,
            kind,
            link: from.link,
            heard_us: now_us,
            boot_ms: None,
            quaternion_us: None,
            attitude: Cadence::default(),
            position_us: None,
        }
    }

    fn is(&self, from: Sender) -> bool {
        (self.system_id, self.component_id) == (from.system, from.component)
    }

    fn is_silent(&self, now_us: i64) -> bool {
        now_us.saturating_sub(self.heard_us) > LOST_US
    }
}

/// Another vehicle than home.
#[derive(Debug, Clone, Copy)]
pub(super) struct OtherVehicle {
    system: u8,
    component: u8,
    /// Whether home was heard after it: they are two.
    beside_home: bool,
}

fn silent(since: Option<i64>, now_us: i64, limit_us: i64) -> bool {
    since.is_none_or(|since| now_us.saturating_sub(since) > limit_us)
}

impl Component {
    /// HEARTBEAT: read by number, because it may hold types that are younger than this program.
    pub(super) fn hear_heartbeat(&mut self, from: Sender, mav_type: u8, kind: u8, now_us: i64) {
        let other_system = self.config.system_id.is_some_and(|own| own != from.system);
        if other_system || !is_vehicle(mav_type, kind, from.component) {
            return;
        }
        let is_home = self.home.is_none_or(|home| home == (from.system, from.component));
        if is_home {
            self.others.iter_mut().for_each(|other| other.beside_home = true);
        }
        if let Some(own) = &mut self.autopilot
            && own.is(from)
        {
            // Heard over several links: the first one, while it works.
            if own.link == from.link || own.is_silent(now_us) {
                own.link = from.link;
                own.heard_us = now_us;
                own.kind = kind;
            }
            return;
        }
        if !is_home {
            let beside_home = self.note_other(from);
            if beside_home || self.autopilot.is_some_and(|own| !own.is_silent(now_us)) {
                return;
            }
        }
        self.serve(from, kind, now_us);
    }

    /// Remembers another vehicle than home; whether it was heard beside it.
    fn note_other(&mut self, from: Sender) -> bool {
        let same = |o: &&OtherVehicle| (o.system, o.component) == (from.system, from.component);
        if let Some(other) = self.others.iter().find(same) {
            return other.beside_home;
        }
        if self.others.is_full() {
            self.others.remove(0);
        }
        let Sender { system, component, .. } = from;
        let _ = self.others.push(OtherVehicle { system, component, beside_home: false });
        false
    }

    /// Serves the vehicle of `from` from now on.
    fn serve(&mut self, from: Sender, kind: u8, now_us: i64) {
        let system_id = from.system;
        let before = self.last_served.filter(|last| last.is(from));
        // Its time since boot is kept, so that a restart while it was silent is noticed.
        let boot_ms = before.and_then(|last| last.boot_ms);
        self.autopilot = Some(Autopilot { boot_ms, ..Autopilot::new(from, kind, now_us) });
        self.forget_flight();
        if before.is_none() {
            // That of another vehicle.
            self.gimbal = Gimbal::default();
        }
        self.home.get_or_insert((from.system, from.component));
        let loss_announced = core::mem::take(&mut self.loss_announced);
        match self.last_served {
            None => self.happened(ComponentEvent::Found { system_id, autopilot: kind }),
            Some(last) if last.is(from) => {
                self.happened(ComponentEvent::Returned { system_id });
                if loss_announced {
                    self.announce(AutopilotNews::Returned);
                }
            }
            Some(_) => {
                self.happened(ComponentEvent::Found { system_id, autopilot: kind });
                self.announce(AutopilotNews::Other(system_id));
            }
        }
        self.last_served = self.autopilot;
    }

    /// A text about the autopilot, to all.
    fn announce(&mut self, news: AutopilotNews) {
        if self.parameters.is_on(super::parameters::Parameter::Text) {
            self.say(
                Destination::All,
                self.config.component_id,
                Priority::Urgent,
                &text::autopilot(news),
            );
        }
    }

    /// Ends serving an autopilot that is silent.
    fn lose_autopilot(&mut self, now_us: i64) {
        self.last_served = self.autopilot.take();
        self.forget_flight();
        self.happened(ComponentEvent::Lost);
        if silent(self.loss_text_us, now_us, LOST_TEXT_US) {
            self.loss_text_us = Some(now_us);
            self.loss_announced = true;
            self.announce(AutopilotNews::Lost);
        }
    }

    fn forget_flight(&mut self) {
        self.clock = ClockOffset::default();
        self.vehicle = None;
        self.unix_offset_us = None;
        self.gimbal.forget();
    }

    /// Whether `from` is our autopilot.
    pub(super) fn is_autopilot(&self, from: Sender) -> bool {
        self.autopilot.is_some_and(|own| own.is(from))
    }

    /// Notes the autopilot's time since boot; a fall is a restart.
    fn hear_boot_time(&mut self, boot_ms: u32) {
        let Some(own) = &mut self.autopilot else { return };
        let restarted = own.boot_ms.is_some_and(|last| boot_ms < last.saturating_sub(RESTART_MS));
        if restarted {
            own.quaternion_us = None;
            own.attitude = Cadence::default();
            own.position_us = None;
        }
        let latest = own.boot_ms.map_or(boot_ms, |last| last.max(boot_ms));
        own.boot_ms = Some(if restarted { boot_ms } else { latest });
        if restarted {
            self.forget_flight();
            self.happened(ComponentEvent::Restarted);
            self.announce(AutopilotNews::Restarted);
        }
    }

    /// Notes that the autopilot sent something.
    pub(super) fn hear_autopilot(&mut self, from: Sender, now_us: i64) {
        if let Some(own) = &mut self.autopilot
            && own.is(from)
            && own.link == from.link
        {
            own.heard_us = now_us;
        }
    }

    /// A message of our autopilot about the vehicle. `false` where its payload is not that of its number.
    pub(super) fn hear_vehicle(
        &mut self,
        id: u32,
        version: MavlinkVersion,
        payload: &[u8],
        now_us: i64,
    ) -> bool {
        match id {
            ATTITUDE_QUATERNION_DATA::ID => {
                let Ok(data) = ATTITUDE_QUATERNION_DATA::deser(version, payload) else {
                    return false;
                };
                let Some(quaternion) = quaternion([data.q1, data.q2, data.q3, data.q4]) else {
                    return false;
                };
                self.hear_boot_time(data.time_boot_ms);
                if let Some(own) = &mut self.autopilot {
                    own.quaternion_us = Some(now_us);
                }
                let time_us = self.hear_attitude(quaternion, data.time_boot_ms, now_us);
                self.hear_rates(time_us, [data.rollspeed, data.pitchspeed, data.yawspeed]);
            }
            ATTITUDE_DATA::ID => {
                let Ok(data) = ATTITUDE_DATA::deser(version, payload) else { return false };
                let Some(quaternion) = from_euler([data.roll, data.pitch, data.yaw]) else {
                    return false;
                };
                self.hear_boot_time(data.time_boot_ms);
                // Both messages hold the same attitude; one is enough.
                if self.autopilot.is_some_and(|own| silent(own.quaternion_us, now_us, SAME_US)) {
                    let time_us = self.hear_attitude(quaternion, data.time_boot_ms, now_us);
                    self.hear_rates(time_us, [data.rollspeed, data.pitchspeed, data.yawspeed]);
                }
            }
            SCALED_IMU_DATA::ID => {
                let fields = PayloadFields(payload);
                let time_us = self.clock.local_us(u32::from_le_bytes(fields.bytes(0)), now_us);
                // Thousandths of a radian a second.
                let rates = [10, 12, 14]
                    .map(|at| I16F16::from_num(i16::from_le_bytes(fields.bytes(at))) / 1000);
                self.happened(ComponentEvent::Rates { time_us, rates });
            }
            HIGHRES_IMU_DATA::ID => {
                let fields = PayloadFields(payload);
                let updated = u16::from_le_bytes(fields.bytes(60));
                if updated & GYROSCOPE == GYROSCOPE {
                    // A stamp that is the time of day, and no time since boot, is of another clock.
                    let boot_ms = u64::from_le_bytes(fields.bytes(0)) / 1000;
                    let time_us = match u32::try_from(boot_ms) {
                        Ok(boot_ms) => self.clock.local_us(boot_ms, now_us),
                        Err(_) => now_us,
                    };
                    self.hear_rates(time_us, [20, 24, 28].map(|at| fields.float(at)));
                }
            }
            GLOBAL_POSITION_INT_DATA::ID => {
                let Ok(data) = GLOBAL_POSITION_INT_DATA::deser(version, payload) else {
                    return false;
                };
                self.hear_boot_time(data.time_boot_ms);
                if let Some(own) = &mut self.autopilot {
                    own.position_us = Some(now_us);
                }
                // Zero by zero is what autopilots say before they have a position.
                let good = (data.lat, data.lon) != (0, 0)
                    && (-900_000_000..=900_000_000).contains(&data.lat)
                    && (-1_800_000_000..=1_800_000_000).contains(&data.lon);
                self.vehicle = good.then_some(Vehicle {
                    latitude: data.lat,
                    longitude: data.lon,
                    altitude: data.alt,
                    velocity: [data.vx, data.vy, data.vz],
                    time_us: now_us,
                });
            }
            SYSTEM_TIME_DATA::ID => {
                let Ok(data) = SYSTEM_TIME_DATA::deser(version, payload) else { return false };
                self.hear_boot_time(data.time_boot_ms);
                let unix = i64::try_from(data.time_unix_usec).ok().filter(|&unix| unix > 0);
                self.unix_offset_us = unix.map(|unix| unix.saturating_sub(now_us));
            }
            _ => {}
        }
        true
    }

    /// An attitude of the vehicle; gives its time.
    fn hear_attitude(&mut self, quaternion: [i32; 4], boot_ms: u32, now_us: i64) -> i64 {
        if let Some(own) = &mut self.autopilot {
            own.attitude.heard(now_us);
        }
        let time_us = self.clock.local_us(boot_ms, now_us);
        self.happened(ComponentEvent::Attitude { time_us, quaternion });
        time_us
    }

    /// Angular velocities about the vehicle's axes, radians a second; those that are no numbers are left alone.
    fn hear_rates(&mut self, time_us: i64, wire: [f32; 3]) {
        let [x, y, z] = wire.map(I16F16::checked_from_num);
        if let (Some(x), Some(y), Some(z)) = (x, y, z) {
            self.happened(ComponentEvent::Rates { time_us, rates: [x, y, z] });
        }
    }

    /// TIMESYNC: answers a question, takes an answer to ours.
    pub(super) fn hear_timesync(&mut self, from: Sender, data: &TIMESYNC_DATA, now_us: i64) {
        if data.tc1 != 0 {
            // ArduPilot's answers bear no target: that the question was ours is what counts.
            if self.is_autopilot(from) {
                self.clock.answer(data.tc1, data.ts1, now_us);
            }
            return;
        }
        let answer = TIMESYNC_DATA {
            tc1: now_us.saturating_mul(1000),
            ts1: data.ts1,
            target_system: from.system,
            target_component: from.component,
        };
        self.say(Destination::Link(from.link), self.config.component_id, Priority::Answer, &answer);
    }

    /// Checks whether the autopilot is still heard, and queues requests to it.
    pub(super) fn keep_autopilot(&mut self, now_us: i64) {
        let Some(own) = self.autopilot else { return };
        if own.is_silent(now_us) {
            self.lose_autopilot(now_us);
            return;
        }
        let to = Destination::Link(own.link);
        let trips = self.clock.trips();
        let interval = if trips < 10 { 200_000 } else { 1_000_000 };
        if silent(self.timesync_us, now_us, interval - 1) {
            self.timesync_us = Some(now_us);
            self.clock.ask(now_us);
            let question = TIMESYNC_DATA {
                tc1: 0,
                ts1: now_us.saturating_mul(1000),
                target_system: own.system_id,
                target_component: own.component_id,
            };
            self.say(to, self.config.component_id, Priority::Urgent, &question);
        }
        let late = own.attitude.is_silent(now_us, STALE_US);
        let missing = late || silent(own.position_us, now_us, 2 * STALE_US);
        let wanted_us = 1_000_000 / i64::from(self.config.attitude_hz.max(1));
        let slow = own.attitude.is_slow(SLOW_US.max(2 * wanted_us));
        let Some(asking) = &mut self.autopilot else { return };
        let again = asking.attitude.has_asked();
        if !asking.attitude.ask(missing || slow, now_us) {
            return;
        }
        // The older attitude only where the first question gave no newer one.
        let again = again && (slow || silent(own.quaternion_us, now_us, STALE_US));
        let attitude = u32::from(self.config.attitude_hz);
        let position = u32::from(self.config.position_hz);
        let to = (own.system_id, own.component_id, own.link);
        self.ask_for(to, ATTITUDE_QUATERNION_DATA::ID, attitude);
        if again {
            self.ask_for(to, ATTITUDE_DATA::ID, attitude);
        }
        self.ask_for(to, GLOBAL_POSITION_INT_DATA::ID, position);
        self.ask_for(to, SYSTEM_TIME_DATA::ID, position.min(1));
    }

    /// Asks a component (system, component, link) for a message at `rate` Hz; 0 asks for nothing.
    pub(super) fn ask_for(&mut self, (system, component, link): (u8, u8, u8), id: u32, hertz: u32) {
        let Some(interval) = 1_000_000u32.checked_div(hertz) else { return };
        // Numbers below 2^24 are whole in an f32.
        let number = |n: u32| fixed::types::U32F0::from_bits(n).to_num::<f32>();
        let command = COMMAND_LONG_DATA {
            param1: number(id),
            param2: number(interval),
            param3: 0.0,
            param4: 0.0,
            param5: 0.0,
            param6: 0.0,
            param7: 0.0,
            command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            target_system: system,
            target_component: component,
            confirmation: 0,
        };
        let to = Destination::Link(link);
        self.queue(to, self.config.component_id, Priority::Urgent, Payload::new(&command));
    }
}
