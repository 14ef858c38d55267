//! Flights are not reported as blind; the same flights out of focus are. A simulated flight is always there, recorded ones
//! where `../shared/data` is.
//!
//! All clips with LOOKOUT_ALL_FLIGHTS=1; LOOKOUT_MEASURE=1 prints what is measured in them.
#![cfg(feature = "std")]

use lookout::mavlink::messages::Blind;
use lookout::shell::live::image_health::{ImageHealth, Measures};
use lookout::shell::simulate::SimulateSettings;
use lookout::shell::simulate::source::Simulated;
use lookout::shell::sources::{self, Frame, FrameSource};
use std::path::Path;
use std::sync::Arc;
use std::{env, fs};

/// Interval of the frames that are judged, in frames.
const EVERY: u64 = 12;

/// The picture out of focus by a Gaussian of `sigma` pixels, with a sensor's noise.
fn blurred(frame: &Frame, sigma: f32) -> Frame {
    let (width, height) = (frame.width as u32, frame.height as u32);
    let picture = image::GrayImage::from_raw(width, height, frame.pixels.clone()).unwrap();
    let mut random = 0x2015_0711_u32;
    let mut noise = || {
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        [0, 8, 16, 24].iter().map(|shift| ((random >> shift) & 255) as i32 % 5 - 2).sum::<i32>()
    };
    let pixels = image::imageops::fast_blur(&picture, sigma).into_raw();
    let pixels = pixels.iter().map(|&p| (i32::from(p) + noise()).clamp(0, 255) as u8).collect();
    Frame { pixels, ..frame.clone() }
}

/// Frames of a flight, a second apart as the judgement sees them.
fn frames(source: &mut dyn FrameSource) -> Vec<Arc<Frame>> {
    let (mut frame, mut kept) = (Frame::default(), Vec::new());
    let mut number = 0;
    while source.next_frame(&mut frame).unwrap() {
        if number % EVERY == 0 {
            let time_us = kept.len() as i64 * 1_000_000;
            kept.push(Arc::new(Frame { time_us, ..frame.clone() }));
        }
        number += 1;
    }
    kept
}

#[test]
fn recorded_flights_are_seen_and_out_of_focus_they_are_not() {
    let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
    let step = if env::var_os("LOOKOUT_ALL_FLIGHTS").is_some() { 1 } else { 16 };
    let mut folders = Vec::new();
    for split in ["real/dev", "airborne/dev"] {
        let Ok(entries) = fs::read_dir(data.join(split)) else {
            println!("skipped: {split} is not here");
            continue;
        };
        let mut clips: Vec<_> = entries.map(|e| e.unwrap().path()).collect();
        clips.retain(|folder| folder.is_dir());
        clips.sort();
        folders.extend(clips.into_iter().step_by(step).map(Some));
    }
    let measure = env::var_os("LOOKOUT_MEASURE").is_some();
    let (mut reported, mut lost) = (0, 0);
    // `None` is the simulated flight.
    for folder in [None].iter().chain(&folders) {
        let (name, frames) = match folder {
            Some(folder) => {
                let mut source = sources::open(folder.to_str().unwrap()).unwrap();
                (folder.display().to_string(), frames(&mut source))
            }
            None => {
                let mut source = Simulated::new(&SimulateSettings::default());
                ("simulated".into(), frames(&mut source))
            }
        };
        assert!(frames.len() >= 4, "{name}: {} frames", frames.len());
        let mut health = ImageHealth::default();
        let blind: Vec<Blind> = frames.iter().map(|frame| health.assess(frame)).collect();
        if measure {
            let all: Vec<Measures> = frames.iter().map(|frame| Measures::of(frame)).collect();
            let steep = |all: &[Measures]| {
                let mut known: Vec<u32> = all.iter().filter_map(|m| m.steep).collect();
                known.sort_unstable();
                (known.first().copied(), known.last().copied(), known.len())
            };
            let dark = all.iter().map(|m| m.dark).max().unwrap();
            let white = all.iter().map(|m| m.white).max().unwrap();
            print!("{name} {} dark {dark} white {white} {:?}", all.len(), steep(&all));
            for sigma in [2.0, 3.0, 5.0, 8.0] {
                let some = frames.iter().step_by(6);
                let all: Vec<_> = some.map(|f| Measures::of(&blurred(f, sigma))).collect();
                print!(" | {sigma} {:?}", steep(&all));
            }
            println!();
            continue;
        }
        assert!(blind.iter().all(|blind| !blind.any()), "{name}: {blind:?}");
        // Where there are edges at all, sharp ones are distinguished from soft ones.
        let edges = Measures::of(&frames[frames.len() / 2]).steep.is_some();
        let mut health = ImageHealth::default();
        let soft = |frame: &Arc<Frame>| health.assess(&Arc::new(blurred(frame, 6.0)));
        let soft: Vec<Blind> = frames.iter().take(4).map(soft).collect();
        match soft.last() {
            Some(blind) if blind.has(Blind::BLUR) => reported += 1,
            _ if edges => lost += 1,
            _ => {}
        }
    }
    println!(
        "{} clips; out of focus: {reported} reported, {lost} not though there were edges",
        folders.len() + 1
    );
    assert!(measure || reported > 0 && reported >= lost, "{reported} reported, {lost} not");
}
