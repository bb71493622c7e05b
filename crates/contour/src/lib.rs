//! Planar contours and 3D primitives from a ranging sensor of uncertain pose, with their covariance.
//!
//! | module | purpose |
//! |---|---|
//! | [`planar`] | identify a planar contour from readings: its kind, dimensions and covariance |
//! | [`primitive`] | planes, spheres, cylinders and boxes from rays in space |
//! | [`constraint`] | geometric relations between the parts of a drawing: proposed, imposed, diagnosed |
//! | [`graph`] | the graphs of those relations, of several views together, and tours through them |
//! | [`sketch`] | contours with their covariance as a drawing, and back |
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a
//! moving sensor*.

pub mod constraint;
pub mod graph;
pub mod planar;
pub mod primitive;
pub mod sketch;
