//! Lists of input files, read into one set of scans.
//!
//! **Input.** Paths of scans (`ply`, `pcd`, `e57`, `las`, `laz`, `obj`, `stl`, `off`, `glb`, `npy`, `npz`,
//! `xyz`, `txt`, `asc`, `csv`, `pts`), of depth images (`png`, `tif`, `tiff`, `npy`), of height maps (`tif`,
//! `tiff`), and of lists of scans
//! (`conf`, `toml`), in any combination.
//!
//! **Output.** A [`ScanSet`] in the order of the paths, for any number of threads.
//!
//! **Limits.** It is not checked that scans overlap, or that scans without a pose share a frame.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use planish_estimate::{Error, ErrorKind, Result};
use planish_sense::{Pose, Scan, Sensor, Viewing};
use rayon::prelude::*;

use crate::depth::{find_calibration, is_depth_image, read_depth};
use crate::e57::read_e57;
use crate::geotiff::{HeightScan, is_height_map, read_geotiff};
use crate::job::read_job;
use crate::las::read_las_and_map;
use crate::npy::{read_npy, read_npz};
use crate::pcd::read_pcd;
use crate::ply::read_scan_and_unit;
use crate::scan_set::unnamed_sensor;
pub use crate::scan_set::{InputFile, PosedScan, ScanSet};
use crate::source::{describe_extension, extension, open};
use crate::split_scans::split_scans;
use crate::vrip::read_conf;
use crate::xyz::read_points;
use crate::{GeoReference, Unit, glb, obj, off, stl};

/// A scan to be read, with the settings of its list entry.
struct RequestedScan {
    path: PathBuf,
    sensor: usize,
    pose: Option<Pose>,
    sigma_translation: Option<f64>,
    sigma_rotation_deg: Option<f64>,
    viewing: Option<Viewing>,
    time_s: Option<f64>,
    /// The calibration of a depth image, if a job names it.
    calibration: Option<PathBuf>,
    /// Name and line of the list, for messages.
    listed: Option<String>,
}

impl RequestedScan {
    /// A scan without settings.
    fn new(path: PathBuf, sensor: usize) -> Self {
        Self {
            path,
            sensor,
            pose: None,
            sigma_translation: None,
            sigma_rotation_deg: None,
            viewing: None,
            time_s: None,
            calibration: None,
            listed: None,
        }
    }
}

/// The scans to read and the lists that name them.
#[derive(Default)]
struct Requests {
    scans: Vec<RequestedScan>,
    /// Each list with the index of its first scan.
    lists: Vec<(usize, PathBuf)>,
}

impl Requests {
    /// Adds a scan, or all scans of a list.
    fn add(&mut self, path: &Path, gathered: &mut Gathered) -> Result<()> {
        let at = |line| Some(format!("{} (line {line})", path.display()));
        match extension(path).as_str() {
            "conf" => {
                // The index later places the list before its first scan in `ScanSet::inputs`.
                self.lists.push((self.scans.len(), path.to_path_buf()));
                let listed = read_conf(path)?;
                let sensor = gathered.sensor(unnamed_sensor(), path)?;
                self.scans.extend(listed.into_iter().map(|scan| RequestedScan {
                    pose: Some(scan.world_from_scanner),
                    listed: at(scan.line),
                    ..RequestedScan::new(scan.path, sensor)
                }));
            }
            "toml" => {
                self.lists.push((self.scans.len(), path.to_path_buf()));
                let job = read_job(path)?;
                if let Some(unit) = job.unit {
                    gathered.unit(unit, path.display().to_string())?;
                }
                // A job numbers its own sensors; the set has other indices.
                let sensors = job.sensors.into_iter().map(|sensor| gathered.sensor(sensor, path));
                let sensors = sensors.collect::<Result<Vec<_>>>()?;
                self.scans.extend(job.scans.into_iter().map(|scan| RequestedScan {
                    pose: Some(scan.world_from_scanner),
                    sigma_translation: scan.sigma_translation,
                    sigma_rotation_deg: scan.sigma_rotation_deg,
                    viewing: scan.viewing,
                    time_s: scan.time_s,
                    calibration: scan.calibration,
                    listed: at(scan.line),
                    ..RequestedScan::new(scan.path, sensors[scan.sensor])
                }));
            }
            _ => {
                let sensor = gathered.sensor(unnamed_sensor(), path)?;
                self.scans.push(RequestedScan::new(path.to_path_buf(), sensor));
            }
        }
        Ok(())
    }
}

/// Sensors and unit of the files so far.
#[derive(Default)]
struct Gathered {
    sensors: Vec<Sensor>,
    unit: Option<(Unit, String)>,
}

impl Gathered {
    /// Index of a sensor. Two sensors of one name must have the same settings, because readings of one sensor
    /// share the estimate of its noise.
    fn sensor(&mut self, sensor: Sensor, path: &Path) -> Result<usize> {
        match self.sensors.iter().position(|s| s.name == sensor.name) {
            Some(known) if self.sensors[known] == sensor => Ok(known),
            Some(_) => Err(Error::input(format!(
                "{}: the sensor \"{}\" has other settings in another job: rename one of the two",
                path.display(),
                sensor.name
            ))),
            None => {
                self.sensors.push(sensor);
                Ok(self.sensors.len() - 1)
            }
        }
    }

    /// Records a unit; all stated units must be equal.
    fn unit(&mut self, unit: Unit, stated_by: String) -> Result<()> {
        match &self.unit {
            Some((known, by)) if *known != unit => Err(Error::input(format!(
                "{stated_by} states lengths in {unit}, but {by} states {known}: convert one of them"
            ))),
            Some(_) => Ok(()),
            None => {
                self.unit = Some((unit, stated_by));
                Ok(())
            }
        }
    }
}

/// Content of a file of scans.
struct Read {
    /// At least one; a file with several scans gives each its pose.
    scans: Vec<Scan>,
    unit: Option<Unit>,
    /// The calibration of the depth image.
    calibration: Option<PathBuf>,
    /// The map projection of its coordinates.
    georeference: Option<GeoReference>,
}

impl From<(Scan, Option<Unit>)> for Read {
    fn from((scan, unit): (Scan, Option<Unit>)) -> Self {
        Self { scans: vec![scan], unit, calibration: None, georeference: None }
    }
}

fn read_one(path: &Path, calibration: Option<&Path>) -> Result<Read> {
    // With a calibration, the readings are distances from a camera.
    if calibration.is_none() && find_calibration(path, None).is_err() && is_height_map(path) {
        let HeightScan { scan, unit, georeference } = read_geotiff(path)?;
        return Ok(Read { scans: vec![scan], unit, calibration: None, georeference });
    }
    if calibration.is_some() || is_depth_image(path) {
        let calibration = find_calibration(path, calibration)?;
        return Ok(Read { calibration: Some(calibration.clone()), ..read_depth(path, &calibration)?.into() });
    }
    match extension(path).as_str() {
        // ASTM E2807 prescribes metres.
        "e57" => Ok(Read {
            scans: read_e57(path)?,
            unit: Some(Unit::Metre),
            calibration: None,
            georeference: None,
        }),
        _ => read_single(path),
    }
}

/// First bytes, name and extensions of formats that can be recognised by their first bytes.
const SIGNATURES: [(&[u8], &str, &[&str]); 4] = [
    (b"ply", "PLY", &["ply"]),
    (b"# .PCD", "PCD", &["pcd"]),
    (b"LASF", "LAS", &["las", "laz"]),
    (b"PK\x03\x04", "zip", &["zip", "npz"]),
];

/// Error for a file whose first bytes show another format than its extension; none if they do not.
///
/// Called only after the reader has failed, so that a valid file with odd first bytes is never rejected.
fn format_mismatch(path: &Path) -> Option<Error> {
    let named = extension(path);
    let longest = SIGNATURES.iter().map(|(bytes, ..)| bytes.len()).max()?;
    // Unpacks gzip, so that the content is judged and not its wrapper.
    let mut source = open(path).ok()?;
    let first = source.peek(longest).ok()?;
    let (_, format, extensions) = SIGNATURES.iter().find(|(bytes, ..)| first.starts_with(bytes))?;
    let way_out = match *format {
        "zip" => "unpack it".to_owned(),
        _ => format!("rename it to end in .{}", extensions.join(" or .")),
    };
    (!extensions.contains(&named.as_str())).then(|| {
        Error::input(format!(
            "{}: the content is that of a {format} file, but the extension is `{named}`: {way_out}",
            path.display()
        ))
    })
}

/// Reads a file of one scan; an error names the true format if the extension is wrong.
fn read_single(path: &Path) -> Result<Read> {
    read_by_extension(path).map_err(|e| match e.kind() {
        // Errors of other kinds, such as a missing file, have nothing to do with the format.
        ErrorKind::Input => format_mismatch(path).unwrap_or(e),
        _ => e,
    })
}

fn read_by_extension(path: &Path) -> Result<Read> {
    let (scan, unit) = match extension(path).as_str() {
        "ply" => read_scan_and_unit(path),
        "las" | "laz" => {
            let (scan, georeference) = read_las_and_map(path)?;
            let unit = georeference.as_ref().and_then(GeoReference::unit);
            return Ok(Read { georeference, ..(scan, unit).into() });
        }
        "pcd" => read_pcd(path).map(|scan| (scan, None)),
        "npy" => read_npy(path).map(|scan| (scan, None)),
        "npz" => read_npz(path).map(|scan| (scan, None)),
        "obj" => obj::read_scan_and_unit(path),
        "stl" => stl::read_scan_and_unit(path),
        "off" => off::read_scan(path).map(|scan| (scan, None)),
        "glb" => glb::read_scan(path),
        "xyz" | "txt" | "asc" | "csv" | "pts" => read_points(path).map(|scan| (scan, None)),
        list @ ("conf" | "toml") => Err(Error::input(format!(
            "{}: expected a scan, found a list of scans (`{list}`): pass lists on the command line, not in \
             other lists",
            path.display()
        ))),
        _ => {
            // A mistyped name is more likely than a file of an unsupported format.
            if !path.exists() {
                return Err(Error::io(format!("{}: does not exist", path.display())));
            }
            if path.is_dir() {
                return Err(Error::io(format!("{}: expected a file, found a folder", path.display())));
            }
            Err(Error::unsupported(format!(
                "{}: expected a scan (ply, pcd, e57, las, laz, obj, stl, off, glb, npy, npz, xyz, txt, asc, \
                 csv, pts), a depth image (png, tif, tiff), a height map (tif, tiff) or a list of \
                 scans (conf, toml), found {}",
                path.display(),
                describe_extension(path)
            )))
        }
    }?;
    Ok((scan, unit).into())
}

/// Reads scans and lists of scans.
///
/// `unit` is the unit that the caller specifies; a file that states another one is an error. Scans without a
/// named sensor share one range sensor, `scanner`, whose σ is estimated. Files are read in parallel, on the
/// current rayon pool.
///
/// # Errors
/// The errors of the readers of the formats; [`Input`](planish_estimate::ErrorKind::Input) also for no paths,
/// a file named twice (its measurements would count twice), a scan without points, and conflicting units or
/// sensors; [`Unsupported`](planish_estimate::ErrorKind::Unsupported) for other extensions. If several files
/// are invalid, the error names the first.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::{Unit, read_inputs};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("probe.csv");
/// std::fs::write(&path, "x,y,z,sigma\n1,2,3,0.05\n4,5,6,0.05\n")?;
/// let set = read_inputs(&[&path], Some(Unit::Millimetre))?;
/// assert_eq!(set.scans[0].scan.points, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
/// assert_eq!((set.unit, set.sensors[0].name.as_str()), (Some(Unit::Millimetre), "scanner"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_inputs<P: AsRef<Path>>(paths: &[P], unit: Option<Unit>) -> Result<ScanSet> {
    let mut gathered = Gathered::default();
    if let Some(unit) = unit {
        gathered.unit(unit, "the option".to_owned())?;
    }
    // Lists are read first, because they name the scans.
    let mut requests = Requests::default();
    for path in paths.iter().map(AsRef::as_ref) {
        requests.add(path, &mut gathered)?;
    }
    let Requests { scans: wanted, lists } = requests;
    if wanted.is_empty() {
        return Err(Error::input("expected at least one scan, found none"));
    }
    refuse_doubles(&wanted)?;

    // Results are collected in the order of the paths, so that sums and messages do not depend on timing.
    let read: Vec<Result<Read>> =
        wanted.par_iter().map(|w| read_one(&w.path, w.calibration.as_deref())).collect();
    let mut set = ScanSet::default();
    let mut lists = lists.into_iter().peekable();
    for (index, (wanted, read)) in wanted.into_iter().zip(read).enumerate() {
        while let Some((_, path)) = lists.next_if(|(first, _)| *first == index) {
            set.inputs.push(InputFile::list(path));
        }
        add_file(&mut set, &mut gathered, wanted, read)?;
    }
    set.unit = gathered.unit.map(|(unit, _)| unit);
    set.sensors = gathered.sensors;
    Ok(set)
}

/// Adds the scans of one file, the file itself and its calibration to the set.
fn add_file(
    set: &mut ScanSet,
    gathered: &mut Gathered,
    wanted: RequestedScan,
    read: Result<Read>,
) -> Result<()> {
    let Read { scans, unit, calibration, georeference } = read.map_err(|e| match &wanted.listed {
        Some(list) => e.in_context(list),
        None => e,
    })?;
    if let Some(unit) = unit {
        gathered.unit(unit, wanted.path.display().to_string())?;
    }
    let file = InputFile::with_scans(wanted.path.clone(), &scans);
    if file.points == 0 {
        return Err(Error::input(format!(
            "{}: expected points, found none ({} records without finite coordinates were dropped)",
            wanted.path.display(),
            file.dropped_not_finite,
        )));
    }
    // A pose moves the points away from their place on the map.
    let georeference = georeference.filter(|_| wanted.pose.is_none());
    if set.scans.is_empty() {
        set.georeference = georeference;
    } else if set.georeference != georeference {
        set.georeference = None;
    }
    // Several images may share a calibration, which is listed once.
    if let Some(path) = calibration
        && !set.inputs.iter().any(|input| input.path == path)
    {
        set.inputs.push(InputFile::list(path));
    }
    set.inputs.push(file);
    add_scans(set, &wanted, scans)
}

/// Adds scans of one file with the pose, viewing, time and sensor that its list specifies.
fn add_scans(set: &mut ScanSet, wanted: &RequestedScan, scans: Vec<Scan>) -> Result<()> {
    let scans = scans.into_iter().map(split_scans).collect::<Result<Vec<_>>>();
    let scans = scans.map_err(|e| match &wanted.listed {
        Some(list) => e.in_context(list),
        None => e,
    })?;
    for mut scan in scans.into_iter().flatten() {
        if let Some(world_from_file) = &wanted.pose {
            scan.world_from_scanner = world_from_file.after(&scan.world_from_scanner);
        }
        scan.viewing = wanted.viewing.unwrap_or(scan.viewing);
        scan.time_s = wanted.time_s.or(scan.time_s);
        set.scans.push(PosedScan {
            scan,
            sensor: wanted.sensor,
            sigma_translation: wanted.sigma_translation,
            sigma_rotation_deg: wanted.sigma_rotation_deg,
        });
    }
    Ok(())
}

/// Rejects a file that is named twice, because its measurements would count twice.
fn refuse_doubles(wanted: &[RequestedScan]) -> Result<()> {
    let mut seen = HashMap::new();
    for w in wanted {
        // A missing file is reported by its reader.
        // Resolved, so that two paths of one file are recognised.
        if let Ok(real) = fs::canonicalize(&w.path)
            && seen.insert(real, &w.path).is_some()
        {
            return Err(Error::input(format!(
                "{}: named twice: its measurements would count twice",
                w.path.display()
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::DVec3;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    const PLY: &str = "ply\nformat ascii 1.0\ncomment unit mm\nelement vertex 1\nproperty float x\nproperty \
        float y\n\
                       property float z\nend_header\n1 2 3\n";

    #[test]
    fn a_file_with_scan_numbers_gives_several_scans() {
        let folder = folder(&[("a.csv", "x,y,z,time,scan\n1,2,3,0.5,2\n4,5,6,1.5,1\n7,8,9,0.5,2\n")]);
        let set = read_inputs(&[folder.path().join("a.csv")], None).unwrap();
        let found: Vec<_> =
            (set.scans.iter()).map(|s| (s.scan.name.as_str(), s.scan.points.len(), s.scan.time_s)).collect();
        assert_eq!(found, [("a.csv, scan 1", 1, Some(1.5)), ("a.csv, scan 2", 2, Some(0.5))]);
        assert_eq!(set.inputs[0].points, 3);
        fs::write(folder.path().join("b.csv"), "x,y,z,scan\n1,2,3,0.5\n").unwrap();
        let e = read_inputs(&[folder.path().join("b.csv")], None).unwrap_err();
        assert!(e.to_string().contains("line 2") && e.to_string().contains("whole number"), "{e}");
    }

    #[test]
    fn lists_and_scans_can_be_combined() {
        let folder = folder(&[
            ("a.ply", PLY),
            ("b.xyz", "1 2 3\nnan 0 0\n"),
            ("c.csv", "x,y,z\n4,5,6\n"),
            ("d.TXT", "7 8 9\n"),
            ("l.conf", "bmesh a.ply 1 0 0 0 0 0 1\n"),
            (
                "j.toml",
                "unit = \"mm\"\n[sensor.p]\nkind = \"touch\"\n[[scan]]\nfile = \"c.csv\"\ndirection = [0, \
                 0, 1]\n\
                 pose = { sigma_translation = 0.5 }\n",
            ),
        ]);
        let paths: Vec<_> =
            ["b.xyz", "l.conf", "j.toml", "d.TXT"].iter().map(|n| folder.path().join(n)).collect();
        let set = read_inputs(&paths, None).unwrap();
        assert_eq!(set.unit, Some(Unit::Millimetre));
        let names: Vec<_> = set.sensors.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["scanner", "p"]);
        let scans: Vec<_> = set.scans.iter().map(|s| (s.scan.name.as_str(), s.sensor)).collect();
        assert_eq!(scans, [("b.xyz", 0), ("a.ply", 0), ("c.csv", 1), ("d.TXT", 0)]);
        assert_eq!(set.scans[1].scan.world_from_scanner.translation, DVec3::X);
        assert_eq!(set.scans[2].scan.viewing, Viewing::Direction(DVec3::Z));
        assert_eq!(set.scans[2].sigma_translation, Some(0.5));
        let inputs: Vec<_> = set
            .inputs
            .iter()
            .map(|i| (i.path.file_name().unwrap().to_str().unwrap(), i.points, i.dropped_not_finite))
            .collect();
        assert_eq!(
            inputs,
            [
                ("b.xyz", 1, 1),
                ("l.conf", 0, 0),
                ("a.ply", 1, 0),
                ("j.toml", 0, 0),
                ("c.csv", 1, 0),
                ("d.TXT", 1, 0)
            ]
        );
    }

    #[test]
    fn invalid_inputs_are_reported() {
        let folder = folder(&[
            ("a.ply", PLY),
            ("b.xyz", "nan 0 0\n"),
            ("c.3mf", "PK\n"),
            ("d.csv", "x,y,z,sigma\n0,0,0,-1\n"),
            ("ply.pcd", PLY),
            ("pcd.xyz", "# .PCD v0.7\nVERSION 0.7\n"),
            ("self.conf", "bmesh self.conf 0 0 0 0 0 0 1\n"),
            ("l.conf", "bmesh d.csv 0 0 0 0 0 0 1\n"),
        ]);
        let read = |names: &[&str], unit| {
            let paths: Vec<_> = names.iter().map(|n| folder.path().join(n)).collect();
            read_inputs(&paths, unit).unwrap_err()
        };
        for (names, unit, kind, words) in [
            (&[][..], None, ErrorKind::Input, "at least one scan"),
            (&["a.ply", "a.ply"], None, ErrorKind::Input, "named twice"),
            (
                &["a.ply"],
                Some(Unit::Metre),
                ErrorKind::Input,
                "states lengths in mm, but the option states m",
            ),
            (&["b.xyz"], None, ErrorKind::Input, "1 records without finite coordinates"),
            (&["c.3mf"], None, ErrorKind::Unsupported, "found the extension `3mf`"),
            (&["gone.3mf"], None, ErrorKind::Io, "does not exist"),
            (&["gone.ply", "c.3mf"], None, ErrorKind::Io, "gone.ply: does not exist"),
            (&["l.conf"], None, ErrorKind::Input, "d.csv: line 2: expected sigma > 0, found -1 (point 0)"),
            (&["l.conf"], None, ErrorKind::Input, "l.conf (line 1)"),
            (&["ply.pcd"], None, ErrorKind::Input, "rename it to end in .ply"),
            (&["pcd.xyz"], None, ErrorKind::Input, "rename it to end in .pcd"),
            (&["self.conf"], None, ErrorKind::Input, "pass lists on the command line"),
        ] {
            let e = read(names, unit);
            assert_eq!(e.kind(), kind, "{e}");
            assert!(e.to_string().contains(words), "{e}");
        }
        let e = read_inputs(&[folder.path().join("")], None).unwrap_err();
        assert!(e.kind() != ErrorKind::Undetermined, "{e}");
        fs::create_dir(folder.path().join("x.ply")).unwrap();
        assert!(read(&["x.ply"], None).to_string().contains("found a folder"));
    }
}
