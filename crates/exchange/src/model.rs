//! `.planish`: saved models, as safetensors.
//!
//! **Input and output.** Named tensors and one JSON object. Any safetensors library opens the file, for
//! example `safetensors.numpy.load_file("part.planish")` in Python. The JSON is text under the metadata key
//! `planish`; its `schema` is the version of the format. The same model gives the same bytes.
//!
//! **Checksums.** Since schema 2, the metadata hold a SHA-256 of each tensor and of themselves, which reading
//! verifies. Files of schema 1 are read without; [`ModelFile::has_checksums`] is false for them.
//!
//! **Limits.** This module checks shapes, types and checksums of tensors, not their meaning.

mod checksums;

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use safetensors::{Dtype, SafeTensors, View};
use serde_json::Value;

use crate::atomic::write_atomically;
use crate::source::open_file;
use checksums::RawTensor;

/// Version of the format that is written, and the newest that is read.
///
/// 1: the first. 2: with checksums. The number was raised because a reader that takes missing checksums as a
/// sign of age would accept a file whose damage is in the names of their keys.
pub const SCHEMA: u64 = 2;

/// Oldest version with checksums.
const FIRST_WITH_CHECKSUMS: u64 = 2;

/// Metadata key of the version.
const SCHEMA_KEY: &str = "schema";

/// Metadata key of the JSON text.
const KEY: &str = "planish";

/// Numbers of a tensor, row by row.
#[derive(Debug, Clone, PartialEq)]
pub enum TensorData {
    /// 64-bit floating point.
    F64(Vec<f64>),
    /// 32-bit unsigned.
    U32(Vec<u32>),
    /// 8-bit unsigned.
    U8(Vec<u8>),
    /// 64-bit signed.
    I64(Vec<i64>),
}

impl TensorData {
    fn len(&self) -> usize {
        match self {
            Self::F64(v) => v.len(),
            Self::U32(v) => v.len(),
            Self::U8(v) => v.len(),
            Self::I64(v) => v.len(),
        }
    }

    fn dtype(&self) -> Dtype {
        match self {
            Self::F64(_) => Dtype::F64,
            Self::U32(_) => Dtype::U32,
            Self::U8(_) => Dtype::U8,
            Self::I64(_) => Dtype::I64,
        }
    }
}

/// An array of numbers; its data has as many entries as the product of its shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Length along each axis, the slowest first; empty for a single number.
    pub shape: Vec<usize>,
    /// The numbers.
    pub data: TensorData,
}

impl Tensor {
    /// Creates a tensor with one axis.
    #[must_use]
    pub fn f64_list(values: Vec<f64>) -> Self {
        Self { shape: vec![values.len()], data: TensorData::F64(values) }
    }

    /// Returns the numbers if they are `f64`.
    ///
    /// # Examples
    /// ```
    /// use planish_exchange::model::Tensor;
    /// let tensor = Tensor::f64_list(vec![1.0, 2.0]);
    /// assert_eq!(tensor.as_f64(), Some(&[1.0, 2.0][..]));
    /// assert_eq!(tensor.as_u8(), None);
    /// ```
    #[must_use]
    pub fn as_f64(&self) -> Option<&[f64]> {
        match &self.data {
            TensorData::F64(v) => Some(v),
            _ => None,
        }
    }

    /// Returns the numbers if they are `u32`.
    #[must_use]
    pub fn as_u32(&self) -> Option<&[u32]> {
        match &self.data {
            TensorData::U32(v) => Some(v),
            _ => None,
        }
    }

    /// Returns the numbers if they are `u8`.
    #[must_use]
    pub fn as_u8(&self) -> Option<&[u8]> {
        match &self.data {
            TensorData::U8(v) => Some(v),
            _ => None,
        }
    }

    /// Returns the numbers if they are `i64`.
    #[must_use]
    pub fn as_i64(&self) -> Option<&[i64]> {
        match &self.data {
            TensorData::I64(v) => Some(v),
            _ => None,
        }
    }
}

impl View for &Tensor {
    fn dtype(&self) -> Dtype {
        self.data.dtype()
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        match &self.data {
            TensorData::F64(v) => v.iter().flat_map(|x| x.to_le_bytes()).collect(),
            TensorData::U32(v) => v.iter().flat_map(|x| x.to_le_bytes()).collect(),
            TensorData::I64(v) => v.iter().flat_map(|x| x.to_le_bytes()).collect(),
            TensorData::U8(v) => Cow::Borrowed(v),
        }
    }

    fn data_len(&self) -> usize {
        self.data.len() * self.data.dtype().bitsize() / 8
    }
}

/// Content of a model file.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelFile {
    /// Tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// A JSON object; `schema` is added on writing.
    pub metadata: Value,
}

impl ModelFile {
    /// True if the file that was read had checksums, which then were correct.
    #[must_use]
    pub fn has_checksums(&self) -> bool {
        schema_of(&self.metadata).is_some_and(|schema| schema >= FIRST_WITH_CHECKSUMS)
    }
}

fn schema_of(metadata: &Value) -> Option<u64> {
    metadata.get(SCHEMA_KEY).and_then(Value::as_u64)
}

/// Writes a model.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) when a shape and its data disagree or the metadata is not an
/// object; [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left
/// half-written.
///
/// # Examples
/// ```
/// use planish_exchange::model::{ModelFile, Tensor, read_model, write_model};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("part.planish");
/// let model = ModelFile {
///     tensors: [("knots_u".to_owned(), Tensor::f64_list(vec![0.0, 1.0]))].into(),
///     metadata: serde_json::json!({ "unit": "mm" }),
/// };
/// write_model(&path, &model)?;
/// assert_eq!(read_model(&path)?.tensors, model.tensors);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_model(path: &Path, model: &ModelFile) -> Result<()> {
    let bytes = to_bytes(model).map_err(|e| e.in_context(path.display()))?;
    write_atomically(path, |writer| writer.write_all(&bytes))
}

/// Reads a model.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable;
/// [`Input`](planish_estimate::ErrorKind::Input) when it is cut off, damaged, not a safetensors file, or from
/// another program; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) when a newer version wrote it.
pub fn read_model(path: &Path) -> Result<ModelFile> {
    let read = open_file(path).and_then(|(mut file, length)| {
        let mut bytes = Vec::with_capacity(length.and_then(|n| usize::try_from(n).ok()).unwrap_or(0));
        file.read_to_end(&mut bytes).map_err(|e| Error::io("could not be read").with_source(e))?;
        from_bytes(&bytes)
    });
    read.map_err(|e| e.in_context(path.display()))
}

fn to_bytes(model: &ModelFile) -> Result<Vec<u8>> {
    for (name, tensor) in &model.tensors {
        // Checked multiplication, because a shape from elsewhere may overflow.
        let product = tensor.shape.iter().try_fold(1_usize, |n, &axis| n.checked_mul(axis));
        if product != Some(tensor.data.len()) {
            return Err(Error::input(format!(
                "tensor `{name}`: expected as many numbers as the shape {:?} has, found {}",
                tensor.shape,
                tensor.data.len()
            )));
        }
    }
    let Value::Object(mut metadata) = model.metadata.clone() else {
        return Err(Error::input("expected a JSON object as the metadata of a model, found another value"));
    };
    // Replaces the schema of a model that was read: what is written has the present format.
    metadata.insert(SCHEMA_KEY.to_owned(), SCHEMA.into());
    let text = checksums::with_checksums(metadata, &model.tensors);
    // A single key, because safetensors writes a hash map, whose order of keys changes from run to run.
    let metadata = HashMap::from([(KEY.to_owned(), text)]);
    // The map of tensors is sorted by name, so their order in the file is fixed.
    safetensors::serialize(model.tensors.iter(), Some(metadata))
        .map_err(|e| Error::input("the model cannot be written as safetensors").with_source(e))
}

fn from_bytes(bytes: &[u8]) -> Result<ModelFile> {
    let damaged = |e: safetensors::SafeTensorError| {
        Error::input(
            "expected a model saved by Planish, found another file, or one that is damaged or cut off",
        )
        .with_source(e)
    };
    let (header, description) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let promised = description.data_len();
    // Eight bytes with the length of the header precede it. Compared here, so that a cut-off file gets a
    // message of its own.
    let found = bytes.len().saturating_sub(header).saturating_sub(8);
    if found != promised {
        return Err(Error::input(format!(
            "the header declares {promised} bytes of tensors, found {found}: the file is cut off or damaged"
        )));
    }
    let not_planish = || {
        Error::input("expected a model saved by Planish, found a safetensors file without metadata `planish`")
    };
    // Before the tensors, so that files of other programs and of newer versions are named as such, whatever
    // types their tensors have.
    let text = description.metadata().as_ref().and_then(|m| m.get(KEY)).ok_or_else(not_planish)?;
    let mut metadata: Value = serde_json::from_str(text).map_err(|e| {
        Error::input("expected JSON in the metadata `planish`, found other text").with_source(e)
    })?;
    match schema_of(&metadata) {
        Some(1..=SCHEMA) => {}
        Some(newer) if newer > SCHEMA => {
            return Err(Error::unsupported(format!(
                "saved by a newer Planish (schema {newer}, this version reads up to {SCHEMA}): update Planish"
            )));
        }
        _ => {
            return Err(Error::input(format!(
                "expected a schema from 1 to {SCHEMA} in the metadata `planish`, found none"
            )));
        }
    }
    let views = SafeTensors::deserialize(bytes).map_err(damaged)?;
    let raw: BTreeMap<&str, RawTensor<'_>> = views
        .iter()
        .map(|(name, view)| {
            (name, RawTensor { dtype: view.dtype(), shape: view.shape().to_vec(), bytes: view.data() })
        })
        .collect();
    // Files of schema 1 have none, but one that has them is a later file whose version was damaged.
    let is_old = schema_of(&metadata).is_some_and(|schema| schema < FIRST_WITH_CHECKSUMS);
    if !is_old || checksums::are_present(&metadata) {
        // The metadata first, because they list the tensors.
        checksums::verify_metadata(text, &metadata)?;
        checksums::verify_tensors(&metadata, &raw)?;
        checksums::remove_checksums(&mut metadata);
    }
    let mut tensors = BTreeMap::new();
    for (name, raw) in &raw {
        let data = decode(raw).map_err(|e| e.in_context(format!("tensor `{name}`")))?;
        tensors.insert((*name).to_owned(), Tensor { shape: raw.shape.clone(), data });
    }
    Ok(ModelFile { tensors, metadata })
}

fn decode(raw: &RawTensor<'_>) -> Result<TensorData> {
    // Decoded value by value: the bytes of a tensor need not be aligned.
    fn numbers<const N: usize, T>(bytes: &[u8], from_le_bytes: fn([u8; N]) -> T) -> Vec<T> {
        bytes.as_chunks::<N>().0.iter().map(|&chunk| from_le_bytes(chunk)).collect()
    }
    match raw.dtype {
        Dtype::F64 => Ok(TensorData::F64(numbers(raw.bytes, f64::from_le_bytes))),
        Dtype::U32 => Ok(TensorData::U32(numbers(raw.bytes, u32::from_le_bytes))),
        Dtype::I64 => Ok(TensorData::I64(numbers(raw.bytes, i64::from_le_bytes))),
        Dtype::U8 => Ok(TensorData::U8(raw.bytes.to_vec())),
        other => Err(Error::unsupported(format!("expected F64, U32, U8 or I64, found {other:?}"))),
    }
}

#[cfg(test)]
mod tests;
