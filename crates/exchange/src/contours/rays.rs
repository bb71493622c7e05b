//! Reads 3D readings from CSV files.

use super::readings::{Header, Row, SigmaDefaults};
use crate::source::{read_file, shown};
use planish_contour::primitive::{Ray, RayTarget};
use planish_core::DVec3;
use planish_core::Setting;
use planish_estimate::{Error, Result};
use std::path::Path;

/// Names of the columns of readings in space.
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

/// Reads a CSV file with a header: ranges `x,y,z,azimuth_deg,elevation_deg,range` with their σ, or points
/// `x,y,z` with `sigma`. The file may be gzip-compressed. The default σ of a heading applies to azimuth and
/// elevation.
///
/// # Errors
/// `Io` when the file cannot be read; `Input` with the line for a word that is not a number, a σ that is not
/// positive, a missing column, or a σ that neither the file nor `defaults` states.
///
/// # Examples
/// ```
/// use planish_exchange::contours::{SigmaDefaults, read_ray_readings};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("points.csv");
/// std::fs::write(&path, "x,y,z,sigma\n1,2,3,0.1\n4,5,6,0.1\n")?;
/// assert_eq!(read_ray_readings(&path, &SigmaDefaults::default())?.len(), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_ray_readings(path: &Path, defaults: &SigmaDefaults) -> Result<Vec<Ray>> {
    read_file(path, |mut source, _| {
        let mut header = None;
        let mut rays = Vec::new();
        loop {
            let number = source.line_number() + 1;
            let Some(line) = source.line()? else { break };
            // Some spreadsheet programs begin CSV files in UTF-8 with a byte order mark.
            let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii();
            if line.is_empty() || line.starts_with(b"#") {
                continue;
            }
            match &header {
                None => header = Some(header_of(line, number)?),
                Some(header) => {
                    let row = Row::parse(line, header, number)?;
                    rays.push(Ray {
                        target: seen(&row, header.has("range"), number, defaults)?,
                        line: number as usize,
                    });
                }
            }
        }
        if rays.is_empty() {
            return Err(Error::input(
                "expected a header `x,y,z,azimuth_deg,elevation_deg,range` or `x,y,z`, and readings, found \
                 none",
            ));
        }
        Ok(rays)
    })
}

fn header_of(line: &[u8], number: u64) -> Result<Header> {
    let header = Header::named(line, number, &RAY_COLUMNS)?;
    // Any of the three columns shows that ranges are meant, so that a missing one is reported.
    let is_range = header.has("range") || header.has("azimuth_deg") || header.has("elevation_deg");
    let needed = if is_range { &RAY_COLUMNS[..6] } else { &RAY_COLUMNS[..3] };
    match needed.iter().find(|name| !header.has(name)) {
        None => Ok(header),
        Some(name) => Err(Error::input(format!(
            "line {number}: expected a header with `x,y,z,azimuth_deg,elevation_deg,range` (ranges) or \
             `x,y,z` (points), found {} without `{name}`",
            shown(line)
        ))),
    }
}

fn seen(row: &Row<'_>, is_range: bool, number: u64, defaults: &SigmaDefaults) -> Result<RayTarget> {
    let place = DVec3::new(row.required("x")?, row.required("y")?, row.required("z")?);
    if !is_range {
        return Ok(RayTarget::Point {
            position: place,
            sigma: row.sigma("sigma", defaults.point, Some(Setting::SigmaPoint))?,
        });
    }
    let range = row.required("range")?;
    if range <= 0.0 {
        return Err(Error::input(format!("line {number}: expected a positive range, found {range}")));
    }
    Ok(RayTarget::Range {
        origin: place,
        direction_rad: [
            row.required("azimuth_deg")?.to_radians(),
            row.required("elevation_deg")?.to_radians(),
        ],
        range,
        sigma: [
            // `None`: a pose without σ is exact, whereas a range without σ is an error.
            row.sigma("sigma_x", defaults.position, None)?,
            row.sigma("sigma_y", defaults.position, None)?,
            row.sigma("sigma_z", defaults.position, None)?,
            row.sigma("sigma_azimuth_deg", defaults.heading_deg, None)?.to_radians(),
            row.sigma("sigma_elevation_deg", defaults.heading_deg, None)?.to_radians(),
            row.sigma("sigma_range", defaults.range, Some(Setting::SigmaRange))?,
        ],
    })
}
