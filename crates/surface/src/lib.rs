//! Smooth surfaces fitted to scans, with their covariance.
//!
//! [`fit::fit`] turns scans into a [`fit::Fit`]: a hierarchical B-spline surface with the information about
//! its control vertices, and a report. [`fit::update`] adds later scans to a saved model.
//! [`stream::SurfaceStream`] takes one reading at a time from a live sensor. A model gives σ at any of its
//! points, and is exported as a mesh with σ, a height raster, or exact faces for CAD.
//!
//! ```
//! use planish_core::{DVec3, Silent};
//! use planish_exchange::{PosedScan, ScanSet, Unit};
//! use planish_sense::{Noise, Scan, Sensor};
//! use planish_surface::export::mesh_from_model;
//! use planish_surface::fit::{FitOptions, fit};
//!
//! // A scan of a sphere of radius 5 mm. Its sensor states σ = 0.02 mm.
//! let points = (0..3000_u32).map(|k| {
//!     let z = 1.0 - (2.0 * f64::from(k) + 1.0) / 3000.0;
//!     let (angle, across) = (2.399_963 * f64::from(k), (1.0 - z * z).sqrt());
//!     let r = 5.0 + 0.02 * (12.9898 * f64::from(k)).sin();
//!     DVec3::new(r * across * angle.cos(), r * across * angle.sin(), r * z)
//! });
//! let scan = Scan { name: "sphere".to_owned(), points: points.collect(), ..Scan::default() };
//! let sensor = Sensor { noise: Some(Noise::Isotropic { sigma: 0.02 }), ..Sensor::default() };
//! let set = ScanSet {
//!     unit: Some(Unit::Millimetre),
//!     sensors: vec![sensor],
//!     scans: vec![PosedScan { scan, sensor: 0, sigma_translation: None, sigma_rotation_deg: None }],
//!     ..ScanSet::default()
//! };
//! let fitted = fit(&set, &FitOptions::default(), &Silent)?;
//! assert_eq!(fitted.report.topology.shape, "ball");
//!
//! // The mesh has σ at each vertex.
//! let mesh = mesh_from_model(&fitted.model, &fitted.posterior(), Some(0.05))?;
//! assert!(mesh.mesh.check().watertight && mesh.sigma.iter().all(|sigma| *sigma > 0.0));
//! # Ok::<(), planish_core::Error>(())
//! ```
//!
//! A fit passes through these modules:
//!
//! | module | purpose |
//! |---|---|
//! | [`observe`] | readings in the world frame with their covariances; errors common to a scan; foot points |
//! | [`fit`] | the stages of a fit: first surface, refinement, finish; known parameters; moving objects |
//! | [`complete`] | readings inferred from symmetry and from the surroundings of gaps |
//! | [`subdivision`] | criteria by which cells are divided, and their log |
//! | [`patch_stream`] | the patch filter for one reading at a time |
//! | [`stream`] | the same for a live sensor |
//! | [`model`] | a fitted surface with its information; posterior covariance |
//! | [`saved`] | `.planish` files |
//! | [`export`] | meshes with σ, height rasters, exact surfaces for CAD |

pub mod complete;
pub mod export;
pub mod fit;
pub mod layout;
pub mod model;
pub mod observe;
pub mod patch_stream;
pub mod saved;
pub mod stream;
pub mod subdivision;
#[doc(hidden)]
pub mod test_support;
