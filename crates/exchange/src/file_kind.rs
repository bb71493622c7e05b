//! What a file is: by its extension, and for TOML, CSV and TIFF by its keys, columns and tags.
//!
//! **Input.** A path.
//!
//! **Output.** A [`FileKind`], which selects the reader.
//!
//! **Limits.** The content is not checked; a reader does that.

use crate::calibration::table;
use crate::geotiff::is_height_map;
use crate::source::{describe_extension, extension, open, read_text};
use planish_estimate::{Error, Result};
use std::path::Path;

/// The kinds of files that Planish reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FileKind {
    /// A saved model (`.planish`).
    Model,
    /// A mesh, or points in a mesh format (PLY, OBJ, STL, OFF, GLB).
    Mesh,
    /// Faces of a STEP file.
    Step,
    /// Points in a format without faces.
    Points,
    /// A list of scans: `job.toml` or VRIP `.conf`.
    ScanList,
    /// Cameras with masks, contours or tracks (`views.toml`).
    Views,
    /// Displacements of the controls of a mesh, and keyframes.
    Poses,
    /// Calibration of a depth camera.
    DepthCamera,
    /// Calibration of a stereo pair.
    StereoCalibration,
    /// Calibration of a camera and a projector of stripes.
    GridCalibration,
    /// Lights of photometric images.
    Lights,
    /// Sensor that `next` plans views for.
    ViewSensor,
    /// A drawing (DXF, SVG, PDF).
    Drawing,
    /// A contour with its covariance (JSON).
    Contour,
    /// Readings of a contour in the plane: CSV or CARMEN log.
    ContourReadings,
    /// Readings of a contour in space: CSV with azimuth, elevation and range.
    RayReadings,
    /// Materials of an OBJ file (MTL).
    Materials,
    /// A picture, or a depth image.
    Picture,
}

/// Keys of the top level that identify kinds of TOML files, the most specific first. All readers
/// refuse unknown keys, so a file has the keys of one kind only.
const TOML_KEYS: [(FileKind, &[&str]); 8] = [
    (FileKind::ScanList, &["scan", "sensor"]),
    (FileKind::GridCalibration, &["projector", "stripes"]),
    // Before views, which also have tables `view`.
    (FileKind::StereoCalibration, &["sigma_disparity_px", "baseline"]),
    (FileKind::Views, &["view"]),
    (FileKind::Lights, &["lights", "ball", "sigma_light_deg"]),
    (FileKind::Poses, &["controls", "rigid", "pose", "keyframe"]),
    // Before depth cameras, which also have focal lengths.
    (FileKind::ViewSensor, &["near", "far", "fov_deg"]),
    (FileKind::DepthCamera, &["fx"]),
];

impl FileKind {
    /// The kind of a file.
    ///
    /// # Errors
    /// `Unsupported` for an extension, or keys of a TOML file, of no kind; `Io` and `Input` if the file must
    /// be read for this and cannot be.
    ///
    /// # Examples
    /// ```
    /// use planish_exchange::FileKind;
    /// # let folder = tempfile::tempdir()?;
    /// let path = folder.path().join("sweep.csv");
    /// std::fs::write(&path, "x,y,heading_deg,range\n0,0,90,2\n")?;
    /// assert_eq!(FileKind::of_file(&path)?, FileKind::ContourReadings);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn of_file(path: &Path) -> Result<Self> {
        Ok(match extension(path).as_str() {
            "planish" => Self::Model,
            "ply" | "obj" | "stl" | "off" | "glb" => Self::Mesh,
            "step" | "stp" => Self::Step,
            "conf" => Self::ScanList,
            "toml" => of_toml(path)?,
            "dxf" | "svg" | "pdf" => Self::Drawing,
            "json" => Self::Contour,
            "log" => Self::ContourReadings,
            "mtl" => Self::Materials,
            "tif" | "tiff" if is_height_map(path) => Self::Points,
            "png" | "tif" | "tiff" | "jpg" | "jpeg" | "tga" | "pgm" | "ppm" => Self::Picture,
            "csv" => of_csv(path)?,
            "xyz" | "txt" | "asc" | "pts" | "pcd" | "las" | "laz" | "e57" | "npy" | "npz" => Self::Points,
            _ => {
                return Err(Error::unsupported(format!(
                    "{}: expected a model, a mesh, a scan, a picture, a drawing, or a list or calibration \
                     (.toml), found {}",
                    path.display(),
                    describe_extension(path)
                )));
            }
        })
    }

    /// The name with the article that a sentence needs, such as `a drawing`.
    #[must_use]
    pub fn with_article(self) -> String {
        // Of these names, only those in the plural have none.
        match self.name() {
            name if name.ends_with('s') && !name.ends_with("scans") => name.to_owned(),
            name if name.contains("readings") => name.to_owned(),
            name => format!("a {name}"),
        }
    }

    /// The name in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Model => "saved model",
            Self::Mesh => "mesh",
            Self::Step => "STEP faces",
            Self::Points => "points",
            Self::ScanList => "list of scans",
            Self::Views => "views",
            Self::Poses => "poses",
            Self::DepthCamera => "depth camera",
            Self::StereoCalibration => "stereo calibration",
            Self::GridCalibration => "grid calibration",
            Self::Lights => "lights",
            Self::ViewSensor => "view sensor",
            Self::Drawing => "drawing",
            Self::Contour => "contour",
            Self::ContourReadings => "contour readings",
            Self::RayReadings => "readings in space",
            Self::Materials => "materials",
            Self::Picture => "picture",
        }
    }
}

fn of_toml(path: &Path) -> Result<FileKind> {
    let keys = || TOML_KEYS.iter().flat_map(|(_, keys)| *keys).copied().collect::<Vec<_>>().join(", ");
    let table: toml::Table = read_text(path)
        .and_then(|text| table(&text, "expected a table with keys"))
        .map_err(|e| e.in_context(path.display()))?;
    let kind = TOML_KEYS.iter().find(|(_, keys)| keys.iter().any(|key| table.contains_key(*key)));
    kind.map(|(kind, _)| *kind).ok_or_else(|| {
        Error::unsupported(format!(
            "{}: expected one of the keys {}, found none of them",
            path.display(),
            keys()
        ))
    })
}

fn of_csv(path: &Path) -> Result<FileKind> {
    let mut source = open(path)?;
    // The header is the first line with content.
    while let Some(line) = source.line().map_err(|e| e.in_context(path.display()))? {
        let line = String::from_utf8_lossy(line);
        let line = line.trim_start_matches('\u{feff}').trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let columns: Vec<&str> = line.split(',').map(str::trim).collect();
        let has = |name: &str| columns.contains(&name);
        return Ok(match (has("z"), has("range") || has("heading_deg")) {
            (true, true) => FileKind::RayReadings,
            (true, false) => FileKind::Points,
            (false, true) => FileKind::ContourReadings,
            // Overhead points of a contour; a file without named columns holds points.
            (false, false) if has("x") && has("y") => FileKind::ContourReadings,
            (false, false) => FileKind::Points,
        });
    }
    Ok(FileKind::Points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_follow_from_extensions_keys_and_columns() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text, kind) in [
            ("a.planish", "", FileKind::Model),
            ("a.ply.gz", "", FileKind::Mesh),
            ("a.STP", "", FileKind::Step),
            ("a.csv", "# note\nx,y,z,sigma\n", FileKind::Points),
            ("b.csv", "\u{feff}x,y,heading_deg,range\n", FileKind::ContourReadings),
            ("c.csv", "x, y, sigma\n", FileKind::ContourReadings),
            ("d.csv", "x,y,z,azimuth_deg,elevation_deg,range\n", FileKind::RayReadings),
            ("e.csv", "1,2,3\n", FileKind::Points),
            ("a.toml", "unit = \"mm\"\n[[scan]]\nfile = \"a.ply\"\n", FileKind::ScanList),
            ("b.toml", "[[view]]\nimage = \"a.png\"\n", FileKind::Views),
            ("c.toml", "sigma_disparity_px = 0.1\n[[view]]\n", FileKind::StereoCalibration),
            ("d.toml", "fx = 1.0\nnear = 1.0\n", FileKind::ViewSensor),
            ("e.toml", "fx = 1.0\nscale = 0.001\n", FileKind::DepthCamera),
            ("f.toml", "[[pose]]\nname = \"a\"\n", FileKind::Poses),
            ("g.toml", "[projector]\n", FileKind::GridCalibration),
            ("h.toml", "lights = [[0, 0, 1]]\n", FileKind::Lights),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            assert_eq!(FileKind::of_file(&path).unwrap(), kind, "{name}");
        }
        let refused = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            FileKind::of_file(&path).unwrap_err().to_string()
        };
        assert!(refused("a.iges", "").contains("convert it to STEP"));
        assert!(refused("x.toml", "size = 3\n").contains("expected one of the keys scan"));
        assert!(refused("y.toml", "unit = \"mm\"\nsize = \n").contains("line 2"));
    }
}
