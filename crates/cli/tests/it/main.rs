//! Tests of the built program. They form one executable; separate ones would each be
//! linked with the whole workspace.

mod sources;
mod support;

mod book;
mod constraints;
mod drawings;
mod end_to_end;
mod errors;
#[cfg(all(target_os = "linux", target_env = "gnu"))]
mod faults;
mod findings;
mod formats;
mod help;
mod hostile;
mod json;
mod layering;
mod merge;
mod occluding;
mod output_sets;
mod prism;
mod programs;
mod reports;
mod sense;
mod shell;
mod source_style;
mod view;
