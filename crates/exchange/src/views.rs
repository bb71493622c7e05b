//! Views of an object: cameras with pictures, masks, contours and tracked features.
//!
//! **Input.** `views.toml`.
//!
//! **Output.** [`Views`], with cameras from `K R t` or from a projection matrix.
//!
//! ```toml
//! unit = "mm"                     # of every length; may be left out
//! mask_threshold = 40             # the object is brighter (default: middle of the mask's range)
//! mask_least_share = 0.01         # fills specks and holes below this share of the object's pixels
//! sigma_px = 0.5                  # σ of a place on the border of a mask, across it
//! sigma_rotation_deg = 1.0        # σ of the pose about and along each axis (default: exact)
//! sigma_translation = 5.0
//! tracks = "tracks.csv"           # features: track,view,x,y[,sigma_px]; views by name
//!
//! [[view]]
//! name = "front"                  # the mask's or the image's name where it is left out
//! image = "a.png"                 # for textures; may be left out
//! mask = "a_mask.png"             # may be left out where nothing is fitted to the view
//! contours = "a.csv"              # points on contours inside the mask: x,y[,sigma_px][,contour]
//! held_out = false                # whether the view only judges the fit
//! K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
//! R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]   # X_camera = R X + t: x right, y down, pixel centres at integers
//! t = [0, 0, 500]
//!
//! [[view]]
//! mask = "b_mask.png"
//! P = [[1200, 0, 320, 0], [0, 1200, 240, 0], [0, 0, 1, 500]]
//! ```
//!
//! `mask_threshold`, `mask_least_share`, `sigma_px`, `sigma_rotation_deg` and `sigma_translation` may also be
//! set in a view, and then apply to it alone. Paths are relative to the file.
//!
//! **Limits.** Lenses are assumed to be free of distortion.

use crate::Unit;
use crate::calibration::table;
use crate::source::{parse_number, read_file, read_text, shown};
use planish_estimate::{Error, Result};
use planish_shell::{Camera, PoseNoise};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// σ of a place on the border of a mask that states none, in pixels.
const USUAL_SIGMA_PX: f64 = 0.5;

/// A view of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewFile {
    /// Its name, of which there is no other.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// How uncertain its pose is.
    pub pose: Option<PoseNoise>,
    /// Its picture.
    pub image: Option<PathBuf>,
    /// Its mask.
    pub mask: Option<PathBuf>,
    /// Contours inside of the mask: pixel and σ.
    pub contours: Vec<([f64; 2], f64)>,
    /// Where in `contours` another one begins: the column `contour` changes.
    pub contour_starts: Vec<usize>,
    /// What of the mask is the thing.
    pub mask_threshold: Option<f64>,
    /// Specks and holes that are filled, as a share of the thing's pixels.
    pub mask_least_share: Option<f64>,
    /// σ of a place on the mask's border, in pixels.
    pub sigma_px: f64,
    /// Whether it only judges.
    pub held_out: bool,
}

/// A feature that is seen in several views: index of the view, pixel and σ.
pub type Track = Vec<(u32, [f64; 2], f64)>;

/// What a file of views holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Views {
    /// The views.
    pub views: Vec<ViewFile>,
    /// Features over them.
    pub tracks: Vec<Track>,
    /// The unit of lengths, where it is named.
    pub unit: Option<Unit>,
    /// Files that were read beside it.
    pub files: Vec<PathBuf>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    unit: Option<String>,
    mask_threshold: Option<f64>,
    mask_least_share: Option<f64>,
    sigma_px: Option<f64>,
    sigma_rotation_deg: Option<f64>,
    sigma_translation: Option<f64>,
    tracks: Option<PathBuf>,
    view: Vec<View>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct View {
    name: Option<String>,
    image: Option<PathBuf>,
    mask: Option<PathBuf>,
    contours: Option<PathBuf>,
    mask_threshold: Option<f64>,
    mask_least_share: Option<f64>,
    sigma_px: Option<f64>,
    sigma_rotation_deg: Option<f64>,
    sigma_translation: Option<f64>,
    #[serde(default)]
    held_out: bool,
    #[serde(rename = "K")]
    k: Option<[[f64; 3]; 3]>,
    #[serde(rename = "R")]
    r: Option<[[f64; 3]; 3]>,
    t: Option<[f64; 3]>,
    #[serde(rename = "P")]
    p: Option<[[f64; 4]; 3]>,
}

/// Reads views, and the contours and tracks that they name; pictures are not opened.
///
/// # Errors
/// `Io` where a file cannot be read; `Input` for keys that are not known, cameras that are none, σ that are
/// not positive, two views of one name, and tracks of views that are not there: with file and line or view.
pub fn read_views(path: &Path) -> Result<Views> {
    let read = || parse(&read_text(path)?, path.parent().unwrap_or(Path::new("")));
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str, folder: &Path) -> Result<Views> {
    let t: Table = table(
        text,
        "views need [[view]] with K, R and t, or P, and may have name, image, mask, contours and held_out; \
         beside them there may be mask_threshold, mask_least_share, sigma_px, sigma_rotation_deg, \
         sigma_translation, tracks and unit",
    )?;
    let mut files = Vec::new();
    let mut views: Vec<ViewFile> = Vec::new();
    for (index, view) in t.view.iter().enumerate() {
        let stem = view.mask.as_ref().or(view.image.as_ref()).and_then(|path| path.file_stem());
        let name = match (&view.name, stem) {
            (Some(name), _) => name.clone(),
            (None, Some(stem)) => stem.to_string_lossy().into_owned(),
            (None, None) => format!("view{}", index + 1),
        };
        if views.iter().any(|other| other.name == name) {
            return Err(Error::input(format!("needed views of different names, found two named `{name}`")));
        }
        let read = || {
            let camera = match (view.k, view.r, view.t, view.p) {
                (Some(k), Some(r), Some(t), None) => Camera::new(k, r, t)?,
                (None, None, None, Some(p)) => Camera::from_projection(p)?,
                _ => return Err(Error::input("needed K, R and t, or P alone")),
            };
            let sigma_px = view.sigma_px.or(t.sigma_px).unwrap_or(USUAL_SIGMA_PX);
            let rotation = view.sigma_rotation_deg.or(t.sigma_rotation_deg);
            let translation = view.sigma_translation.or(t.sigma_translation);
            for (key, value) in [
                ("sigma_px", Some(sigma_px)),
                ("sigma_rotation_deg", rotation),
                ("sigma_translation", translation),
            ] {
                if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
                    return Err(Error::input(format!(
                        "needed a finite number above 0 for {key}, found {value}"
                    )));
                }
            }
            let pose = match (rotation, translation) {
                (None, None) => None,
                (Some(deg), Some(sigma_translation)) => {
                    Some(PoseNoise { sigma_rotation: deg.to_radians(), sigma_translation })
                }
                _ => {
                    return Err(Error::input(
                        "needed both sigma_rotation_deg and sigma_translation, or neither",
                    ));
                }
            };
            let contours = match &view.contours {
                None => (Vec::new(), Vec::new()),
                Some(file) => read_pixels(&folder.join(file), sigma_px)?,
            };
            Ok((camera, pose, sigma_px, contours))
        };
        let (camera, pose, sigma_px, (contours, contour_starts)) =
            read().map_err(|e| e.in_context(format!("view `{name}`")))?;
        files.extend(view.contours.iter().map(|file| folder.join(file)));
        views.push(ViewFile {
            name,
            camera,
            pose,
            image: view.image.as_ref().map(|file| folder.join(file)),
            mask: view.mask.as_ref().map(|file| folder.join(file)),
            contours,
            contour_starts,
            mask_threshold: view.mask_threshold.or(t.mask_threshold),
            mask_least_share: view.mask_least_share.or(t.mask_least_share),
            sigma_px,
            held_out: view.held_out,
        });
    }
    let mut tracks = Vec::new();
    if let Some(file) = &t.tracks {
        let file = folder.join(file);
        tracks = read_tracks(&file, &views, t.sigma_px.unwrap_or(USUAL_SIGMA_PX))?;
        files.push(file);
    }
    Ok(Views { views, tracks, unit: t.unit.map(|name| name.parse()).transpose()?, files })
}

/// Lines of a CSV with a header: for each line its number and the words of the named columns, `None` for one
/// that is not there.
fn read_columns(path: &Path, names: &[&str], needed: usize) -> Result<Vec<(u64, Vec<Option<String>>)>> {
    read_file(path, |mut source, _| {
        let mut header: Option<Vec<Option<usize>>> = None;
        let mut rows = Vec::new();
        let mut number = 0;
        while let Some(line) = source.line()? {
            number += 1;
            let line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line).trim_ascii();
            if line.is_empty() || line.starts_with(b"#") {
                continue;
            }
            let words: Vec<&[u8]> = line.split(|&b| b == b',').map(<[u8]>::trim_ascii).collect();
            match &header {
                None => {
                    let places: Vec<Option<usize>> = (names.iter())
                        .map(|name| words.iter().position(|word| *word == name.as_bytes()))
                        .collect();
                    if places[..needed].contains(&None) {
                        return Err(Error::input(format!(
                            "line {number}: needed a header with {}, found {}",
                            names[..needed].join(","),
                            shown(line)
                        )));
                    }
                    header = Some(places);
                }
                Some(places) => {
                    let mut row = Vec::with_capacity(names.len());
                    for (place, name) in places.iter().zip(names) {
                        row.push(match place {
                            None => None,
                            Some(place) => match words.get(*place).filter(|word| !word.is_empty()) {
                                Some(word) => Some(String::from_utf8_lossy(word).into_owned()),
                                None => {
                                    return Err(Error::input(format!(
                                        "line {number}: needed a value of {name}"
                                    )));
                                }
                            },
                        });
                    }
                    rows.push((number, row));
                }
            }
        }
        Ok(rows)
    })
}

fn number(line: u64, word: Option<&str>, fallback: f64, positive: bool) -> Result<f64> {
    let Some(word) = word else { return Ok(fallback) };
    match parse_number(word.as_bytes()) {
        Some(value) if value.is_finite() && (value > 0.0 || !positive) => Ok(value),
        _ => Err(Error::input(format!(
            "line {line}: needed a {} number, found `{word}`",
            if positive { "finite positive" } else { "finite" }
        ))),
    }
}

/// Pixels with σ.
type Pixels = Vec<([f64; 2], f64)>;

/// Pixels with σ, and where the column `contour` changes; at the first alone where there is none.
fn read_pixels(path: &Path, sigma_px: f64) -> Result<(Pixels, Vec<usize>)> {
    let pixel = |(line, row): &(u64, Vec<Option<String>>)| {
        let at = |k: usize, fallback, positive| number(*line, row[k].as_deref(), fallback, positive);
        Ok(([at(0, 0.0, false)?, at(1, 0.0, false)?], at(2, sigma_px, true)?))
    };
    let rows = read_columns(path, &["x", "y", "sigma_px", "contour"], 2)?;
    let all: Result<Vec<_>> = rows.iter().map(pixel).collect();
    let starts = (0..rows.len()).filter(|&k| k == 0 || rows[k].1[3] != rows[k - 1].1[3]).collect();
    Ok((all.map_err(|e| e.in_context(path.display()))?, starts))
}

fn read_tracks(path: &Path, views: &[ViewFile], sigma_px: f64) -> Result<Vec<Track>> {
    let rows = read_columns(path, &["track", "view", "x", "y", "sigma_px"], 4)?;
    let mut tracks: BTreeMap<String, Track> = BTreeMap::new();
    let mut order = Vec::new();
    for (line, row) in rows {
        let read = || {
            let name = row[1].clone().unwrap_or_default();
            let view = (views.iter().position(|view| view.name == name))
                .ok_or_else(|| Error::input(format!("line {line}: there is no view named `{name}`")))?;
            let at = |k: usize, fallback, positive| number(line, row[k].as_deref(), fallback, positive);
            Ok((view as u32, [at(2, 0.0, false)?, at(3, 0.0, false)?], at(4, sigma_px, true)?))
        };
        let sighting = read().map_err(|e: Error| e.in_context(path.display()))?;
        let track = row[0].clone().unwrap_or_default();
        if !tracks.contains_key(&track) {
            order.push(track.clone());
        }
        tracks.entry(track).or_default().push(sighting);
    }
    // One sighting alone says nothing.
    Ok((order.iter()).filter_map(|name| tracks.remove(name)).filter(|track| track.len() > 1).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "unit = \"m\"
sigma_px = 0.4
[[view]]
mask = \"a.png\"
K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
t = [0, 0, 5]
[[view]]
name = \"other\"
held_out = true
sigma_rotation_deg = 1
sigma_translation = 0.05
P = [[1200, 0, 320, 1600], [0, 1200, 240, 1200], [0, 0, 1, 5]]
";

    #[test]
    fn both_kinds_of_cameras_are_read() {
        let found = parse(GOOD, Path::new("folder")).unwrap();
        let [a, b] = &found.views[..] else { panic!("two views") };
        assert_eq!((a.name.as_str(), b.name.as_str(), found.unit), ("a", "other", Some(Unit::Metre)));
        assert_eq!(a.mask.as_deref(), Some(Path::new("folder/a.png")));
        let [p, q] = [a.camera.pinhole, b.camera.pinhole];
        let pairs = p.k.iter().flatten().chain(&p.t).zip(q.k.iter().flatten().chain(&q.t));
        assert!(pairs.map(|(x, y)| (x - y).abs()).all(|off| off < 1e-9));
        assert!(a.pose.is_none() && b.pose.is_some() && b.held_out && a.sigma_px == 0.4);
    }

    #[test]
    fn tracks_and_contours_come_from_beside_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        write("t.csv", "track,view,x,y\n7,a,1,2\n7,other,3,4\n8,a,5,6\n");
        write("c.csv", "x,y,sigma_px\n1,2,0.1\n");
        let text = GOOD
            .replace("sigma_px = 0.4", "tracks = \"t.csv\"")
            .replace("held_out = true", "contours = \"c.csv\"");
        let found = parse(&text, folder.path()).unwrap();
        assert_eq!(found.tracks, [vec![(0, [1.0, 2.0], 0.5), (1, [3.0, 4.0], 0.5)]]);
        assert_eq!(found.views[1].contours, [([1.0, 2.0], 0.1)]);
        write("c.csv", "x,y,contour\n1,2,0\n3,4,0\n5,6,1\n");
        let numbered = parse(&text, folder.path()).unwrap();
        assert_eq!(numbered.views[1].contour_starts, [0, 2]);
        assert_eq!(found.files.len(), 2);
        write("t.csv", "track,view,x,y\n7,elsewhere,1,2\n");
        let said = parse(&text, folder.path()).unwrap_err().to_string();
        assert!(said.contains("t.csv") && said.contains("line 2") && said.contains("elsewhere"), "{said}");
        write("t.csv", "track,view,x\n");
        assert!(parse(&text, folder.path()).unwrap_err().to_string().contains("track,view,x,y"));
    }

    #[test]
    fn mistakes_are_named() {
        let with = |from: &str, to: &str| {
            assert!(GOOD.contains(from), "{from}");
            parse(&GOOD.replacen(from, to, 1), Path::new("")).unwrap_err().to_string()
        };
        assert!(with("mask =", "maske =").contains("line 4"));
        assert!(with("t = [0, 0, 5]\n", "").contains("view `a`: needed K, R and t, or P alone"));
        assert!(with("\"other\"", "\"a\"").contains("two named `a`"));
        assert!(with("sigma_rotation_deg = 1", "sigma_rotation_deg = 0").contains("sigma_rotation_deg"));
        assert!(with("sigma_rotation_deg = 1\n", "").contains("or neither"));
        assert!(
            with("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nt", "[[1, 0, 0], [0, 2, 0], [0, 0, 1]]\nt")
                .contains("a rotation")
        );
    }
}
