//! The gimbal that carries the camera, and streams that come too rarely.

use super::*;
use fixed::types::I2F30;

const IN_VEHICLE_FRAME: GimbalDeviceFlags =
    GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME;
const IN_EARTH_FRAME: GimbalDeviceFlags = GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME;

/// A gimbal that points `yaw` (radians) to the right, level.
fn status(flags: GimbalDeviceFlags, yaw: f32) -> GIMBAL_DEVICE_ATTITUDE_STATUS_DATA {
    GIMBAL_DEVICE_ATTITUDE_STATUS_DATA {
        time_boot_ms: 0,
        q: [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()],
        flags,
        angular_velocity_x: f32::NAN,
        angular_velocity_y: f32::NAN,
        angular_velocity_z: f32::NAN,
        failure_flags: GimbalDeviceErrorFlags::empty(),
        target_system: 0,
        target_component: 0,
        delta_yaw: f32::NAN,
        delta_yaw_velocity: f32::NAN,
        gimbal_device_id: 0,
    }
}

fn view(degrees: f32) -> CAMERA_FOV_STATUS_DATA {
    CAMERA_FOV_STATUS_DATA { hfov: degrees, ..CAMERA_FOV_STATUS_DATA::default() }
}

/// A flight of system 42 with a gimbal.
fn flight() -> TestFlight {
    let config = ComponentConfig { gimbal: true, ..ComponentConfig::default() };
    let mut flight = TestFlight::new(config, Parameters::default());
    flight.fly(1.0);
    flight.events.clear();
    flight
}

/// Yaw in thousandths of radians, and whether it counts from north, of what the gimbal was heard to say.
fn pointed(flight: &mut TestFlight) -> Vec<(i64, bool)> {
    flight.drain();
    let events = core::mem::take(&mut flight.events);
    let yaw = |event: &ComponentEvent| match event {
        ComponentEvent::Gimbal { quaternion, from_north, .. } => {
            let [w, x, y, z] = quaternion.map(|q| I2F30::from_bits(q).to_num::<f64>());
            assert!(x.abs() < 1e-3 && y.abs() < 1e-3);
            Some(((2.0 * z.atan2(w) * 1000.0).round() as i64, *from_north))
        }
        _ => None,
    };
    events.iter().filter_map(yaw).collect()
}

#[test]
fn yaw_counts_from_what_the_flags_say() {
    let lock = GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_LOCK;
    let none = GimbalDeviceFlags::empty();
    let nan = f32::NAN;
    for (flags, delta_yaw, wanted) in [
        (IN_EARTH_FRAME, nan, Some((500, true))),
        (IN_EARTH_FRAME | lock, 0.3, Some((500, true))),
        (IN_VEHICLE_FRAME, nan, Some((500, false))),
        // Follows the earth, told from the vehicle.
        (IN_VEHICLE_FRAME | lock, nan, Some((500, false))),
        // It knows the vehicle's heading itself.
        (IN_VEHICLE_FRAME, 0.3, Some((800, true))),
        // Before these flags there were, and the field that goes with them is to be ignored.
        (lock, 0.3, Some((500, true))),
        (none, 0.3, Some((500, false))),
        (IN_VEHICLE_FRAME | IN_EARTH_FRAME, nan, None),
    ] {
        let mut flight = flight();
        let data = GIMBAL_DEVICE_ATTITUDE_STATUS_DATA {
            delta_yaw,
            gimbal_device_id: 1,
            ..status(flags, 0.5)
        };
        flight.hear(42, 154, &data);
        assert_eq!(pointed(&mut flight), Vec::from_iter(wanted), "{flags:?} {delta_yaw}");
    }
}

#[test]
fn one_gimbal_of_the_own_vehicle() {
    let mut flight = flight();
    let mut heard = |system, component, device, yaw| {
        let data = GIMBAL_DEVICE_ATTITUDE_STATUS_DATA {
            gimbal_device_id: device,
            ..status(IN_EARTH_FRAME, yaw)
        };
        flight.hear(system, component, &data);
        pointed(&mut flight)
    };
    assert_eq!(heard(43, 154, 0, 0.1), [], "another vehicle's");
    assert_eq!(heard(42, 154, 0, 0.2), [(200, true)]);
    assert_eq!(heard(42, 171, 0, 0.3), [], "a second gimbal");
    assert_eq!(heard(42, 1, 1, 0.4), [], "the autopilot about it");
    assert_eq!(heard(42, 154, 0, 0.5), [(500, true)]);
    assert_eq!(flight.component.gimbal().unwrap().device(), Some((154, 0)));
    // No rotation at all.
    let broken = GIMBAL_DEVICE_ATTITUDE_STATUS_DATA { q: [0.0; 4], ..status(IN_EARTH_FRAME, 0.0) };
    let malformed = flight.component.counters().malformed;
    flight.hear(42, 154, &broken);
    assert_eq!(flight.component.counters().malformed, malformed + 1);
    // Without the setting nothing is heard of any.
    let mut fixed = super::flight();
    fixed.fly(1.0);
    fixed.hear(42, 154, &status(IN_EARTH_FRAME, 0.2));
    assert_eq!(pointed(&mut fixed), []);
    assert!(fixed.component.gimbal().is_none());
}

#[test]
fn times_are_those_of_the_gimbals_clock() {
    let mut flight = flight();
    // Started 100 s before us, 20 to 60 ms on the way.
    for step in 0..100i64 {
        let delay = 20_000 + step * 7 % 40 * 1000;
        let data = GIMBAL_DEVICE_ATTITUDE_STATUS_DATA {
            time_boot_ms: ((flight.now - delay) / 1000 + 100_000) as u32,
            ..status(IN_EARTH_FRAME, 0.0)
        };
        flight.hear(42, 1, &autopilot_heartbeat());
        flight.hear(42, 154, &data);
        flight.drain();
        let last = flight.events.iter().rev().find_map(|event| match event {
            ComponentEvent::Gimbal { time_us, .. } => Some(*time_us),
            _ => None,
        });
        let late = last.unwrap() - (flight.now - delay);
        assert!(step < 50 || (0..=21_000).contains(&late), "{step}: {late}");
        flight.events.clear();
        flight.now += 50_000;
    }
    // A gimbal without a clock.
    flight.hear(42, 154, &status(IN_EARTH_FRAME, 0.0));
    flight.drain();
    let now = flight.now;
    let at_arrival = |event: &ComponentEvent| matches!(event, ComponentEvent::Gimbal { time_us, .. } if *time_us == now);
    assert!(flight.events.iter().any(at_arrival));
}

#[test]
fn fields_of_view() {
    let mut flight = flight();
    for degrees in [f32::NAN, 0.0, -5.0, 180.0, 1e9] {
        flight.hear(42, 100, &view(degrees));
    }
    flight.hear(42, 100, &view(62.5));
    flight.hear(42, 101, &view(20.0));
    flight.hear(7, 100, &view(20.0));
    flight.drain();
    let views =
        flight.events.iter().filter(|event| matches!(event, ComponentEvent::FieldOfView { .. }));
    let wanted = ComponentEvent::FieldOfView { degrees: I16F16::from_num(62.5) };
    assert_eq!(views.collect::<Vec<_>>(), [&wanted]);
}

/// SET_MESSAGE_INTERVAL by message: when, to which component, microseconds.
fn asked(flight: &TestFlight, id: u32) -> Vec<(i64, u8, i64)> {
    let commands = flight.of::<COMMAND_LONG_DATA>();
    let of_id = commands.iter().filter(|(_, _, data)| {
        data.command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL && data.param1 == id as f32
    });
    of_id.map(|(now, _, data)| (now / SECOND, data.target_component, data.param2 as i64)).collect()
}

#[test]
fn a_gimbal_is_asked_for_and_asked_to_be_quicker() {
    let id = GIMBAL_DEVICE_ATTITUDE_STATUS_DATA::ID;
    let mut flight = flight();
    flight.fly(9.0);
    // The autopilot, which may be the one that drives it.
    assert_eq!(asked(&flight, id), [(0, 1, 50_000), (5, 1, 50_000)]);
    assert_eq!(asked(&flight, CAMERA_FOV_STATUS_DATA::ID)[0], (0, 1, SECOND));
    flight.sent.clear();
    // Five times a second.
    for _ in 0..150 {
        flight.hear(42, 154, &status(IN_EARTH_FRAME, 0.0));
        flight.fly(0.2);
    }
    let slow = asked(&flight, id);
    assert!((2..=4).contains(&slow.len()) && slow.iter().all(|ask| ask.1 == 154), "{slow:?}");
    flight.sent.clear();
    for _ in 0..600 {
        flight.hear(42, 154, &status(IN_EARTH_FRAME, 0.0));
        flight.fly(0.04);
    }
    assert!(asked(&flight, id).len() <= 1, "{:?}", asked(&flight, id));
}

/// A link on which attitudes come three times a second.
#[test]
fn rare_attitudes_are_asked_for_again_ever_more_rarely() {
    let mut flight = super::flight();
    flight.fly(2.0);
    flight.sent.clear();
    let autopilot = flight.autopilot.take();
    for step in 0..360 {
        if step % 3 == 0 {
            flight.hear(42, 1, &autopilot_heartbeat());
        }
        let boot = (flight.now / 1000 + flight.boot) as u32;
        flight.hear(42, 1, &position(boot));
        flight.hear(42, 1, &attitude(boot));
        flight.fly(0.34);
    }
    let times: Vec<i64> =
        asked(&flight, ATTITUDE_QUATERNION_DATA::ID).iter().map(|ask| ask.0).collect();
    assert!((4..=7).contains(&times.len()), "{times:?}");
    let waits: Vec<i64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(waits.is_sorted() && waits[0] >= 5 && waits.last() >= Some(&35), "{waits:?}");
    // The angles, too: the autopilot may know only these.
    assert!(!asked(&flight, ATTITUDE_DATA::ID).is_empty());
    // At the rate that was asked for nothing is asked.
    flight.autopilot = autopilot;
    flight.fly(2.0);
    flight.sent.clear();
    flight.fly(70.0);
    assert_eq!(asked(&flight, ATTITUDE_QUATERNION_DATA::ID), []);
}

/// The quaternion once a second, as a slow link gives what was asked for beside its own stream, angles ten times.
#[test]
fn the_angles_count_where_the_quaternion_is_rarer() {
    let mut flight = super::flight();
    flight.fly(1.0);
    flight.autopilot = None;
    flight.events.clear();
    for step in 0..50 {
        let boot = (flight.now / 1000 + flight.boot) as u32;
        if step % 10 == 0 {
            flight.hear(42, 1, &autopilot_heartbeat());
            flight.hear(42, 1, &attitude(boot));
        }
        let angles = ATTITUDE_DATA { time_boot_ms: boot, yaw: 0.25, ..ATTITUDE_DATA::default() };
        flight.hear(42, 1, &angles);
        flight.fly(0.1);
    }
    let count =
        flight.events.iter().filter(|e| matches!(e, ComponentEvent::Attitude { .. })).count();
    assert!(count >= 45, "{count} of 55");
}

#[test]
fn angular_velocities() {
    let mut flight = super::flight();
    flight.fly(1.0);
    flight.events.clear();
    let boot = (flight.now / 1000 + flight.boot) as u32;
    let rates = [0.5, -0.25, 2.0f32];
    let [rollspeed, pitchspeed, yawspeed] = rates;
    flight.hear(
        42,
        1,
        &ATTITUDE_QUATERNION_DATA { rollspeed, pitchspeed, yawspeed, ..attitude(boot) },
    );
    let [xgyro, ygyro, zgyro] = rates.map(|rate| (rate * 1000.0) as i16);
    let scaled =
        SCALED_IMU_DATA { time_boot_ms: boot, xgyro, ygyro, zgyro, ..SCALED_IMU_DATA::default() };
    flight.hear(42, 1, &scaled);
    let [xgyro, ygyro, zgyro] = rates;
    let highres = HIGHRES_IMU_DATA {
        time_usec: u64::from(boot) * 1000,
        xgyro,
        ygyro,
        zgyro,
        fields_updated: HighresImuUpdatedFlags::from_bits_retain(63),
        ..HIGHRES_IMU_DATA::default()
    };
    flight.hear(42, 1, &highres);
    // Not of our autopilot, not measured, no numbers.
    flight.hear(7, 1, &scaled);
    let fields_updated = HighresImuUpdatedFlags::from_bits_retain(7);
    flight.hear(42, 1, &HIGHRES_IMU_DATA { fields_updated, ..highres.clone() });
    flight.hear(42, 1, &HIGHRES_IMU_DATA { xgyro: f32::NAN, ..highres });
    flight.drain();
    let heard = flight.events.iter().filter_map(|event| match event {
        ComponentEvent::Rates { time_us, rates } => {
            Some((*time_us, rates.map(|rate| rate.to_num::<f32>())))
        }
        _ => None,
    });
    let heard: Vec<_> = heard.collect();
    assert_eq!(heard.len(), 3, "{heard:?}");
    for (time_us, found) in heard {
        assert!((flight.now - time_us).abs() < 3000, "{time_us}");
        assert!(found.iter().zip(rates).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
    }
}

/// A detector that takes 2 s a frame: one state, one text, though no frame is finished for longer than usual.
#[test]
fn a_slow_detector_is_one_state() {
    let mut flight = super::flight();
    flight.frames = false;
    flight.health.busy_us = 2_000_000;
    flight.seen.push(traffic(1));
    let mut states = Vec::new();
    for _ in 0..20 {
        flight.component.observe(&flight.seen, flight.health, flight.now, flight.now);
        for _ in 0..20 {
            flight.fly(0.1);
            states.push(flight.component.state());
        }
    }
    assert!(states.iter().all(|state| *state == LookoutState::Slow), "{states:?}");
    let texts: Vec<_> = flight
        .of::<STATUSTEXT_DATA>()
        .iter()
        .map(|text| std::string::String::from(text.2.text.to_str().unwrap()))
        .filter(|text| text.starts_with("Lookout:"))
        .collect();
    assert_eq!(texts, ["Lookout: too slow, traffic is not watched"]);
    // Then the camera goes.
    flight.fly(8.0);
    assert_eq!(flight.component.state(), LookoutState::Stalled);
    // Smaller frames are quick.
    flight.health.busy_us = 20_000;
    flight.frames = true;
    flight.fly(1.0);
    assert_eq!(flight.component.state(), LookoutState::Watching);
}
