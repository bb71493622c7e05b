//! Foundations that every crate of Planish shares. This crate depends on no other.
//!
//! | Module | Contents |
//! |---|---|
//! | [`error`] | [`Error`], its [`ErrorKind`] and [`Result`] |
//! | [`progress`] | [`Progress`]: reports from long work, and requests to stop it |
//! | [`vector3`] | sums, products and lengths of `[f64; 3]` |
//! | [`random`] | repeatable random bits and hashes |
//! | crate root | [`Unit`], [`Length`], [`BoundingBox`], [`SymmetricMatrix3`], [`Pose`], [`DisjointSets`] |
//!
//! Coordinates are `[f64; 3]` in the unit of the model.
//!
//! # Examples
//! The size of a scan in the world's frame:
//! ```
//! use planish_core::{BoundingBox, Pose, Unit};
//! let world_from_scanner = Pose { translation: [0.0, 0.0, 5.0], ..Pose::identity() };
//! let points = [[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]].map(|p| world_from_scanner.apply(p));
//! let bounds = BoundingBox::from_points(&points).expect("two points");
//! assert_eq!((bounds.center(), bounds.diagonal()), ([1.5, 2.0, 5.0], 5.0));
//! assert_eq!(bounds.diagonal() * Unit::Inch.millimetres(), 127.0);
//! ```

pub mod error;
pub mod matrix3;
pub mod progress;
pub mod random;
pub mod vector3;

mod bounding_box;
mod disjoint_sets;
mod pinhole;
mod pose;
mod symmetric_matrix3;
mod unit;

pub use bounding_box::BoundingBox;
pub use disjoint_sets::DisjointSets;
pub use error::{Error, ErrorKind, Result};
pub use pinhole::Pinhole;
pub use pose::Pose;
pub use progress::{Progress, ProgressPart, SHOWING_STAGE, Silent, WRITING_STAGE};
pub use symmetric_matrix3::SymmetricMatrix3;
pub use unit::{Length, Unit};
