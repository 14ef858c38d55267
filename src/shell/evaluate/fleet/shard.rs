//! The part of a manifest that one process works on.

use super::FleetError;
use std::string::{String, ToString};

/// Every `count`th clip, from the `index`th on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Number of this shard, from 0.
    pub index: usize,
    /// How many there are, at least 1.
    pub count: usize,
}

impl Default for Shard {
    /// All of it.
    fn default() -> Self {
        Self { index: 0, count: 1 }
    }
}

/// Index and count of the engines that start many processes alike.
const ENGINES: [(&str, &str); 3] = [
    ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_COUNT"),
    // Kubernetes says the index alone; the job's file repeats `completions`, see examples/fleet.
    ("JOB_COMPLETION_INDEX", "JOB_COMPLETIONS"),
    ("AWS_BATCH_JOB_ARRAY_INDEX", "AWS_BATCH_JOB_ARRAY_SIZE"),
];

impl Shard {
    /// `I/N`, for the command line.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let wrong = || String::from("expected I/N with I from 0 to N - 1");
        let (index, count) = text.split_once('/').ok_or_else(wrong)?;
        let number = |text: &str| text.parse::<usize>().map_err(|_| wrong());
        let shard = Self { index: number(index)?, count: number(count)? };
        if shard.index < shard.count { Ok(shard) } else { Err(wrong()) }
    }

    /// Shard that an engine's environment variables name, and the variable's name; `None` without one.
    ///
    /// # Errors
    /// [`FleetError::Shard`] naming the variable that is missing or wrong.
    pub fn of_environment(
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Option<(Self, &'static str)>, FleetError> {
        for (index, count) in ENGINES {
            if variable(index).is_none() {
                continue;
            }
            let number = |name: &str| {
                let value = variable(name).unwrap_or_default();
                value.parse::<usize>().map_err(|_| FleetError::Shard {
                    name: name.to_string(),
                    value,
                    reason: "expected a whole number beside the index; or give --shard I/N",
                })
            };
            let mut shard = Self { index: number(index)?, count: number(count)? };
            if index == "SLURM_ARRAY_TASK_ID" {
                // `--array=1-9:2` has the numbers 1, 3, 5, 7, 9.
                let (min, max) = (number("SLURM_ARRAY_TASK_MIN")?, number("SLURM_ARRAY_TASK_MAX")?);
                let step = max.saturating_sub(min) / shard.count.saturating_sub(1).max(1);
                shard.index = shard.index.saturating_sub(min) / step.max(1);
            }
            if shard.index >= shard.count {
                return Err(FleetError::Shard {
                    name: index.to_string(),
                    value: shard.index.to_string(),
                    reason: "it is not below the count",
                });
            }
            return Ok(Some((shard, index)));
        }
        Ok(None)
    }

    /// Whether the clip at `place` of the manifest, from 0, belongs to it.
    pub fn holds(self, place: usize) -> bool {
        place % self.count == self.index
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(variables: &[(&str, &str)]) -> Result<Option<Shard>, String> {
        let find = |name: &str| variables.iter().find(|v| v.0 == name).map(|v| v.1.to_string());
        let found = Shard::of_environment(find).map_err(|error| error.to_string())?;
        Ok(found.map(|(shard, _)| shard))
    }

    #[test]
    fn shards_in_words() {
        assert_eq!(Shard::parse("0/1"), Ok(Shard::default()));
        assert_eq!(Shard::parse("3/64"), Ok(Shard { index: 3, count: 64 }));
        for wrong in ["3", "3/3", "-1/3", "0/0", "a/2", "1/"] {
            assert!(Shard::parse(wrong).is_err(), "{wrong}");
        }
        let parts = [0, 1, 2].map(|index| Shard { index, count: 3 });
        for place in 0..9 {
            assert_eq!(parts.iter().filter(|part| part.holds(place)).count(), 1);
        }
    }

    #[test]
    fn engines_say_which_one() {
        assert_eq!(of(&[]), Ok(None));
        let batch = [("AWS_BATCH_JOB_ARRAY_INDEX", "2"), ("AWS_BATCH_JOB_ARRAY_SIZE", "9")];
        assert_eq!(of(&batch), Ok(Some(Shard { index: 2, count: 9 })));
        let job = [("JOB_COMPLETION_INDEX", "2"), ("JOB_COMPLETIONS", "3")];
        assert_eq!(of(&job), Ok(Some(Shard { index: 2, count: 3 })));
        assert!(of(&job[..1]).unwrap_err().starts_with("JOB_COMPLETIONS"));
        assert!(of(&[job[0], ("JOB_COMPLETIONS", "2")]).unwrap_err().contains("not below"));
        let array = |id, min, max, count| {
            of(&[
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_MIN", min),
                ("SLURM_ARRAY_TASK_MAX", max),
                ("SLURM_ARRAY_TASK_COUNT", count),
            ])
        };
        assert_eq!(array("0", "0", "63", "64"), Ok(Some(Shard { index: 0, count: 64 })));
        assert_eq!(array("9", "1", "9", "9"), Ok(Some(Shard { index: 8, count: 9 })));
        assert_eq!(array("5", "1", "9", "5"), Ok(Some(Shard { index: 2, count: 5 })));
        assert_eq!(array("7", "7", "7", "1"), Ok(Some(Shard { index: 0, count: 1 })));
    }
}
