//! Reads CARMEN logs: text lines of a keyword and words, in metres and radians.
//!
//! | line | words |
//! |---|---|
//! | `FLASER` | `n r1 … rn x y θ odom_x odom_y odom_θ time host time`: half a turn about the heading `θ` |
//! | `ROBOTLASER1` | `type start field resolution max accuracy mode n r1 … rn m e1 … em x y θ …` |
//!
//! Other lines are skipped. A file is a log if its first line that is no comment begins with a keyword in
//! capitals and has no comma, whatever the keyword.

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
pub const DEFAULT_SIGMA_RANGE: f64 = 0.03;

/// True if a line that is no comment begins with a keyword of a log. Headers of tables have commas or small
/// letters.
pub(super) fn is_log_line(line: &[u8]) -> bool {
    let keyword = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
    let is_keyword = |b: &u8| b.is_ascii_uppercase() || b.is_ascii_digit() || *b == b'_';
    keyword.len() > 1
        && keyword[0].is_ascii_uppercase()
        && keyword.iter().all(is_keyword)
        && !line.contains(&b',')
}

/// Where a line of a scan has its words.
struct ScanLine {
    /// Index of the first range, and the number of ranges.
    ranges: [usize; 2],
    /// Index of `x` of the pose of the laser; `y` and `θ` follow.
    pose: usize,
    /// Index of the time, if there is one.
    time: Option<usize>,
    /// Direction of the first beam from the heading, and the step between beams, in radians.
    beams: [f64; 2],
}

impl ScanLine {
    /// The layout of a line; `None` if it is no scan.
    ///
    /// # Errors
    /// What was expected and found, if the line is a scan but too short.
    fn parse(words: &[&[u8]]) -> std::result::Result<Option<Self>, String> {
        let number = |k: usize| words.get(k).and_then(|w| parse_number(w)).filter(|v| v.is_finite());
        // Saturating, because the file may state any number of beams.
        let count = |k: usize| number(k).unwrap_or(0.0) as usize;
        let (line, expected) = match words.first() {
            Some(&b"FLASER") => {
                let n = count(1);
                // `FLASER` states no field of view. By convention, it is half a turn about the heading; an
                // odd number of beams includes both ends.
                let steps = if n % 2 == 1 { n.saturating_sub(1) } else { n };
                let step = std::f64::consts::PI / steps.max(1) as f64;
                let pose = n.saturating_add(2);
                let beams = [-std::f64::consts::FRAC_PI_2, step];
                let time = (words.len() > n.saturating_add(8)).then(|| n + 8);
                (Self { ranges: [2, n], pose, time, beams }, "`FLASER n` with n ranges and a pose")
            }
            Some(&b"ROBOTLASER1") => {
                let n = count(8);
                let pose = n.saturating_add(9).saturating_add(1).saturating_add(count(n.saturating_add(9)));
                let beams = [number(2).unwrap_or(f64::NAN), number(4).unwrap_or(f64::NAN)];
                // Two poses of three words and five velocities and distances precede the time.
                let time = (words.len() > pose.saturating_add(11)).then(|| pose + 11);
                let expected = "`ROBOTLASER1` with seven words, n, n ranges, m, m remissions and a pose";
                let is_whole = beams.iter().all(|b| b.is_finite());
                (Self { ranges: [9, if is_whole { n } else { 0 }], pose, time, beams }, expected)
            }
            _ => return Ok(None),
        };
        if line.ranges[1] == 0 || words.len() < line.pose.saturating_add(3) {
            return Err(format!("expected {expected}, found {} words", words.len()));
        }
        Ok(Some(line))
    }
}

/// Reads the selected scans; `first` is the first line of the file, which was read to detect the format.
/// Beams of a scan share a pose.
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
        let wrong = |what: String| Error::input(format!("line {number}: {what}"));
        let words: Vec<&[u8]> = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty()).collect();
        let Some(scan) = ScanLine::parse(&words).map_err(wrong)? else { continue };
        scans += 1;
        if scans <= options.first || scans > options.first.saturating_add(options.count) {
            continue;
        }
        let value = |k: usize| {
            parse_number(words[k]).filter(|v| v.is_finite()).ok_or_else(|| {
                wrong(format!("expected a finite number as word {}, found {}", k + 1, shown(words[k])))
            })
        };
        let origin = [value(scan.pose)?, value(scan.pose + 1)?];
        let heading = value(scan.pose + 2)?;
        let time_s = scan.time.map_or(Ok(0.0), value)?;
        for beam in 0..scan.ranges[1] {
            let range = value(scan.ranges[0] + beam)?;
            // A scanner reports its maximum range where it receives no echo, which is not a measurement.
            if range < options.range[0] || range > options.range[1] {
                read.ignored += 1;
                continue;
            }
            let turn = scan.beams[0] + beam as f64 * scan.beams[1];
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
            "expected ranges from {} to {} m in the selected scans ({} from scan {} on; lines FLASER or \
             ROBOTLASER1), found none in a log of {scans} scans",
            options.range[0], options.range[1], options.count, options.first
        )));
    }
    Ok(read)
}

#[cfg(test)]
mod tests {
    use super::{CarmenOptions, is_log_line};
    use crate::contours::{ContourReadings, SigmaDefaults, read_contour_readings};
    use planish_estimate::Result;

    fn read(text: &str) -> Result<ContourReadings> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("robot.log");
        std::fs::write(&path, text).expect("a file");
        read_contour_readings(&path, &SigmaDefaults::default(), &CarmenOptions::default())
    }

    #[test]
    fn a_log_begins_with_any_keyword() {
        let scan = "FLASER 3 2 2 2 1 0 0 1 0 0 7.5 host 7.5\n";
        for first in
            ["ODOM 0 0 0 0 0 0 0 host 0", "# a comment", "NEFF 12.5", "PARAM a b", "\n# x\n\nSYNC 1", ""]
        {
            let read = read(&format!("{first}\n{scan}")).expect(first);
            assert_eq!(read.sightings.len(), 3, "{first}");
            assert!(read.in_metres && read.sightings[0].time_s == 7.5);
        }
        // Three beams over half a turn: right, ahead, left. Two steps, not three.
        let points: Vec<[f64; 2]> = read(scan).expect("a scan").sightings.iter().map(|s| s.point()).collect();
        for (point, expected) in points.iter().zip([[1.0, -2.0], [3.0, 0.0], [1.0, 2.0]]) {
            assert!((point[0] - expected[0]).abs() + (point[1] - expected[1]).abs() < 1e-12, "{point:?}");
        }
    }

    #[test]
    fn beams_of_robotlaser_have_their_own_field() {
        // Type, start −45°, field 90°, step 45°, maximum, accuracy, mode; three ranges; one remission; poses.
        let line = "ROBOTLASER1 0 -0.7853981633974483 1.5707963267948966 0.7853981633974483 81 0.01 0 3 1 2 \
                    1 1 9 5 5 0 5 5 0 0 0 0 0 0 3.25 host 3.25\n";
        let read = read(line).expect("a scan");
        assert_eq!(read.sightings[1].point(), [7.0, 5.0]);
        assert_eq!(read.sightings[1].time_s, 3.25);
        let [x, y] = read.sightings[2].point();
        assert!((x - 5.0 - 0.5f64.sqrt()).abs() < 1e-12 && (y - 5.0 - 0.5f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn tables_are_no_logs_and_cut_scans_are_errors() {
        assert!(!is_log_line(b"x,y,range") && !is_log_line(b"X,Y") && !is_log_line(b"x y"));
        let table = read("# points\nx,y,sigma\n1,2,0.1\n").expect("a table after a comment");
        assert_eq!(table.sightings.len(), 1);
        for (line, expected) in [
            ("FLASER 3 1 1\n", "expected `FLASER n`"),
            ("FLASER 99999999999999999999 1\n", "expected `FLASER n`"),
            ("ROBOTLASER1 0 -1 2 1 81 0.01 0 2 1 1 99999999999999999999\n", "expected `ROBOTLASER1`"),
            ("ODOM 0 0 0\n", "lines FLASER or ROBOTLASER1"),
        ] {
            let error = read(line).expect_err(line).to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
