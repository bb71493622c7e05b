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
mod overlap;
mod renewed;
mod skeleton;

pub use camera::Camera;
pub use controls::{Controls, automatic_controls, controls_from, nearest_pairs, stiffness};
pub use deformation::{
    Deformation, Dirichlet, Lattice, LatticeBasis, Modes, PartMotion, RigidPart, RigidParts,
    VertexDisplacements, displaced, displacements, parameter_row,
};
pub use delaunay::Delaunay;
pub use field::{Metaball, Share, Shell, ShellDistance, ShellOptions, subdivided};
pub use fit::{
    FeatureTrack, FrameFit, OutlineKind, OutlinePoint, ParameterPrior, PointReading, PoseNoise, ShellFit,
    ShellFitOptions, ShellProgress, ShellReadings, ShellTracker, ShellView, Sighting, SourceFit, fit_points,
    fit_shell, fit_shell_watched, of_three_coordinates,
};
pub use isosurface::{IsoLevel, IsoOptions, IsoSurface, iso_surface};
pub use natural_neighbour::{NaturalNeighbours, Weight};
pub use overlap::{covered_pixels, intersection_over_union, projected_vertices};
pub use renewed::{Bound, Renewal, local_means, renewed};
