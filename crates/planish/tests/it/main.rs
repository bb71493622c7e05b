//! Integration tests. They share one program, because each program would be linked with the whole library.

// Helpers of tests may unwrap and print as tests do.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::type_complexity)]

mod common;

mod accuracy;
mod brep;
mod calibration;
mod clouds;
mod contour_scene;
mod contours;
mod few_readings;
mod filters;
mod freeform;
mod front_ends;
mod merge;
mod poses;
mod propagation;
mod quantities;
mod reported;
mod reports;
mod rough_start;
mod shells;
mod solids;
mod sphere_figures;
mod stripes;
mod terrain;
mod tessellation;
mod texture;
mod unresolved_shape;
mod view;
