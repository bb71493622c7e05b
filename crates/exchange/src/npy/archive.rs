//! Reads NPZ files: named arrays in a ZIP archive.

use planish_core::{Budget, DVec3};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::{Scan, Viewing};
use zip::ZipArchive;
use zip::result::ZipError;

use super::array::Array;
use super::{collect, scan_from};
use crate::points::PointColumns;
use crate::source::{DATA_RATIO, MAX_DEFLATE_RATIO, Source, open_file};

type Archive = ZipArchive<BufReader<File>>;

/// Reads the points of an archive.
///
/// # Errors
/// As [`read_npy`](super::read_npy); [`Input`](planish_estimate::ErrorKind::Input) also for an archive
/// without points, and for arrays of different lengths.
pub fn read_npz(path: &Path) -> Result<Scan> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    archive_scan(path, &name).map_err(|e| e.in_context(path.display()))
}

fn damaged(e: ZipError) -> Error {
    match e {
        ZipError::Io(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            Error::io("could not be read").with_source(e)
        }
        e => Error::input("not an NPZ archive, or damaged or cut off").with_source(e),
    }
}

fn open_archive(path: &Path) -> Result<(Archive, Budget)> {
    let (file, length) = open_file(path)?;
    let budget = Budget::of_compressed(length.unwrap_or(0), DATA_RATIO);
    Ok((ZipArchive::new(BufReader::new(file)).map_err(damaged)?, budget))
}

/// Opens an entry, if its packed size can hold the declared size.
fn entry<'a>(archive: &'a mut Archive, number: usize, budget: &Budget) -> Result<Source<impl Read + 'a>> {
    let entry = archive.by_index(number).map_err(damaged)?;
    let (packed, promised) = (entry.compressed_size(), entry.size());
    if promised > packed.saturating_mul(MAX_DEFLATE_RATIO).saturating_add(MAX_DEFLATE_RATIO) {
        return Err(Error::input(format!(
            "{packed} compressed bytes cannot unpack to {promised}: the archive is damaged"
        )));
    }
    Ok(Source::new(entry, Some(promised)).with_budget(budget.clone()))
}

/// Use of an array of an archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    /// Several numbers per point, for these columns.
    Family(&'static [&'static str]),
    /// One number per point, for the column with the name of the array.
    Column,
    Viewpoint,
    Unused,
}

const POSITIONS: &[&str] = &["x", "y", "z"];

fn role(name: &str) -> Role {
    match name {
        "points" | "xyz" => Role::Family(POSITIONS),
        "normals" => Role::Family(&["nx", "ny", "nz"]),
        "covariance" => Role::Family(&["cxx", "cxy", "cxz", "cyy", "cyz", "czz"]),
        "x" | "y" | "z" | "nx" | "ny" | "nz" | "sigma" | "sigma_n_deg" | "cxx" | "cxy" | "cxz" | "cyy"
        | "cyz" | "czz" => Role::Column,
        "viewpoint" => Role::Viewpoint,
        _ => Role::Unused,
    }
}

fn archive_scan(path: &Path, name: &str) -> Result<Scan> {
    // One budget for all arrays, so that many of them cannot take more than one.
    let (mut archive, budget) = open_archive(path)?;
    let mut entries: Vec<(usize, String)> = Vec::new();
    for number in 0..archive.len() {
        // Raw, because a name is needed even of an entry whose compression is not supported.
        let name = archive.by_index_raw(number).map_err(damaged)?.name().map_err(damaged)?.into_owned();
        if let Some(name) = name.strip_suffix(".npy") {
            entries.push((number, name.to_owned()));
        }
    }
    // `numpy.savez` names a single array `arr_0`, so its name is not required.
    if let [(number, array)] = &entries[..] {
        let source = entry(&mut archive, *number, &budget);
        return source
            .and_then(|source| scan_from(source, name))
            .map_err(|e| e.in_context(format_args!("array `{array}`")));
    }
    let mut wanted: Vec<(usize, &str, Role)> = entries
        .iter()
        .map(|(number, name)| (*number, name.as_str(), role(name)))
        .filter(|(.., role)| matches!(role, Role::Family(_) | Role::Column))
        .collect();
    // Positions come first, because other arrays are compared with their length.
    wanted.sort_by_key(|(.., role)| *role != Role::Family(POSITIONS));
    let mut columns: Vec<&str> = Vec::new();
    for (_, array, role) in &wanted {
        match role {
            Role::Family(names) => columns.extend(*names),
            _ => columns.push(array),
        }
    }
    // `points` and `x`, for example, give the same column.
    if let Some(twice) = (1..columns.len()).find(|&k| columns[..k].contains(&columns[k])) {
        return Err(Error::input(format!("the column `{}` is named twice", columns[twice])));
    }
    let found = PointColumns::find(&columns).map_err(|e| {
        let names: Vec<&str> = entries.iter().map(|(_, name)| name.as_str()).collect();
        e.in_context(format_args!("expected an array `points`, found [{}]", names.join(", ")))
    })?;
    // Each array gets its own reader of the archive: a ZIP reader can stream one entry at a time, and all
    // arrays are read in step.
    let mut archives =
        wanted.iter().map(|_| open_archive(path).map(|(archive, _)| archive)).collect::<Result<Vec<_>>>()?;
    let mut arrays = Vec::with_capacity(wanted.len());
    for (archive, (number, array, role)) in archives.iter_mut().zip(&wanted) {
        let (width, inner) = match role {
            Role::Family(names) => (names.len() as u64, 1),
            _ => (1, 0),
        };
        let opened = entry(archive, *number, &budget).and_then(|source| {
            let opened = Array::open(source, inner)?;
            let last = opened.shape().last().copied().unwrap_or(0);
            if opened.is_structured()
                || (inner == 1 && last != width)
                || !matches!(opened.outer().len(), 1 | 2)
            {
                return Err(opened.wrong_shape(&match inner {
                    1 => format!("(n, {width}) or (h, w, {width})"),
                    _ => "(n,) or (h, w)".to_owned(),
                }));
            }
            Ok(opened)
        });
        arrays.push(opened.map_err(|e| e.in_context(format_args!("array `{array}`")))?);
    }
    for (array, (_, name, _)) in arrays.iter().zip(&wanted) {
        if array.outer() != arrays[0].outer() {
            return Err(Error::input(format!(
                "expected the arrays `{}` and `{name}` to have as many entries, found {:?} and {:?}",
                wanted[0].1,
                arrays[0].outer(),
                array.outer()
            )));
        }
    }
    let mut scan = collect(arrays, found, false, name)?;
    if let Some((number, _)) = entries.iter().find(|(_, name)| role(name) == Role::Viewpoint) {
        let read = entry(&mut archive, *number, &budget).and_then(viewpoint);
        scan.viewing = Viewing::Origin(read.map_err(|e| e.in_context("array `viewpoint`"))?);
    }
    Ok(scan)
}

fn viewpoint<R: Read>(source: Source<R>) -> Result<DVec3> {
    let mut array = Array::open(source, 1)?;
    let mut numbers = Vec::new();
    if array.shape() == [3] && !array.is_structured() {
        array.next(&mut numbers)?;
    }
    match numbers[..] {
        [x, y, z] if numbers.iter().all(|c| c.is_finite()) => Ok(DVec3::new(x, y, z)),
        _ => Err(array.wrong_shape("of three finite numbers")),
    }
}
