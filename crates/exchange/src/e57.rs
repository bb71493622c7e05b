//! E57, the exchange format of terrestrial scanners: one or more scans per file, each with its pose.
//!
//! **Input.** An ASTM E2807 file, Cartesian or spherical.
//!
//! **Output.** One [`Scan`] per point cloud, in the frame of its scanner with its pose, in metres (the unit
//! of the format). Points marked as invalid are dropped and counted. Row and column indices give the sampling
//! grid if no two points share a cell. The viewpoint is the origin of the frame for spherical and organised
//! clouds and for those with a pose; for other clouds it is unknown.
//!
//! **Limits.** Colours, intensities, images and times are ignored.
//!
//! # References
//! ASTM E2807-11, *Standard Specification for 3D Imaging Data Exchange*, 2011.

use planish_core::{Budget, DVec3};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use e57::{E57Reader, PointCloud, Record, RecordDataType, RecordName, RecordValue};
use planish_estimate::{Error, ErrorKind, Result};
use planish_sense::{Pose, RangeGrid, Scan, Viewing};

use crate::points::{PointCollector, PointColumns};
use crate::source::{DATA_RATIO, open_file};

/// Maximum ratio of grid cells to points. Beyond it, the indices do not describe a sampling grid, and the
/// grid would take far more memory than the points. Guarded by `shared_and_sparse_cells_give_no_grid`.
const MAX_CELLS_PER_POINT: u64 = 64;

/// Reads all point clouds that have points. If none has, one empty scan is returned, which counts the dropped
/// points.
///
/// # Errors
/// [`Io`](ErrorKind::Io) when the file is missing or unreadable, [`Input`](ErrorKind::Input) when it is
/// malformed, cut off, or holds no point cloud: with the file, the cloud and the point.
pub fn read_e57(path: &Path) -> Result<Vec<Scan>> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    scans_from(path, &name).map_err(|e| e.in_context(path.display()))
}

fn damaged(e: e57::Error, what: &str) -> Error {
    Error::input(format!("{what}: the file is damaged, cut off or not an E57 file")).with_source(e)
}

fn scans_from(path: &Path, name: &str) -> Result<Vec<Scan>> {
    let (file, length) = open_file(path)?;
    // Packed integers may take a single bit.
    let budget = length.map_or_else(Budget::of_process, |n| Budget::of_compressed(n, DATA_RATIO));
    let mut reader =
        E57Reader::new(BufReader::new(file)).map_err(|e| damaged(e, "the header cannot be read"))?;
    let clouds = reader.pointclouds();
    let mut scans = Vec::with_capacity(clouds.len());
    for (number, cloud) in clouds.iter().enumerate() {
        // Names of clouds are optional and need not differ, so a number distinguishes several.
        let label = match (&clouds[..], &cloud.name) {
            ([_], _) => name.to_owned(),
            (_, Some(own)) if !own.is_empty() => format!("{name} {} ({own})", number + 1),
            _ => format!("{name} {}", number + 1),
        };
        let read = scan_from(&mut reader, cloud, &label, length, &budget);
        scans.push(read.map_err(|e| e.in_context(format_args!("point cloud {}", number + 1)))?);
    }
    if scans.is_empty() {
        return Err(Error::input("expected at least one point cloud, found none"));
    }
    // A cloud without valid points is no error beside others, but a fit could not use it.
    if scans.iter().any(|scan| !scan.points.is_empty()) {
        scans.retain(|scan| !scan.points.is_empty());
    } else {
        scans.truncate(1);
    }
    Ok(scans)
}

/// Size of a value of a record in bits.
fn bits(record: &Record) -> u64 {
    match record.data_type {
        RecordDataType::Single { .. } => 32,
        RecordDataType::Double { .. } => 64,
        RecordDataType::Integer { min, max } | RecordDataType::ScaledInteger { min, max, .. } => {
            // E57 packs integers into the fewest bits that hold `max - min`; with 128 bits it cannot
            // overflow.
            u64::from(128 - (i128::from(max) - i128::from(min)).max(0).leading_zeros())
        }
    }
}

fn scan_from(
    reader: &mut E57Reader<BufReader<File>>,
    cloud: &PointCloud,
    name: &str,
    length: Option<u64>,
    budget: &Budget,
) -> Result<Scan> {
    let (cartesian, spherical) = (cloud.has_cartesian(), cloud.has_spherical());
    if !cartesian && !spherical {
        return Err(Error::new(
            ErrorKind::Input,
            "expected Cartesian or spherical coordinates, found neither",
        ));
    }
    let record: u64 = cloud.prototype.iter().map(bits).sum();
    // Fields with one possible value take no bits, so any number of such points would fit: count one bit.
    let needed = cloud.records.saturating_mul(record.max(1)) / 8;
    if let Some(length) = length
        && needed > length
    {
        return Err(Error::input(format!(
            "the header declares {} points, which take at least {needed} bytes, but the file has {length}: \
             it is cut off or its header is wrong",
            cloud.records
        )));
    }
    if record == 0 && cloud.records > 0 {
        return Err(Error::input(
            "expected points with different coordinates, found a cloud whose points are all equal",
        ));
    }
    let world_from_scanner = pose(cloud)?;
    let mut collector = PointCollector::new(PointColumns::positions_only(), cloud.records as usize, budget);
    let mut cells = Vec::new();
    let layout = Layout::new(cloud);
    // The simple reader of the crate stops at a packet without a whole point, which its own writer produces
    // (decision 0036). The raw reader does not.
    let points = reader.pointcloud_raw(cloud).map_err(|e| damaged(e, "its points cannot be found"))?;
    for (number, values) in points.enumerate() {
        let cannot = |e| damaged(e, &format!("point {number} cannot be read"));
        let values = values.map_err(cannot)?;
        let position = layout.position(cloud, &values).map_err(cannot)?;
        // Only kept points have a cell.
        let before = collector.len();
        collector.push(position.unwrap_or(DVec3::NAN).as_ref(), format_args!("point {number}"))?;
        if let Some([column, row]) = layout.cell.filter(|_| collector.len() > before) {
            let index = |k: usize| values[k].to_i64(&cloud.prototype[k].data_type).map_err(cannot);
            budget.take_elements(1, size_of::<[i64; 2]>() as u64, format_args!("cells (point {number})"))?;
            cells.push([index(column)?, index(row)?]);
        }
    }
    let (mut scan, _) = collector.finish(name);
    scan.grid = grid(&cells);
    // Such coordinates are relative to the scanner, so it is at their origin.
    if scan.grid.is_some() || !cartesian || world_from_scanner != Pose::identity() {
        scan.viewing = Viewing::Origin(DVec3::ZERO);
    }
    scan.world_from_scanner = world_from_scanner;
    Ok(scan)
}

/// Index of each quantity in a record.
struct Layout {
    cartesian: Option<[usize; 3]>,
    cartesian_state: Option<usize>,
    spherical: Option<[usize; 3]>,
    spherical_state: Option<usize>,
    cell: Option<[usize; 2]>,
}

impl Layout {
    /// Finds the known quantities in the prototype of a point cloud.
    fn new(cloud: &PointCloud) -> Self {
        let find = |name: RecordName| cloud.prototype.iter().position(|record| record.name == name);
        let three = |[a, b, c]: [RecordName; 3]| Some([find(a)?, find(b)?, find(c)?]);
        Self {
            cartesian: three([RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ]),
            cartesian_state: find(RecordName::CartesianInvalidState),
            spherical: three([
                RecordName::SphericalRange,
                RecordName::SphericalAzimuth,
                RecordName::SphericalElevation,
            ]),
            spherical_state: find(RecordName::SphericalInvalidState),
            cell: find(RecordName::ColumnIndex).zip(find(RecordName::RowIndex)).map(|(c, r)| [c, r]),
        }
    }

    /// Cartesian coordinates; `None` if the point is marked as invalid or as a direction without range.
    fn position(&self, cloud: &PointCloud, values: &[RecordValue]) -> e57::Result<Option<DVec3>> {
        let number = |k: usize| values[k].to_f64(&cloud.prototype[k].data_type);
        let stated = |family: Option<[usize; 3]>, state: Option<usize>| {
            let Some([a, b, c]) = family else { return Ok(None) };
            // 0 is valid; with 1 only the direction is meaningful, with 2 nothing is.
            let valid = state.map(number).transpose()?.is_none_or(|state| state == 0.0);
            e57::Result::Ok(match valid {
                true => Some([number(a)?, number(b)?, number(c)?]),
                false => None,
            })
        };
        // A record may hold both kinds of coordinates; Cartesian ones need no conversion.
        if let Some(point) = stated(self.cartesian, self.cartesian_state)? {
            return Ok(Some(DVec3::from(point)));
        }
        let spherical = stated(self.spherical, self.spherical_state)?;
        Ok(spherical.map(|[range, azimuth, elevation]| {
            // Elevation counts from the horizontal plane, azimuth from x (ASTM E2807).
            let level = range * elevation.cos();
            DVec3::new(level * azimuth.cos(), level * azimuth.sin(), range * elevation.sin())
        }))
    }
}

fn pose(cloud: &PointCloud) -> Result<Pose> {
    let Some(stated) = &cloud.transform else {
        return Ok(Pose::identity());
    };
    let (q, t) = (&stated.rotation, &stated.translation);
    let translation = DVec3::new(t.x, t.y, t.z);
    Pose::from_quaternion_xyzw([q.x, q.y, q.z, q.w], translation)
        .filter(|_| translation.is_finite())
        .ok_or_else(|| {
            Error::input("expected a finite pose with a quaternion other than zero, found another")
        })
}

/// Builds the sampling grid from columns and rows of the points; none if two points share a cell, if there is
/// only one row or column, or if too many cells are empty.
fn grid(cells: &[[i64; 2]]) -> Option<RangeGrid> {
    let mut low = *cells.first()?;
    let mut high = low;
    for cell in cells {
        for k in 0..2 {
            low[k] = low[k].min(cell[k]);
            high[k] = high[k].max(cell[k]);
        }
    }
    // In 128 bits, because the difference of two 64-bit indices may overflow.
    let side = |k: usize| u64::try_from(i128::from(high[k]) - i128::from(low[k]) + 1).ok();
    let (columns, rows) = (side(0)?, side(1)?);
    let count = columns.checked_mul(rows)?;
    if columns < 2 || rows < 2 || count > MAX_CELLS_PER_POINT * cells.len() as u64 {
        return None;
    }
    let mut made = RangeGrid {
        columns: usize::try_from(columns).ok()?,
        rows: usize::try_from(rows).ok()?,
        cells: vec![RangeGrid::EMPTY; usize::try_from(count).ok()?],
    };
    for (point, cell) in cells.iter().enumerate() {
        let at = (cell[1] - low[1]) as usize * made.columns + (cell[0] - low[0]) as usize;
        // Several returns of one direction share a cell, and a cell holds one reading.
        if made.cells[at] != RangeGrid::EMPTY {
            return None;
        }
        made.cells[at] = point as u32;
    }
    Some(made)
}

#[cfg(test)]
mod tests;
