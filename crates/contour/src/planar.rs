//! Planar contours of objects, measured by a ranging sensor with an uncertain pose.
//!
//! In: [`ContourReading`]s (ranges from a pose, or points) with σ. Out: a [`ContourFit`] with the
//! [`ContourKind`], its parameters and their covariance; [`choose()`] also lists alternatives. Not
//! guaranteed: the right kind if the noise hides the difference; `bic_margin` states the evidence.
//!
//! | module | purpose |
//! |---|---|
//! | kind | kinds, their parameters, and their outlines of lines and arcs |
//! | curve | distance of a point to a piece of an outline, with derivatives |
//! | reading | a reading as an equation `g(z − v, x) = 0`; motion; product and active-facet form |
//! | start | initial parameters: algebraic fits, boxes, segmentation by dynamic programming |
//! | soft_constraint, ends, joints | prior knowledge about chains: ends and smooth joints, as equations |
//! | options | method, gate and other options of a fit |
//! | fit, recursive | fit of one kind by a batch or a filter, with a gate |
//! | likelihood | likelihood of readings whose places on an outline are unknown |
//! | marginal, combined | outline of maximum marginal likelihood, after the batch |
//! | plausible | checks of corners, and of the location of a fit |
//! | choose | choice among several kinds by BIC |
//! | sides | lengths of sides and radii of arcs, with σ |
//! | displaced | covariance by displacements that many readings share |
//! | simulated | readings of known contours |
//! | parts | separation of objects, and containment in outlines |
//! | walls | straight walls of rooms, with gaps and corners |
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, section 2.

mod choose;
mod combined;
#[cfg(test)]
mod combined_tests;
mod curve;
mod displaced;
mod ends;
mod fit;
mod joints;
mod kind;
mod likelihood;
mod marginal;
mod options;
mod parts;
mod plausible;
mod reading;
mod recursive;
mod sides;
mod simulated;
mod soft_constraint;
mod start;
mod walls;

pub use choose::{Alternative, Choice, auto_kinds, choose};
pub use curve::arc_circle;
pub use displaced::Foot;
pub(crate) use fit::GatedResiduals;
pub use fit::{ContourFit, bound, fit};
pub use kind::{ContourKind, Outline};
pub use options::{ContourFitOptions, Method};
pub use parts::{contains, separate, typical_gap};
pub use reading::{ContourReading, ContourTarget, Form, PlanarMotion};
pub use sides::Side;
pub use simulated::{SensorOptions, SimulatedReadings, points, ranges};
pub use start::circle as circle_of_points;
pub use start::circle_of_moments;
pub use start::starts;
pub use walls::{Wall, WallCorner, WallErrors, WallMap, find_walls, wall_corners};

#[cfg(test)]
mod tests;
