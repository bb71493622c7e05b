//! Readings of contours from CSV files, and the choice between the formats.

use super::carmen::{CarmenOptions, read_carmen};
use crate::source::{Source, parse_number, read_file, shown};
use planish_contour::planar::{ContourReading, ContourTarget};
use planish_core::Setting;
use planish_estimate::{Error, Result};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

/// σ of what a file has no column for; `None` is no σ at all for poses, and an error for ranges and points.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SigmaDefaults {
    /// σ of x and y of the sensor.
    pub position: Option<f64>,
    /// σ of its heading, in degrees.
    pub heading_deg: Option<f64>,
    /// σ of the range.
    pub range: Option<f64>,
    /// σ of points, in x and in y.
    pub point: Option<f64>,
}

/// What a file held.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ContourReadings {
    /// The readings.
    pub sightings: Vec<ContourReading>,
    /// The level of each, where the file has levels.
    pub levels: Option<Vec<f64>>,
    /// Whether it has times.
    pub has_times: bool,
    /// Readings that were left out: at the sensor's maximum range, or outside of the range asked for.
    pub left_out: usize,
    /// Whether lengths are in metres by the format.
    pub in_metres: bool,
}

/// Columns that are known, those of ranges from poses first.
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

/// Reads a CSV with a header, or a CARMEN log, by what the first line holds. Either may be compressed by
/// gzip.
///
/// # Errors
/// `Io` when the file cannot be read; `Input` with the line for a word that is no number, a σ that is not
/// positive, a missing column, or a σ that neither file nor `defaults` state.
pub fn read_contour_readings(
    path: &Path,
    defaults: &SigmaDefaults,
    carmen: &CarmenOptions,
) -> Result<ContourReadings> {
    read_file(path, |mut source, _| {
        let first = loop {
            let Some(line) = source.line()? else {
                return Err(Error::input(
                    "holds no readings: needed a header `x,y,heading_deg,range` or `x,y`",
                ));
            };
            let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii();
            if line.starts_with(b"#") || line.starts_with(b"PARAM") || line.starts_with(b"FLASER") {
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

/// Which column holds what.
pub(super) struct Header {
    index: BTreeMap<&'static str, usize>,
    width: usize,
}

impl Header {
    /// Those of `columns` that a header names.
    pub(super) fn named(line: &[u8], number: u64, columns: &[&'static str]) -> Result<Self> {
        let mut index = BTreeMap::new();
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

    /// Parses the header line and checks that its columns describe readings.
    fn parse(line: &[u8], number: u64) -> Result<Self> {
        let header = Self::named(line, number, &COLUMNS)?;
        let has = |name: &str| header.has(name);
        if Self::named(line, number, &["z"])?.has("z") {
            return Err(Error::input(format!(
                "line {number}: the column `z` belongs to readings in space: state their kind of shape \
                 (plane3, sphere, cylinder or box)"
            ))
            .with_setting(Setting::Kind));
        }
        let missing = match (has("x") && has("y"), has("heading_deg"), has("range")) {
            (false, _, _) => Some("x,y"),
            (true, true, false) => Some("range"),
            (true, false, true) => Some("heading_deg"),
            _ => None,
        };
        match missing {
            Some(name) => Err(Error::input(format!(
                "line {number}: needed a header with `x,y,heading_deg,range` (ranges) or `x,y` (points), \
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
        let pose = match row.optional("pose_id")? {
            Some(id) => {
                let next = poses.len();
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
            levels.push(row.needed("level")?);
        }
    }
    if read.sightings.is_empty() {
        return Err(Error::input("holds a header and no readings"));
    }
    read.levels = levels;
    Ok(read)
}

/// A line with its columns.
pub(super) struct Row<'a> {
    header: &'a Header,
    fields: Vec<&'a [u8]>,
    number: u64,
}

impl<'a> Row<'a> {
    /// Splits a line into as many fields as the header has.
    pub(super) fn parse(line: &'a [u8], header: &'a Header, number: u64) -> Result<Self> {
        let fields: Vec<&[u8]> = line.split(|&b| b == b',').map(<[u8]>::trim_ascii).collect();
        if fields.len() != header.width {
            return Err(Error::input(format!(
                "line {number}: needed {} fields as in the header, found {}",
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
                "line {}: needed a number in column `{name}`, found {}",
                self.number,
                shown(self.fields[k])
            ))),
        }
    }

    pub(super) fn needed(&self, name: &'static str) -> Result<f64> {
        self.optional(name)?
            .ok_or_else(|| Error::input(format!("line {}: needed column `{name}`", self.number)))
    }

    /// A σ by column or default. It may be zero or missing if no setting states a default for it.
    pub(super) fn sigma(
        &self,
        name: &'static str,
        default: Option<f64>,
        setting: Option<Setting>,
    ) -> Result<f64> {
        match self.optional(name)?.or(default) {
            Some(value) if value > 0.0 || (setting.is_none() && value == 0.0) => Ok(value),
            Some(value) => Err(Error::input(format!(
                "line {}: needed a positive σ in column `{name}`, found {value}",
                self.number
            ))),
            None => match setting {
                None => Ok(0.0),
                Some(setting) => Err(Error::input(format!(
                    "line {}: σ of the readings is unknown: needed a column `{name}`, or a default",
                    self.number
                ))
                .with_setting(setting)),
            },
        }
    }

    fn target(&self, defaults: &SigmaDefaults) -> Result<ContourTarget> {
        let origin = [self.needed("x")?, self.needed("y")?];
        let Some(range) = self.optional("range")? else {
            return Ok(ContourTarget::Point {
                position: origin,
                sigma: self.sigma("sigma", defaults.point, Some(Setting::SigmaPoint))?,
            });
        };
        if range <= 0.0 {
            return Err(Error::input(format!(
                "line {}: needed a positive range, found {range}",
                self.number
            )));
        }
        Ok(ContourTarget::Range {
            origin,
            heading_rad: self.needed("heading_deg")?.to_radians(),
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
