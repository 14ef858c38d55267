//! Progress of a training on the terminal and as JSON Lines, and the generated part of a model card.

use super::boost::Round;
use super::stage::TrainingStage;
use super::{TrainArgs, TrainError};
use crate::shell::error::Error;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::time::Instant;
use std::vec::Vec;
use std::{eprintln, format};

/// Between these lines the card is the trainer's; the rest of it is left as it is.
const BEGIN: &str = "<!-- written by lookout train -->";
const END: &str = "<!-- end of what lookout train writes -->";

/// Clips and frames learned from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrainingSummary {
    /// Number of clips, held back ones included.
    pub clips: usize,
    /// Of these, clips that were shown again with objects pasted in.
    pub pasted_clips: usize,
    /// Frames of the clips that are learned from.
    pub samples: usize,
    /// Clips held back for validation and calibration.
    pub held_back_clips: usize,
    /// Frames of the clips held back.
    pub held_back_samples: usize,
    /// Rendered flights among the clips.
    pub rendered: usize,
    /// Clips without targets among them.
    pub empty: usize,
}

impl TrainingSummary {
    /// Of which kinds the clips are, in words that follow their number.
    fn more(&self) -> String {
        let kinds = [
            (self.rendered, "rendered"),
            (self.empty, "without targets"),
            (self.pasted_clips, "shown again with objects of others pasted in"),
        ];
        let kinds = kinds.iter().filter(|(count, _)| *count > 0);
        let kinds: Vec<String> = kinds.map(|(count, kind)| format!("{count} {kind}")).collect();
        if kinds.is_empty() { String::new() } else { format!(" ({})", kinds.join(", ")) }
    }
}

/// Progress, log and card.
#[derive(Debug)]
pub struct TrainingReport {
    path: PathBuf,
    /// None where progress alone is shown.
    log: Option<File>,
    started: Instant,
    /// When the first stage of this run began, and the shares of the stages since.
    worked: Option<(Instant, u64)>,
}

/// Share of a training's time that measuring the precision of scores takes, percent.
const CALIBRATION: u64 = 8;

impl TrainingReport {
    /// Starts the log at `path`, or goes on with it.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn create(path: &Path, go_on: bool) -> Result<Self, Error> {
        let log = OpenOptions::new()
            .create(true)
            .write(true)
            .append(go_on)
            .truncate(!go_on)
            .open(path)
            .map_err(Error::write(path))?;
        Ok(Self { path: path.into(), log: Some(log), started: Instant::now(), worked: None })
    }

    /// Progress on the terminal alone: several machines work at the same model.
    pub fn without_log() -> Self {
        Self { path: PathBuf::new(), log: None, started: Instant::now(), worked: None }
    }

    fn line(&mut self, mut value: serde_json::Value) -> Result<(), Error> {
        value["seconds"] = json!(self.started.elapsed().as_secs());
        let Some(log) = &mut self.log else { return Ok(()) };
        writeln!(log, "{value}").map_err(Error::write(&self.path))
    }

    /// A progress bar of a stage of `length` steps; 0 where the number is not known.
    pub fn bar(&self, name: &str, length: u64) -> ProgressBar {
        let bar = if length > 0 { ProgressBar::new(length) } else { ProgressBar::new_spinner() };
        let style = ProgressStyle::with_template(
            "{elapsed_precise} {wide_msg} {bar:30} {pos}/{len} {eta_precise} left",
        );
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.set_message(name.to_string());
        bar
    }

    /// Says something on the terminal and in the log.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn note(&mut self, text: &str) -> Result<(), Error> {
        eprintln!("{:>6} s  {text}", self.started.elapsed().as_secs());
        self.line(json!({ "note": text }))
    }

    /// Says that stage `number` of `stages` begins, and how long the rest will take by the stages before.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn stage(&mut self, stages: &[TrainingStage], number: usize) -> Result<(), Error> {
        let rest = stages[number..].iter().map(|stage| stage.share()).sum::<u64>() + CALIBRATION;
        let (began, share) = *self.worked.get_or_insert_with(|| (Instant::now(), 0));
        let left = match began.elapsed().as_secs_f64() * rest as f64 / share as f64 {
            seconds if share > 0 => format!("; about {} left", duration(seconds)),
            _ => String::new(),
        };
        self.worked = Some((began, share + stages[number].share()));
        let (of, title) = (stages.len(), stages[number].title());
        self.note(&format!("stage {} of {of}: {title}{left}", number + 1))
    }

    /// A round of boosting in the log.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn round(&mut self, stage: &str, round: &Round) -> Result<(), Error> {
        self.line(json!({
            "stage": stage,
            "trees": round.trees,
            "loss": round.train_loss,
            "held_back": round.validation_loss,
        }))
    }

    /// Prints size, precision and time of the model, and writes the card if `--card` is given.
    ///
    /// # Errors
    /// [`Error`] of a card that is no text or cannot be written.
    pub fn finish(
        &mut self,
        args: &TrainArgs,
        bytes: &[u8],
        summary: &TrainingSummary,
        precision: &str,
    ) -> Result<(), Error> {
        let time = duration(self.started.elapsed().as_secs_f64());
        self.note(&format!("precision on the clips held back (IoU 0.3): {precision}"))?;
        self.note(&format!("{}: {} bytes, in {time}", args.out.display(), bytes.len()))?;
        let Some(path) = &args.card else { return Ok(()) };
        let name = name(&args.out);
        let TrainingSummary { clips, samples, held_back_clips, held_back_samples, .. } = summary;
        let generated = format!(
            "{BEGIN}\n| | |\n| --- | --- |\n{}\n| command | `{}` |\n\
             | learned from | {samples} frames of {} clips{} |\n| held back to decide when to stop | \
             {held_back_samples} frames of {held_back_clips} clips |\n{}\n| time | {time} |\n{END}",
            model_row(&name, bytes),
            super::command(),
            clips - held_back_clips,
            summary.more(),
            precision_row(precision),
        );
        let old = read_card(path)?;
        let text: String = match (old.find(BEGIN), old.find(END)) {
            (Some(begin), Some(end)) if begin < end => {
                format!("{}{generated}{}", &old[..begin], &old[end + END.len()..])
            }
            _ if old.is_empty() => format!("# {name}\n\n{generated}\n"),
            _ => format!("{}\n\n# {name}\n\n{generated}\n", old.trim_end()),
        };
        super::write(path, text.as_bytes())
    }
}

/// The card at `path`; empty where there is none.
fn read_card(path: &Path) -> Result<String, Error> {
    match fs::read_to_string(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(String::new()),
        text => Ok(text.map_err(|source| TrainError::Card { path: path.into(), source })?),
    }
}

/// Seconds as a person says them.
fn duration(seconds: f64) -> String {
    match seconds.max(0.0).round() as u64 {
        seconds if seconds < 90 => format!("{seconds} seconds"),
        seconds if seconds < 5400 => format!("{} minutes", (seconds + 30) / 60),
        seconds => format!("{:.1} hours", seconds as f64 / 3600.0),
    }
}

fn name(model: &Path) -> String {
    model.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn model_row(name: &str, bytes: &[u8]) -> String {
    let checksum = crate::model::checksum(&bytes[20..]);
    format!("| model | `{name}`, {} bytes, CRC-32 {checksum:08x} |", bytes.len())
}

fn precision_row(precision: &str) -> String {
    format!("| precision on the clips held back (IoU 0.3) | {precision} |")
}

/// Writes the rows of the generated part of the card at `path` that change with the table of precisions; a card
/// without a generated part is left as it is.
///
/// # Errors
/// [`Error::Write`].
pub fn refresh_card(path: &Path, model: &Path, bytes: &[u8], precision: &str) -> Result<(), Error> {
    let old = read_card(path)?;
    let Some((before, rest)) = old.split_once(BEGIN) else { return Ok(()) };
    let Some((generated, after)) = rest.split_once(END) else { return Ok(()) };
    let row = precision_row(precision);
    let is_precision = |line: &&str| line.starts_with("| precision ");
    let mut lines: Vec<&str> = generated.lines().filter(|line| !is_precision(line)).collect();
    let model_row = model_row(&name(model), bytes);
    let place = lines.iter().position(|line| line.starts_with("| model |"));
    place.into_iter().for_each(|place| lines[place] = &model_row);
    let end = lines.iter().position(|line| line.starts_with("| time |")).unwrap_or(lines.len());
    lines.insert(end, &row);
    super::write(path, format!("{before}{BEGIN}{}\n{END}{after}", lines.join("\n")).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_table_changes_its_rows_of_the_card_alone() {
        let folder = tempfile::tempdir().unwrap();
        let (card, model) = (folder.path().join("README.md"), folder.path().join("a.lkm"));
        let refresh = |precision: &str| {
            refresh_card(&card, &model, &[0; 24], precision).unwrap();
            fs::read_to_string(&card).unwrap_or_default()
        };
        assert_eq!(refresh("0.9 from score 1.00"), "", "no card is begun");
        let text = |model: &str, precision: &str| {
            format!(
                "# a.lkm\n\n{BEGIN}\n| | |\n| --- | --- |\n{model}\n| command | `x` |\n{precision}| time | 7 minutes |\n{END}\n\nMore.\n"
            )
        };
        fs::write(&card, text("| model | old |", "")).unwrap();
        let row = |precision| format!("{}\n", precision_row(precision));
        let model_row = model_row("a.lkm", &[0; 24]);
        assert_eq!(refresh("first"), text(&model_row, &row("first")));
        assert_eq!(refresh("second"), text(&model_row, &row("second")));
    }
}
