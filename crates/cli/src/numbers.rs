//! Numbers as people read them: those of reports.

pub use planish_report::numbers::{count, counted, percent, significant};
