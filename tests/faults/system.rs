//! A wall clock that is set while the service runs, a disk on which every write takes a second.

use crate::live::{ACTIVE, Ground};
use crate::service::{Service, settings};
use crate::signing::{self, KEY};
use crate::{link_to, steady};
use lookout::mavlink::dialect::MavMessage;
use lookout::shell::link::signing::{Signing, clock};
use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// What [`shim.c`](self) reads.
struct System(File);

impl System {
    /// Compiles the shim and has the service start behind it; `None` where there is no C compiler.
    fn start(text: &str) -> Option<(Self, Service)> {
        let compiler = ["cc", "gcc"].into_iter().find(|name| {
            Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success())
        });
        let Some(compiler) = compiler else {
            println!("skipped: no C compiler");
            return None;
        };
        let mut system = None;
        let service = Service::start(text, |command, folder| {
            signing::prepare(folder);
            let (shim, faults) = (folder.join("shim.so"), folder.join("faults"));
            let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/faults/shim.c");
            let mut compile = Command::new(compiler);
            compile.args(["-shared", "-fPIC", "-O1", "-o"]).arg(&shim).arg(source);
            assert!(compile.status().unwrap().success());
            fs::write(&faults, [0; 16]).unwrap();
            command.env("LD_PRELOAD", shim).env("FAULTS_OF_TEST", &faults);
            system = Some(Self(File::options().write(true).open(faults).unwrap()));
        });
        Some((system?, service))
    }

    /// Sets the wall clock ahead by so many seconds of the true time.
    fn set_clock(&self, seconds: i64) {
        self.0.write_all_at(&seconds.to_ne_bytes(), 0).unwrap();
    }

    /// Sets the time that an fsync takes.
    fn set_fsync(&self, milliseconds: i64) {
        self.0.write_all_at(&milliseconds.to_ne_bytes(), 8).unwrap();
    }
}

#[test]
fn the_clock_steps_in_both_directions() {
    let mut ground = Ground::default();
    let text = format!(
        "system_id = 1\nsigning_key = 'FOLDER/key'\nrecord = 'FOLDER/record'\n\
         event_log = 'FOLDER/log'\n{}",
        settings(&ground)
    );
    let Some((system, service)) = System::start(&text) else { return };
    ground.wait_state(ACTIVE, 0);
    // A peer known from before, and for each step one that is new, all with the true time.
    let peer = || Signing::new(KEY, None, clock()).unwrap();
    let mut known = peer();
    let take = |ground: &mut Ground, value: f32, peer: &mut Signing, link: u8| {
        link_to(ground, &signing::set(value, Some((peer, link))));
        signing::echoed(ground, value);
    };
    take(&mut ground, 1.0, &mut known, 1);
    const HOUR: i64 = 3600;
    for (step, seconds) in (2u8..).zip([HOUR, 0, -HOUR, 0, -10 * 365 * 24 * HOUR, 0]) {
        system.set_clock(seconds);
        steady(&mut ground, 3);
        if seconds == 0 {
            take(&mut ground, f32::from(step), &mut known, 1);
            take(&mut ground, f32::from(step) + 0.5, &mut peer(), step);
        }
    }
    // Frames that go out are signed with times that rise.
    let times: Vec<u64> = ground.heard.iter().map(|(_, bytes, _)| signing::time(bytes)).collect();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "signing times that do not rise");
    let second = 100_000;
    assert!(times[times.len() - 1] - times[0] > HOUR as u64 * second, "the clock was not set");
    service.signal("TERM");
    let (status, _, err, folder) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(folder.path().join("record/000001/frames").read_dir().unwrap().count() > 50);
}

#[test]
fn a_disk_that_takes_a_second_for_every_write_holds_nobody_up() {
    let mut ground = Ground::default();
    let text = format!(
        "system_id = 1\nsigning_key = 'FOLDER/key'\nparameters = 'FOLDER/parameters'\n{}",
        settings(&ground)
    );
    let Some((system, service)) = System::start(&text) else { return };
    ground.wait_state(ACTIVE, 0);
    system.set_fsync(1000);
    let mut peer = Signing::new(KEY, None, clock()).unwrap();
    let before = ground.heard.len();
    for value in 1..=8u8 {
        link_to(&mut ground, &signing::set(f32::from(value), Some((&mut peer, 1))));
        signing::echoed(&mut ground, f32::from(value));
        steady(&mut ground, 1);
    }
    // The frames went on: the state never was anything else.
    let active = |message: &MavMessage| match message {
        MavMessage::HEARTBEAT(data) => data.system_status as u8 == ACTIVE,
        _ => true,
    };
    assert!(ground.heard[before..].iter().all(|(_, _, message)| active(message)));
    let kept = |folder: &Path| fs::read_to_string(folder.join("parameters")).unwrap_or_default();
    let start = std::time::Instant::now();
    while !kept(service.folder.path()).contains("LK_WINGSPAN 8\n") {
        assert!(start.elapsed() < Duration::from_secs(20), "{}", kept(service.folder.path()));
        std::thread::sleep(Duration::from_millis(50));
    }
}
