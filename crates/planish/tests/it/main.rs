//! Integration tests. They share one program, because each program would be linked with the whole library.

// Helpers of tests may unwrap and print as tests do.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::type_complexity)]

mod common;

mod brep;
mod calibration;
mod clouds;
mod contour_scene;
mod contours;
mod filters;
mod freeform;
mod front_ends;
mod honesty;
mod merge;
mod poses;
mod propagation;
mod quantities;
mod reports;
mod rough_start;
mod shape_left;
mod shells;
mod solids;
mod sphere_figures;
mod stripes;
mod terrain;
mod tessellation;
mod texture;
mod told;
mod view;
