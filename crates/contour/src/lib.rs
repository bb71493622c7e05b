//! Planar contours and 3D primitives from a ranging sensor with an uncertain pose, with their covariance.
//!
//! A sensor measures ranges from poses that are themselves uncertain, or points. This crate estimates the
//! parameters of a contour from them, chooses the kind of contour by BIC, and reports the covariance.
//! Relations such as parallel or tangent can then be tested on that covariance and imposed.
//!
//! | module | purpose |
//! |---|---|
//! | [`planar`] | identify a planar contour from readings: its kind, dimensions and covariance |
//! | [`primitive`] | planes, spheres, cylinders and boxes from rays in space |
//! | [`constraint`] | geometric relations between parts of a drawing: proposed, imposed, diagnosed |
//! | [`graph`] | graphs of the constraints, composite graphs of several views, tours |
//! | [`sketch`] | conversion of contours to a drawing with a joint covariance, and back |
//!
//! # Examples
//! Choose the kind of a contour from 300 ranges with errors in position, heading and range:
//! ```
//! use planish_contour::planar::{ContourFitOptions, ContourKind, SensorOptions, choose, ranges};
//!
//! let rectangle = [0.0, 0.0, 40.0, 30.0, 0.2];
//! let sensor = SensorOptions::around(40.0, 0.2);
//! let readings = ranges(&ContourKind::Rectangle, &rectangle, [0.0, 0.0], 300, &sensor, 1).noisy;
//! let kinds = [ContourKind::Circle, ContourKind::Ellipse, ContourKind::Rectangle];
//! let choice = choose(&kinds, false, &readings, &ContourFitOptions::default())?;
//! assert_eq!(choice.fit.kind, ContourKind::Rectangle);
//!
//! let (theta, source) = choice.fit.kind.canonical(choice.fit.state.as_slice());
//! let sigma = choice.fit.covariance[(source[2].0, source[2].0)].sqrt();
//! assert!((theta[2] - 40.0).abs() < 4.0 * sigma && sigma < 0.5); // the width
//! # Ok::<(), planish_estimate::Error>(())
//! ```
//!
//! Find the relations of an estimated outline and impose them:
//! ```
//! use nalgebra::DMatrix;
//! use planish_contour::constraint::{ConstrainOptions, ParametricDrawing, constrain};
//!
//! let outline = ParametricDrawing::polygon(&[[0.01, 0.0], [40.02, 0.03], [39.98, 29.97], [0.0, 30.01]])?;
//! let covariance = DMatrix::identity(8, 8) * 0.0009;
//! let found = constrain(&outline, &covariance, &ConstrainOptions::default())?;
//! assert_eq!(found.freedoms, 4); // an upright rectangle: position, width and height
//! assert!(found.covariance.trace() < covariance.trace());
//! # Ok::<(), planish_estimate::Error>(())
//! ```
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a
//! moving sensor*.

pub mod constraint;
pub mod graph;
pub mod planar;
pub mod primitive;
pub mod sketch;
