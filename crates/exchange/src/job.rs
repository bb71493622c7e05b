//! `job.toml`: named sensors and their scans.
//!
//! **Input.** A TOML file.
//!
//! **Output.** A [`JobFile`]. Lengths are in the unit of the job; relative paths start at its folder. Unknown
//! keys are errors, so that a misspelt σ does not go unnoticed.
//!
//! ```toml
//! unit = "mm"                      # mm, m, in or ft
//!
//! [sensor.laser]
//! kind = "range"                   # range, touch, stereo, normal or curvature
//! sigma_along = 0.05               # σ along and across the ray, or one `sigma` for all directions;
//! sigma_across = 0.02              # without them, σ is estimated
//! sigma_deg = 2.0                  # σ of the normals of its scans, which then are measurements, too
//! sigma_k = 0.01                   # σ of their principal curvatures (1/unit), likewise
//! sigma_bias = 0.02                # σ of the error common to all readings of a scan, along their rays
//!
//! [[scan]]
//! sensor = "laser"                 # optional if the job names one sensor or none
//! file = "top.ply"
//! pose = { translation = [0, 0, 0], quaternion_xyzw = [0, 0, 0, 1], sigma_translation = 0.1,
//!          sigma_rotation_deg = 0.05 }
//! viewpoint = [0, 0, 300]          # or direction = [0, 0, -1]: how the sensor looks, in the scanner's frame
//! time = 12.5                      # time of the scan in seconds, for a moving object
//! calibration = "camera.toml"      # camera of a depth image (`file` is PNG, TIFF or NPY)
//! ```
//!
//! A pose is `p_world = R(q) p_scanner + t`, unlike in VRIP lists. It is applied after the pose that the file
//! itself states (E57).
//!
//! **Limits.** The files of the scans are checked to exist, but not opened.

use planish_core::DVec3;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use planish_estimate::{Error, Result};
use planish_sense::{Noise, Pose, Sensor, SensorKind, Viewing};
use serde::Deserialize;
use toml::Spanned;

use crate::Unit;
use crate::calibration::take_tree;
use crate::points::MAX_SIGMA_NORMAL_DEG;
use crate::source::{no_file, read_text};
use crate::vrip::QUATERNION_TOLERANCE;

/// Content of a job file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JobFile {
    /// The unit of every length in the job and its files, if stated.
    pub unit: Option<Unit>,
    /// The sensors, by name.
    pub sensors: Vec<Sensor>,
    /// The scans, in the order of the file.
    pub scans: Vec<ScanEntry>,
}

/// A scan of a job.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanEntry {
    /// Path of the file.
    pub path: PathBuf,
    /// Index into [`JobFile::sensors`].
    pub sensor: usize,
    /// Pose: maps the frame of the scanner to the world.
    pub world_from_scanner: Pose,
    /// Standard deviation of each coordinate of the translation, in the unit of the job; none for an exact
    /// pose.
    pub sigma_translation: Option<f64>,
    /// Standard deviation of the rotation about each axis, in degrees; none for an exact pose.
    pub sigma_rotation_deg: Option<f64>,
    /// Viewpoint or viewing direction of the sensor, if stated.
    pub viewing: Option<Viewing>,
    /// Time of the scan in seconds, if stated.
    pub time_s: Option<f64>,
    /// Path of the calibration of the camera, for a depth image.
    pub calibration: Option<PathBuf>,
    /// Line of the entry in the job, from 1.
    pub line: usize,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JobTable {
    unit: Option<Spanned<String>>,
    #[serde(default)]
    sensor: BTreeMap<String, Spanned<SensorTable>>,
    #[serde(default)]
    scan: Vec<Spanned<ScanTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorTable {
    // Values keep their spans, so that errors found after parsing still name the line.
    kind: Spanned<String>,
    sigma: Option<Spanned<f64>>,
    sigma_along: Option<Spanned<f64>>,
    sigma_across: Option<Spanned<f64>>,
    sigma_deg: Option<Spanned<f64>>,
    sigma_k: Option<Spanned<f64>>,
    sigma_bias: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScanTable {
    sensor: Option<Spanned<String>>,
    file: Spanned<String>,
    pose: Option<PoseTable>,
    viewpoint: Option<Spanned<[f64; 3]>>,
    direction: Option<Spanned<[f64; 3]>>,
    time: Option<Spanned<f64>>,
    calibration: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseTable {
    translation: Option<Spanned<[f64; 3]>>,
    quaternion_xyzw: Option<Spanned<[f64; 4]>>,
    sigma_translation: Option<Spanned<f64>>,
    sigma_rotation_deg: Option<Spanned<f64>>,
}

/// Reads a job.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) if the job or a file that it names is missing;
/// [`Input`](planish_estimate::ErrorKind::Input) for malformed TOML, unknown keys or kinds, σ ≤ 0, and
/// quaternions without unit length: with file, line and key.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// std::fs::write(folder.path().join("top.xyz"), "1 2 3\n")?;
/// let path = folder.path().join("job.toml");
/// std::fs::write(&path, r#"
/// unit = "mm"
/// [sensor.probe]
/// kind = "touch"
/// sigma = 0.004
/// [[scan]]
/// file = "top.xyz"
/// "#)?;
/// let job = planish_exchange::job::read_job(&path)?;
/// assert_eq!((job.sensors[0].name.as_str(), job.scans.len()), ("probe", 1));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_job(path: &Path) -> Result<JobFile> {
    let read = read_text(path).and_then(|text| {
        let job = parse(&text, path.parent().unwrap_or(Path::new("")))?;
        // Checked now, so that a mistyped name is reported before large scans are read.
        for scan in &job.scans {
            let named = [("scan", Some(&scan.path)), ("calibration", scan.calibration.as_ref())];
            let missing = |path: &Path| !path.is_file();
            if let Some((what, Some(path))) = named.iter().find(|(_, path)| path.is_some_and(|p| missing(p)))
            {
                return Err(Error::io(format!(
                    "line {}: names the {what} {}, which {}",
                    scan.line,
                    path.display(),
                    no_file(path)
                )));
            }
        }
        Ok(job)
    });
    read.map_err(|e| e.in_context(path.display()))
}

/// Finds the line of a byte offset, for messages.
///
/// The ends of lines are indexed once: counting them per message would take quadratic time in a long job.
struct Text {
    /// Offsets of line ends, ascending.
    ends: Vec<usize>,
}

impl Text {
    fn new(text: &str) -> Self {
        let ends = text.bytes().enumerate().filter(|(_, b)| *b == b'\n');
        Self { ends: ends.map(|(at, _)| at).collect() }
    }

    fn line(&self, at: usize) -> usize {
        1 + self.ends.partition_point(|&end| end < at)
    }

    fn wrong<T>(&self, found: &Spanned<T>, message: impl std::fmt::Display) -> Error {
        Error::input(format!("line {}: {message}", self.line(found.span().start)))
    }

    fn toml_error(&self, e: &toml::de::Error) -> Error {
        let message = e.message().trim_end();
        match e.span() {
            Some(span) => Error::input(format!("line {}: {message}", self.line(span.start))),
            None => Error::input(message),
        }
    }

    /// A standard deviation that is positive and finite.
    fn sigma(&self, key: &str, value: Option<&Spanned<f64>>) -> Result<Option<f64>> {
        match value {
            Some(v) if !(*v.get_ref() > 0.0 && v.get_ref().is_finite()) => {
                Err(self.wrong(v, format_args!("expected {key} > 0, found {}", v.get_ref())))
            }
            // Variances of σ outside this range underflow to zero or overflow.
            Some(v) if !(1e-100..1e100).contains(v.get_ref()) => {
                let found = v.get_ref();
                Err(self.wrong(v, format_args!("expected {key} between 1e-100 and 1e100, found {found:e}")))
            }
            value => Ok(value.map(|v| *v.get_ref())),
        }
    }

    fn finite<const N: usize>(&self, key: &str, value: &Spanned<[f64; N]>) -> Result<[f64; N]> {
        match value.get_ref() {
            v if v.iter().all(|c| c.is_finite()) => Ok(*v),
            v => Err(self.wrong(value, format_args!("expected finite numbers for {key}, found {v:?}"))),
        }
    }

    fn sensor(&self, name: &str, table: &SensorTable) -> Result<Sensor> {
        let stated = table.kind.get_ref().as_str();
        let kind = (SensorKind::ALL.into_iter().find(|kind| kind.name() == stated)).ok_or_else(|| {
            let known = SensorKind::ALL.map(SensorKind::name).join(", ");
            self.wrong(
                &table.kind,
                format_args!("expected sensor.{name}.kind among [{known}], found \"{stated}\""),
            )
        })?;
        let key = |key: &str| format!("sensor.{name}.{key}");
        let sigma = self.sigma(&key("sigma"), table.sigma.as_ref())?;
        let along = self.sigma(&key("sigma_along"), table.sigma_along.as_ref())?;
        let across = self.sigma(&key("sigma_across"), table.sigma_across.as_ref())?;
        let ray_key = table.sigma_along.as_ref().or(table.sigma_across.as_ref());
        if let (SensorKind::Touch, Some(found)) = (kind, ray_key) {
            return Err(self.wrong(
                found,
                format_args!("sensor.{name}: expected `sigma`, because a touch probe has no ray"),
            ));
        }
        let sigma_normal_deg = self.sigma(&key("sigma_deg"), table.sigma_deg.as_ref())?;
        if let Some(deg) = table.sigma_deg.as_ref().filter(|deg| *deg.get_ref() >= MAX_SIGMA_NORMAL_DEG) {
            let key = key("sigma_deg");
            let found = deg.get_ref();
            return Err(self.wrong(
                deg,
                format_args!("expected {key} below {MAX_SIGMA_NORMAL_DEG} degrees, found {found}"),
            ));
        }
        let sigma_curvature = self.sigma(&key("sigma_k"), table.sigma_k.as_ref())?;
        let sigma_bias = self.sigma(&key("sigma_bias"), table.sigma_bias.as_ref())?;
        // A σ of positions would have no effect on a sensor that measures none.
        let of_places = table.sigma.as_ref().or(ray_key).or(table.sigma_bias.as_ref());
        if let (false, Some(found)) = (kind.measures_positions(), of_places) {
            return Err(self.wrong(
                found,
                format_args!(
                    "sensor.{name}: expected `sigma_deg` (of normals) or `sigma_k` (of curvatures), because \
                     this kind measures no positions"
                ),
            ));
        }
        // One of the two along the ray would leave the other direction exact or unknown.
        let noise = match (sigma, along, across) {
            (None, None, None) => None,
            (Some(sigma), None, None) => Some(Noise::Isotropic { sigma }),
            (None, Some(sigma_along), Some(sigma_across)) => Some(Noise::Ray { sigma_along, sigma_across }),
            _ => {
                let line = ray_key.map_or(1, |found| self.line(found.span().start));
                return Err(Error::input(format!(
                    "line {line}: sensor.{name}: expected `sigma` alone, or both `sigma_along` and \
                     `sigma_across`, or none of the three"
                )));
            }
        };
        Ok(Sensor { name: name.to_owned(), kind, noise, sigma_normal_deg, sigma_curvature, sigma_bias })
    }

    fn scan(&self, entry: &Spanned<ScanTable>, sensors: &[Sensor], folder: &Path) -> Result<ScanEntry> {
        let table = entry.get_ref();
        let sensor = match &table.sensor {
            // Sensors come from a `BTreeMap` and are sorted by name.
            Some(name) => sensors.binary_search_by(|s| s.name.cmp(name.get_ref())).map_err(|_| {
                let known: Vec<_> = sensors.iter().map(|s| s.name.as_str()).collect();
                self.wrong(
                    name,
                    format_args!(
                        "expected one of the sensors [{}], found \"{}\"",
                        known.join(", "),
                        name.get_ref()
                    ),
                )
            })?,
            // With one sensor, its name need not be repeated in every scan.
            None if sensors.len() == 1 => 0,
            None => {
                return Err(self.wrong(entry, "expected `sensor` in this scan: the job names several"));
            }
        };
        let pose = table.pose.as_ref();
        let translation = match pose.and_then(|p| p.translation.as_ref()) {
            Some(t) => self.finite("pose.translation", t)?,
            None => [0.0; 3],
        };
        let world_from_scanner = match pose.and_then(|p| p.quaternion_xyzw.as_ref()) {
            None => Pose { translation: DVec3::from(translation), ..Pose::identity() },
            Some(stated) => {
                let q = self.finite("pose.quaternion_xyzw", stated)?;
                let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
                // The length is checked, not only normalised: another length shows a mistake in the numbers.
                Pose::from_quaternion_xyzw(q, DVec3::from(translation))
                    .filter(|_| (length - 1.0).abs() <= QUATERNION_TOLERANCE)
                    .ok_or_else(|| {
                        let message =
                            format!("expected pose.quaternion_xyzw of length 1, found length {length}");
                        self.wrong(stated, message)
                    })?
            }
        };
        let viewing = match (&table.viewpoint, &table.direction) {
            (None, None) => None,
            (Some(point), None) => Some(Viewing::Origin(DVec3::from(self.finite("viewpoint", point)?))),
            (None, Some(direction)) => {
                let d = self.finite("direction", direction)?;
                // Unlike quaternions, directions of any length are accepted: their length has no meaning.
                let length = d.iter().map(|c| c * c).sum::<f64>().sqrt();
                if !(length > 0.0 && length.is_finite()) {
                    return Err(self.wrong(direction, format_args!("expected a direction, found {d:?}")));
                }
                Some(Viewing::Direction(DVec3::from(d.map(|c| c / length))))
            }
            (Some(_), Some(direction)) => {
                return Err(self.wrong(direction, "expected `viewpoint` or `direction`, found both"));
            }
        };
        Ok(ScanEntry {
            path: folder.join(table.file.get_ref()),
            sensor,
            world_from_scanner,
            sigma_translation: self
                .sigma("pose.sigma_translation", pose.and_then(|p| p.sigma_translation.as_ref()))?,
            sigma_rotation_deg: self
                .sigma("pose.sigma_rotation_deg", pose.and_then(|p| p.sigma_rotation_deg.as_ref()))?,
            viewing,
            time_s: match &table.time {
                Some(time) if !time.get_ref().is_finite() => {
                    return Err(self
                        .wrong(time, format_args!("expected a time in seconds, found {}", time.get_ref())));
                }
                time => time.as_ref().map(|t| *t.get_ref()),
            },
            calibration: table.calibration.as_ref().map(|name| folder.join(name)),
            line: self.line(table.file.span().start),
        })
    }
}

fn parse(source: &str, folder: &Path) -> Result<JobFile> {
    let text = Text::new(source);
    take_tree(source)?;
    let table: JobTable = toml::from_str(source).map_err(|e| text.toml_error(&e))?;
    let unit = match &table.unit {
        Some(name) => Some(name.get_ref().parse().map_err(|e: Error| text.wrong(name, e))?),
        None => None,
    };
    let mut sensors = Vec::with_capacity(table.sensor.len());
    for (name, sensor) in &table.sensor {
        sensors.push(text.sensor(name, sensor.get_ref())?);
    }
    if table.scan.is_empty() {
        return Err(Error::input("expected at least one [[scan]], found none"));
    }
    // A job may only list files and poses; σ is then estimated, as for files without a job.
    if sensors.is_empty() {
        sensors.push(crate::scan_set::unnamed_sensor());
    }
    let scans = table.scan.iter().map(|entry| text.scan(entry, &sensors, folder));
    Ok(JobFile { unit, scans: scans.collect::<Result<_>>()?, sensors })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_estimate::ErrorKind;
    use proptest::prelude::*;

    const GOOD: &str = r#"
unit = "mm"

[sensor.probe]
kind = "touch"
sigma = 0.004

[sensor.laser]
kind = "range"
sigma_along = 0.05
sigma_across = 0.02

[[scan]]
sensor = "laser"
file = "top.ply"
pose = { translation = [1, 2, 3], quaternion_xyzw = [0, 0, 0.70710678, 0.70710678],
         sigma_translation = 0.1, sigma_rotation_deg = 0.05 }
direction = [0, 0, -2]

[[scan]]
sensor = "probe"
file = "p.csv"
viewpoint = [0, 0, 300]
"#;

    fn error(from: &str, to: &str) -> Error {
        assert!(GOOD.contains(from), "{from}");
        parse(&GOOD.replacen(from, to, 1), Path::new("d")).unwrap_err()
    }

    #[test]
    fn a_job_names_sensors_and_scans() {
        let job = parse(GOOD, Path::new("d")).unwrap();
        assert_eq!(job.unit, Some(Unit::Millimetre));
        assert_eq!(job.sensors.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["laser", "probe"]);
        assert_eq!(job.sensors[0].noise, Some(Noise::Ray { sigma_along: 0.05, sigma_across: 0.02 }));
        assert_eq!(job.sensors[1].noise, Some(Noise::Isotropic { sigma: 0.004 }));
        assert_eq!(job.sensors[1].kind, SensorKind::Touch);
        let [top, probe] = &job.scans[..] else { panic!("two scans") };
        assert_eq!((top.sensor, probe.sensor), (0, 1));
        assert_eq!(top.path, Path::new("d/top.ply"));
        assert_eq!((top.sigma_translation, top.sigma_rotation_deg), (Some(0.1), Some(0.05)));
        assert_eq!(top.viewing, Some(Viewing::Direction(DVec3::new(0.0, 0.0, -1.0))));
        assert_eq!(probe.viewing, Some(Viewing::Origin(DVec3::new(0.0, 0.0, 300.0))));
        assert_eq!(probe.world_from_scanner, Pose::identity());
        // The plain convention: a quarter turn about +z carries x to +y.
        let p = top.world_from_scanner.apply(DVec3::X);
        assert!(p.to_array().iter().zip([1.0, 3.0, 3.0]).all(|(a, b)| (a - b).abs() < 1e-7), "{p:?}");
    }

    #[test]
    fn errors_name_line_and_key() {
        for (from, to, line, words) in [
            ("sigma = 0.004", "sigma = 0", 6, "sensor.probe.sigma > 0, found 0"),
            ("sigma_along = 0.05", "sigma_along = nan", 10, "sensor.laser.sigma_along"),
            ("sigma_along = 0.05", "sigma_alnog = 0.05", 10, "sigma_alnog"),
            (
                "sigma_across = 0.02",
                "sigma_across = 0.02\nsigma_bias = 1e200",
                12,
                "sensor.laser.sigma_bias between 1e-100 and 1e100",
            ),
            (
                "sigma_across = 0.02",
                "sigma_across = 0.02\nsigma_deg = 400",
                12,
                "sensor.laser.sigma_deg below 90",
            ),
            ("sigma_across = 0.02\n", "", 10, "both `sigma_along` and `sigma_across`"),
            ("sigma = 0.004", "sigma_along = 0.004", 6, "touch probe"),
            ("kind = \"touch\"", "kind = \"probe\"", 5, "found \"probe\""),
            ("sensor = \"laser\"", "sensor = \"lazer\"", 14, "sensors [laser, probe], found \"lazer\""),
            ("0.70710678, 0.70710678", "0.7, 0.8", 16, "pose.quaternion_xyzw of length 1"),
            ("sigma_translation = 0.1", "sigma_translation = -1", 17, "pose.sigma_translation > 0"),
            ("direction = [0, 0, -2]", "direction = [0, 0, 0]", 18, "expected a direction"),
            ("viewpoint =", "direction = [1, 0, 0]\nviewpoint =", 23, "found both"),
            ("unit = \"mm\"", "unit = \"cm\"", 2, "expected `mm`, `m`, `in` or `ft`"),
            ("file = \"p.csv\"", "", 20, "missing field `file`"),
            ("sensor = \"probe\"\n", "", 20, "expected `sensor`"),
            ("[[scan]]", "[[scan]", 13, ""),
        ] {
            let e = error(from, to);
            assert_eq!(e.kind(), ErrorKind::Input, "{e}");
            assert!(
                e.to_string().contains(&format!("line {line}: ")) && e.to_string().contains(words),
                "{e}"
            );
        }
        assert!(parse("unit = \"mm\"", Path::new("d")).unwrap_err().to_string().contains("[[scan]]"));
    }

    #[test]
    fn sensors_of_normals_and_curvatures_have_their_own_sigmas() {
        let job = GOOD.replacen("kind = \"touch\"\nsigma = 0.004", "kind = \"normal\"\nsigma_deg = 2.0", 1);
        let job = parse(&job, Path::new("d")).unwrap();
        assert_eq!(job.sensors[1].kind, SensorKind::Normal);
        assert_eq!((job.sensors[1].noise, job.sensors[1].sigma_normal_deg), (None, Some(2.0)));
        let e = error("kind = \"touch\"", "kind = \"curvature\"");
        assert!(e.to_string().contains("line 6: sensor.probe: expected `sigma_deg`"), "{e}");
    }

    #[test]
    fn a_job_without_sensors_gets_one_whose_noise_is_estimated() {
        let job = parse("[[scan]]\nfile = \"a.ply\"\n", Path::new("d")).unwrap();
        assert_eq!((job.sensors.len(), job.sensors[0].noise, job.scans[0].sensor), (1, None, 0));
    }

    #[test]
    fn a_missing_scan_is_an_io_error_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("job.toml");
        std::fs::write(&path, "\n[[scan]]\nfile = \"gone.ply\"\n").unwrap();
        let e = read_job(&path).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Io);
        assert!(e.to_string().contains("job.toml: line 3") && e.to_string().contains("gone.ply"), "{e}");
    }

    #[test]
    fn a_job_of_a_hundred_thousand_scans_is_read_in_linear_time() {
        let scans: String = (0..100_000).map(|k| format!("[[scan]]\nfile = \"{k}.ply\"\n")).collect();
        assert_eq!(parse(&scans, Path::new("d")).unwrap().scans[99_999].line, 200_000);
    }

    proptest! {
        #[test]
        fn no_text_causes_a_panic(text in "([\\[\\]=\"{}a-z0-9. \n]|\\[\\[scan\\]\\]\n|file \
            = \"a\"\n|\\[sensor.a\\]\n|kind = \"range\"\n){0,40}") {
            let _ = parse(&text, Path::new("d"));
        }
    }
}
