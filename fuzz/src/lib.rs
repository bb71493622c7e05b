//! Valid files of every format, their damage, and the readers and commands that are tested with them.
//!
//! In: valid files from our own writers, or written by hand. Out: a table of targets, each with its files,
//! the words of its format and a function that reads a damaged file. The program `planish-fuzz` runs them
//! with random damage; `fuzz/coverage` lets the coverage of the code guide the damage.

#![allow(clippy::missing_errors_doc, reason = "functions fail only if an example cannot be written")]

pub mod mutate;
pub mod targets;
pub mod valid;
