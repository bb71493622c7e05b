//! NPY and NPZ, the arrays of NumPy.
//!
//! **Input.** One array (`.npy`) or named ones (`.npz`), plain or compressed. Numbers are integers or
//! floating-point numbers of 8 to 64 bits in either byte order, stored by rows or by columns.
//!
//! **Output.** A [`Scan`] at the identity pose.
//!
//! **Arrays.** `(n, 3)` is x y z; of `(n, 6)` the last three are normals if all of them have length 1 within
//! 1 %; of other widths up to 16 the rest is ignored, as in text. Fields of a structured array are columns:
//! `x y z`, `sigma` or `cxx cxy cxz cyy cyz czz`, `nx ny nz`, `sigma_n_deg`; a field of three numbers may be
//! called `xyz`, `points` or `position`, and `normal` or `normals`. An array with one more axis, `(h, w, 3)`
//! or structured `(h, w)`, is organised: it gives the sampling grid, and points that are not finite are empty
//! cells.
//!
//! **NPZ.** `points` (or `xyz`), `normals` and `covariance` hold 3, 3 and 6 numbers per point. An array of
//! one number per point is the column of its name: `sigma`, `sigma_n_deg`, or any of those above. `viewpoint`
//! is the position of the scanner. A single array may have any name.
//!
//! **Limits.** A number without a name is never read as σ (decision 0039).
//!
//! # References
//! NumPy Enhancement Proposal 1, *A Simple File Format for NumPy Arrays*.

mod archive;
mod array;
mod header;
#[cfg(test)]
mod tests;

use std::io::Read;
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::Scan;

pub use archive::read_npz;
use array::Array;

use crate::points::{PointCollector, PointColumns, grid_without, keep_unit_normals};
use crate::source::{Source, open, read_file};

/// Maximum width of an array of points. Wider arrays are images or transposed points.
pub(crate) const MAX_COLUMNS: u64 = 16;

/// Reads the points of an array. Records with a coordinate that is not finite are dropped and counted.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable,
/// [`Input`](planish_estimate::ErrorKind::Input) when it is malformed, cut off, of a shape or with fields
/// that are no points, or states a σ or covariance that is not positive: with the file and byte;
/// [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for numbers of other kinds.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::npy::read_npy;
/// use planish_exchange::raster::write_raster;
/// # let folder = tempfile::tempdir()?;
/// // An array (1, 2, 3): one row of two points.
/// let path = folder.path().join("points.npy");
/// write_raster(&path, 2, 1, &[&[1.0, 4.0], &[2.0, 5.0], &[3.0, 6.0]])?;
/// assert_eq!(read_npy(&path)?.points, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_npy(path: &Path) -> Result<Scan> {
    read_file(path, scan_from)
}

/// Header of an NPY file as NumPy writes it; `descr` and `shape` are Python literals.
pub(crate) fn npy_header(descr: &str, columns_first: bool, shape: &str) -> Vec<u8> {
    let order = if columns_first { "True" } else { "False" };
    let mut header = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}");
    // Version 1.0 aligns the data to 64 bytes, so that they can be mapped into memory.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    // The format pads before the line feed, which must be the last byte of the header.
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes
}

/// True if the array is an image: plain numbers, two axes, and wider than points.
pub(crate) fn is_image(path: &Path) -> bool {
    // A damaged file counts as points, whose reader then reports the damage.
    let shape = open(path).and_then(|mut source| header::read_header(&mut source)).ok();
    shape.is_some_and(|h| !h.structured && matches!(h.shape[..], [_, columns] if columns > MAX_COLUMNS))
}

/// Reads an array with two axes: columns, rows, and the numbers row by row.
pub(crate) fn read_image(path: &Path) -> Result<(usize, usize, Vec<f64>)> {
    let mut array = Array::open(open(path)?, 0)?;
    let [Some(rows), Some(columns)] = [0, 1].map(|axis| array.shape().get(axis).copied()) else {
        return Err(array.wrong_shape("(h, w)"));
    };
    if array.shape().len() != 2 || array.is_structured() {
        return Err(array.wrong_shape("(h, w)"));
    }
    let mut numbers = Vec::with_capacity(array.reserve());
    let mut record = Vec::new();
    for number in 0..array.records() {
        record.clear();
        array.next(&mut record)?;
        let bytes = size_of_val(&record[..]) as u64;
        array.budget().take_elements(1, bytes, format_args!("readings (number {number})"))?;
        numbers.extend_from_slice(&record);
    }
    Ok((columns as usize, rows as usize, numbers))
}

fn scan_from<R: Read>(source: Source<R>, name: &str) -> Result<Scan> {
    let array = Array::open_points(source)?;
    let names = array.names()?;
    // Only columns without names are ambiguous; fields of a structured array have names.
    let tentative_normals = !array.is_structured() && names.len() == 6;
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let columns = match tentative_normals {
        true => PointColumns::positions_and_normals(),
        false => PointColumns::find(&names).map_err(|e| e.in_context("the array's fields"))?,
    };
    collect(vec![array], columns, tentative_normals, name)
}

/// Collects points from arrays that each hold some of the columns. They are read in step, so that memory does
/// not depend on their size.
fn collect<R: Read>(
    mut arrays: Vec<Array<R>>,
    columns: PointColumns,
    tentative_normals: bool,
    name: &str,
) -> Result<Scan> {
    let records = arrays[0].records();
    let mut collector = PointCollector::new(columns, arrays[0].reserve(), arrays[0].budget());
    let mut record = Vec::new();
    for point in 0..records {
        record.clear();
        let byte = arrays[0].offset();
        for array in &mut arrays {
            array.next(&mut record)?;
        }
        collector.push(&record, format_args!("byte {byte}"))?;
        debug_assert!(collector.len() as u64 <= point + 1);
    }
    let grid = arrays[0].grid();
    let (mut scan, dropped) = collector.finish(name);
    if tentative_normals {
        keep_unit_normals(&mut scan);
    }
    if let Some([rows, columns]) = grid {
        let side = |n: u64| {
            usize::try_from(n).map_err(|_| Error::unsupported("the grid is too large for this computer"))
        };
        scan.grid = Some(grid_without(side(columns)?, side(rows)?, &dropped));
    }
    Ok(scan)
}
