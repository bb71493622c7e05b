//! Checksums of saved models: SHA-256 of each tensor and of the metadata.
//!
//! **Layout.** The metadata key `tensors` holds type, shape and checksum of every tensor, so that the
//! checksum of the metadata also covers names, types and shapes. The key `sha256` holds the checksum of the
//! JSON text, computed with 64 zeros in place of its own digits. Other programs can check both with a few
//! lines:
//!
//! ```text
//! meta["sha256"] == sha256(text.replace(meta["sha256"], "0" * 64))
//! meta["tensors"]["cells"]["sha256"] == sha256(cells.tobytes())
//! ```
//!
//! **Limits.** Checksums detect accidental damage and edits by programs that do not know the format. They do
//! not detect an author who computes them again.

use super::{KEY, Tensor};
use crate::checksum::hexadecimal;
use planish_estimate::{Error, Result};
use safetensors::{Dtype, View};
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// Metadata key of the checksums of tensors.
const TENSORS: &str = "tensors";
/// Metadata key of the checksum of the metadata, and of each tensor in its entry of [`TENSORS`].
const SHA256: &str = "sha256";
/// Hexadecimal digits of a checksum.
const DIGITS: usize = 64;

/// What a user can do about a file that fails a check.
const WAY_OUT: &str = "the file was changed or is damaged; restore it from a copy or fit the model again";

fn sha256(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

/// Name of a type as safetensors writes it.
fn type_name(dtype: Dtype) -> String {
    format!("{dtype:?}")
}

/// The JSON text of the metadata, with the checksums of the tensors and its own.
pub(super) fn with_checksums(mut metadata: Map<String, Value>, tensors: &BTreeMap<String, Tensor>) -> String {
    let entries = tensors.iter().map(|(name, tensor)| {
        let tensor: &Tensor = tensor;
        let digest = sha256(&View::data(&tensor));
        let entry =
            json!({ "dtype": type_name(View::dtype(&tensor)), "shape": tensor.shape, SHA256: digest });
        (name.clone(), entry)
    });
    metadata.insert(TENSORS.to_owned(), Value::Object(entries.collect()));
    // The text is made twice, because the place of the digits is not known before, and other text may
    // contain as many zeros.
    metadata.insert(SHA256.to_owned(), "0".repeat(DIGITS).into());
    let digest = sha256(Value::Object(metadata.clone()).to_string().as_bytes());
    metadata.insert(SHA256.to_owned(), digest.into());
    Value::Object(metadata).to_string()
}

/// True if the metadata have a checksum, be it correct or not.
pub(super) fn are_present(metadata: &Value) -> bool {
    metadata.get(SHA256).is_some() || metadata.get(TENSORS).is_some()
}

/// Verifies the checksum of the metadata.
///
/// # Errors
/// `Input` if it is missing or wrong.
pub(super) fn verify_metadata(text: &str, metadata: &Value) -> Result<()> {
    let digest = metadata.get(SHA256).and_then(Value::as_str).unwrap_or_default();
    if digest.len() != DIGITS {
        return Err(Error::input(format!(
            "expected a checksum of {DIGITS} digits in `{SHA256}` of the metadata `{KEY}`, found \
             \"{digest}\": {WAY_OUT}"
        )));
    }
    let found = sha256(text.replace(digest, &"0".repeat(DIGITS)).as_bytes());
    if found != digest {
        return Err(Error::input(format!(
            "metadata `{KEY}`: expected the SHA-256 {digest}, found {found}: {WAY_OUT}"
        )));
    }
    Ok(())
}

/// A tensor as it lies in a file.
pub(super) struct RawTensor<'a> {
    pub(super) dtype: Dtype,
    pub(super) shape: Vec<usize>,
    pub(super) bytes: &'a [u8],
}

/// Verifies that a file has the tensors that the metadata lists, with their types, shapes and checksums. The
/// metadata was verified before.
///
/// # Errors
/// `Input` that names the first tensor with a difference.
pub(super) fn verify_tensors(metadata: &Value, tensors: &BTreeMap<&str, RawTensor<'_>>) -> Result<()> {
    let Some(listed) = metadata.get(TENSORS).and_then(Value::as_object) else {
        return Err(Error::input(format!(
            "expected the checksums of the tensors in `{TENSORS}` of the metadata `{KEY}`, found none: \
             {WAY_OUT}"
        )));
    };
    if let Some(missing) = listed.keys().find(|name| !tensors.contains_key(name.as_str())) {
        return Err(Error::input(format!("expected the tensor `{missing}`, found none: {WAY_OUT}")));
    }
    for (name, raw) in tensors {
        let Some(entry) = listed.get(*name) else {
            return Err(Error::input(format!(
                "tensor `{name}`: the metadata has no checksum of it: {WAY_OUT}"
            )));
        };
        let expected = |key: &str| entry.get(key).cloned().unwrap_or_default();
        let differs = |what: &str, expected: Value, found: Value| {
            Error::input(format!("tensor `{name}`: expected {what} {expected}, found {found}: {WAY_OUT}"))
        };
        for (key, what, found) in [
            ("dtype", "the type", Value::from(type_name(raw.dtype))),
            ("shape", "the shape", json!(raw.shape)),
            (SHA256, "the SHA-256", Value::from(sha256(raw.bytes))),
        ] {
            if expected(key) != found {
                return Err(differs(what, expected(key), found));
            }
        }
    }
    Ok(())
}

/// Removes the checksums from metadata that were read: they describe a file, not a model.
pub(super) fn remove_checksums(metadata: &mut Value) {
    if let Value::Object(metadata) = metadata {
        metadata.remove(TENSORS);
        metadata.remove(SHA256);
    }
}
