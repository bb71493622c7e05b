//! Writes scans as binary little-endian PLY files.
//!
//! **Input.** A [`Scan`].
//!
//! **Output.** `float64 x y z`, the uncertainties of the points, and the sampling grid of an organised scan.
//!
//! **Limits.** Poses and viewing directions are not written; they belong in the job.

use std::io::{self, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::{RangeGrid, Scan};

use crate::Unit;
use crate::atomic::write_packed;

/// Writes a scan, compressed if the path ends with `.gz`; [`read_scan`](super::read_scan) returns the same
/// numbers.
///
/// Columns: `x y z`; `nx ny nz`, `sigma_n_deg`; `k1 k2 d1x d1y d1z`, `sigma_k`; the covariance
/// `cxx cxy cxz cyy cyz czz`, else `sigma`; the element `range_grid`. Pose, viewing direction and the number
/// of dropped readings are not written.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) for columns of unequal length or a grid that names no point;
/// [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left half-written.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::ply::{read_scan, write_scan};
/// use planish_sense::Scan;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("one.ply");
/// let scan = Scan { points: vec![DVec3::new(0.1, 0.2, 0.3)], sigma: Some(vec![0.05]), ..Scan::default() };
/// write_scan(&path, &scan, None)?;
/// assert_eq!(read_scan(&path)?.sigma, Some(vec![0.05]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_scan(path: &Path, scan: &Scan, unit: Option<Unit>) -> Result<()> {
    // Before anything is written, because the header declares one count for all columns.
    check(scan).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| write_to(&mut writer, scan, unit))
}

fn check(scan: &Scan) -> Result<()> {
    let count = scan.points.len();
    for (name, length) in [
        ("normals", scan.normals.as_ref().map(Vec::len)),
        ("sigma_n_deg", scan.sigma_normal_deg.as_ref().map(Vec::len)),
        ("k1", scan.curvatures.as_ref().map(Vec::len)),
        ("sigma_k", scan.sigma_curvature.as_ref().map(Vec::len)),
        ("covariance", scan.covariance.as_ref().map(Vec::len)),
        ("sigma", scan.sigma.as_ref().map(Vec::len)),
    ] {
        if let Some(length) = length
            && length != count
        {
            return Err(Error::input(format!(
                "expected {count} entries in the column `{name}`, found {length}"
            )));
        }
    }
    if let Some(grid) = &scan.grid {
        if grid.columns.checked_mul(grid.rows) != Some(grid.cells.len()) {
            return Err(Error::input(format!(
                "expected {} x {} cells in the grid, found {}",
                grid.columns,
                grid.rows,
                grid.cells.len()
            )));
        }
        // The list of indices has the type `int`.
        let limit = count.min(i32::MAX as usize);
        let wrong = |&&cell: &&u32| cell != RangeGrid::EMPTY && cell as usize >= limit;
        if let Some(cell) = grid.cells.iter().find(wrong) {
            return Err(Error::input(format!(
                "expected indices below {limit} in the cells of the grid, found {cell}"
            )));
        }
    }
    Ok(())
}

fn write_to(writer: &mut impl Write, scan: &Scan, unit: Option<Unit>) -> io::Result<()> {
    writeln!(writer, "ply\nformat binary_little_endian 1.0")?;
    if let Some(unit) = unit {
        writeln!(writer, "comment unit {unit}")?;
    }
    if let Some(grid) = &scan.grid {
        writeln!(writer, "obj_info num_cols {}\nobj_info num_rows {}", grid.columns, grid.rows)?;
    }
    writeln!(writer, "element vertex {}", scan.points.len())?;
    let mut names = vec!["x", "y", "z"];
    if scan.normals.is_some() {
        names.extend(["nx", "ny", "nz"]);
    }
    if scan.sigma_normal_deg.is_some() {
        names.push("sigma_n_deg");
    }
    if scan.curvatures.is_some() {
        names.extend(["k1", "k2", "d1x", "d1y", "d1z"]);
    }
    if scan.sigma_curvature.is_some() {
        names.push("sigma_k");
    }
    if scan.covariance.is_some() {
        names.extend(["cxx", "cxy", "cxz", "cyy", "cyz", "czz"]);
    } else if scan.sigma.is_some() {
        names.push("sigma");
    }
    for name in names {
        writeln!(writer, "property double {name}")?;
    }
    if let Some(grid) = &scan.grid {
        writeln!(writer, "element range_grid {}", grid.cells.len())?;
        writeln!(writer, "property list uchar int vertex_indices")?;
    }
    writeln!(writer, "end_header")?;
    for (i, point) in scan.points.iter().enumerate() {
        let mut put = |values: &[f64]| values.iter().try_for_each(|v| writer.write_all(&v.to_le_bytes()));
        // In the order of `names` above, which is all that tells the columns apart.
        put(point.as_ref())?;
        if let Some(normals) = &scan.normals {
            put(normals[i].as_ref())?;
        }
        if let Some(sigma) = &scan.sigma_normal_deg {
            put(&[sigma[i]])?;
        }
        if let Some(curvatures) = &scan.curvatures {
            put(&curvatures[i].values)?;
            put(curvatures[i].direction.as_ref())?;
        }
        if let Some(sigma) = &scan.sigma_curvature {
            put(&[sigma[i]])?;
        }
        // Readers reject files with both, so the covariance, which states more, takes precedence.
        if let Some(covariance) = &scan.covariance {
            put(&covariance[i].to_array())?;
        } else if let Some(sigma) = &scan.sigma {
            put(&[sigma[i]])?;
        }
    }
    for &cell in scan.grid.iter().flat_map(|grid| &grid.cells) {
        if cell == RangeGrid::EMPTY {
            writer.write_all(&[0])?;
        } else {
            writer.write_all(&[1])?;
            writer.write_all(&cell.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::read_scan;
    use super::*;
    use planish_core::DVec3;
    use planish_core::SymmetricMatrix3;

    #[test]
    fn written_scans_read_back_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let full = Scan {
            name: "a.ply".to_owned(),
            points: vec![DVec3::new(0.1, 1.0 / 3.0, -2e-7), DVec3::new(4.0, 5.0, 6.0)],
            covariance: Some(vec![
                SymmetricMatrix3::from_array([1.0, 0.1, 0.0, 2.0, 0.0, 3.0]),
                SymmetricMatrix3::isotropic(0.5),
            ]),
            normals: Some(vec![DVec3::new(0.0, 0.6, 0.8), DVec3::X]),
            sigma_normal_deg: Some(vec![2.0, 0.5]),
            grid: Some(RangeGrid { columns: 3, rows: 1, cells: vec![1, RangeGrid::EMPTY, 0] }),
            ..Scan::default()
        };
        let plain = Scan {
            sigma: Some(vec![0.25, 0.5]),
            covariance: None,
            normals: None,
            sigma_normal_deg: None,
            grid: None,
            ..full.clone()
        };
        for (scan, name) in [(full, "a.ply"), (plain.clone(), "a.ply"), (plain, "b.ply.gz")] {
            let path = folder.path().join(name);
            write_scan(&path, &scan, Some(Unit::Inch)).unwrap();
            // The first bytes of a gzip file (RFC 1952).
            let bytes = std::fs::read(&path).unwrap();
            assert_eq!(bytes.starts_with(&[0x1f, 0x8b]), name.ends_with(".gz"));
            let read = read_scan(&path).unwrap();
            assert_eq!(read.points, scan.points);
            assert_eq!((read.sigma, read.covariance), (scan.sigma, scan.covariance));
            assert_eq!((read.normals, read.grid), (scan.normals, scan.grid));
            assert_eq!(read.sigma_normal_deg, scan.sigma_normal_deg);
        }
    }

    #[test]
    fn columns_of_wrong_length_are_rejected() {
        let points = vec![DVec3::ZERO];
        let grid = |columns, cells| Some(RangeGrid { columns, rows: 1, cells });
        for (scan, words) in [
            (
                Scan { sigma: Some(vec![]), points: points.clone(), ..Scan::default() },
                "column `sigma`, found 0",
            ),
            (Scan { grid: grid(2, vec![0]), points: points.clone(), ..Scan::default() }, "2 x 1 cells"),
            (
                Scan { grid: grid(1, vec![1]), points, ..Scan::default() },
                "below 1 in the cells of the grid, found 1",
            ),
        ] {
            let e = check(&scan).unwrap_err();
            assert!(e.to_string().contains(words), "{e}");
        }
    }
}
