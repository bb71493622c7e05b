//! Reconstruction of solids from two or three orthographic views.
//!
//! A drawing can describe several solids. [`views::solve`] lists them, [`reprojection::disagreements`] checks
//! a solid against the drawing, and [`tessellation::tessellate`] makes a watertight mesh of it:
//!
//! ```
//! use planish_solid::reprojection::{ReprojectionOptions, disagreements};
//! use planish_solid::tessellation::tessellate;
//! use planish_solid::views::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind, solve};
//!
//! let rectangle = |x: f64, y: f64| {
//!     let corners = [[0.0, 0.0], [x, 0.0], [x, y], [0.0, y]];
//!     (0..4)
//!         .map(|k| DrawnCurve {
//!             curve: Curve2::Segment(corners[k], corners[(k + 1) % 4]),
//!             style: LineStyle::Visible,
//!             entity: format!("side {k}"),
//!         })
//!         .collect::<Vec<_>>()
//! };
//! let views = vec![
//!     View::new(ViewKind::Front, rectangle(40.0, 20.0)),
//!     View::new(ViewKind::Top, rectangle(40.0, 30.0)),
//!     View::new(ViewKind::Side, rectangle(30.0, 20.0)),
//! ];
//! let drawing = Drawing { views };
//! let found = solve(&drawing)?;
//! let best = &found.solutions[0];
//! assert_eq!(best.solid.faces.len(), 6);
//! assert!((best.measures.volume - 24_000.0).abs() < 1e-6);
//! assert!(disagreements(&best.solid, &drawing, &ReprojectionOptions::default()).is_empty());
//! assert!(tessellate(&best.solid, 0.1)?.check().watertight);
//! # Ok::<(), planish_estimate::Error>(())
//! ```
//!
//! The views of a file that holds all of them on one sheet are found by [`sheet::read_sheet`]; coordinates
//! that nearly agree are joined by [`views::joined`]. Measured views with errors are adjusted by
//! [`noisy_views::match_views`] first, which also gives σ of each dimension.
//!
//! Faces of CAD files have surfaces of more kinds. [`parametric`] represents and triangulates these:
//!
//! ```
//! use planish_core::DVec3;
//! use planish_solid::brep::FaceSurface;
//! use planish_solid::parametric::{Fineness, ParametricFace, ParametricShape, ParametricSurface};
//!
//! let (axis, x) = (DVec3::Z, DVec3::X);
//! let sphere = FaceSurface::Sphere { center: DVec3::ZERO, axis, x, radius: 2.0 };
//! let ball = ParametricFace {
//!     name: "ball".to_owned(),
//!     surface: ParametricSurface::Elementary(sphere),
//!     is_outward: true,
//!     loops: Vec::new(),
//! };
//! let shape = ParametricShape { faces: vec![ball], ..ParametricShape::default() };
//! let meshed = shape.triangles(&Fineness { chord: 0.01, longest: f64::INFINITY })?;
//! assert!(meshed.parts[0].positions.iter().all(|p| (p.length() - 2.0).abs() < 1e-12));
//! # Ok::<(), planish_estimate::Error>(())
//! ```
//!
//! | module | purpose |
//! |---|---|
//! | [`views`] | all solids that match two or three orthographic views, best first |
//! | [`noisy_views`] | measured views with covariance, matched by χ² tests and joined into one geometry |
//! | [`stack`] | solid from sections at several heights, with steps, pockets and holes |
//! | [`drawing`] | data model of a drawing: curves with line styles in up to three views |
//! | [`sheet`] | finds the views of a sheet among frame, title block, dimensions and notes |
//! | [`brep`] | B-rep on planes, cylinders, cones, spheres and tori: checks, volume, area, centroid |
//! | [`reprojection`] | projects a solid into its views and compares them with a drawing |
//! | [`repair`] | the solid of a drawing after the least edit of its lines |
//! | [`tessellation`] | watertight triangle mesh of a solid |
//! | [`parametric`] | trimmed parametric faces of CAD files and their triangulation |
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a
//! moving sensor*.

pub mod brep;
pub mod drawing;
pub mod noisy_views;
pub mod parametric;
pub mod repair;
pub mod reprojection;
pub mod sheet;
pub mod stack;
pub mod tessellation;
pub mod views;
