//! What every crate of Planish shares: errors, findings, progress of long work, vectors.

pub mod error;
pub mod finding;
pub mod progress;
pub mod setting;
pub mod vector3;

pub use error::{Error, ErrorKind, Result};
pub use finding::{Finding, FindingCode, FindingLevel};
pub use progress::{Progress, ProgressPart, SHOWING_STAGE, Silent, WRITING_STAGE};
pub use setting::Setting;
