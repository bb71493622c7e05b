//! Contours of objects, measured by a ranging sensor of uncertain pose.
//!
//! Comes in: [`ContourReading`]s (ranges from a pose, or points) with σ. Goes out: a [`ContourFit`]: the
//! [`ContourKind`], its dimensions and position with covariance; [`choose()`] also lists the alternatives.
//! Not guaranteed: the right kind where the noise hides the difference; `bic_margin` states the evidence.
//!
//! | module | what |
//! |---|---|
//! | kind | the kinds, their parameters, and their outlines: vertices joined by lines and arcs |
//! | curve | the distance of a point to a piece of an outline, with derivatives by point and parameters |
//! | reading | a reading as an equation `g(z − v, x) = 0`; motion; product and active-facet form |
//! | start | parameters without a guess: algebraic fits, boxes, segmentation by dynamic programming |
//! | ends | where an open chain ends, as equations |
//! | fit, recursive | one kind fitted by the batch or a filter, gates |
//! | likelihood | how likely readings are whose places on an outline are not known |
//! | marginal, combined | the outline for which they are most likely, after the batch |
//! | plausible | whether corners are corners, and a fit is where the readings are |
//! | choose | several kinds, and the one of the least BIC |
//! | simulated | readings of contours that are known exactly |
//! | parts | readings of several things told apart, holes |
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, section 2.

mod choose;
mod combined;
#[cfg(test)]
mod combined_tests;
mod curve;
mod ends;
mod fit;
mod joints;
mod kind;
mod likelihood;
mod marginal;
mod parts;
mod plausible;
mod reading;
mod recursive;
mod sides;
mod simulated;
mod soft_constraint;
mod start;

pub use choose::{Alternative, Choice, auto_kinds, choose};
pub use curve::arc_circle;
pub(crate) use fit::GatedResiduals;
pub use fit::{ContourFit, ContourFitOptions, Method, bound, fit};
pub use kind::{ContourKind, Outline};
pub use parts::{contains, separate, usual_gap};
pub use reading::{ContourReading, ContourTarget, Form, PlanarMotion};
pub use sides::Side;
pub use simulated::{SensorOptions, SimulatedReadings, points, ranges};
pub use start::circle as circle_of_points;
pub use start::starts;

#[cfg(test)]
mod tests;
