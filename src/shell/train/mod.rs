//! Training: from flights with known targets to a model file.

pub mod boost;
