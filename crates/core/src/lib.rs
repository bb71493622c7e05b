//! What every crate of Planish shares: errors, progress of long work, vectors.

pub mod error;
pub mod progress;
pub mod vector3;

pub use error::{Error, ErrorKind, Result};
pub use progress::{Progress, ProgressPart, SHOWING_STAGE, Silent, WRITING_STAGE};
