//! A camera on a gimbal: where traffic is comes from the gimbal's attitude, and nothing is said without it.
#![cfg(feature = "std")]

use fixed::types::I28F4;
use lookout::camera::Camera;
use lookout::camera::attitude::Attitude;
use lookout::detector::Detections;
use lookout::detector::detection::{Detection, Shift};
use lookout::image::Rect;
use lookout::math::real::{PI, Real, Vector};
use lookout::mavlink::component::{Component, ComponentConfig, ComponentEvent, Trust};
use lookout::mavlink::dialect::*;
use lookout::mavlink::lookout::Lookout;
use lookout::mavlink::placing::{News, UnplacedCause};
use lookout::tracking::tracker;
use mavlink_core::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, MavHeader};

const FRAME_US: i64 = 33_333;
const SECOND: i64 = 1_000_000;
const LATITUDE: f64 = 47.0;
const LONGITUDE: f64 = 8.0;

fn degrees(angle: f64) -> Real {
    Real::from_num(angle) * PI / 180
}

fn attitude(roll: f64, pitch: f64, yaw: f64) -> Attitude {
    Attitude::from_euler(degrees(roll), degrees(pitch), degrees(yaw))
}

fn wire(attitude: Attitude) -> [f32; 4] {
    [attitude.w, attitude.x, attitude.y, attitude.z].map(|v| v.to_num())
}

fn raw(component: u8, message: &MavMessage) -> MAVLinkMessageRaw {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(
        MavHeader { system_id: 1, component_id: component, sequence: 0 },
        message,
    );
    MAVLinkMessageRaw::V2(raw)
}

/// A vehicle that turns, pitches and rolls, its camera on a gimbal that looks steadily to the north-east and 10 degrees down.
struct Flight {
    onboard: Lookout,
    /// As the gimbal reports yaw.
    from_north: bool,
    gimbal: bool,
    /// Times a second that the vehicle's attitude comes.
    attitudes: i64,
    now: i64,
    frame: i64,
    reports: Vec<(i64, ADSB_VEHICLE_DATA)>,
    texts: Vec<String>,
    events: Vec<ComponentEvent>,
    /// Bearings of confirmed objects from the vehicle's nose, degrees, and what they should be.
    bearings: Vec<(f64, f64)>,
}

/// Where the gimbal looks, and where the object is: 40 degrees from north, 4 below the horizon.
fn gimbal() -> Attitude {
    attitude(0.0, -10.0, 45.0)
}

fn object() -> Vector {
    attitude(0.0, -4.0, 40.0).rotate([Real::ONE, Real::ZERO, Real::ZERO])
}

impl Flight {
    fn new(from_north: bool) -> Self {
        let camera = Camera::from_field_of_view(640, 480, degrees(60.0)).unwrap();
        let config = ComponentConfig { gimbal: true, ..ComponentConfig::default() };
        let tracks = tracker::TrackerSettings::default();
        let onboard = Lookout::new(camera, tracks, config, Default::default(), 0);
        Self {
            onboard,
            from_north,
            gimbal: true,
            attitudes: 50,
            now: 0,
            frame: 0,
            reports: Vec::new(),
            texts: Vec::new(),
            events: Vec::new(),
            bearings: Vec::new(),
        }
    }

    /// The vehicle: its heading turns by 12 degrees a second.
    fn heading(&self) -> f64 {
        self.now as f64 / 1e6 * 12.0
    }

    fn vehicle(&self) -> Attitude {
        let swing = (self.now as f64 / 1e6 * 2.0).sin();
        attitude(8.0 * swing, -6.0 * swing, self.heading())
    }

    fn hear(&mut self, component: u8, message: &MavMessage) {
        self.onboard.receive(0, &raw(component, message), Trust::Open, self.now);
    }

    fn speak(&mut self) {
        if self.now % SECOND == 0 {
            self.hear(
                1,
                &MavMessage::HEARTBEAT(HEARTBEAT_DATA {
                    mavtype: MavType::MAV_TYPE_QUADROTOR,
                    autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
                    ..HEARTBEAT_DATA::default()
                }),
            );
        }
        let time_boot_ms = (self.now / 1000) as u32 + 5000;
        if self.attitudes > 0 && self.now % (SECOND / self.attitudes) == 0 {
            let [q1, q2, q3, q4] = wire(self.vehicle());
            self.hear(
                1,
                &MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
                    time_boot_ms,
                    q1,
                    q2,
                    q3,
                    q4,
                    ..ATTITUDE_QUATERNION_DATA::default()
                }),
            );
        }
        if self.now % 200_000 == 0 {
            self.hear(
                1,
                &MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
                    time_boot_ms,
                    lat: (LATITUDE * 1e7) as i32,
                    lon: (LONGITUDE * 1e7) as i32,
                    alt: 500_000,
                    ..GLOBAL_POSITION_INT_DATA::default()
                }),
            );
        }
        if self.gimbal && self.now % 100_000 == 0 {
            let seen = if self.from_north {
                gimbal()
            } else {
                attitude(0.0, 0.0, -self.heading()).compose(gimbal())
            };
            let flags = if self.from_north {
                GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
            } else {
                GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
            };
            self.hear(
                154,
                &MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(GIMBAL_DEVICE_ATTITUDE_STATUS_DATA {
                    time_boot_ms,
                    q: wire(seen),
                    flags,
                    delta_yaw: f32::NAN,
                    delta_yaw_velocity: f32::NAN,
                    ..GIMBAL_DEVICE_ATTITUDE_STATUS_DATA::default()
                }),
            );
        }
    }

    fn fly(&mut self, seconds: f64) {
        let end = self.now + (seconds * 1e6) as i64;
        while self.now < end {
            self.speak();
            if self.now >= self.frame {
                self.frame += FRAME_US;
                self.see();
            }
            while let Some(message) = self.onboard.poll(self.now) {
                match message.payload.parse() {
                    Some(MavMessage::ADSB_VEHICLE(data)) => self.reports.push((self.now, data)),
                    Some(MavMessage::STATUSTEXT(data)) => {
                        self.texts.push(data.text.to_str().unwrap().into());
                    }
                    _ => {}
                }
            }
            while let Some(event) = self.onboard.event() {
                self.events.push(event);
            }
            self.now += 10_000;
        }
    }

    /// A frame with the object in it, where the camera on the gimbal sees it.
    fn see(&mut self) {
        let mut found = Detections::default();
        let seen = gimbal().inverse().rotate(object());
        let (x, y) = self.onboard.camera().project(seen).unwrap();
        let [width, height] = [20, 10].map(I28F4::from_num);
        let rect = Rect { x: x - width / 2, y: y - height / 2, width, height };
        let detection =
            Detection { rect, score: 6 << 16, frame_score: 6 << 16, shifts: [Shift::default(); 3] };
        found.list.push(detection).unwrap();
        let tracks = self.onboard.process(&found, self.now, self.now);
        let body = self.vehicle().inverse().rotate(object()).map(|v| v.to_num::<f64>());
        let wanted = body[1].atan2(body[0]).to_degrees();
        for track in tracks.iter().filter(|track| track.confirmed) {
            if self.onboard.is_pointed() {
                let azimuth = track.body.azimuth().to_num::<f64>().to_degrees();
                self.bearings.push((azimuth, wanted));
            }
        }
    }

    fn component(&self) -> &Component {
        self.onboard.component()
    }
}

/// Degrees from north of a report, seen from the vehicle.
fn bearing(report: &ADSB_VEHICLE_DATA) -> f64 {
    let north = f64::from(report.lat) / 1e7 - LATITUDE;
    let east = (f64::from(report.lon) / 1e7 - LONGITUDE) * LATITUDE.to_radians().cos();
    east.atan2(north).to_degrees()
}

#[test]
fn traffic_is_where_the_gimbal_looks() {
    for from_north in [true, false] {
        let mut flight = Flight::new(from_north);
        flight.fly(12.0);
        assert!(flight.reports.len() >= 10, "{}", flight.reports.len());
        for (_, report) in &flight.reports {
            assert!((bearing(report) - 40.0).abs() < 1.0, "{from_north}: {}", bearing(report));
        }
        // Text and obstacles count from the vehicle's nose, which has turned by more than 140 degrees.
        let last = flight.bearings.last().unwrap();
        assert!(last.0 < -90.0, "{last:?}");
        for (found, wanted) in &flight.bearings {
            assert!((found - wanted).abs() < 1.5, "{from_north}: {found}, {wanted}");
        }
        assert_eq!(flight.onboard.placing().counts().worst(), None);
        let seen = flight.onboard.camera_on_vehicle().unwrap();
        let axis = seen.mounting().rotate([Real::ZERO, Real::ZERO, Real::ONE]);
        let azimuth = axis[1].to_num::<f64>().atan2(axis[0].to_num::<f64>()).to_degrees();
        let wanted = (45.0 - flight.heading() + 180.0).rem_euclid(360.0) - 180.0;
        assert!((azimuth - wanted).abs() < 4.0, "{azimuth}, {wanted}");
    }
}

#[test]
fn a_silent_gimbal_puts_nothing_on_the_map_and_is_reported() {
    let mut flight = Flight::new(true);
    flight.fly(6.0);
    assert!(!flight.reports.is_empty());
    flight.gimbal = false;
    let gone = flight.now;
    flight.fly(5.0);
    // A report goes out at once, about the newest frame.
    let late = flight.reports.iter().filter(|(now, _)| *now > gone + 400_000).count();
    assert_eq!(late, 0, "positions from a gimbal that is silent");
    assert!(!flight.onboard.is_pointed() && flight.onboard.camera_on_vehicle().is_none());
    let text = "Lookout: gimbal silent, no traffic on the map";
    assert_eq!(flight.texts.iter().filter(|words| *words == text).count(), 1);
    assert!(flight.events.contains(&ComponentEvent::Map(News::Lost(UnplacedCause::Gimbal))));
    assert_eq!(
        flight.onboard.placing().counts().worst().map(|(cause, _)| cause),
        Some(UnplacedCause::Gimbal)
    );
    // It is back.
    flight.gimbal = true;
    let back = flight.now;
    flight.fly(5.0);
    assert!(flight.reports.iter().any(|(now, _)| *now > back));
    assert!(flight.texts.contains(&"Lookout: traffic is on the map again".into()));
}

#[test]
fn a_gimbal_that_was_never_heard_is_reported() {
    let mut flight = Flight::new(true);
    flight.gimbal = false;
    flight.fly(6.0);
    assert_eq!(flight.reports, []);
    assert!(flight.texts.contains(&"Lookout: gimbal silent, no traffic on the map".into()));
    assert!(flight.texts.iter().any(|text| text.contains("where unknown")), "{:?}", flight.texts);
    assert_eq!(flight.component().gimbal().unwrap().heard_us(), None);
}

/// Yaw from north needs no attitude of the vehicle for the map; only the direction from its nose does.
#[test]
fn without_the_vehicles_attitude() {
    let mut flight = Flight::new(true);
    flight.attitudes = 0;
    flight.fly(8.0);
    assert!(!flight.reports.is_empty() && !flight.onboard.is_pointed());
    assert!(flight.reports.iter().all(|(_, report)| (bearing(report) - 40.0).abs() < 1.0));
    let mut relative = Flight::new(false);
    relative.attitudes = 0;
    relative.fly(8.0);
    assert_eq!(relative.reports, []);
    assert!(relative.texts.contains(&"Lookout: no attitude, no traffic on the map".into()));
}

#[test]
fn the_cameras_own_field_of_view() {
    let mut flight = Flight::new(true);
    flight.fly(1.1);
    let view =
        |flight: &Flight| flight.onboard.camera().field_of_view().to_num::<f64>().to_degrees();
    let told = |hfov| {
        MavMessage::CAMERA_FOV_STATUS(CAMERA_FOV_STATUS_DATA {
            hfov,
            ..CAMERA_FOV_STATUS_DATA::default()
        })
    };
    flight.hear(100, &told(f32::NAN));
    assert!((view(&flight) - 60.0).abs() < 0.1);
    flight.hear(100, &told(20.0));
    assert!((view(&flight) - 20.0).abs() < 0.1, "{}", view(&flight));
    // The same again is nothing new: tracks go on.
    flight.fly(3.0);
    let tracked = flight.bearings.len();
    flight.hear(100, &told(20.1));
    flight.fly(0.5);
    assert!(flight.bearings.len() > tracked + 10);
    let views =
        flight.events.iter().filter(|event| matches!(event, ComponentEvent::FieldOfView { .. }));
    assert_eq!(views.count(), 1);
    // Frames of another size: the same view.
    flight.onboard.set_camera(Camera::from_field_of_view(1280, 720, degrees(60.0)).unwrap());
    assert!((view(&flight) - 20.0).abs() < 0.1);
    // A calibration is used while its view is the one that is told.
    flight.hear(100, &told(59.0));
    assert!((view(&flight) - 60.0).abs() < 0.1, "{}", view(&flight));
}
