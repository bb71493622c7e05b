//! Readings in space from CSV files.

use super::readings::{Header, Row, SigmaDefaults};
use crate::source::{read_file, shown};
use planish_contour::primitive::{Ray, RayTarget};
use planish_core::Setting;
use planish_estimate::{Error, Result};
use std::path::Path;

/// Columns of readings in space that are known.
pub const RAY_COLUMNS: [&str; 13] = [
    "x",
    "y",
    "z",
    "azimuth_deg",
    "elevation_deg",
    "range",
    "sigma_x",
    "sigma_y",
    "sigma_z",
    "sigma_azimuth_deg",
    "sigma_elevation_deg",
    "sigma_range",
    "sigma",
];

/// Reads a CSV with a header: ranges `x,y,z,azimuth_deg,elevation_deg,range` with their σ, or points `x,y,z`
/// with `sigma`. It may be compressed by gzip. The default σ of a heading is that of both angles.
///
/// # Errors
/// `Io` when the file cannot be read; `Input` with the line for a word that is no number, a σ that is not
/// positive, a missing column, or a σ that neither file nor `defaults` state.
pub fn read_ray_readings(path: &Path, defaults: &SigmaDefaults) -> Result<Vec<Ray>> {
    read_file(path, |mut source, _| {
        let mut header = None;
        let mut rays = Vec::new();
        loop {
            let number = source.line_number() + 1;
            let Some(line) = source.line()? else { break };
            let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii();
            if line.is_empty() || line.starts_with(b"#") {
                continue;
            }
            match &header {
                None => header = Some(header_of(line, number)?),
                Some(header) => {
                    let row = Row::parse(line, header, number)?;
                    rays.push(Ray {
                        seen: seen(&row, header.has("range"), number, defaults)?,
                        line: number as usize,
                    });
                }
            }
        }
        if rays.is_empty() {
            return Err(Error::input(
                "holds no readings in space: needed a header `x,y,z,azimuth_deg,elevation_deg,range` or \
                 `x,y,z`, and lines",
            ));
        }
        Ok(rays)
    })
}

fn header_of(line: &[u8], number: u64) -> Result<Header> {
    let header = Header::named(line, number, &RAY_COLUMNS)?;
    let is_range = header.has("range") || header.has("azimuth_deg") || header.has("elevation_deg");
    let needed = if is_range { &RAY_COLUMNS[..6] } else { &RAY_COLUMNS[..3] };
    match needed.iter().find(|name| !header.has(name)) {
        None => Ok(header),
        Some(name) => Err(Error::input(format!(
            "line {number}: needed a header with `x,y,z,azimuth_deg,elevation_deg,range` (ranges) or \
             `x,y,z` (points), found {} without `{name}`",
            shown(line)
        ))),
    }
}

fn seen(row: &Row<'_>, is_range: bool, number: u64, defaults: &SigmaDefaults) -> Result<RayTarget> {
    let place = [row.needed("x")?, row.needed("y")?, row.needed("z")?];
    if !is_range {
        return Ok(RayTarget::Point {
            position: place,
            sigma: row.sigma("sigma", defaults.point, Some(Setting::SigmaPoint))?,
        });
    }
    let range = row.needed("range")?;
    if range <= 0.0 {
        return Err(Error::input(format!("line {number}: needed a positive range, found {range}")));
    }
    Ok(RayTarget::Range {
        origin: place,
        direction_rad: [row.needed("azimuth_deg")?.to_radians(), row.needed("elevation_deg")?.to_radians()],
        range,
        sigma: [
            row.sigma("sigma_x", defaults.position, None)?,
            row.sigma("sigma_y", defaults.position, None)?,
            row.sigma("sigma_z", defaults.position, None)?,
            row.sigma("sigma_azimuth_deg", defaults.heading_deg, None)?.to_radians(),
            row.sigma("sigma_elevation_deg", defaults.heading_deg, None)?.to_radians(),
            row.sigma("sigma_range", defaults.range, Some(Setting::SigmaRange))?,
        ],
    })
}
