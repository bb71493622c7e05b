//! The command from outside: one program for all, as each would be linked with the whole of it.

mod sources;
mod support;

mod book;
mod constraints;
mod drawings;
mod end_to_end;
mod errors;
mod help;
mod hostile;
mod json;
mod layering;
mod merge;
mod occluding;
mod prism;
mod programs;
mod reports;
mod sense;
mod shell;
mod source_style;
mod view;
