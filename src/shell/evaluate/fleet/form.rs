//! Form of the files of a run.

use serde::{Deserialize, Serialize};
use std::path::Path;

/// Form of the results of a run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ResultForm {
    /// Lines of JSON.
    #[default]
    Lines,
    /// Parquet, with the feature `parquet`.
    Parquet,
}

impl ResultForm {
    /// Extension of the files.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Lines => "jsonl",
            Self::Parquet => "parquet",
        }
    }
}

/// Whether a file is a Parquet file, by its name.
pub fn is_parquet(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == ResultForm::Parquet.extension())
}
