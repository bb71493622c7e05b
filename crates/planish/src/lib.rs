//! From noisy measurements to 3D models that state how accurate they are.
//!
//! This crate is the front door of Planish: each job is a struct with public fields that implements [`Job`].
//! The crates below it (`planish-surface`, `planish-contour`, `planish-solid`, …) hold the mathematics and
//! can be used on their own.
//!
//! | Job | Purpose |
//! |---|---|
//! | [`fit_files::FitJob`], [`fit::fit`] | fit a surface to scans |
//! | [`compare::CompareJob`] | deviations from a reference, and whether σ is consistent |
//! | [`next::NextJob`], [`next::NextViewsJob`] | choose the next points or views to measure |
//! | [`merge::MergeJob`] | merge overlapping patches into one mesh |
//! | [`shell::fit::ShellFitJob`], [`shell`] | deform, wrap, pose and colour a mesh |
//! | [`contour::ContourJob`] | identify contours and primitives, with constraints |
//! | [`solid::SolidJob`] | turn two or three views into solids |
//! | [`sense::SenseJob`], [`occluding::OccludingJob`] | turn images into points with a covariance |
//! | [`view::PictureJob`], [`info`] | draw or describe a file |
//! | [`simulate`] | scenes with known truth for every job |
//!
//! # Fit a surface
//! ```
//! use planish::fit::{FitOptions, fit};
//! use planish::progress::Silent;
//! use planish::simulate::{ScanSceneOptions, scans};
//! let options = ScanSceneOptions { readings: 2000, probe_points: 20, ..ScanSceneOptions::default() };
//! let scene = scans(&options)?;
//! let fitted = fit(&scene.set, &FitOptions::default(), &Silent)?;
//! println!("median σ: {}", fitted.report.sigma.median);
//! assert!(fitted.report.observed_area_fraction > 0.5);
//! # Ok::<(), planish::Error>(())
//! ```
//!
//! # Compare with a reference
//! ```
//! use planish::{Job, compare::CompareJob, progress::Silent};
//! let mesh = "../../examples/data/pebble/truth.ply";
//! let job = CompareJob { model: mesh.into(), reference: mesh.into(), ..CompareJob::default() };
//! let report = job.run(&Silent)?;
//! assert!(report.forward.is_some_and(|deviations| deviations.rms < 1e-9));
//! # Ok::<(), planish::Error>(())
//! ```
//!
//! # Turn views into a solid
//! ```
//! use planish::{Job, progress::Silent, solid::SolidJob};
//! let view = |name: &str| format!("../../examples/data/bracket/{name}.dxf").into();
//! let job = SolidJob { views: ["front", "top", "side"].map(view).to_vec(), ..SolidJob::default() };
//! let report = job.run(&Silent)?;
//! println!("{} planes, {} cylinders", report.solutions[0].faces.plane, report.solutions[0].faces.cylinder);
//! assert!(report.complete && report.unexplained.is_empty());
//! # Ok::<(), planish::Error>(())
//! ```
//!
//! # Identify a contour
//! ```
//! use planish::{Job, contour::ContourJob, progress::Silent};
//! let mut text = String::from("x,y,sigma\n");
//! for k in 0..60 {
//!     let angle = f64::from(k) * 0.1;
//!     let radius = 20.0 + 0.01 * f64::from(k % 3 - 1);
//!     text += &format!("{},{},0.01\n", radius * angle.cos(), radius * angle.sin());
//! }
//! # let folder = tempfile::tempdir().unwrap();
//! let input = folder.path().join("points.csv");
//! std::fs::write(&input, text).unwrap();
//! let report = ContourJob { input, ..ContourJob::default() }.run(&Silent)?;
//! assert_eq!(report.main.kind, "circle");
//! let (_, radius) = report.main.parameters.iter().find(|(name, _)| name == "radius").unwrap();
//! assert!((radius.value - 20.0).abs() < 0.05);
//! # Ok::<(), planish::Error>(())
//! ```
//!
//! # Merge patches, wrap a mesh, draw a file
//! ```no_run
//! use planish::{Job, merge::MergeJob, progress::Silent, shell::surface::ShellMeshJob, view::PictureJob};
//! let job = MergeJob {
//!     patches: vec!["left.ply".into(), "right.ply".into()],
//!     outputs: vec!["whole.ply".into()],
//!     ..MergeJob::default()
//! };
//! println!("{} triangles", job.run(&Silent)?.merge.triangles);
//! let job = ShellMeshJob {
//!     mesh: "whole.ply".into(),
//!     outputs: vec!["shell.ply".into()],
//!     ..ShellMeshJob::default()
//! };
//! assert!(job.run(&Silent)?.watertight);
//! let mut job = PictureJob { output: "shell.png".into(), ..PictureJob::default() };
//! job.viewed.file = "shell.ply".into();
//! job.run(&Silent)?;
//! # Ok::<(), planish::Error>(())
//! ```

pub mod animation;
mod assumed_unit;
pub mod compare;
pub mod contour;
pub mod fit_files;
pub mod graphs;
pub mod info;
mod job;
pub mod merge;
pub mod next;
pub mod occluding;
pub mod output;
pub mod report;
pub mod sense;
pub mod shell;
pub mod simulate;
pub mod solid;
pub mod verify;
pub mod view;

pub use job::Job;
pub use planish_core::{
    DVec3, Error, ErrorKind, Finding, FindingCode, FindingLevel, Length, Result, Setting, Unit,
};
pub use planish_core::{budget, finding, progress};
pub use planish_exchange::write_as_set;
/// Settings of the sensors' front ends.
pub use planish_sense::{StereoOptions, StereoPoints, stripes::GridOptions};
pub use planish_spline::{Shape, SymmetryKind};
pub use planish_surface::{complete, export, fit, model, saved, stream};
