//! A scan: points of one sensor from one pose, with whatever it states about their errors.

use crate::Pose;

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
    /// The mark of a cell without a point.
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
    /// Not known: every side of a surface may have been seen.
    #[default]
    Unknown,
    /// Parallel rays that travel along this unit direction.
    Direction([f64; 3]),
    /// Rays that leave this point.
    Origin([f64; 3]),
}

/// Principal curvatures of a surface at a point: positive where it bends towards its normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrincipalCurvatures {
    /// `κ1` and `κ2`, one over the model's unit.
    pub values: [f64; 2],
    /// The direction of `κ1`; that of `κ2` stands on it and on the normal.
    pub direction: [f64; 3],
}

/// Points of one sensor from one pose, in the scanner's own frame.
///
/// Every optional column, where present, has one entry for each point.
#[derive(Debug, Clone, Default)]
pub struct Scan {
    /// What messages and reports call the scan: usually its file name.
    pub name: String,
    /// Positions, in the model's unit.
    pub points: Vec<[f64; 3]>,
    /// Standard deviation of each coordinate, in the model's unit.
    pub sigma: Option<Vec<f64>>,
    /// Covariances `[xx, xy, xz, yy, yz, zz]`, in the model's unit squared.
    pub covariance: Option<Vec<[f64; 6]>>,
    /// Measured or precomputed normals (not necessarily of unit length).
    pub normals: Option<Vec<[f64; 3]>>,
    /// Standard deviation of the normals, in degrees.
    pub sigma_normal_deg: Option<Vec<f64>>,
    /// Measured principal curvatures, with respect to the normals.
    pub curvatures: Option<Vec<PrincipalCurvatures>>,
    /// Standard deviation of each of them, one over the model's unit.
    pub sigma_curvature: Option<Vec<f64>>,
    /// What each point lies on, by the classes of the ASPRS (2 is ground), where somebody has told them
    /// apart.
    pub classes: Option<Vec<u8>>,
    /// Parameters `(u, v)` of each point on the surface that it was taken of, in `[0, 1]`, where they are
    /// known.
    pub parameters: Option<Vec<[f64; 2]>>,
    /// Sampling grid of an organised scan.
    pub grid: Option<RangeGrid>,
    /// How the sensor looks, in the scanner's frame.
    pub viewing: Viewing,
    /// Carries the scanner's frame into the world.
    pub world_from_scanner: Pose,
    /// When each point was taken, in seconds, where a file says so.
    pub times_s: Option<Vec<f64>>,
    /// Which of the scans of its file each point is of, where a file holds several.
    pub scan_numbers: Option<Vec<u32>>,
    /// When it was taken, in seconds, where a job or the file says so.
    pub time_s: Option<f64>,
    /// How many records of the file were dropped because a coordinate was not finite.
    pub dropped_not_finite: usize,
}
