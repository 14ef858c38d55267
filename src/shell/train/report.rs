//! What training tells: progress on the terminal, a log in JSON Lines, the generated part of the model card.

use super::boost::Round;
use crate::shell::error::Error;
use crate::shell::support::file_error::FileError;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::time::{Duration, Instant};
use std::vec::Vec;
use std::{eprintln, format};

/// Between these lines the card is the trainer's; the rest of it is left as it is.
const BEGIN: &str = "<!-- written by lookout train -->";
const END: &str = "<!-- end of what lookout train writes -->";

/// What was learned from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Summary {
    /// Clips in all.
    pub clips: usize,
    /// Of these, clips that were shown again with objects pasted in.
    pub pasted_clips: usize,
    /// Frames learned from.
    pub samples: usize,
    /// Clips held back.
    pub held_back_clips: usize,
    /// Frames of those.
    pub held_back_samples: usize,
}

/// Progress, log and card.
#[derive(Debug)]
pub struct Report {
    path: PathBuf,
    log: File,
    started: Instant,
}

impl Report {
    /// Starts the log at `path`, or goes on with it.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn create(path: &Path, go_on: bool) -> Result<Self, Error> {
        let log = OpenOptions::new()
            .create(true)
            .write(true)
            .append(go_on)
            .truncate(!go_on)
            .open(path)
            .map_err(|source| FileError::Write { path: path.into(), source })?;
        Ok(Self { path: path.into(), log, started: Instant::now() })
    }

    fn line(&mut self, mut value: serde_json::Value) -> Result<(), Error> {
        value["seconds"] = json!(self.started.elapsed().as_secs());
        writeln!(self.log, "{value}")
            .map_err(|source| FileError::Write { path: self.path.clone(), source }.into())
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
    /// [`FileError::Write`].
    pub fn note(&mut self, text: &str) -> Result<(), Error> {
        eprintln!("{:>6} s  {text}", self.started.elapsed().as_secs());
        self.line(json!({ "note": text }))
    }

    /// A round of boosting in the log.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn round(&mut self, stage: &str, round: &Round) -> Result<(), Error> {
        self.line(json!({
            "stage": stage,
            "trees": round.trees,
            "loss": round.train_loss,
            "held_back": round.validation_loss,
        }))
    }

    /// Writes the generated part of the card at `path`.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn card(
        &self,
        path: &Path,
        model: &Path,
        bytes: &[u8],
        summary: &Summary,
        precision: &str,
        time: Duration,
    ) -> Result<(), Error> {
        let Summary { clips, pasted_clips, samples, held_back_clips, held_back_samples } = summary;
        let again = match pasted_clips {
            0 => String::new(),
            clips => format!("; {clips} of them again with objects of others pasted in"),
        };
        let name = name(model);
        let generated = format!(
            "{BEGIN}\n| | |\n| --- | --- |\n{}\n| command | `{}` |\n\
             | learned from | {samples} frames of {} clips{again} |\n| held back to decide when to stop | \
             {held_back_samples} frames of {held_back_clips} clips |\n{}\n| time | {} minutes |\n{END}",
            model_row(&name, bytes),
            super::command(),
            clips - held_back_clips,
            precision_row(precision),
            time.as_secs().div_ceil(60),
        );
        let old = fs::read_to_string(path).unwrap_or_default();
        let text: String = match (old.find(BEGIN), old.find(END)) {
            (Some(begin), Some(end)) if begin < end => {
                format!("{}{generated}{}", &old[..begin], &old[end + END.len()..])
            }
            _ => format!("{old}# {name}\n\n{generated}\n"),
        };
        super::write(path, text.as_bytes())
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
/// [`FileError::Write`].
pub fn refresh_card(path: &Path, model: &Path, bytes: &[u8], precision: &str) -> Result<(), Error> {
    let old = fs::read_to_string(path).unwrap_or_default();
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
