//! Planes, spheres, cylinders and boxes from ranges in space with uncertain poses.
//!
//! In: [`Ray`]s (a pose, a direction and a range, or a point) with their σ. Out: a [`PrimitiveFit`] with the
//! parameters of a [`PrimitiveKind`] and their covariance. The estimator is that of contours
//! (`planish_estimate::implicit`), with six noise values per reading. Not guaranteed: shapes of which too
//! little was observed. The ends of a cylinder are not estimated.
//!
//! | module | purpose |
//! |---|---|
//! | shape | shapes, their charts, signed distances with derivatives |
//! | ray | a reading as an equation `g(z − v, x) = 0` |
//! | start | initial parameters: algebraic fits, and searches over directions and rotations |
//! | fit | batch and filters; choice of a shape by BIC |
//! | simulated | readings of known shapes |
//!
//! # Examples
//! A sphere of radius 5 from 200 simulated rays:
//! ```
//! use planish_contour::planar::ContourFitOptions;
//! use planish_core::DVec3;
//! use planish_contour::primitive::{PrimitiveKind, SimulatedPrimitive, SpaceSensor, fit, rays};
//!
//! let shape = PrimitiveKind::Sphere;
//! let center = DVec3::new(1.0, 2.0, 3.0);
//! let sphere = SimulatedPrimitive { shape, center, turn: DVec3::ZERO, size: [5.0, 0.0, 0.0] };
//! let sensor = SpaceSensor {
//!     standoff: 20.0,
//!     sigma_position: 0.01,
//!     sigma_angle_rad: 0.001,
//!     sigma_range_share: 0.001,
//! };
//! let found = fit(shape, &rays(&sphere, 200, &sensor, 1).noisy, &ContourFitOptions::default())?;
//! assert!((found.parameters[3] - 5.0).abs() < 0.02);
//! # Ok::<(), planish_estimate::Error>(())
//! ```
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, section 2 (the case of three dimensions).

mod fit;
mod ray;
mod shape;
mod simulated;
mod start;

pub use fit::{PrimitiveFit, choose, fit};
pub use ray::{Ray, RayTarget};
pub use shape::PrimitiveKind;
pub use simulated::{SimulatedPrimitive, SimulatedRays, SpaceSensor, rays};

#[cfg(test)]
mod tests;
