//! Implicit shells: wraps a triangle mesh in a smooth distance field, deforms it by a few control points, and
//! fits it to measurements.
//!
//! In: a mesh, control points, and points or silhouettes of a real object. Out: the deformed mesh and the
//! covariance of its parameters.
//! Source: S. Ilic, P. Fua, "From explicit to implicit surfaces for visualization, animation and modeling",
//! 2003.
//!
//! Not guaranteed: a deformed mesh may intersect itself.
//!
//! # A tour
//!
//! 1. [`automatic_controls`] places control points on a mesh; [`stiffness`] and [`stiffness_for_xyz`] give
//!    their smoothness energy.
//! 2. A [`Deformation`] maps the parameters to vertices: [`Dirichlet`], [`Lattice`], [`Modes`],
//!    [`VertexDisplacements`] or [`RigidParts`].
//! 3. [`fit_points`] or [`fit_shell`] estimates the parameters; [`ShellTracker`] does so frame by frame.
//! 4. [`Shell`] evaluates the distance field by itself, and [`iso_surface`] meshes it.
//!
//! # Examples
//!
//! Fit a sphere of radius 1 to points on a sphere of radius 1.1:
//! ```
//! use planish_core::SymmetricMatrix3;
//! use planish_mesh::icosphere;
//! use planish_shell::{Dirichlet, PointReading, ShellFitOptions, automatic_controls, fit_points};
//! use planish_shell::{stiffness, stiffness_for_xyz};
//! let ball = icosphere(1.0, 2);
//! let controls = automatic_controls(&ball, 20)?;
//! let deformation = Dirichlet::new(&controls.points, &ball.positions)?;
//! let points: Vec<PointReading> = icosphere(1.1, 3)
//!     .positions
//!     .into_iter()
//!     .map(|at| PointReading { at, covariance: SymmetricMatrix3::isotropic(1e-4) })
//!     .collect();
//! let k = stiffness(&controls.points, &controls.triangles, &controls.edges);
//! let options = ShellFitOptions { stiffness: Some(stiffness_for_xyz(&k)), ..ShellFitOptions::default() };
//! let fit = fit_points(&ball, &deformation, &points, &options)?;
//! assert!(fit.points.rms < 0.05);
//! # Ok::<(), planish_estimate::Error>(())
//! ```

mod articulation;
mod camera;
mod controls;
mod deformation;
mod delaunay;
mod field;
mod fit;
mod isosurface;
mod natural_neighbour;
mod overlap;
mod point_tree;
mod remeshing;
mod rigidity;
mod skeleton;

pub use camera::Camera;
pub use controls::{
    ControlSampling, Controls, automatic_controls, automatic_controls_skipping, nearest_pairs, stiffness,
};
pub use deformation::{
    Deformation, Dirichlet, Lattice, LatticeBasis, Modes, PartMotion, RigidPart, RigidParts, RowForms,
    SparseRow, VertexDisplacements, displaced_positions, displacements, parameter_row,
};
pub use delaunay::Delaunay;
pub use field::{FacetShare, Metaball, Shell, ShellDistance, ShellOptions, subdivide_for_spheres};
pub use fit::{
    ControlGrowth, ControlledDeformation, FacetRoundness, FeatureObservation, FeatureTrack, FrameFit,
    GrownFit, LandmarkReading, OutlineKind, OutlinePoint, ParameterPrior, PointReading, PoseNoise,
    ResumePoint, ShellFit, ShellFitOptions, ShellProgress, ShellReadings, ShellTracker, ShellView,
    SmoothedMotion, SourceFit, VertexResiduals, VertexSupport, fit_points, fit_shell,
    fit_shell_with_progress, fit_with_growing_controls, stiffness_for_xyz,
};
pub use isosurface::{IsoLevel, IsoOptions, IsoSurface, iso_surface};
pub use natural_neighbour::{NaturalNeighbours, Weight};
pub use overlap::{covered_pixels, intersection_over_union, projected_vertices};
pub use remeshing::{Region, RemeshOptions, large_parts, remesh, smooth_vertex_values};
pub use rigidity::Rigidity;
