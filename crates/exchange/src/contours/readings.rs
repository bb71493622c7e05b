//! Reads readings of contours from CSV files, and detects the format.

use super::carmen::{CarmenOptions, is_log_line, read_carmen};
use crate::source::{Source, parse_number, read_file, shown};
use planish_contour::planar::{ContourReading, ContourTarget};
use planish_core::Setting;
use planish_estimate::{Error, Result};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// σ of quantities for which a file has no column. `None` means exact for poses, and is an error for ranges
/// and points, whose σ cannot be guessed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SigmaDefaults {
    /// σ of the coordinates of the sensor.
    pub position: Option<f64>,
    /// σ of the heading of the sensor, in degrees.
    pub heading_deg: Option<f64>,
    /// σ of ranges.
    pub range: Option<f64>,
    /// σ of the coordinates of points.
    pub point: Option<f64>,
}

/// Content of a file of readings.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ContourReadings {
    /// The readings.
    pub sightings: Vec<ContourReading>,
    /// Level of each reading, if the file has levels.
    pub levels: Option<Vec<f64>>,
    /// True if the file has times.
    pub has_times: bool,
    /// Number of ignored readings: at the maximum range of the sensor, or outside the selected range or
    /// region.
    pub ignored: usize,
    /// True if the format prescribes metres.
    pub in_metres: bool,
}

/// Names of the columns; those of ranges from poses come first.
pub const COLUMNS: [&str; 13] = [
    "x",
    "y",
    "heading_deg",
    "range",
    "sigma_x",
    "sigma_y",
    "sigma_heading_deg",
    "sigma_range",
    "pose_id",
    "time",
    "level",
    "sigma",
    "sigma_point",
];

/// Reads a CSV file with a header or a CARMEN log; the first line shows which. Either may be compressed by
/// gzip.
///
/// # Errors
/// `Io` when the file cannot be read; `Input` with the line for a word that is not a number, a σ that is not
/// positive, a missing column, or a σ that neither the file nor `defaults` states.
///
/// # Examples
/// ```
/// use planish_exchange::contours::{CarmenOptions, SigmaDefaults, read_contour_readings};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("sweep.csv");
/// std::fs::write(&path, "x,y,heading_deg,range\n0,0,90,2\n0,0,0,3\n")?;
/// let defaults = SigmaDefaults { range: Some(0.01), ..SigmaDefaults::default() };
/// let readings = read_contour_readings(&path, &defaults, &CarmenOptions::default())?.sightings;
/// // Two metres straight ahead along +y.
/// assert!((readings[0].point()[1] - 2.0).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_contour_readings(
    path: &Path,
    defaults: &SigmaDefaults,
    carmen: &CarmenOptions,
) -> Result<ContourReadings> {
    read_file(path, |mut source, _| {
        let first = loop {
            let Some(line) = source.line()? else {
                return Err(Error::input(
                    "expected a header `x,y,heading_deg,range` or `x,y`, found no readings",
                ));
            };
            // Some spreadsheet programs begin CSV files in UTF-8 with a byte order mark.
            let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii();
            // Logs and tables may begin with comments.
            if line.starts_with(b"#") {
                continue;
            }
            if is_log_line(line) {
                let first = line.to_vec();
                return read_carmen(&mut source, &first, defaults, carmen);
            }
            if !line.is_empty() {
                break line.to_vec();
            }
        };
        table(&mut source, &first, defaults)
    })
}

/// Index of each known column.
pub(super) struct Header {
    index: BTreeMap<&'static str, usize>,
    width: usize,
}

impl Header {
    /// Finds the columns of a header; unknown ones are ignored.
    pub(super) fn named(line: &[u8], number: u64, columns: &[&'static str]) -> Result<Self> {
        let mut index = BTreeMap::new();
        // Programs differ in the case of column names.
        let text = String::from_utf8_lossy(line).to_ascii_lowercase();
        let fields: Vec<&str> = text.split(',').map(|f| f.trim().trim_matches('"')).collect();
        for (k, field) in fields.iter().enumerate() {
            if let Some(&name) = columns.iter().find(|c| *c == field)
                && index.insert(name, k).is_some()
            {
                return Err(Error::input(format!("line {number}: the column `{name}` is named twice")));
            }
        }
        Ok(Self { index, width: fields.len() })
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.index.contains_key(name)
    }

    /// Parses the header and checks that its columns describe readings.
    fn parse(line: &[u8], number: u64) -> Result<Self> {
        let header = Self::named(line, number, &COLUMNS)?;
        let has = |name: &str| header.has(name);
        // Reading only x and y of points in space would silently project them.
        if Self::named(line, number, &["z"])?.has("z") {
            return Err(Error::input(format!(
                "line {number}: the column `z` belongs to readings in space: state their kind of shape \
                 (plane3, sphere, cylinder or box)"
            ))
            .with_setting(Setting::Kind));
        }
        // A heading without a range, or a range without a heading, is a mistake and not a point.
        let missing = match (has("x") && has("y"), has("heading_deg"), has("range")) {
            (false, _, _) => Some("x,y"),
            (true, true, false) => Some("range"),
            (true, false, true) => Some("heading_deg"),
            _ => None,
        };
        match missing {
            Some(name) => Err(Error::input(format!(
                "line {number}: expected a header with `x,y,heading_deg,range` (ranges) or `x,y` (points), \
                 found {} without `{name}`",
                shown(line)
            ))),
            None => Ok(header),
        }
    }
}

fn table<R: Read>(
    source: &mut Source<R>,
    header: &[u8],
    defaults: &SigmaDefaults,
) -> Result<ContourReadings> {
    let header = Header::parse(header, source.line_number())?;
    let mut read =
        ContourReadings { has_times: header.index.contains_key("time"), ..ContourReadings::default() };
    let mut levels = header.index.contains_key("level").then(Vec::new);
    let mut poses = BTreeMap::new();
    loop {
        let number = source.line_number() + 1;
        let Some(line) = source.line()? else { break };
        let line = line.trim_ascii();
        if line.is_empty() || line.starts_with(b"#") {
            continue;
        }
        let row = Row::parse(line, &header, number)?;
        // Identifiers need not be consecutive, so they are numbered by first occurrence.
        let pose = match row.optional("pose_id")? {
            Some(id) => {
                let next = poses.len();
                // Compared by bits: identifiers are copied, not computed, and `f64` has no total order for a
                // map.
                Some(*poses.entry(id.to_bits()).or_insert(next))
            }
            None => None,
        };
        read.sightings.push(ContourReading {
            target: row.target(defaults)?,
            pose,
            time_s: row.optional("time")?.unwrap_or(0.0),
            line: number as usize,
        });
        if let Some(levels) = &mut levels {
            levels.push(row.required("level")?);
        }
    }
    if read.sightings.is_empty() {
        return Err(Error::input("expected readings after the header, found none"));
    }
    read.levels = levels;
    Ok(read)
}

/// A line with its fields.
pub(super) struct Row<'a> {
    header: &'a Header,
    fields: Vec<&'a [u8]>,
    number: u64,
}

impl<'a> Row<'a> {
    /// Splits a line into fields; their number must be that of the header.
    pub(super) fn parse(line: &'a [u8], header: &'a Header, number: u64) -> Result<Self> {
        let fields: Vec<&[u8]> = line.split(|&b| b == b',').map(<[u8]>::trim_ascii).collect();
        // A decimal comma splits a number in two, which must not silently shift the columns behind it.
        if fields.len() != header.width {
            return Err(Error::input(format!(
                "line {number}: expected {} fields as in the header, found {}",
                header.width,
                fields.len()
            )));
        }
        Ok(Self { header, fields, number })
    }

    fn optional(&self, name: &'static str) -> Result<Option<f64>> {
        let Some(&k) = self.header.index.get(name) else {
            return Ok(None);
        };
        match parse_number(self.fields[k]).filter(|value| value.is_finite()) {
            Some(value) => Ok(Some(value)),
            None => Err(Error::input(format!(
                "line {}: expected a number in column `{name}`, found {}",
                self.number,
                shown(self.fields[k])
            ))),
        }
    }

    pub(super) fn required(&self, name: &'static str) -> Result<f64> {
        self.optional(name)?
            .ok_or_else(|| Error::input(format!("line {}: expected column `{name}`", self.number)))
    }

    /// A σ by column or default. It may be zero or missing if no setting states a default for it.
    pub(super) fn sigma(
        &self,
        name: &'static str,
        default: Option<f64>,
        setting: Option<Setting>,
    ) -> Result<f64> {
        match self.optional(name)?.or(default) {
            // σ = 0 is sensible for a pose (exact) but would give a range or a point infinite weight.
            Some(value) if value > 0.0 || (setting.is_none() && value == 0.0) => Ok(value),
            Some(value) => Err(Error::input(format!(
                "line {}: expected a positive σ in column `{name}`, found {value}",
                self.number
            ))),
            None => match setting {
                None => Ok(0.0),
                Some(setting) => Err(Error::input(format!(
                    "line {}: σ of the readings is unknown: expected a column `{name}`, or a default",
                    self.number
                ))
                .with_setting(setting)),
            },
        }
    }

    fn target(&self, defaults: &SigmaDefaults) -> Result<ContourTarget> {
        let origin = [self.required("x")?, self.required("y")?];
        let Some(range) = self.optional("range")? else {
            return Ok(ContourTarget::Point {
                position: origin,
                sigma: self.sigma("sigma", defaults.point, Some(Setting::SigmaPoint))?,
            });
        };
        if range <= 0.0 {
            return Err(Error::input(format!(
                "line {}: expected a positive range, found {range}",
                self.number
            )));
        }
        Ok(ContourTarget::Range {
            origin,
            heading_rad: self.required("heading_deg")?.to_radians(),
            range,
            sigma: [
                self.sigma("sigma_x", defaults.position, None)?,
                self.sigma("sigma_y", defaults.position, None)?,
                self.sigma("sigma_heading_deg", defaults.heading_deg, None)?.to_radians(),
                self.sigma("sigma_range", defaults.range, Some(Setting::SigmaRange))?,
            ],
        })
    }
}
