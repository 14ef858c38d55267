//! The firmware on QEMU's mps2-an500 (Cortex-M7): a flight comes from files of the host, MAVLink goes out of UART 0.
//! `run` gives it the files and compares what it says with what the host says of the same flight.
#![no_std]
#![no_main]

mod counter;
mod ram;
mod tlog;
mod uart;

use core::fmt::Display;
use cortex_m::Peripherals;
use cortex_m_rt::entry;
use counter::Counter;
use firmware::{CONFIG, Firmware, TICK_US};
use lookout::camera::Camera;
use lookout::detector::DetectorStage;
use lookout::detector::digest::Digest;
use lookout::image::Image;
use lookout::math::real::{PI, Real};
use semihosting::fs::File;
use semihosting::io::Read;
use semihosting::{eprintln, print, println, process};
use tlog::Tlog;
use uart::Uart;

/// Pixels of a frame.
const PIXELS: usize = CONFIG.width * CONFIG.height;

/// Time from a frame to its detections that `lookout replay` assumes, microseconds.
const LATENCY_US: i64 = 40_000;

/// Frames a second of a folder of pictures.
const FRAMES_A_SECOND: i64 = 30;

/// Horizontal field of view that `lookout replay` assumes, 60 degrees in radians.
const VIEW: Real = PI.strict_div_int(3);

#[entry]
fn main() -> ! {
    static mut FRAME: [u8; PIXELS] = [0; PIXELS];
    replay(FRAME);
    process::exit(0)
}

/// Replays the flight in the folder that QEMU was started in (frames.grey, one frame after the other, and flight.tlog) on
/// the clock of its frames, as `lookout replay` does, and tells `run` of it in a line of JSON.
fn replay(pixels: &mut [u8; PIXELS]) {
    let open = |name| File::open(name).unwrap_or_else(|error| fail("a file of the flight", &error));
    let mut frames = open(c"frames.grey");
    let mut log = Tlog::new(open(c"flight.tlog")).unwrap_or_else(|e| fail("flight.tlog", &e));
    let Some(peripherals) = Peripherals::take() else { return };
    let Some(mut counter) = Counter::new(peripherals.SYST) else {
        fail("instructions", &"QEMU was not started with -icount shift=0")
    };
    let mut uart = Uart::new();
    let camera = Camera::from_field_of_view(CONFIG.width as u32, CONFIG.height as u32, VIEW)
        .unwrap_or_else(|error| fail("camera", &error));
    let lookout = Firmware::start(camera, 0).unwrap_or_else(|error| fail("detector", &error));

    let (mut digest, mut detections) = (Digest::default(), 0);
    let (mut number, mut now_us) = (0, 0);
    let (mut total, mut worst) = (Work::default(), 0);
    loop {
        match frames.read(&mut pixels[..1]) {
            Ok(0) => break,
            read => read.and_then(|_| frames.read_exact(&mut pixels[1..])),
        }
        .unwrap_or_else(|error| fail("frames.grey", &error));
        let frame = Image::packed(pixels, CONFIG.width, CONFIG.height)
            .unwrap_or_else(|error| fail("frame", &error));
        let time_us = number * 1_000_000 / FRAMES_A_SECOND;
        let done_us = time_us + LATENCY_US;
        let mut lap = || counter.lap().unwrap_or_else(|| fail("instructions", &"too many"));
        let mut work = Work::default();
        lap();
        while now_us < done_us {
            now_us = done_us.min(now_us + TICK_US);
            while log
                .due(now_us, |frame, heard_us| lookout.hear(frame, heard_us))
                .unwrap_or_else(|error| fail("flight.tlog", &error))
            {}
            lookout.speak(now_us, |bytes| uart.write(bytes));
        }
        work.others = lap();
        let mut observer = |stage| work.stages[stage as usize] = lap();
        match lookout.see(frame, time_us, &mut observer, || done_us) {
            Ok(found) => {
                digest.update(&found.list);
                detections += found.list.len();
            }
            Err(error) => fail("frame", &error),
        }
        work.others += lap();
        total.add(&work);
        worst = worst.max(work.sum());
        number += 1;
    }
    let (digest, statics, stack) = (digest.value(), ram::statics(), ram::stack());
    print!("{{\"frames\": {number}, \"detections\": {detections}, \"digest\": \"{digest:016x}\", ");
    print!("\"statics\": {statics}, \"stack\": {stack}, \"instructions_worst\": {worst}, ");
    let mean = |sum: u64| sum / number.max(1).unsigned_abs();
    for (stage, sum) in DetectorStage::ALL.iter().zip(total.stages) {
        print!("\"instructions_{}\": {}, ", stage.name(), mean(sum));
    }
    println!("\"instructions_others\": {}}}", mean(total.others));
}

/// Instructions of a frame.
#[derive(Default)]
struct Work {
    /// Of the detector, by stage.
    stages: [u64; DetectorStage::ALL.len()],
    /// Of all else: tracks, and messages heard and sent.
    others: u64,
}

impl Work {
    fn sum(&self) -> u64 {
        self.stages.iter().sum::<u64>() + self.others
    }

    fn add(&mut self, work: &Self) {
        for (sum, stage) in self.stages.iter_mut().zip(work.stages) {
            *sum += stage;
        }
        self.others += work.others;
    }
}

/// Says what is wrong with what, and ends with a status of its own.
fn fail(what: &str, error: &dyn Display) -> ! {
    eprintln!("{what}: {error}");
    process::exit(1)
}
