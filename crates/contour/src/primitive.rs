//! Planes, spheres, cylinders and boxes, seen by rays in space from uncertain poses.
//!
//! Comes in: [`Ray`]s — a pose, a direction, a range — or points, with their σ. Goes out: a [`PrimitiveFit`]:
//! the parameters of a [`PrimitiveKind`] with their covariance. The same estimator as of contours
//! (`planish_estimate::implicit`), with six noises a reading. Not guaranteed: a shape of which too little was
//! seen; a cylinder's ends, which are not looked for.
//!
//! | module | what |
//! |---|---|
//! | shape | the shapes, their charts, signed distances with derivatives |
//! | ray | a reading as an equation `g(z − v, x) = 0` |
//! | start | parameters without a guess: algebraic fits, and searches over directions and rotations |
//! | fit | batch and filters; the choice of a shape by BIC |
//! | simulated | readings of shapes that are known exactly |
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, section 2 (the case in space).

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
