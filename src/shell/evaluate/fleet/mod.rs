//! Evaluation of thousands of clips on many machines: `lookout manifest`, `lookout eval --manifest M --shard I/N --out DIR`,
//! `lookout merge DIR`.
//!
//! A manifest lists clips; a shard is every Nth of them. Each clip's result is a file of its own, which is there whole or
//! not at all, and whose name holds the contents of the clip, the model and the arguments: so a run that was ended goes on
//! where it was, on any number of machines, and a changed clip, model or argument begins anew. No machine speaks to
//! another; they share the folder. `merge` makes of the files what `lookout eval` on one machine would have printed.

mod error;
pub mod fetch;
pub mod form;
pub mod manifest;
pub mod merge;
pub mod outcome;
mod parts;
pub mod row;
pub mod run;
pub mod settings;
pub mod shard;
#[cfg_attr(not(feature = "parquet"), path = "no_table.rs")]
mod table;
pub mod turn;

pub use error::FleetError;
