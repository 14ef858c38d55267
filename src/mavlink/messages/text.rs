//! Words for the people on the ground: STATUSTEXT.
//!
//! A text says who, where as a clock position, how far, and how soon: `WARNING VIS0003: 2 o'clock high, 240 m, in 8 s`.
//! Every text costs attention, so an aircraft gets a new one only when it has become more urgent.

use super::adsb::Callsign;
use super::status::LookoutState;
use super::{Blind, angle};
use crate::mavlink::dialect::{MavSeverity, STATUSTEXT_DATA};
use crate::mavlink::placing::{News, UnplacedCause};
use crate::tracking::traffic::{AlertLevel, Traffic};
use core::fmt::Write;
use mavlink_core::types::CharArray;

/// Letters in one text; longer ones would need chunks.
pub const LENGTH: usize = 50;

/// Sine of 10 degrees in Q30: higher or lower than this is said in words.
const SLANTED: i32 = 186_453_324;

/// Texts of level [`AlertLevel::Traffic`] are at least this far apart, in microseconds; the urgent ones never wait.
const TRAFFIC_GAP_US: i64 = 1_000_000;

fn text(severity: MavSeverity, words: &str) -> STATUSTEXT_DATA {
    STATUSTEXT_DATA { severity, text: CharArray::from(words), id: 0, chunk_seq: 0 }
}

/// The text about an object of this name; `None` below [`AlertLevel::Traffic`]. Its direction is left out unless it is
/// `pointed` ([`Health::pointed`](super::Health::pointed)).
pub fn about(traffic: &Traffic, callsign: Callsign, pointed: bool) -> Option<STATUSTEXT_DATA> {
    let (severity, word) = match traffic.level {
        AlertLevel::None => return None,
        AlertLevel::Traffic => (MavSeverity::MAV_SEVERITY_INFO, "Traffic"),
        AlertLevel::Caution => (MavSeverity::MAV_SEVERITY_WARNING, "Caution"),
        // Ground stations show this one in red and raise it before the pilot.
        AlertLevel::Warning => (MavSeverity::MAV_SEVERITY_CRITICAL, "WARNING"),
    };
    let mut words = heapless::String::<LENGTH>::new();
    let _ = write!(words, "{word} {callsign}: {}", ObjectPosition(traffic, pointed));
    Some(text(severity, &words))
}

/// Where an object is and how soon it is here.
struct ObjectPosition<'a>(&'a Traffic, bool);

impl core::fmt::Display for ObjectPosition<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self(traffic, pointed) = self;
        if *pointed {
            let (x, y) = (traffic.body.x.to_bits(), traffic.body.y.to_bits());
            let hours = (i64::from(angle::atan2(y.into(), x.into())) * 12 + (1 << 31)) >> 32;
            let hour = match hours.rem_euclid(12) {
                0 => 12,
                hour => hour,
            };
            // Above the horizon where it is known, else above the vehicle's own plane.
            let down = traffic.ned.unwrap_or(traffic.body).z.to_bits();
            let height = match down {
                _ if down < -SLANTED => "high",
                _ if down > SLANTED => "low",
                _ => "level",
            };
            write!(f, "{hour} o'clock {height}")?;
        } else {
            f.write_str("where unknown")?;
        }
        if let Some(range) = traffic.range {
            let metres = range.value.to_num::<i32>().max(0);
            match metres {
                // An assumed wingspan deserves two digits.
                ..100 => write!(f, ", {metres} m")?,
                100..1000 => write!(f, ", {} m", (metres + 5) / 10 * 10)?,
                1000..10_000 => write!(f, ", {}.{} km", metres / 1000, metres % 1000 / 100)?,
                _ => write!(f, ", {} km", metres / 1000)?,
            }
        }
        if let Some(time) = traffic.time_to_contact.filter(|_| traffic.level >= AlertLevel::Caution)
        {
            write!(f, ", in {} s", time.value.to_num::<i32>().clamp(0, 99))?;
        }
        Ok(())
    }
}

/// The text that the lookout sees nothing, sees again, or ends.
pub fn sight(state: LookoutState) -> STATUSTEXT_DATA {
    let blind = match state {
        LookoutState::Blind(reasons) => reasons,
        _ => Blind::NO,
    };
    let (severity, words) = if state == LookoutState::Stalled {
        (MavSeverity::MAV_SEVERITY_ERROR, "Lookout: no pictures, traffic is not watched")
    } else if state == LookoutState::Slow {
        (MavSeverity::MAV_SEVERITY_ERROR, "Lookout: too slow, traffic is not watched")
    } else if state == LookoutState::Ending {
        (MavSeverity::MAV_SEVERITY_WARNING, "Lookout: ended, traffic is not watched")
    } else if blind.has(Blind::COVERED) {
        (MavSeverity::MAV_SEVERITY_ERROR, "Lookout: picture frozen, traffic is not watched")
    } else if blind.has(Blind::DARK) {
        (MavSeverity::MAV_SEVERITY_ERROR, "Lookout: too dark, traffic is not watched")
    } else if blind.has(Blind::GLARE) {
        (MavSeverity::MAV_SEVERITY_ERROR, "Lookout: glare, traffic is not watched")
    } else if blind.any() {
        (MavSeverity::MAV_SEVERITY_ERROR, "Lookout: blurred view, traffic is not watched")
    } else {
        (MavSeverity::MAV_SEVERITY_INFO, "Lookout: watching for traffic")
    };
    text(severity, words)
}

/// A change of the autopilot that is served.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AutopilotNews {
    /// Nothing is heard of it any more.
    Lost,
    /// It is heard again.
    Returned,
    /// It started anew: its time since boot fell.
    Restarted,
    /// That of another system is served now.
    Other(u8),
}

/// The text about the autopilot.
pub fn autopilot(news: AutopilotNews) -> STATUSTEXT_DATA {
    let mut words = heapless::String::<LENGTH>::new();
    let (severity, written) = match news {
        AutopilotNews::Lost => (
            MavSeverity::MAV_SEVERITY_ERROR,
            words.write_str("Lookout: autopilot lost, no traffic on the map"),
        ),
        AutopilotNews::Returned => {
            (MavSeverity::MAV_SEVERITY_INFO, words.write_str("Lookout: autopilot is back"))
        }
        AutopilotNews::Restarted => {
            (MavSeverity::MAV_SEVERITY_INFO, words.write_str("Lookout: autopilot restarted"))
        }
        AutopilotNews::Other(system) => (
            MavSeverity::MAV_SEVERITY_WARNING,
            write!(words, "Lookout: serves system {system} now"),
        ),
    };
    debug_assert!(written.is_ok());
    text(severity, &words)
}

/// News about the lookout's own outputs, which the pilot should know of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Notice {
    /// Frames are not recorded: disk full, read-only, or gone.
    RecordingStopped,
    /// Frames are recorded again.
    RecordingGoesOn,
    /// A parameter was set but cannot be kept over a restart.
    ParametersNotKept,
    /// The signing times cannot be written: after a restart receivers may refuse what is sent.
    SigningTimeNotKept,
    /// A frame was rightly signed with a time more than a day ahead of ours, and refused.
    ClockOfPeer,
    /// Whether traffic is put on the map.
    Map(News),
}

impl Notice {
    /// The notice as STATUSTEXT.
    pub fn data(self) -> STATUSTEXT_DATA {
        let (severity, words) = match self {
            Self::RecordingStopped => {
                (MavSeverity::MAV_SEVERITY_WARNING, "Lookout: recording stopped, disk full or gone")
            }
            Self::RecordingGoesOn => (MavSeverity::MAV_SEVERITY_INFO, "Lookout: recording goes on"),
            Self::ParametersNotKept => {
                (MavSeverity::MAV_SEVERITY_WARNING, "Lookout: parameter set, but lost at restart")
            }
            Self::SigningTimeNotKept => {
                (MavSeverity::MAV_SEVERITY_WARNING, "Lookout: signing times not kept, see its log")
            }
            Self::Map(News::Good) => {
                (MavSeverity::MAV_SEVERITY_INFO, "Lookout: traffic is on the map again")
            }
            Self::Map(News::Lost(cause)) => {
                let words = match cause {
                    UnplacedCause::NoAutopilot => "Lookout: no autopilot, no traffic on the map",
                    UnplacedCause::NoAttitude => "Lookout: no attitude, no traffic on the map",
                    UnplacedCause::RareAttitude => {
                        "Lookout: attitude too rare, traffic off the map"
                    }
                    UnplacedCause::Gimbal => "Lookout: gimbal silent, no traffic on the map",
                    UnplacedCause::NoPosition => "Lookout: no position, no traffic on the map",
                };
                (MavSeverity::MAV_SEVERITY_WARNING, words)
            }
            Self::ClockOfPeer => {
                (MavSeverity::MAV_SEVERITY_WARNING, "Lookout: signed a day ahead, check the clocks")
            }
        };
        text(severity, words)
    }
}

#[derive(Debug, Clone, Copy)]
struct Reported {
    track: u16,
    level: AlertLevel,
    time_us: i64,
}

/// Tracks that are remembered: those that live and as many that lived.
const REMEMBERED: usize = 32;

/// Alert level last reported of each track, and when.
#[derive(Debug, Default)]
pub struct Alerts {
    reported: heapless::Vec<Reported, REMEMBERED>,
    traffic_us: Option<i64>,
}

impl Alerts {
    /// The text about `traffic` that is due at `now_us`, if any. A track's texts only become more urgent; after
    /// `interval_us` at a lower level the next rise counts as new.
    pub fn due(
        &mut self,
        traffic: &Traffic,
        callsign: Callsign,
        pointed: bool,
        now_us: i64,
        interval_us: i64,
    ) -> Option<STATUSTEXT_DATA> {
        if !traffic.confirmed {
            return None;
        }
        let at = self.reported.iter().position(|reported| reported.track == traffic.id);
        if let Some(at) = at {
            let reported = &mut self.reported[at];
            if traffic.level < reported.level
                && now_us.saturating_sub(reported.time_us) >= interval_us
            {
                reported.level = traffic.level;
                reported.time_us = now_us;
            }
            if traffic.level <= reported.level {
                return None;
            }
        }
        if traffic.level == AlertLevel::Traffic {
            if self.traffic_us.is_some_and(|last| now_us.saturating_sub(last) < TRAFFIC_GAP_US) {
                return None;
            }
            self.traffic_us = Some(now_us);
        }
        let words = about(traffic, callsign, pointed)?;
        let reported = Reported { track: traffic.id, level: traffic.level, time_us: now_us };
        match at {
            Some(at) => self.reported[at] = reported,
            None => {
                if self.reported.is_full() {
                    let oldest = (0..self.reported.len()).min_by_key(|&i| self.reported[i].time_us);
                    self.reported.swap_remove(oldest.unwrap_or(0));
                }
                let _ = self.reported.push(reported);
            }
        }
        Some(words)
    }

    /// Forgets everything, as after a jump of the clock.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::messages::tests::{any_traffic, direction, metres, traffic};
    use crate::tracking::traffic::Estimate;
    use fixed::types::I16F16;
    use proptest::prelude::*;

    fn name(traffic: &Traffic) -> Callsign {
        Callsign::of_track(196, traffic.id)
    }

    fn due(alerts: &mut Alerts, traffic: &Traffic, now_us: i64) -> bool {
        alerts.due(traffic, name(traffic), true, now_us, 60_000_000).is_some()
    }

    fn words(traffic: &Traffic) -> std::string::String {
        about(traffic, name(traffic), true).unwrap().text.to_str().unwrap().into()
    }

    #[test]
    fn an_operator_reads_who_where_and_when() {
        let seconds = |s: i32| Some(Estimate { value: I16F16::from_num(s), sigma: I16F16::ONE });
        let far = Traffic {
            range: Some(metres(1250)),
            body: direction(60.0, 0.0),
            ned: Some(direction(100.0, 20.0)),
            ..traffic(12)
        };
        assert_eq!(words(&far), "Traffic VIS0012: 2 o'clock high, 1.2 km");
        let near = Traffic {
            level: AlertLevel::Warning,
            range: Some(metres(236)),
            time_to_contact: seconds(8),
            body: direction(-58.0, 0.0),
            ned: Some(direction(0.0, -12.0)),
            ..traffic(3)
        };
        assert_eq!(words(&near), "WARNING VIS0003: 10 o'clock low, 240 m, in 8 s");
        assert_eq!(about(&near, name(&near), true).unwrap().severity as u8, 2);
        let unknown = about(&near, name(&near), false).unwrap();
        assert_eq!(unknown.text.to_str(), Ok("WARNING VIS0003: where unknown, 240 m, in 8 s"));
        let ahead = Traffic {
            level: AlertLevel::Caution,
            range: None,
            body: direction(10.0, 0.0),
            ned: None,
            ..near
        };
        assert_eq!(words(&ahead), "Caution VIS0003: 12 o'clock level, in 8 s");
        let longest = Traffic {
            id: 9999,
            level: AlertLevel::Warning,
            range: Some(metres(32_767)),
            time_to_contact: seconds(5000),
            ned: None,
            body: direction(-60.0, 0.0),
            ..traffic(1)
        };
        assert_eq!(words(&longest), "WARNING VIS9999: 10 o'clock level, 32 km, in 99 s");
    }

    #[test]
    fn urgency_only_rises() {
        let mut alerts = Alerts::default();
        let mut reported = std::vec::Vec::new();
        let levels = [
            AlertLevel::None,
            AlertLevel::Traffic,
            AlertLevel::Caution,
            AlertLevel::Traffic,
            AlertLevel::Caution,
            AlertLevel::Warning,
            AlertLevel::Caution,
        ];
        for (second, level) in levels.into_iter().enumerate() {
            let now = second as i64 * 1_000_000;
            if due(&mut alerts, &Traffic { level, ..traffic(1) }, now) {
                reported.push(level);
            }
        }
        assert_eq!(reported, [AlertLevel::Traffic, AlertLevel::Caution, AlertLevel::Warning]);
        // Calm for a minute, then dangerous again: that is news.
        assert!(!due(&mut alerts, &traffic(1), 66_000_000));
        let again = Traffic { level: AlertLevel::Warning, ..traffic(1) };
        assert!(due(&mut alerts, &again, 67_000_000));
        assert!(!due(&mut alerts, &Traffic { confirmed: false, ..traffic(2) }, 0));
    }

    #[test]
    fn a_flock_is_told_slowly_a_warning_at_once() {
        let mut alerts = Alerts::default();
        let count = |alerts: &mut Alerts, level, now| {
            (0..16).filter(|&id| due(alerts, &Traffic { level, ..traffic(id) }, now)).count()
        };
        assert_eq!(count(&mut alerts, AlertLevel::Traffic, 0), 1);
        assert_eq!(count(&mut alerts, AlertLevel::Traffic, 1_000_000), 1);
        assert_eq!(count(&mut alerts, AlertLevel::Warning, 1_100_000), 16);
    }

    #[test]
    fn news_of_the_autopilot_fit() {
        for (news, words) in [
            (AutopilotNews::Lost, "Lookout: autopilot lost, no traffic on the map"),
            (AutopilotNews::Returned, "Lookout: autopilot is back"),
            (AutopilotNews::Restarted, "Lookout: autopilot restarted"),
            (AutopilotNews::Other(255), "Lookout: serves system 255 now"),
        ] {
            assert_eq!(autopilot(news).text.to_str(), Ok(words));
        }
        assert_eq!(autopilot(AutopilotNews::Lost).severity as u8, 3);
    }

    #[test]
    fn news_of_the_map_fit() {
        for cause in UnplacedCause::ALL {
            let data = Notice::Map(News::Lost(cause)).data();
            let words = data.text.to_str().unwrap();
            // One that was cut would end within a word.
            assert!(words.ends_with("the map") && words.len() <= LENGTH, "{words}");
        }
    }

    proptest! {
        #[test]
        fn any_traffic_fits(objects in prop::collection::vec((any_traffic(), any::<i64>()), 0..80)) {
            let mut alerts = Alerts::default();
            for (object, now) in &objects {
                if let Some(data) = about(object, name(object), true) {
                    prop_assert!(data.text.to_str().unwrap().len() > 20);
                }
                due(&mut alerts, object, *now);
            }
        }
    }
}
