//! XML files: attributes and children with errors that name file, line and field.

use super::ImportError;
use roxmltree::{Document, Node};
use std::path::Path;
use std::string::String;
use std::{format, fs};

/// The text of a file without a byte-order mark.
///
/// # Errors
/// [`ImportError::Read`].
pub fn text(path: &Path) -> Result<String, ImportError> {
    let bytes = fs::read(path).map_err(ImportError::read(path))?;
    let text = String::from_utf8_lossy(&bytes);
    Ok(text.strip_prefix('\u{feff}').unwrap_or(&text).into())
}

/// A parsed XML file, with its path for errors.
#[derive(Debug)]
pub struct Xml<'a> {
    path: &'a Path,
    /// Elements and attributes of the file.
    pub document: Document<'a>,
}

impl<'a> Xml<'a> {
    /// Parses `text`, the contents of `path`.
    ///
    /// # Errors
    /// [`ImportError::Xml`].
    pub fn parse(path: &'a Path, text: &'a str) -> Result<Self, ImportError> {
        // Pascal VOC files of some tools name a document type; entities are still bounded by the parser.
        let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
        let document = Document::parse_with_options(text, options)
            .map_err(|source| ImportError::Xml { path: path.into(), source })?;
        Ok(Self { path, document })
    }

    /// An attribute as a number.
    ///
    /// # Errors
    /// [`ImportError::Value`].
    pub fn attribute(&self, node: Node<'_, '_>, name: &'static str) -> Result<f64, ImportError> {
        self.number(node, name, node.attribute(name))
    }

    /// The text of the child `name` as a number.
    ///
    /// # Errors
    /// [`ImportError::Value`].
    pub fn child(&self, node: Node<'_, '_>, name: &'static str) -> Result<f64, ImportError> {
        self.number(node, name, child(node, name).and_then(|child| child.text()))
    }

    /// The error that `what` of `node` is not as expected.
    pub fn wrong(
        &self,
        node: Node<'_, '_>,
        what: &'static str,
        value: Option<&str>,
        expected: &'static str,
    ) -> ImportError {
        let line = self.document.text_pos_at(node.range().start).row;
        let value = value.map_or(String::new(), |value| format!("{}", value.escape_debug()));
        ImportError::Value { path: self.path.into(), line: Some(line), what, value, expected }
    }

    fn number(
        &self,
        node: Node<'_, '_>,
        name: &'static str,
        text: Option<&str>,
    ) -> Result<f64, ImportError> {
        let number =
            text.and_then(|text| text.trim().parse::<f64>().ok()).filter(|v| v.is_finite());
        number.ok_or_else(|| self.wrong(node, name, text, "a number"))
    }
}

/// The first child of that name.
pub fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|child| child.has_tag_name(name))
}

/// All children of that name.
pub fn children<'a, 'i: 'a>(
    node: Node<'a, 'i>,
    name: &'a str,
) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |child| child.has_tag_name(name))
}
