//! Builds a scan from point records with named columns.
//!
//! **Input.** The names of the columns of a file and its records as numbers.
//!
//! **Output.** A [`Scan`] without records whose coordinates are not finite (these are counted). Every σ is
//! checked to be positive and finite, every covariance to be positive definite. Columns with other names are
//! ignored; `scan` and `time` are kept for [`crate::split_scans`], which splits a file by them.
//!
//! **Limits.** Normals need not have unit length. A normal that is not finite is kept as zero, which means
//! unknown.

use std::fmt::Display;

use planish_core::{Budget, DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};
use planish_sense::{PrincipalCurvatures, RangeGrid, Scan};

/// Tolerance of the length of normals in unnamed columns. Wide enough for normals written with two or three
/// digits; colours and other values practically never have unit length in every record (decision 0039).
const UNIT_LENGTH_TOLERANCE: f64 = 0.01;

/// Upper limit of the σ of a normal, in degrees. Beyond it, the direction is unknown.
pub(crate) const MAX_SIGMA_NORMAL_DEG: f64 = 90.0;
/// Largest scan number; it fits into `u32` and is exact in `f64`.
const MAX_SCAN_NUMBER: f64 = 1e9;

/// Column names.
const POSITION: [&str; 3] = ["x", "y", "z"];
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
const COVARIANCE: [&str; 6] = ["cxx", "cxy", "cxz", "cyy", "cyz", "czz"];
const SIGMA: &str = "sigma";
const SIGMA_NORMAL: &str = "sigma_n_deg";
const CURVATURE: [&str; 5] = ["k1", "k2", "d1x", "d1y", "d1z"];
const SIGMA_CURVATURE: &str = "sigma_k";
const TIME: &str = "time";
const SCAN: &str = "scan";

/// True if a column of that name always means a quantity of points. `u` and `v` do not count, because other
/// programs use these names for texture coordinates.
pub(crate) fn is_point_column(name: &str) -> bool {
    let sigmas = [SIGMA, SIGMA_NORMAL, SIGMA_CURVATURE];
    let families: [&[&str]; 5] = [&POSITION, &NORMAL, &COVARIANCE, &CURVATURE, &sigmas];
    families.iter().any(|family| family.contains(&name))
}

/// Columns that state the uncertainty of a position.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Uncertainty {
    Unstated,
    Sigma(usize),
    Covariance([usize; 6]),
}

/// Column index of each quantity in a record.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PointColumns {
    position: [usize; 3],
    uncertainty: Uncertainty,
    normal: Option<[usize; 3]>,
    sigma_normal: Option<usize>,
    curvature: Option<[usize; 5]>,
    sigma_curvature: Option<usize>,
    parameters: Option<[usize; 2]>,
    time: Option<usize>,
    scan: Option<usize>,
}

/// Finds the columns of a group: all, none, or an error that names the missing ones.
fn family<const N: usize>(names: &[&str], wanted: [&str; N]) -> Result<Option<[usize; N]>> {
    let found = wanted.map(|name| names.iter().position(|n| *n == name));
    if found.iter().all(Option::is_none) {
        return Ok(None);
    }
    let missing: Vec<_> = (0..N).filter(|&k| found[k].is_none()).map(|k| wanted[k]).collect();
    if !missing.is_empty() {
        return Err(Error::input(format!(
            "expected all of the columns {}, found no {}",
            wanted.join(" "),
            missing.join(" ")
        )));
    }
    Ok(Some(found.map(Option::unwrap_or_default)))
}

impl PointColumns {
    /// Layout with positions in the first three columns.
    pub(crate) fn positions_only() -> Self {
        Self {
            position: [0, 1, 2],
            uncertainty: Uncertainty::Unstated,
            normal: None,
            sigma_normal: None,
            curvature: None,
            sigma_curvature: None,
            parameters: None,
            time: None,
            scan: None,
        }
    }

    /// Layout with positions, then normals, in the first six columns.
    pub(crate) fn positions_and_normals() -> Self {
        Self { normal: Some([3, 4, 5]), ..Self::positions_only() }
    }

    /// Derives the layout from column names.
    ///
    /// # Errors
    /// `Input` if positions are missing, a group is incomplete, σ and covariance are both given, or a σ
    /// belongs to a quantity that is absent.
    pub(crate) fn find(names: &[&str]) -> Result<Self> {
        let Some(position) = family(names, POSITION)? else {
            return Err(Error::input(format!(
                "expected the columns x y z, found {}",
                if names.is_empty() { "none".to_owned() } else { names.join(" ") }
            )));
        };
        let covariance = family(names, COVARIANCE)?;
        let sigma = names.iter().position(|n| *n == SIGMA);
        let uncertainty = match (sigma, covariance) {
            (None, None) => Uncertainty::Unstated,
            (Some(column), None) => Uncertainty::Sigma(column),
            (None, Some(columns)) => Uncertainty::Covariance(columns),
            (Some(_), Some(_)) => {
                return Err(Error::input("expected either sigma or cxx cxy cxz cyy cyz czz, found both"));
            }
        };
        let named = |name: &str| names.iter().position(|n| *n == name);
        let normal = family(names, NORMAL)?;
        let curvature = match (named(CURVATURE[0]), named(CURVATURE[1])) {
            (Some(_), Some(_)) => family(names, CURVATURE)?,
            // Other programs use single columns of these names for other quantities.
            _ => None,
        };
        let (sigma_normal, sigma_curvature) = (named(SIGMA_NORMAL), named(SIGMA_CURVATURE));
        // A σ without its quantity points to a misspelt column, which would otherwise be ignored silently.
        for (sigma, has_quantity, of_what) in [
            (sigma_normal.map(|_| SIGMA_NORMAL), normal.is_some(), &NORMAL[..]),
            (sigma_curvature.map(|_| SIGMA_CURVATURE), curvature.is_some(), &CURVATURE[..]),
        ] {
            if let (Some(sigma), false) = (sigma, has_quantity) {
                return Err(Error::input(format!(
                    "expected the columns {} with {sigma}, which is their σ, found none",
                    of_what.join(" ")
                )));
            }
        }
        Ok(Self {
            position,
            uncertainty,
            normal,
            sigma_normal,
            curvature,
            sigma_curvature,
            time: named(TIME),
            scan: named(SCAN),
            // A single `u` or `v` is another quantity and is ignored.
            parameters: family(names, ["u", "v"]).unwrap_or(None),
        })
    }

    /// Memory of a point with its columns in bytes.
    fn bytes(&self) -> u64 {
        let scalar = |is_present: bool| u64::from(is_present) * size_of::<f64>() as u64;
        let uncertainty = match self.uncertainty {
            Uncertainty::Unstated => 0,
            Uncertainty::Sigma(_) => scalar(true),
            Uncertainty::Covariance(_) => size_of::<SymmetricMatrix3>() as u64,
        };
        size_of::<DVec3>() as u64
            + uncertainty
            + 3 * scalar(self.normal.is_some())
            + 2 * scalar(self.parameters.is_some())
            + 5 * scalar(self.curvature.is_some())
            + scalar(self.sigma_normal.is_some())
            + scalar(self.sigma_curvature.is_some())
            + scalar(self.time.is_some())
            + scalar(self.scan.is_some())
    }

    /// Minimum number of columns of a record.
    pub(crate) fn width(&self) -> usize {
        let uncertainty: &[usize] = match &self.uncertainty {
            Uncertainty::Unstated => &[],
            Uncertainty::Sigma(column) => std::slice::from_ref(column),
            Uncertainty::Covariance(columns) => columns,
        };
        let all = self
            .position
            .iter()
            .chain(uncertainty)
            .chain(self.normal.iter().flatten())
            .chain(self.curvature.iter().flatten())
            .chain(self.parameters.iter().flatten());
        1 + all
            .chain(&self.sigma_normal)
            .chain(&self.sigma_curvature)
            .chain(&self.time)
            .chain(&self.scan)
            .max()
            .copied()
            .unwrap_or(0)
    }
}

/// Collects records into a scan.
pub(crate) struct PointCollector {
    columns: PointColumns,
    scan: Scan,
    records: u64,
    /// Indices of the dropped records, ascending.
    dropped: Vec<u64>,
    budget: Budget,
    /// Memory of one point with all of its columns, in bytes.
    bytes: u64,
}

impl PointCollector {
    /// Creates an empty collector with room for `reserve` points, which takes their memory from a budget.
    pub(crate) fn new(columns: PointColumns, reserve: usize, budget: &Budget) -> Self {
        let bytes = columns.bytes();
        // Never more than the budget holds: points beyond it are rejected anyway.
        let reserve = reserve.min(usize::try_from(budget.left(bytes)).unwrap_or(usize::MAX));
        let mut scan = Scan { points: Vec::with_capacity(reserve), ..Scan::default() };
        match columns.uncertainty {
            Uncertainty::Unstated => {}
            Uncertainty::Sigma(_) => scan.sigma = Some(Vec::with_capacity(reserve)),
            Uncertainty::Covariance(_) => scan.covariance = Some(Vec::with_capacity(reserve)),
        }
        scan.normals = columns.normal.map(|_| Vec::with_capacity(reserve));
        scan.parameters = columns.parameters.map(|_| Vec::with_capacity(reserve));
        scan.sigma_normal_deg = columns.sigma_normal.map(|_| Vec::with_capacity(reserve));
        scan.curvatures = columns.curvature.map(|_| Vec::with_capacity(reserve));
        scan.sigma_curvature = columns.sigma_curvature.map(|_| Vec::with_capacity(reserve));
        scan.times_s = columns.time.map(|_| Vec::with_capacity(reserve));
        scan.scan_numbers = columns.scan.map(|_| Vec::with_capacity(reserve));
        Self { columns, scan, records: 0, dropped: Vec::new(), budget: budget.clone(), bytes }
    }

    /// Number of points kept so far.
    pub(crate) fn len(&self) -> usize {
        self.scan.points.len()
    }

    /// Adds a record of at least [`PointColumns::width`] numbers; `place` is used in messages.
    ///
    /// A record without finite coordinates is dropped before its σ is checked, because the σ of a missed
    /// reading means nothing.
    #[inline]
    pub(crate) fn push(&mut self, record: &[f64], place: impl Display) -> Result<()> {
        // Dropped records count, too, because grids and messages refer to the records of the file.
        let number = self.records;
        self.records += 1;
        let point = self.columns.position.map(|c| record[c]);
        if !point.iter().all(|c| c.is_finite()) {
            let bytes = size_of_val(&number) as u64;
            self.budget.take_elements(1, bytes, format_args!("points without coordinates ({place})"))?;
            self.dropped.push(number);
            return Ok(());
        }
        self.budget.take_elements(1, self.bytes, format_args!("points ({place}, point {number})"))?;
        // Sampling grids refer to points by 32-bit indices; the largest one marks an empty cell.
        if self.scan.points.len() as u64 >= u64::from(u32::MAX) {
            return Err(Error::unsupported(format!(
                "more than {} points in one scan: split the file",
                u32::MAX
            )));
        }
        self.scan.points.push(DVec3::from(point));
        // σ = 0 would give a reading infinite weight.
        let positive = |name: &str, value: f64| {
            if value > 0.0 && value.is_finite() {
                return Ok(value);
            }
            Err(Error::input(format!("{place}: expected {name} > 0, found {value} (point {number})")))
        };
        match self.columns.uncertainty {
            Uncertainty::Unstated => {}
            Uncertainty::Sigma(column) => {
                let sigma = positive("sigma", record[column])?;
                self.scan.sigma.get_or_insert_default().push(sigma);
            }
            Uncertainty::Covariance(columns) => {
                let covariance = columns.map(|c| record[c]);
                if !is_positive_definite(&covariance) {
                    return Err(Error::input(format!(
                        "{place}: expected a positive definite covariance, found cxx cxy cxz cyy cyz czz = \
                         {} (point {number})",
                        covariance.map(|c| c.to_string()).join(" ")
                    )));
                }
                self.scan.covariance.get_or_insert_default().push(SymmetricMatrix3::from_array(covariance));
            }
        }
        if let Some(columns) = self.columns.normal {
            let normal = DVec3::from_array(columns.map(|c| record[c]));
            // Kept as zero instead of dropped, so that normals stay parallel to points.
            let known = normal.is_finite();
            let normals = self.scan.normals.get_or_insert_default();
            normals.push(if known { normal } else { DVec3::ZERO });
        }
        if let Some(columns) = self.columns.parameters {
            let parameters = columns.map(|c| record[c]);
            self.scan.parameters.get_or_insert_default().push(parameters);
        }
        if let Some(column) = self.columns.sigma_normal {
            let sigma = positive(SIGMA_NORMAL, record[column])?;
            if sigma >= MAX_SIGMA_NORMAL_DEG {
                return Err(Error::input(format!(
                    "{place}: expected {SIGMA_NORMAL} below {MAX_SIGMA_NORMAL_DEG} degrees, found {sigma} \
                     (point {number})"
                )));
            }
            self.scan.sigma_normal_deg.get_or_insert_default().push(sigma);
        }
        if let Some(columns) = self.columns.curvature {
            let [k1, k2, x, y, z] = columns.map(|c| record[c]);
            let known = [k1, k2, x, y, z].iter().all(|c| c.is_finite());
            self.scan.curvatures.get_or_insert_default().push(PrincipalCurvatures {
                values: [k1, k2],
                // A zero direction marks an unknown curvature, as a zero normal marks an unknown normal.
                direction: if known { DVec3::new(x, y, z) } else { DVec3::ZERO },
            });
        }
        if let Some(column) = self.columns.sigma_curvature {
            let sigma = positive(SIGMA_CURVATURE, record[column])?;
            self.scan.sigma_curvature.get_or_insert_default().push(sigma);
        }
        if let Some(column) = self.columns.time {
            let time = record[column];
            // Unlike a normal, a time has no value that means unknown: scans are split and ordered by it.
            if !time.is_finite() {
                return Err(Error::input(format!(
                    "{place}: expected a time in seconds, found {time} (point {number})"
                )));
            }
            self.scan.times_s.get_or_insert_default().push(time);
        }
        if let Some(column) = self.columns.scan {
            let found = record[column];
            if !(0.0..=MAX_SCAN_NUMBER).contains(&found) || found.fract() != 0.0 {
                return Err(Error::input(format!(
                    "{place}: expected a scan number, a whole number from 0, found {found} (point {number})"
                )));
            }
            self.scan.scan_numbers.get_or_insert_default().push(found as u32);
        }
        Ok(())
    }

    /// Returns the scan and the indices of the dropped records.
    pub(crate) fn finish(mut self, name: &str) -> (Scan, Vec<u64>) {
        self.scan.name = name.to_owned();
        self.scan.dropped_not_finite = self.dropped.len();
        (self.scan, self.dropped)
    }
}

/// Removes normals from unnamed columns unless every one has unit length.
///
/// One exception rejects them all, because the columns then hold something else, such as colours.
pub(crate) fn keep_unit_normals(scan: &mut Scan) {
    let unit_length = |n: &DVec3| {
        let length = n.to_array().iter().map(|c| c * c).sum::<f64>().sqrt();
        (length - 1.0).abs() <= UNIT_LENGTH_TOLERANCE
    };
    if !scan.normals.iter().flatten().all(unit_length) {
        scan.normals = None;
    }
}

/// Builds the sampling grid of records stored row by row. Cells of dropped records are empty.
pub(crate) fn grid_without(columns: usize, rows: usize, dropped: &[u64]) -> RangeGrid {
    let mut dropped = dropped.iter().copied().peekable();
    let mut next = 0;
    let cells = (0..(columns * rows) as u64)
        .map(|record| {
            if dropped.next_if_eq(&record).is_some() {
                return RangeGrid::EMPTY;
            }
            next += 1;
            next - 1
        })
        .collect();
    RangeGrid { columns, rows, cells }
}

/// True if `[xx, xy, xz, yy, yz, zz]` is finite and positive definite beyond rounding.
fn is_positive_definite(c: &[f64; 6]) -> bool {
    let [xx, xy, xz, yy, yz, zz] = *c;
    // Relative to the largest variance, so that the unit of the file does not matter.
    let min_pivot = 1e-14 * xx.max(yy).max(zz);
    // Pivots of the Cholesky factorisation; NaN fails every comparison.
    let (a, b) = (xy / xx, xz / xx);
    let p1 = yy - a * xy;
    let q = (yz - b * xy) / p1;
    let p2 = zz - b * xz - q * (yz - b * xy);
    c.iter().all(|v| v.is_finite()) && xx > 0.0 && xx > min_pivot && p1 > min_pivot && p2 > min_pivot
}

#[cfg(test)]
mod tests {
    use super::*;

    fn collect(names: &[&str], records: &[&[f64]]) -> Result<Scan> {
        let mut collector = PointCollector::new(PointColumns::find(names)?, 0, &Budget::of_process());
        for (i, record) in records.iter().enumerate() {
            collector.push(record, format_args!("line {}", i + 1))?;
        }
        Ok(collector.finish("a").0)
    }

    #[test]
    fn columns_are_found_in_any_order() {
        let names = ["nz", "z", "red", "sigma", "y", "x", "ny", "nx"];
        let scan = collect(&names, &[&[6.0, 3.0, 9.0, 0.5, 2.0, 1.0, 5.0, 4.0]]).unwrap();
        assert_eq!(scan.points, [DVec3::new(1.0, 2.0, 3.0)]);
        assert_eq!(scan.normals.unwrap(), [DVec3::new(4.0, 5.0, 6.0)]);
        assert_eq!(scan.sigma.unwrap(), [0.5]);
    }

    #[test]
    fn an_incomplete_group_of_columns_is_an_error_that_names_the_missing_ones() {
        let e = PointColumns::find(&["x", "y", "z", "cxx", "cyy", "czz"]).unwrap_err();
        assert!(e.to_string().contains("found no cxy cxz cyz"), "{e}");
        let e = PointColumns::find(&["x", "y"]).unwrap_err();
        assert!(e.to_string().contains("found no z"), "{e}");
    }

    #[test]
    fn a_sigma_without_its_quantity_is_an_error_that_names_the_columns() {
        for (more, words) in [
            (&["sigma_n_deg"][..], "expected the columns nx ny nz with sigma_n_deg"),
            (&["sigma_k"], "expected the columns k1 k2 d1x d1y d1z with sigma_k"),
            (&["k1", "k2"], "found no d1x d1y d1z"),
        ] {
            let names: Vec<&str> = ["x", "y", "z"].iter().chain(more).copied().collect();
            let e = PointColumns::find(&names).unwrap_err();
            assert!(e.to_string().contains(words), "{e}");
        }
        // A single column of that name is another quantity.
        assert!(PointColumns::find(&["x", "y", "z", "k1"]).is_ok());
        let names = ["x", "y", "z", "nx", "ny", "nz", "sigma_n_deg"];
        let e = collect(&names, &[&[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 400.0]]).unwrap_err();
        assert!(e.to_string().contains("below 90") && e.to_string().contains("line 1"), "{e}");
    }

    #[test]
    fn invalid_sigma_and_covariance_are_reported_with_line_and_point() {
        for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let records: [&[f64]; 2] = [&[0.0, 0.0, 0.0, 1.0], &[0.0, 0.0, 0.0, sigma]];
            let e = collect(&["x", "y", "z", "sigma"], &records).unwrap_err();
            assert!(e.to_string().contains("line 2") && e.to_string().contains("point 1"), "{e}");
        }
        let names = ["x", "y", "z", "cxx", "cxy", "cxz", "cyy", "cyz", "czz"];
        assert!(collect(&names, &[&[0.0, 0.0, 0.0, 4.0, 1.0, 0.0, 1.0, 0.2, 1.0]]).is_ok());
        for c in [
            [1.0, 1.0, 0.0, 1.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, -1.0, 0.0, 1.0],
            [1.0, 0.9, 0.9, 1.0, -0.9, 1.0],
            [0.0; 6],
            [f64::NAN, 0.0, 0.0, 1.0, 0.0, 1.0],
        ] {
            let record: Vec<f64> = [0.0; 3].into_iter().chain(c).collect();
            assert!(collect(&names, &[&record]).is_err(), "{c:?}");
        }
    }

    #[test]
    fn records_without_a_finite_position_are_dropped_and_counted() {
        let scan = collect(&["x", "y", "z", "sigma"], &[&[f64::NAN, 0.0, 0.0, -1.0], &[1.0, 0.0, 0.0, 1.0]]);
        let scan = scan.unwrap();
        assert_eq!((scan.points.len(), scan.dropped_not_finite), (1, 1));
        assert_eq!(scan.sigma.unwrap().len(), 1);
    }
}
