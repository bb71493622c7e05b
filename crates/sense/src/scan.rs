//! A scan: the points of one sensor from one pose, with their stated errors.

use planish_core::{DVec3, Pose, SymmetricMatrix3};

/// The sampling grid of an organised scan: which point, if any, each grid cell holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RangeGrid {
    /// Number of columns.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
    /// Row by row, the index of the point in each cell; [`RangeGrid::EMPTY`] where there is none.
    pub cells: Vec<u32>,
}

impl RangeGrid {
    /// Index of a cell without a point.
    pub const EMPTY: u32 = u32::MAX;

    /// The point at a column and row.
    #[must_use]
    pub fn point(&self, column: usize, row: usize) -> Option<usize> {
        let index = self.cells[row * self.columns + column];
        (index != Self::EMPTY).then_some(index as usize)
    }
}

/// How the sensor looks at the object, in the scanner's own frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Viewing {
    /// Unknown: either side of a surface may have been seen.
    #[default]
    Unknown,
    /// Parallel rays that travel along this unit direction.
    Direction(DVec3),
    /// Rays that leave this point.
    Origin(DVec3),
}

/// Principal curvatures of a surface at a point: positive where it bends towards its normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrincipalCurvatures {
    /// `κ1` and `κ2`, one over the model's unit.
    pub values: [f64; 2],
    /// The direction of `κ1`; that of `κ2` is perpendicular to it and to the normal.
    pub direction: DVec3,
}

/// Points of one sensor from one pose, in the scanner's own frame.
///
/// Every optional column that is present has one entry for each point.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_sense::{Scan, Viewing};
/// let scan = Scan {
///     name: "left".to_owned(),
///     points: vec![DVec3::Z, DVec3::new(0.1, 0.0, 1.0)],
///     sigma: Some(vec![0.01, 0.02]),
///     viewing: Viewing::Origin(DVec3::ZERO),
///     ..Scan::default()
/// };
/// assert_eq!(scan.points.len(), 2);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Scan {
    /// Name in messages and reports, usually the file name.
    pub name: String,
    /// Positions, in the model's unit.
    pub points: Vec<DVec3>,
    /// Standard deviation of each coordinate, in the model's unit.
    pub sigma: Option<Vec<f64>>,
    /// Covariances, in the model's unit squared.
    pub covariance: Option<Vec<SymmetricMatrix3>>,
    /// Measured or precomputed normals (not necessarily of unit length).
    pub normals: Option<Vec<DVec3>>,
    /// Standard deviation of the normals, in degrees.
    pub sigma_normal_deg: Option<Vec<f64>>,
    /// Measured principal curvatures, with respect to the normals.
    pub curvatures: Option<Vec<PrincipalCurvatures>>,
    /// Standard deviation of each of them, one over the model's unit.
    pub sigma_curvature: Option<Vec<f64>>,
    /// ASPRS class of each point (2 is ground), if the points are classified.
    pub classes: Option<Vec<u8>>,
    /// Parameters `(u, v)` of each point on the measured surface, in `[0, 1]`, if known.
    pub parameters: Option<Vec<[f64; 2]>>,
    /// Sampling grid of an organised scan.
    pub grid: Option<RangeGrid>,
    /// Viewing geometry of the sensor, in the scanner's frame.
    pub viewing: Viewing,
    /// Pose of the scanner: maps its frame into the world.
    pub world_from_scanner: Pose,
    /// Time of each point in seconds, if the file states it.
    pub times_s: Option<Vec<f64>>,
    /// Number of the scan of each point, if the file holds several scans.
    pub scan_numbers: Option<Vec<u32>>,
    /// Time of the scan in seconds, if the job or the file states it.
    pub time_s: Option<f64>,
    /// Number of records that were dropped because a coordinate was not finite.
    pub dropped_not_finite: usize,
}
