//! Parquet: manifests, and results of clips as tables that data tools read.
//!
//! A result has one row a detection (frame from 1; left, top, width, height in pixels; score in log-odds), then one row a
//! frame with its time in the detector (`ms`). The file's metadata has the rest, counts and tracks among it, as JSON under
//! the key [`HEAD`].

use super::FleetError;
use super::parts::OutcomeParts;
use super::row::ManifestRow;
use crate::shell::error::Error;
use crate::shell::evaluate::matching::DetectionRecord;
use parquet::basic::Compression;
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::{Field, Row};
use parquet::schema::parser::parse_message_type;
use std::fs::File;
use std::path::Path;
use std::string::{String, ToString};
use std::sync::Arc;
use std::vec::Vec;
use std::{format, vec};

/// Key of the metadata with all of a result but its rows, as JSON.
const HEAD: &str = "lookout.clip";

const RESULT: &str = "message result {
  required int64 frame;
  optional double left; optional double top; optional double width; optional double height; optional double score;
  optional double ms;
}";

const MANIFEST: &str = "message manifest {
  required binary clip (utf8); required binary split (utf8); required binary path (utf8);
  optional binary labels (utf8); optional binary telemetry (utf8); optional binary tags (utf8);
}";

/// Values of a column, one a row.
enum Column {
    Whole(Vec<i64>),
    /// None in rows without a value.
    Real(Vec<Option<f64>>),
    Text(Vec<String>),
    /// Empty ones are stored as none.
    SomeText(Vec<String>),
}

/// The bytes of a file with these columns in the order of `schema`.
fn encode(
    schema: &str,
    columns: Vec<Column>,
    head: Option<String>,
) -> Result<Vec<u8>, ParquetError> {
    let properties = WriterProperties::builder()
        .set_created_by(format!("lookout {}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::SNAPPY)
        .set_key_value_metadata(head.map(|head| vec![KeyValue::new(HEAD.to_string(), head)]))
        .build();
    let schema = Arc::new(parse_message_type(schema)?);
    let mut bytes = Vec::new();
    let mut writer = SerializedFileWriter::new(&mut bytes, schema, Arc::new(properties))?;
    let mut group = writer.next_row_group()?;
    for column in columns {
        let Some(mut writer) = group.next_column()? else { break };
        write(writer.untyped(), column)?;
        writer.close()?;
    }
    group.close()?;
    writer.close()?;
    Ok(bytes)
}

fn write(writer: &mut ColumnWriter<'_>, column: Column) -> Result<(), ParquetError> {
    let levels = |there: &mut dyn Iterator<Item = bool>| there.map(i16::from).collect::<Vec<i16>>();
    match (writer, column) {
        (ColumnWriter::Int64ColumnWriter(writer), Column::Whole(values)) => {
            writer.write_batch(&values, None, None)?;
        }
        (ColumnWriter::DoubleColumnWriter(writer), Column::Real(values)) => {
            let levels = levels(&mut values.iter().map(Option::is_some));
            let values: Vec<f64> = values.into_iter().flatten().collect();
            writer.write_batch(&values, Some(&levels), None)?;
        }
        (ColumnWriter::ByteArrayColumnWriter(writer), Column::Text(values)) => {
            let values: Vec<ByteArray> = values.iter().map(|value| value.as_str().into()).collect();
            writer.write_batch(&values, None, None)?;
        }
        (ColumnWriter::ByteArrayColumnWriter(writer), Column::SomeText(values)) => {
            let levels = levels(&mut values.iter().map(|value| !value.is_empty()));
            let there = values.iter().filter(|value| !value.is_empty());
            let values: Vec<ByteArray> = there.map(|value| value.as_str().into()).collect();
            writer.write_batch(&values, Some(&levels), None)?;
        }
        _ => {
            return Err(ParquetError::General("a column of another type than the schema's".into()));
        }
    }
    Ok(())
}

fn open(path: &Path, wrong: Wrong) -> Result<SerializedFileReader<File>, Error> {
    let file = File::open(path).map_err(Error::read(path))?;
    SerializedFileReader::new(file).map_err(|error| wrong(path, error.to_string()))
}

/// The error of a file and a reason.
type Wrong = fn(&Path, String) -> Error;

fn wrong_result(path: &Path, reason: String) -> Error {
    let reason = format!("not the result of a clip: {reason}");
    Error::verb(FleetError::Result { path: path.into(), reason })
}

fn wrong_manifest(path: &Path, reason: String) -> Error {
    FleetError::Table { path: path.into(), reason }.forever()
}

/// Calls `row` with each row of a file.
fn each(
    reader: &dyn FileReader,
    path: &Path,
    wrong: Wrong,
    mut row: impl FnMut(&Row) -> Result<(), String>,
) -> Result<(), Error> {
    let rows = reader.get_row_iter(None).map_err(|error| wrong(path, error.to_string()))?;
    for (number, found) in rows.enumerate() {
        let found = found.map_err(|error| error.to_string());
        found
            .and_then(|found| row(&found))
            .map_err(|reason| wrong(path, format!("row {}: {reason}", number + 1)))?;
    }
    Ok(())
}

/// The bytes of a manifest; `path` is that of the file.
///
/// # Errors
/// [`FleetError::Table`].
pub fn encode_manifest(path: &Path, rows: &[ManifestRow]) -> Result<Vec<u8>, Error> {
    let text = |of: fn(&ManifestRow) -> &String| rows.iter().map(|row| of(row).clone()).collect();
    let columns = vec![
        Column::Text(text(|row| &row.clip)),
        Column::Text(text(|row| &row.split)),
        Column::Text(text(|row| &row.path)),
        Column::SomeText(text(|row| &row.labels)),
        Column::SomeText(text(|row| &row.telemetry)),
        Column::SomeText(text(|row| &row.tags)),
    ];
    encode(MANIFEST, columns, None).map_err(|error| wrong_manifest(path, error.to_string()))
}

/// The rows of a manifest; the columns labels, telemetry and tags may be missing, others are not read.
///
/// # Errors
/// [`Error`] of a file that cannot be read, [`FleetError::Table`] naming the column.
pub fn read_manifest(path: &Path) -> Result<Vec<ManifestRow>, Error> {
    let reader = open(path, wrong_manifest)?;
    let mut rows = Vec::new();
    each(&reader, path, wrong_manifest, |row| {
        let mut found = ManifestRow::default();
        for (name, field) in row.get_column_iter() {
            let place = match name.as_str() {
                "clip" => &mut found.clip,
                "split" => &mut found.split,
                "path" => &mut found.path,
                "labels" => &mut found.labels,
                "telemetry" => &mut found.telemetry,
                "tags" => &mut found.tags,
                _ => continue,
            };
            match field {
                Field::Str(text) => place.clone_from(text),
                Field::Null => {}
                _ => return Err(format!("column {name} is no text")),
            }
        }
        rows.push(found);
        Ok(())
    })?;
    Ok(rows)
}

/// The bytes of a result.
///
/// # Errors
/// [`FleetError::Result`], by a fault of the program.
pub fn encode_outcome((head, found, times_ms): &OutcomeParts) -> Result<Vec<u8>, Error> {
    let wrong = |reason: String| wrong_result(Path::new("clips"), reason);
    let head = serde_json::to_string(head).map_err(|error| wrong(error.to_string()))?;
    let frame = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
    let frames = found.iter().map(|found| found.frame).chain(1..=times_ms.len() as u64);
    let real = |of: &dyn Fn(&DetectionRecord) -> f64| {
        let values = found.iter().map(|found| Some(of(found)));
        Column::Real(values.chain(times_ms.iter().map(|_| None)).collect())
    };
    let times = found.iter().map(|_| None).chain(times_ms.iter().copied().map(Some));
    let columns = vec![
        Column::Whole(frames.map(frame).collect()),
        real(&|found| found.rect[0]),
        real(&|found| found.rect[1]),
        real(&|found| found.rect[2]),
        real(&|found| found.rect[3]),
        real(&|found| found.score),
        Column::Real(times.collect()),
    ];
    encode(RESULT, columns, Some(head)).map_err(|error| wrong(error.to_string()))
}

/// Head (JSON) and detections of a result.
///
/// # Errors
/// [`Error`] of a file that cannot be read, [`FleetError::Result`] for another file.
pub fn read_outcome(path: &Path) -> Result<(String, Vec<DetectionRecord>), Error> {
    let reader = open(path, wrong_result)?;
    let head = head_of(&reader, path)?;
    let mut found = Vec::new();
    each(&reader, path, wrong_result, |row| {
        let (mut frame, mut values) = (None, [None; 5]);
        for (name, field) in row.get_column_iter() {
            let place = ["left", "top", "width", "height", "score"].iter().position(|n| n == name);
            match (place.and_then(|place| values.get_mut(place)), field) {
                (Some(value), Field::Double(number)) => *value = Some(*number),
                (None, Field::Long(number)) if name == "frame" => frame = Some(*number),
                _ => {}
            }
        }
        match (frame.and_then(|frame| u64::try_from(frame).ok()), values) {
            (Some(frame), [Some(left), Some(top), Some(width), Some(height), Some(score)]) => {
                found.push(DetectionRecord { frame, rect: [left, top, width, height], score });
            }
            // A frame's time.
            (Some(_), [None, None, None, None, None]) => {}
            _ => return Err("frame, left, top, width, height or score is missing".into()),
        }
        Ok(())
    })?;
    Ok((head, found))
}

/// The head of a result alone, JSON.
///
/// # Errors
/// As [`read_outcome`].
pub fn read_head(path: &Path) -> Result<String, Error> {
    head_of(&open(path, wrong_result)?, path)
}

fn head_of(reader: &SerializedFileReader<File>, path: &Path) -> Result<String, Error> {
    let metadata = reader.metadata().file_metadata().key_value_metadata();
    let head = metadata.into_iter().flatten().find(|pair| pair.key == HEAD);
    let missing = || wrong_result(path, format!("no {HEAD} in its metadata"));
    head.and_then(|pair| pair.value.clone()).ok_or_else(missing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn manifests_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.parquet");
        let row = |clip: &str, tags: &str| ManifestRow {
            clip: clip.into(),
            split: "one".into(),
            path: format!("one/{clip}"),
            tags: tags.into(),
            ..ManifestRow::default()
        };
        let rows = vec![row("a", ""), row("b,\"c", "kind=hover;movers=2"), row("d", "")];
        fs::write(&path, encode_manifest(&path, &rows).unwrap()).unwrap();
        assert_eq!(read_manifest(&path).unwrap(), rows);
        for bytes in [&b"clip,path\n"[..], b"", &fs::read(&path).unwrap()[..90]] {
            fs::write(&path, bytes).unwrap();
            let error = read_manifest(&path).unwrap_err();
            assert!(error.to_string().contains("m.parquet: no manifest"), "{error}");
            assert_eq!(error.exit_status(), 42);
        }
    }
}
