//! The command line: verbs and what they take.

use super::{bench, doctor, evaluate, import, live, mask, params, replay, train};
use clap::{Parser, Subcommand};
use std::format;

/// Finds other flying objects in a drone's own moving camera.
#[derive(Debug, Clone, Parser)]
#[command(name = "lookout", version, arg_required_else_help = true)]
#[command(after_help = "LOOKOUT_LOG=debug (or info, trace) tells more on standard error.")]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

/// What the program can do.
#[derive(Debug, Clone, Subcommand)]
pub enum Verb {
    /// Render a flight: frames, ground truth and what camera and target did
    Simulate(super::simulate::SimulateArgs),
    /// Find flying objects in a recorded flight, or in a simulated one
    Replay(replay::ReplayArgs),
    /// Watch through a live camera and tell autopilot and ground station, as a service
    Run(live::RunArgs),
    /// Measure accuracy on a folder of clips with ground truth
    Eval(evaluate::EvalArgs),
    /// Measure accuracy of detections in files
    Score(evaluate::ScoreArgs),
    /// Write labels of other forms (YOLO, COCO, MOTChallenge, CVAT, Pascal VOC, AOT) as a folder of clips
    Import(import::ImportArgs),
    /// Measure speed and memory
    Bench(bench::BenchArgs),
    /// Tell what is missing between the lookout and the autopilot
    Doctor(doctor::DoctorArgs),
    /// Find the own craft's parts in a recorded flight, so that nothing is reported there
    Mask(mask::MaskArgs),
    /// Read or set the parameters (LK_..) of a running lookout over a link
    Params(params::ParamsArgs),
    /// Learn a model from a folder of clips with ground truth
    Train(train::TrainArgs),
}
