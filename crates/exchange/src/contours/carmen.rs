//! Reads CARMEN logs: lines `FLASER n r1 … rn x y θ odom_x odom_y odom_θ time host time`, in metres and
//! radians.

use super::readings::{ContourReadings, SigmaDefaults};
use crate::source::{Source, parse_number, shown};
use planish_contour::planar::{ContourReading, ContourTarget};
use planish_estimate::{Error, Result};
use std::io::Read;

/// Selection of the scans of a log and of their ranges.
///
/// # Examples
/// ```
/// use planish_exchange::contours::CarmenOptions;
/// let options = CarmenOptions { first: 10, count: 5, ..CarmenOptions::default() };
/// assert_eq!(options.range, [0.05, 20.0]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CarmenOptions {
    /// Index of the first scan, from 0.
    pub first: usize,
    /// Number of scans.
    pub count: usize,
    /// Minimum and maximum range in metres; other readings are ignored.
    pub range: [f64; 2],
    /// Box `x0 y0 x1 y1` of the map, in metres; readings outside are ignored.
    pub region: Option<[f64; 4]>,
}

impl Default for CarmenOptions {
    fn default() -> Self {
        Self { first: 0, count: 1, range: [0.05, 20.0], region: None }
    }
}

/// Default σ of a range in metres, as manufacturers of these scanners state it. The log itself states none.
const DEFAULT_SIGMA_RANGE: f64 = 0.03;

/// Reads the selected scans; `first` is the first line of the file, which was read to detect the format. Beam
/// `i` of `n` points to `θ − 90° + i·180°/n`. Beams of a scan share a pose.
pub(crate) fn read_carmen<R: Read>(
    source: &mut Source<R>,
    first: &[u8],
    defaults: &SigmaDefaults,
    options: &CarmenOptions,
) -> Result<ContourReadings> {
    let mut read = ContourReadings { has_times: true, in_metres: true, ..ContourReadings::default() };
    let mut scans = 0;
    // A source cannot be rewound (it may be a gzip stream), so the line that showed the format is passed in.
    let mut begun = Some((source.line_number(), first.to_vec()));
    loop {
        let (number, line) = match begun.take() {
            Some(first) => first,
            None => {
                let number = source.line_number() + 1;
                let Some(line) = source.line()? else { break };
                (number, line.to_vec())
            }
        };
        if !line.starts_with(b"FLASER ") {
            continue;
        }
        scans += 1;
        if scans <= options.first || scans > options.first + options.count {
            continue;
        }
        let wrong = |what: String| Error::input(format!("line {number}: {what}"));
        let words: Vec<&[u8]> = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).collect();
        let beams = words.get(1).and_then(|w| parse_number(w)).unwrap_or(0.0) as usize;
        // Saturating, because the file may state any number of beams.
        if beams == 0 || words.len() < beams.saturating_add(5) {
            return Err(wrong(format!(
                "expected `FLASER n` with n ranges and a pose, found {} words",
                words.len()
            )));
        }
        let value = |k: usize| {
            parse_number(words[k]).filter(|v| v.is_finite()).ok_or_else(|| {
                wrong(format!("expected a finite number as word {}, found {}", k + 1, shown(words[k])))
            })
        };
        let origin = [value(beams + 2)?, value(beams + 3)?];
        let heading = value(beams + 4)?;
        let time_s = if words.len() > beams + 8 { value(beams + 8)? } else { 0.0 };
        for beam in 0..beams {
            let range = value(2 + beam)?;
            // A scanner reports its maximum range where it receives no echo, which is not a measurement.
            if range < options.range[0] || range > options.range[1] {
                read.ignored += 1;
                continue;
            }
            // `FLASER` states no field of view; by convention it is half a turn about the heading.
            let turn = std::f64::consts::PI * beam as f64 / beams as f64 - std::f64::consts::FRAC_PI_2;
            let sighting = ContourReading {
                target: ContourTarget::Range {
                    origin,
                    heading_rad: heading + turn,
                    range,
                    sigma: [
                        defaults.position.unwrap_or(0.0),
                        defaults.position.unwrap_or(0.0),
                        defaults.heading_deg.unwrap_or(0.0).to_radians(),
                        defaults.range.unwrap_or(DEFAULT_SIGMA_RANGE),
                    ],
                },
                // An exact pose has no error that the readings could share.
                pose: (defaults.position.is_some() || defaults.heading_deg.is_some()).then_some(scans),
                time_s,
                line: number as usize,
            };
            let [x, y] = sighting.point();
            match options.region {
                Some([x0, y0, x1, y1]) if x < x0 || x > x1 || y < y0 || y > y1 => read.ignored += 1,
                _ => read.sightings.push(sighting),
            }
        }
    }
    if read.sightings.is_empty() {
        return Err(Error::input(format!(
            "expected ranges from {} to {} m in the selected scans ({} from scan {} on), found none in a log \
             of {scans} scans",
            options.range[0], options.range[1], options.count, options.first
        )));
    }
    Ok(read)
}
