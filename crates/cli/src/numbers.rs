//! Formatting of numbers for people, shared with the HTML reports.

pub use planish_report::numbers::{count, counted, percent, significant};
