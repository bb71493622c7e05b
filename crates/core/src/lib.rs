//! Foundations that the crates of Planish share. This crate depends on no other crate of Planish.
//!
//! | Contents | |
//! |---|---|
//! | [`Error`], [`ErrorKind`], [`Result`] | the error type of all crates, and its exit codes |
//! | [`Finding`], [`FindingCode`], [`FindingLevel`] | messages about a result, with stable codes |
//! | [`Setting`] | settings that messages refer to; the command prints their options |
//! | [`Progress`], [`ProgressPart`], [`Silent`] | progress of long work, and requests to stop it |
//! | [`Budget`], [`budget`] | limits on the memory of inputs and of the process |
//! | [`Unit`], [`Length`] | units of length, and lengths that a user states |
//! | [`SmallUnit`], [`numbers`] | lengths and numbers in messages |
//! | [`DVec3`], [`Vec3`] | points, normals and directions, in double and single precision (crate `glam`) |
//! | [`vector3`], [`matrix3`] | what `DVec3` lacks, and arithmetic of 3 × 3 matrices |
//! | [`SymmetricMatrix3`] | covariances and curvature tensors |
//! | [`Pose`] | rigid motions between two frames |
//! | [`Pinhole`] | cameras and projectors |
//! | [`BoundingBox`] | axis-aligned boxes |
//! | [`DisjointSets`] | union-find |
//! | [`random`] | repeatable random bits and hashes |
//!
//! Coordinates are [`DVec3`] in the unit of the model. Files and messages hold them as `[f64; 3]`. Frames are
//! named in variables: `world_from_scanner` maps points of the scanner's frame into the world.
//!
//! # Examples
//! The size of a scan in the world's frame, and the uncertainty of its points along the vertical:
//! ```
//! use planish_core::{BoundingBox, DVec3, Pose, SymmetricMatrix3, Unit};
//! let world_from_scanner = Pose { translation: DVec3::new(0.0, 0.0, 5.0), ..Pose::identity() };
//! let points = [DVec3::ZERO, DVec3::new(3.0, 4.0, 0.0)].map(|p| world_from_scanner.apply(p));
//! let bounds = BoundingBox::from_points(&points).expect("two points");
//! assert_eq!((bounds.center(), bounds.diagonal()), (DVec3::new(1.5, 2.0, 5.0), 5.0));
//! assert_eq!(bounds.diagonal() * Unit::Inch.millimetres(), 127.0);
//!
//! let covariance = SymmetricMatrix3::isotropic(0.5 * 0.5).rotated(&world_from_scanner.rotation);
//! assert_eq!(covariance.along(DVec3::Z).sqrt(), 0.5);
//! ```

pub mod budget;
pub mod error;
pub mod finding;
pub mod matrix3;
pub mod numbers;
pub mod progress;
pub mod random;
pub mod setting;
pub mod vector3;

// Types, which are re-exported below. The modules above also have functions, which are called with the
// name of their module.
mod bounding_box;
mod disjoint_sets;
mod pinhole;
mod pose;
mod small_unit;
mod symmetric_matrix3;
mod unit;

pub use bounding_box::{BoundingBox, Coordinates};
pub use budget::Budget;
pub use disjoint_sets::{DisjointSets, connected_groups};
pub use error::{Error, ErrorKind, Result};
pub use finding::{Finding, FindingCode, FindingLevel};
pub use glam::{DVec3, Vec3};
pub use pinhole::Pinhole;
pub use pose::Pose;
pub use progress::{Progress, ProgressPart, SHOWING_STAGE, Silent, WRITING_STAGE};
pub use setting::Setting;
pub use small_unit::SmallUnit;
pub use symmetric_matrix3::SymmetricMatrix3;
pub use unit::{Length, Unit};
