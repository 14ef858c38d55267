//! Encounters without pictures: boxes as a detector would give them, from geometry in f64.

use fixed::types::I28F4;
use lookout::camera::attitude::Attitude;
use lookout::camera::attitude_buffer::AttitudeBuffer;
use lookout::camera::{Camera, Intrinsics};
use lookout::detector::detection::{Detection, SHIFTS, Shift};
use lookout::image::Rect;
use lookout::math::real::Real;
use lookout::model::calibration::{self, Calibration, Knot};
use lookout::registration::global_motion::GlobalMotion;
use lookout::tracking::tracker;
use lookout::tracking::traffic::{AlertLevel, MAX_TRAFFIC, Traffic};
use lookout::tracking::{TrafficMonitor, TrafficSettings};
use proptest::prelude::*;

const FOCAL: f64 = 560.0;
const FRAME_US: i64 = 33_333;

fn camera() -> Camera {
    Camera::new(Intrinsics {
        width: 640,
        height: 480,
        focal: [Real::from_num(FOCAL); 2],
        centre: [319.5, 239.5].map(Real::from_num),
        lens: lookout::camera::Lens::PINHOLE,
    })
    .unwrap()
}

/// Small noise without a seed to choose: -1 to 1, about even.
fn noise(n: u64) -> f64 {
    let mut x = n.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (n >> 7);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (x >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Roll, pitch, yaw of a vehicle that sways.
fn sway(time: f64) -> [f64; 3] {
    [0.05 * (3.0 * time).sin(), 0.04 * (2.3 * time + 1.0).sin(), 0.1 * (1.7 * time).sin()]
}

fn attitude(time: f64) -> Attitude {
    let [roll, pitch, yaw] = sway(time).map(Real::from_num);
    Attitude::from_euler(roll, pitch, yaw)
}

/// Where a point of the world (north, east, down) is seen, in pixels.
fn seen(place: [f64; 3], time: f64) -> (f64, f64) {
    let [roll, pitch, yaw] = sway(time);
    let (n, e, d) = (place[0], place[1], place[2]);
    let (x, y) = (n * yaw.cos() + e * yaw.sin(), -n * yaw.sin() + e * yaw.cos());
    let (x, z) = (x * pitch.cos() - d * pitch.sin(), x * pitch.sin() + d * pitch.cos());
    let (y, z) = (y * roll.cos() + z * roll.sin(), -y * roll.sin() + z * roll.cos());
    (FOCAL * y / x + 320.0, FOCAL * z / x + 240.0)
}

/// The motion of a distant background from a frame to the one before.
fn background(time: f64, dt: f64) -> GlobalMotion {
    // Exact at the first order: shift, turn and scale from three points.
    let at = |x: f64, y: f64| {
        let camera = camera();
        let ray = camera.body(I28F4::from_num(x), I28F4::from_num(y));
        let world = attitude(time).rotate(ray).map(|v| v.to_num::<f64>());
        let (u, v) = seen(world, time - dt);
        (u - x, v - y)
    };
    let ((a, d), half) = (at(320.0, 240.0), 128.0);
    let ((a1, d1), (a2, d2)) = (at(320.0 + half, 240.0), at(320.0, 240.0 + half));
    let unit = 512.0 / half;
    let parameters =
        [a, d, (a1 - a) * unit, (a2 - a) * unit, (d1 - d) * unit, (d2 - d) * unit, 0.0, 0.0];
    GlobalMotion::new(640, 480, parameters.map(|v| (v * 65536.0) as i32))
}

struct Encounter {
    start: [f64; 3],
    velocity: [f64; 3],
    span: f64,
}

impl Encounter {
    fn place(&self, time: f64) -> [f64; 3] {
        core::array::from_fn(|i| self.start[i] + self.velocity[i] * time)
    }

    /// A box with the errors of a detector: 4 % of its size, a third of a pixel.
    fn detection(&self, frame: u64) -> Detection {
        let time = frame as f64 / 30.0;
        let place = self.place(time);
        let range = place.iter().map(|v| v * v).sum::<f64>().sqrt();
        let side = FOCAL * self.span / range;
        let jitter = |k| noise(frame * 8 + k);
        let (width, height) =
            (side * (1.0 + 0.06 * jitter(0)), side * 0.5 * (1.0 + 0.06 * jitter(1)));
        let (x, y) = seen(place, time);
        let (x, y) = (x + 0.5 * jitter(2), y + 0.5 * jitter(3));
        let mut shifts = [Shift::default(); SHIFTS];
        for (age, shift) in shifts.iter_mut().enumerate() {
            let before = time - (age + 1) as f64 / 30.0;
            let (u, v) = seen(self.place(before), before);
            *shift = Shift { x: I28F4::from_num(u - x), y: I28F4::from_num(v - y) };
        }
        let [x, y, width, height] =
            [x - width / 2.0, y - height / 2.0, width, height].map(I28F4::from_num);
        Detection {
            rect: Rect { x, y, width, height },
            score: 3 << 16,
            frame_score: 3 << 16,
            shifts,
        }
    }

    /// Frames, with the vehicle's attitude or without; `frame` may change what is detected.
    fn fly(
        &self,
        frames: u64,
        with_attitude: bool,
        mut change: impl FnMut(u64, Detection) -> Vec<Detection>,
    ) -> Vec<Vec<Traffic>> {
        let mut watch = TrafficMonitor::new(TrafficSettings::default(), camera());
        let mut attitudes = AttitudeBuffer::new();
        (0..frames)
            .map(|frame| {
                let time = frame as f64 / 30.0;
                let time_us = frame as i64 * FRAME_US;
                if with_attitude {
                    attitudes.push(time_us, attitude(time));
                }
                let found = change(frame, self.detection(frame));
                let motion = background(time, 1.0 / 30.0);
                watch.update(&found, time_us, &motion, &attitudes).to_vec()
            })
            .collect()
    }
}

/// From 66 m at 9 m/s: contact after 7.3 s.
const COLLISION: Encounter =
    Encounter { start: [64.0, 12.0, -10.0], velocity: [-8.73, -1.64, 1.36], span: 1.2 };
const CROSSING: Encounter =
    Encounter { start: [30.0, -12.0, 2.0], velocity: [0.0, 5.0, 0.0], span: 1.2 };
const RECEDING: Encounter =
    Encounter { start: [20.0, 2.0, 2.0], velocity: [6.0, 0.5, 0.0], span: 1.2 };
const HOVER: Encounter = Encounter { start: [25.0, 3.0, 2.0], velocity: [0.0; 3], span: 1.2 };

fn highest(flight: &[Vec<Traffic>]) -> AlertLevel {
    flight.iter().flatten().map(|t| t.level).max().unwrap_or_default()
}

fn num(value: impl fixed::traits::ToFixed) -> f64 {
    Real::from_num(value).to_num()
}

#[test]
fn a_collision_is_warned_of_in_time_and_others_are_not() {
    for with_attitude in [true, false] {
        let flight = COLLISION.fly(200, with_attitude, |_, d| vec![d]);
        let first = flight.iter().position(|f| f.iter().any(|t| t.level == AlertLevel::Warning));
        let before = 7.3 - first.expect("a warning") as f64 / 30.0;
        assert!((2.5..7.0).contains(&before), "{before} s before contact");
        for other in [CROSSING, RECEDING, HOVER] {
            let flight = other.fly(150, with_attitude, |_, d| vec![d]);
            let level = highest(&flight);
            assert!(
                level < AlertLevel::Warning && level >= AlertLevel::Traffic,
                "{level:?} {:?}",
                other.velocity
            );
        }
    }
}

#[test]
fn what_is_told_of_a_collision_is_true() {
    let flight = COLLISION.fly(180, true, |_, d| vec![d]);
    let ids: std::collections::BTreeSet<u16> = flight.iter().flatten().map(|t| t.id).collect();
    assert_eq!(ids.len(), 1);
    let mut honest = Vec::new();
    for (frame, traffic) in flight.iter().enumerate().skip(60) {
        let time = frame as f64 / 30.0;
        let t = &traffic[0];
        let place = COLLISION.place(time);
        let range = place.iter().map(|v| v * v).sum::<f64>().sqrt();
        let ned = t.ned.unwrap();
        let off: f64 = [num(ned.x), num(ned.y), num(ned.z)]
            .iter()
            .zip(place)
            .map(|(a, b)| (a - b / range).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(off < 4.0 * num(t.direction_sigma) + 1e-3, "frame {frame}: {off} rad");
        // The span is 1.2 m, 1 m is assumed.
        let guess = t.range.unwrap();
        assert!((num(guess.value) * 1.2 / range - 1.0).abs() < 0.2, "frame {frame}");
        assert!(num(guess.sigma) > 0.5 * num(guess.value));
        if let Some(contact) = t.time_to_contact {
            honest.push((num(contact.value) - (7.3 - time)) / num(contact.sigma));
            let velocity = t.velocity.unwrap().map(num);
            assert!(velocity[0] < 0.0, "{velocity:?}");
        }
    }
    assert!(honest.len() > 60, "known in {} frames", honest.len());
    let rms = (honest.iter().map(|h| h * h).sum::<f64>() / honest.len() as f64).sqrt();
    assert!((0.05..2.0).contains(&rms), "{rms}");
}

#[test]
fn a_gap_is_bridged_and_a_long_one_ends_the_track() {
    let gap = |from, to| {
        HOVER.fly(
            150,
            true,
            move |frame, d| if (from..to).contains(&frame) { vec![] } else { vec![d] },
        )
    };
    let short = gap(60, 70);
    assert!(short[65][0].coasting && short[75][0].id == short[50][0].id);
    let (x, _) = seen(HOVER.start, 65.0 / 30.0);
    let rect = short[65][0].rect;
    assert!((num(rect.x) + num(rect.width) / 2.0 - x).abs() < 4.0, "the box is foretold");
    let long = gap(60, 100);
    assert!(long[95].is_empty());
    assert_ne!(long[149][0].id, long[50][0].id);
}

#[test]
fn time_and_attitude_that_jump_leave_nothing_stale() {
    let mut watch = TrafficMonitor::new(TrafficSettings::default(), camera());
    let mut attitudes = AttitudeBuffer::new();
    let mut step = |frame: u64, time_us: i64, known: bool| {
        let time = frame as f64 / 30.0;
        if known {
            attitudes.push(time_us, attitude(time));
        }
        let found = [COLLISION.detection(frame)];
        let motion = background(time, 1.0 / 30.0);
        watch.update(&found, time_us, &motion, &attitudes).to_vec()
    };
    for frame in 0..170 {
        // Attitudes are missing for a while: the picture carries on, and the track with it; the world for a second.
        let known = !(60..100).contains(&frame);
        let traffic = step(frame, frame as i64 * FRAME_US, known);
        assert_eq!(traffic.len(), 1, "frame {frame}");
        assert_eq!(traffic[0].id, 1, "frame {frame}");
        assert_eq!(traffic[0].ned.is_some(), !(90..100).contains(&frame), "frame {frame}");
        if let Some(ned) = traffic[0].ned {
            let place = COLLISION.place(frame as f64 / 30.0);
            let range = place.iter().map(|v| v * v).sum::<f64>().sqrt();
            let off = [num(ned.x), num(ned.y), num(ned.z)];
            let off =
                off.iter().zip(place).map(|(a, b)| (a - b / range).powi(2)).sum::<f64>().sqrt();
            assert!(off < 0.01, "frame {frame}: {off} rad");
        }
        if frame == 169 {
            assert_eq!(traffic[0].level, AlertLevel::Warning);
        }
    }
    // The clock is set back, then far ahead: every warning has to be earned anew.
    for (frame, time_us) in [(170, -1_000_000_000), (171, 1_000_000_000_000)] {
        let traffic = step(frame, time_us, true);
        assert!(traffic.iter().all(|t| !t.confirmed && t.level == AlertLevel::None));
    }
    // Between attitudes the clock jumps: no direction in the world outlives it.
    let world = |traffic: Vec<Traffic>| traffic[0].ned.is_some();
    let mut time_us = 1_000_000_000_000;
    for (frame, ahead_us, known) in
        [(172, 100_000, true), (173, 66_666, true), (174, 5_000_000, false), (175, -100_000, false)]
    {
        time_us += ahead_us;
        assert_eq!(world(step(frame, time_us, known && frame == 172)), known, "frame {frame}");
    }
}

#[test]
fn attitudes_that_were_forgotten_carry_nothing_on() {
    let mut watch = TrafficMonitor::new(TrafficSettings::default(), camera());
    let mut attitudes = AttitudeBuffer::new();
    for frame in 0..60 {
        let time = frame as f64 / 30.0;
        let time_us = frame as i64 * FRAME_US;
        match frame {
            0..30 => attitudes.push(time_us, attitude(time)),
            // Another autopilot, or the same one after a restart.
            40 => attitudes.clear(),
            // Its first attitude is ahead of the frame.
            45 => attitudes.push(time_us + 2 * FRAME_US, attitude(time + 2.0 / 30.0)),
            _ => {}
        }
        let motion = background(time, 1.0 / 30.0);
        let traffic = watch.update(&[HOVER.detection(frame)], time_us, &motion, &attitudes);
        assert_eq!(traffic[0].id, 1, "frame {frame}");
        assert_eq!(traffic[0].ned.is_some(), !(40..47).contains(&frame), "frame {frame}");
    }
}

#[test]
fn a_model_s_calibration_says_what_makes_a_track() {
    let knots = |knots: &[(i32, u32)]| -> Vec<u8> {
        let knot = |&(score, percent)| Knot { score, precision: calibration::ONE / 100 * percent };
        knots.iter().flat_map(|k| knot(k).encode()).collect()
    };
    let default = tracker::TrackerSettings::default();
    let none = [default.start_score, default.confirm_score, default.keep_score];
    for (table, [start_score, confirm_score, keep_score]) in [
        (&[(-500, 10), (-400, 40), (-100, 49), (300, 51), (400, 99)][..], [300, 400, -400]),
        // Never sure enough: what is known of the low scores holds all the same.
        (&[(-170_000, 20), (-100_000, 45)], [none[0], none[1], -100_000]),
        // Never sure enough to confirm: not less sure than to start.
        (&[(-170_000, 20), (500, 55)], [500, 500, 500]),
        // All of it good: what starts a track continues it.
        (&[(7, 98), (8, 99)], [7, 7, 7]),
        (&[], none),
    ] {
        let bytes = knots(table);
        let settings = tracker::TrackerSettings::calibrated(&Calibration::parse(&bytes).unwrap());
        assert_eq!(
            settings,
            tracker::TrackerSettings { start_score, confirm_score, keep_score, ..default }
        );
    }
}

#[test]
fn weak_detections_alone_confirm_nothing() {
    let encounter = Encounter { start: [40.0, 3.0, -2.0], velocity: [0.0, 1.0, 0.2], span: 1.0 };
    let TrafficSettings { track: scores, .. } = TrafficSettings::default();
    let between = (scores.start_score + scores.confirm_score) / 2;
    // Where there is nothing in two frames of three, the scores of the third say little.
    for (score, every, confirmed) in [(between, 1, false), (0, 1, true), (0, 3, false)] {
        let traffic = encounter.fly(120, true, |frame, found| match frame % every {
            0 => vec![Detection { score, frame_score: score, ..found }],
            _ => vec![],
        });
        let any = traffic.iter().flatten().any(|t| t.confirmed);
        assert_eq!(any, confirmed, "{score} every {every}");
        assert!(traffic.iter().any(|t| !t.is_empty()), "{score} every {every}: no track");
    }
}

/// An aircraft that reports its own position in the direction of a track makes it surer.
#[test]
fn evidence_from_elsewhere_confirms_a_weak_track() {
    let TrafficSettings { track: scores, .. } = TrafficSettings::default();
    let between = (scores.start_score + scores.confirm_score) / 2;
    let confirmed = |supported: u16| {
        let (mut watch, mut attitudes) =
            (TrafficMonitor::new(TrafficSettings::default(), camera()), AttitudeBuffer::new());
        (0..60).any(|frame| {
            let (time, time_us) = (frame as f64 / 30.0, frame as i64 * FRAME_US);
            attitudes.push(time_us, attitude(time));
            watch.support([supported].into_iter());
            let found =
                Detection { score: between, frame_score: between, ..HOVER.detection(frame) };
            let traffic =
                watch.update(&[found], time_us, &background(time, 1.0 / 30.0), &attitudes);
            assert!(traffic.iter().all(|track| track.id == 1), "{traffic:?}");
            traffic.iter().any(|track| track.confirmed)
        })
    };
    assert!(confirmed(1));
    assert!(!confirmed(2), "the evidence was for another track");
}

#[test]
fn a_part_of_what_is_known_is_no_object() {
    let encounter = Encounter { start: [20.0, 1.0, -1.0], velocity: [0.0, 0.5, 0.1], span: 1.5 };
    let traffic = encounter.fly(120, true, |frame, whole| {
        let Rect { width, height, .. } = whole.rect;
        let rect = Rect { width: width / 2, height: height / 2, ..whole.rect };
        let part = Detection { rect, score: 1 << 16, frame_score: 1 << 16, ..whole };
        if frame < 30 { vec![whole] } else { vec![whole, part] }
    });
    assert!(traffic[30..].iter().all(|t| t.len() == 1 && t[0].confirmed && t[0].id == 1));
}

#[test]
fn more_objects_than_there_is_room_for() {
    let mut watch = TrafficMonitor::new(TrafficSettings::default(), camera());
    let many: Vec<Detection> = (0..40)
        .map(|i| {
            let [x, y] = [i % 8 * 70 + 20, i / 8 * 80 + 20].map(I28F4::from_num::<i32>);
            let side = I28F4::from_num(20);
            let rect = Rect { x, y, width: side, height: side };
            Detection {
                rect,
                score: (i + 1) << 16,
                frame_score: (i + 1) << 16,
                shifts: [Shift::default(); SHIFTS],
            }
        })
        .collect();
    let first = watch.update(&many, 0, &GlobalMotion::IDENTITY, &AttitudeBuffer::new());
    assert_eq!((first.len(), watch.dropped()), (MAX_TRAFFIC, 40 - MAX_TRAFFIC as u32));
    let mut ids: Vec<u16> = first.iter().map(|t| t.id).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), MAX_TRAFFIC);
    // The surest have the places.
    assert!(first.iter().all(|t| t.score > 24 << 16));
}

/// The longest run of frames without a detection in which the level was caution or warning.
fn longest_alert_without_detection(traffic: &[Vec<Traffic>]) -> usize {
    let (mut run, mut longest) = (0, 0);
    for frame in traffic {
        let held = frame.iter().any(|t| t.coasting && t.level >= AlertLevel::Caution);
        run = if held { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    longest
}

/// A drone on a collision course that is warned of, and then no longer found.
#[test]
fn an_alert_ends_with_its_evidence() {
    let head_on = Encounter { start: [70.0, 0.0, 0.0], velocity: [-15.0, 0.0, 0.0], span: 1.0 };
    let warned = |traffic: &[Vec<Traffic>]| {
        traffic
            .iter()
            .position(|frame| frame.iter().any(|t| t.level == AlertLevel::Warning))
            .unwrap()
    };
    let full = head_on.fly(120, true, |_, d| vec![d]);
    let lost = warned(&full) as u64 + 5;
    let traffic = head_on.fly(120, true, |frame, d| if frame < lost { vec![d] } else { vec![] });
    // 0.4 s at 30 frames a second.
    assert_eq!(longest_alert_without_detection(&traffic), 12);
    // A weak box comes back every half second: the track lives on, the warning does not.
    // Contact is after 140 frames.
    let flicker = head_on.fly((lost + 90).min(130), true, |frame, d| {
        if frame < lost || (frame - lost) % 15 == 14 { vec![d] } else { vec![] }
    });
    let after = &flicker[lost as usize + 15..];
    assert!(after.iter().flatten().any(|t| t.confirmed), "the track lives on");
    assert!(
        after.iter().flatten().all(|t| t.level <= AlertLevel::Traffic),
        "no evidence, no alert"
    );
}

#[test]
fn boxes_are_clipped_to_the_frame() {
    let crossing = Encounter { start: [20.0, 8.0, 0.0], velocity: [0.0, 4.0, 0.0], span: 2.0 };
    let traffic = crossing.fly(45, true, |frame, d| if frame < 30 { vec![d] } else { vec![] });
    let mut cut = 0;
    for t in traffic.iter().flatten() {
        let right = t.rect.x + t.rect.width;
        assert!(t.rect.x >= 0 && right <= 640 && t.rect.width >= 0, "{t:?}");
        cut += usize::from(right == 640);
    }
    assert!(cut > 5, "{cut} boxes reach the edge");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn nothing_panics(frames in proptest::collection::vec(
        (any::<i64>(), proptest::collection::vec((any::<[i32; 4]>(), any::<i32>(), any::<[i32; 6]>()), 0..20), any::<[i32; 8]>(), any::<[i64; 4]>(), any::<bool>()),
        1..12,
    ), wild: bool, settings: [i64; 12], (width, height, focal) in (1..=65535u32, 1..=65535u32, 0..=10u32)) {
        let mut chosen = TrafficSettings::default();
        if wild {
            let [a, b, c, d, e, f, g, h, i, j, k, l] = settings;
            let real = Real::from_bits;
            chosen.track.agility = real(a);
            chosen.track.growth_agility = real(b);
            chosen.track.place_error = real(c);
            chosen.track.size_error = real(d);
            chosen.track.coast_us = e;
            chosen.track.confirm_hits = f as u8;
            chosen.track.confirm_window = g as u8;
            chosen.threat.wingspan = real(h);
            chosen.threat.wingspan_sigma = real(i);
            chosen.threat.warning_distance = real(j);
            chosen.threat.persistence_us = k;
            chosen.threat.min_snr_time_to_contact = real(l);
        }
        // From the widest to the narrowest view there is.
        let focal = Real::from_num(width.max(height)) * (1 << focal) / 16;
        let intrinsics = Intrinsics { width, height, focal: [focal; 2], ..*camera().intrinsics() };
        let any = Camera::new(intrinsics).ok().filter(|_| wild);
        let mut watch = TrafficMonitor::new(chosen, any.unwrap_or(camera()));
        let mut attitudes = AttitudeBuffer::new();
        let mut time = 0i64;
        for (step, found, motion, q, sane) in frames {
            time = if sane { time.wrapping_add(step.rem_euclid(1 << 17)) } else { step };
            if let Some(attitude) = Attitude::new(q.map(Real::from_bits)) {
                attitudes.push(time, attitude);
            }
            let found: Vec<Detection> = found.into_iter().map(|(rect, score, shifts)| {
                let shrink = if sane { 4096 * 64 } else { 1 };
                let [x, y, width, height] = rect.map(|v| I28F4::from_bits(v / shrink));
                let shift = |i: usize| Shift { x: I28F4::from_bits(shifts[2 * i] / shrink), y: I28F4::from_bits(shifts[2 * i + 1] / shrink) };
                Detection { rect: Rect { x, y, width, height }, score, frame_score: score, shifts: core::array::from_fn(shift) }
            }).collect();
            let motion = GlobalMotion::new(640, 480, motion);
            // The same frame again: tracks are met, and time stands still.
            for time in [time, time.saturating_add(30_000), time.saturating_add(30_000)] {
                let traffic = watch.update(&found, time, &motion, &attitudes);
                prop_assert!(traffic.iter().all(|t| t.id != 0 && t.time_us == time));
            }
        }
    }
}
