//! Contours with their covariance, geometric constraints, views, and the solids that they mean.
//!
//! Eleven parts, each usable by itself:
//!
//! | module | what |
//! |---|---|
//! | [`contour`] | which shape a ranging sensor of uncertain pose saw, its dimensions and their covariance |
//! | [`sketch`] | contours with their covariance as a drawing, and back |
//! | [`primitive`] | planes, spheres, cylinders and boxes from rays in space |
//! | [`constraint`] | what holds between the parts of a drawing: found, imposed, counted |
//! | [`graph`] | the graphs of those constraints, of several views together, and tours through them |
//! | [`noisy_views`] | views with covariance matched by χ² and made one geometry |
//! | [`brep`] | solids as faces on planes and cylinders: made, checked, measured |
//! | [`parametric`] | trimmed faces of CAD files, on surfaces of any kind, as triangles |
//! | [`reprojection`] | what a finished solid shows in its views, compared with a drawing |
//! | [`tessellation`] | watertight triangles of a solid |
//! | [`views`] | every solid that two or three orthographic views can mean |
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a
//! moving sensor*.

pub mod brep;
pub mod constraint;
pub mod contour;
pub mod graph;
pub mod noisy_views;
pub mod parametric;
pub mod primitive;
pub mod reprojection;
pub mod sketch;
pub mod tessellation;
pub mod views;
