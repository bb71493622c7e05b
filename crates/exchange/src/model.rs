//! `.planish`: saved models, as safetensors.
//!
//! **Input and output.** Named tensors and one JSON object. Any safetensors library opens the file, for
//! example `safetensors.numpy.load_file("part.planish")` in Python. The JSON is text under the metadata key
//! `planish`; its `schema` is the version of the format. The same model gives the same bytes.
//!
//! **Limits.** This module checks shapes and types of tensors, not their meaning.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use safetensors::{Dtype, SafeTensors, View};
use serde_json::Value;

use crate::atomic::write_atomically;
use crate::source::open_file;

/// Version of the format that is written, and the newest that is read.
pub const SCHEMA: u64 = 1;

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
/// [`Input`](planish_estimate::ErrorKind::Input) when it is cut off, not a safetensors file, or from another
/// program; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) when a newer version wrote it.
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
    metadata.insert("schema".to_owned(), SCHEMA.into());
    // A single key, because safetensors writes a hash map, whose order of keys changes from run to run.
    let metadata = HashMap::from([(KEY.to_owned(), Value::Object(metadata).to_string())]);
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
    let metadata: Value = serde_json::from_str(text).map_err(|e| {
        Error::input("expected JSON in the metadata `planish`, found other text").with_source(e)
    })?;
    match metadata.get("schema").and_then(Value::as_u64) {
        Some(SCHEMA) => {}
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
    let mut tensors = BTreeMap::new();
    for (name, view) in SafeTensors::deserialize(bytes).map_err(damaged)?.iter() {
        // Decoded value by value: the bytes of a tensor need not be aligned.
        fn numbers<const N: usize, T>(bytes: &[u8], from_le_bytes: fn([u8; N]) -> T) -> Vec<T> {
            bytes.as_chunks::<N>().0.iter().map(|&chunk| from_le_bytes(chunk)).collect()
        }
        let data = match view.dtype() {
            Dtype::F64 => TensorData::F64(numbers(view.data(), f64::from_le_bytes)),
            Dtype::U32 => TensorData::U32(numbers(view.data(), u32::from_le_bytes)),
            Dtype::I64 => TensorData::I64(numbers(view.data(), i64::from_le_bytes)),
            Dtype::U8 => TensorData::U8(view.data().to_vec()),
            other => {
                return Err(Error::unsupported(format!(
                    "tensor `{name}`: expected F64, U32, U8 or I64, found {other:?}"
                )));
            }
        };
        let shape = view.shape().to_vec();
        tensors.insert(name.to_owned(), Tensor { shape, data });
    }
    Ok(ModelFile { tensors, metadata })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_estimate::ErrorKind;
    use proptest::prelude::*;
    use serde_json::json;

    fn model() -> ModelFile {
        let tensor = |shape: &[usize], data| Tensor { shape: shape.to_vec(), data };
        ModelFile {
            tensors: [
                ("vertices", tensor(&[2, 3], TensorData::F64(vec![0.1, -0.0, 1e-300, f64::MAX, 5.0, 6.0]))),
                ("cells", tensor(&[2, 1], TensorData::U32(vec![0, u32::MAX]))),
                ("observed", tensor(&[3], TensorData::U8(vec![0, 1, 2]))),
                ("order", tensor(&[], TensorData::I64(vec![-3]))),
                ("none", tensor(&[0, 3], TensorData::F64(vec![]))),
            ]
            .map(|(name, tensor)| (name.to_owned(), tensor))
            .into(),
            metadata: json!({ "unit": "mm", "sensors": [{ "name": "läser \"1\"" }], "schema": 1 }),
        }
    }

    #[test]
    fn models_read_back_unchanged_and_write_to_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.planish");
        write_model(&path, &model()).unwrap();
        let first = std::fs::read(&path).unwrap();
        let read = read_model(&path).unwrap();
        assert_eq!(read, model());
        for _ in 0..5 {
            write_model(&path, &read).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), first);
        }
    }

    #[test]
    fn numbers_of_the_metadata_keep_every_bit() {
        let mut state = 1_u64;
        let numbers: Vec<f64> = (0..2000)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 11) as f64 * 1e-14
            })
            .chain([31.245_270_191_439_438])
            .collect();
        let mut model = model();
        model.metadata["numbers"] = json!(numbers);
        let read = from_bytes(&to_bytes(&model).unwrap()).unwrap();
        assert_eq!(read.metadata["numbers"], json!(numbers));
    }

    #[test]
    fn truncated_files_are_rejected() {
        let bytes = to_bytes(&model()).unwrap();
        for end in 0..bytes.len() {
            assert_eq!(from_bytes(&bytes[..end]).unwrap_err().kind(), ErrorKind::Input, "{end}");
        }
        let longer = [&bytes[..], b"x"].concat();
        assert!(from_bytes(&longer).is_err());
    }

    #[test]
    fn foreign_and_newer_files_have_their_own_messages() {
        let none: [(&str, &Tensor); 0] = [];
        let write = |metadata: Option<&str>| {
            let metadata = metadata.map(|text| HashMap::from([(KEY.to_owned(), text.to_owned())]));
            safetensors::serialize(none, metadata).unwrap()
        };
        let e = from_bytes(&write(None)).unwrap_err();
        assert!(e.kind() == ErrorKind::Input && e.to_string().contains("without metadata `planish`"), "{e}");
        let e = from_bytes(&write(Some(r#"{"schema": 2}"#))).unwrap_err();
        assert!(e.kind() == ErrorKind::Unsupported && e.to_string().contains("newer Planish"), "{e}");
        assert!(from_bytes(&write(Some("{}"))).unwrap_err().to_string().contains("expected a schema"));
        assert!(from_bytes(&write(Some("{"))).unwrap_err().to_string().contains("expected JSON"));
        assert!(
            from_bytes(b"solid part").unwrap_err().to_string().contains("expected a model saved by Planish")
        );
    }

    #[test]
    fn a_shape_that_disagrees_with_its_numbers_is_rejected() {
        let mut wrong = model();
        wrong.tensors.insert("bad".to_owned(), Tensor { shape: vec![2], data: TensorData::U8(vec![1]) });
        assert!(to_bytes(&wrong).unwrap_err().to_string().contains("tensor `bad`"));
    }

    proptest! {
        #[test]
        fn no_bytes_cause_a_panic(
            mut bytes in proptest::collection::vec(any::<u8>(), 0..200),
            length in 0_u64..100,
        ) {
            let _ = from_bytes(&bytes);
            bytes.splice(0..0, length.to_le_bytes());
            let _ = from_bytes(&bytes);
        }

        #[test]
        fn no_changed_byte_causes_a_panic(at in 0_usize..600, value in any::<u8>()) {
            let mut bytes = to_bytes(&model()).unwrap();
            let at = at % bytes.len();
            bytes[at] = value;
            let _ = from_bytes(&bytes);
        }
    }
}
