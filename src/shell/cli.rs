//! The command line: verbs and what they take.

use super::{bench, doctor, evaluate, import, live, mask, params, replay, train};
use clap::{Parser, Subcommand};
use std::format;

/// Finds other flying objects in a drone's own moving camera.
#[derive(Debug, Clone, Parser)]
#[command(name = "lookout", version, arg_required_else_help = true)]
#[command(after_help = "LOOKOUT_LOG=debug (or info, trace) prints more on standard error.")]
pub struct Cli {
    /// The verb.
    #[command(subcommand)]
    pub verb: Verb,
}

/// Verbs of the program.
#[derive(Debug, Clone, Subcommand)]
pub enum Verb {
    /// Render a flight: frames, ground truth, telemetry
    Simulate(super::simulate::SimulateArgs),
    /// Find flying objects in a recorded flight, or in a simulated one
    Replay(replay::ReplayArgs),
    /// Run on a live camera as a service that reports to autopilot and ground station
    Run(live::RunArgs),
    /// Measure accuracy on a folder of clips with ground truth
    Eval(evaluate::EvalArgs),
    /// Measure accuracy of detections in files
    Score(evaluate::ScoreArgs),
    /// List the clips of folders, for evaluation on many machines (eval --manifest)
    Manifest(evaluate::fleet::manifest::ManifestArgs),
    /// Print the figures of an evaluation on many machines
    Merge(evaluate::fleet::merge::MergeArgs),
    /// Convert labels (YOLO, COCO, MOTChallenge, CVAT, Pascal VOC, AOT) to a folder of clips
    Import(import::ImportArgs),
    /// Measure speed and memory
    Bench(bench::BenchArgs),
    /// Check links, the autopilot's parameters and video sources
    Doctor(doctor::DoctorArgs),
    /// Find the own craft's parts in a recorded flight, so that nothing is reported there
    Mask(mask::MaskArgs),
    /// Read or set the parameters (LK_..) of a running lookout over a link
    Params(params::ParamsArgs),
    /// Train a model on folders of clips with ground truth
    Train(train::TrainArgs),
    /// Look for windows to train on in a part of the clips: training on many machines, together with fit
    Mine(train::MineArgs),
    /// Train on the windows that mine found; the model is that of train
    Fit(train::FitArgs),
}
