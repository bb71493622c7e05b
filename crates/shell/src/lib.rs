//! Implicit shells: any triangle mesh wrapped in a smooth field, deformed by a handful of control points,
//! fitted and posed.
//!
//! Comes in: a mesh, control points, and points or silhouettes of a real thing. Goes out: the mesh, moved.
//! Source: S. Ilic, P. Fua, "From explicit to implicit surfaces for visualization, animation and modeling",
//! 2003.
//!
//! Not guaranteed: that a deformed mesh does not cross itself.

mod camera;
mod controls;
mod deformation;
mod delaunay;
mod field;
mod fit;
mod isosurface;
mod natural_neighbour;
mod remeshing;
mod skeleton;

pub use camera::Camera;
pub use controls::{Controls, automatic_controls, automatic_controls_skipping, nearest_pairs, stiffness};
pub use deformation::{
    Deformation, Dirichlet, Lattice, LatticeBasis, Modes, PartMotion, RigidPart, RigidParts,
    VertexDisplacements, displaced_positions, displacements, parameter_row,
};
pub use delaunay::Delaunay;
pub use field::{FacetShare, Metaball, Shell, ShellDistance, ShellOptions, subdivide_for_spheres};
pub use fit::{
    FeatureObservation, FeatureTrack, FrameFit, OutlineKind, OutlinePoint, ParameterPrior, PointReading,
    PoseNoise, ShellFit, ShellFitOptions, ShellProgress, ShellReadings, ShellTracker, ShellView, SourceFit,
    fit_points, fit_shell, fit_shell_with_progress, stiffness_for_xyz,
};
pub use isosurface::{IsoLevel, IsoOptions, IsoSurface, iso_surface};
pub use natural_neighbour::{NaturalNeighbours, Weight};
pub use remeshing::{Region, RemeshOptions, remesh, smooth_vertex_values};
