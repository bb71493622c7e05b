//! What is written of a model: the format follows the file's extension.

use std::path::Path;

/// A path's extension in lower case; empty where it has none.
pub(crate) fn extension(path: &Path) -> String {
    path.extension()
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default()
}
