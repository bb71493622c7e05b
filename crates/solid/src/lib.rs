//! Solids from orthographic views: every solid that two or three views can describe, checked by reprojection.
//!
//! | module | purpose |
//! |---|---|
//! | [`views`] | every solid that two or three orthographic views can describe, best first |
//! | [`noisy_views`] | measured views with covariance, matched by χ² tests and joined into one geometry |
//! | [`drawing`] | a drawing as curves of a style in up to three views |
//! | [`brep`] | solids as faces on planes, cylinders, cones, spheres and tori: construction, checks, measures |
//! | [`reprojection`] | the views of a finished solid, compared with a drawing |
//! | [`tessellation`] | watertight triangles of a solid |
//! | [`parametric`] | trimmed faces of CAD files on surfaces of any kind, as triangles |
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a
//! moving sensor*.

pub mod brep;
pub mod drawing;
pub mod noisy_views;
pub mod parametric;
pub mod reprojection;
pub mod tessellation;
pub mod views;
