//! Reads views of an object: cameras with pictures, masks, contours and tracked features.
//!
//! **Input.** `views.toml`.
//!
//! **Output.** [`Views`], with cameras from `K R t` or from a projection matrix.
//!
//! ```toml
//! unit = "mm"                     # unit of all lengths (optional)
//! mask_threshold = 40             # the object is brighter (default: middle of the range of the mask)
//! mask_least_share = 0.01       # removes specks and holes below this share of the pixels of the object
//! box = [[-60, -60, 0], [60, 60, 90]] # two corners of a box that contains the object: pixels of masks whose
//!                                 # line of sight misses it are background (optional)
//! sigma_px = 0.5                  # σ of the border of a mask, across it (default 0.5)
//! sigma_rotation_deg = 1.0        # σ of the pose about and along each axis (default: exact)
//! sigma_translation = 5.0
//! tracks = "tracks.csv"           # features: track,view,x,y[,sigma_px]; views by name
//!
//! [[view]]
//! name = "front"                  # default: file name of the mask or the image
//! image = "a.png"                 # for textures (optional)
//! mask = "a_mask.png"             # optional if nothing is fitted to the view
//! contours = "a.csv"              # points on contours inside the mask: x,y[,sigma_px][,contour]
//! held_out = false                # true: the view is not fitted, but used to check the fit
//! K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
//! R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]   # X_camera = R X + t: x right, y down, pixel centres at integers
//! t = [0, 0, 500]
//!
//! [[view]]
//! mask = "b_mask.png"
//! P = [[1200, 0, 320, 0], [0, 1200, 240, 0], [0, 0, 1, 500]]
//! ```
//!
//! `mask_threshold`, `mask_least_share`, `sigma_px`, `sigma_rotation_deg` and `sigma_translation` can also be
//! set in a view, and then apply to it alone. Paths are relative to the file.
//!
//! **Limits.** Lenses are assumed to be free of distortion.

use crate::Unit;
use crate::calibration::table;
use crate::columns::{number, read_columns};
use crate::picture::read_brightness;
use crate::source::read_text;
use planish_core::{BoundingBox, DVec3};
use planish_estimate::{Error, Result};
use planish_sense::Image;
use planish_shell::{Camera, PoseNoise};
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Default σ of the border of a mask in pixels: masks are rounded to whole pixels. Too small a value makes
/// outlines outweigh points, too large a value ignores them.
const DEFAULT_SIGMA_PX: f64 = 0.5;

/// Maximum number of views. Each takes time in every step of a fit, and a picture; photogrammetry of an
/// object takes some hundred pictures.
pub const MAX_VIEWS: usize = 5000;

/// A view of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewFile {
    /// Unique name.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// σ of its pose; none for an exact pose.
    pub pose: Option<PoseNoise>,
    /// Path of the picture.
    pub image: Option<PathBuf>,
    /// Path of the mask.
    pub mask: Option<PathBuf>,
    /// Points on contours inside the mask: pixel and σ.
    pub contours: Vec<([f64; 2], f64)>,
    /// Indices into `contours` at which a contour starts: there the column `contour` changes.
    pub contour_starts: Vec<usize>,
    /// Brightness above which a pixel of the mask belongs to the object.
    pub mask_threshold: Option<f64>,
    /// Maximum size of removed specks and holes, as a share of the pixels of the object.
    pub mask_min_share: Option<f64>,
    /// A box that contains the object. Pixels whose line of sight misses it are background.
    pub object_box: Option<BoundingBox>,
    /// σ of the border of the mask, in pixels.
    pub sigma_px: f64,
    /// True if the view is used only to check the fit.
    pub held_out: bool,
}

impl ViewFile {
    /// Reads the mask, if there is one. Pixels whose line of sight misses the box of the object get the
    /// minimum value.
    ///
    /// # Errors
    /// As [`read_brightness`].
    pub fn read_mask(&self) -> Result<Option<Image>> {
        let Some(path) = &self.mask else { return Ok(None) };
        let mut picture = read_brightness(path)?;
        if let Some(bounds) = &self.object_box {
            let lowest = picture.values.iter().copied().fold(f32::INFINITY, f32::min);
            let center = self.camera.center();
            for (k, value) in picture.values.iter_mut().enumerate() {
                let pixel = [k % picture.columns, k / picture.columns].map(|x| x as f64);
                if !meets_box(center, self.camera.direction(pixel), bounds) {
                    *value = lowest;
                }
            }
        }
        Ok(Some(picture))
    }
}

/// True if a ray meets a box: the intervals within its three slabs overlap (T. Kay, J. Kajiya, *Ray tracing
/// complex scenes*, SIGGRAPH 1986).
fn meets_box(from: DVec3, direction: DVec3, bounds: &BoundingBox) -> bool {
    let (mut near, mut far) = (0.0_f64, f64::INFINITY);
    for k in 0..3 {
        let ends = [bounds.min[k], bounds.max[k]].map(|x| (x - from[k]) / direction[k]);
        // A ray within the plane of a side gives NaN, which `min` and `max` ignore.
        near = near.max(ends[0].min(ends[1]));
        far = far.min(ends[0].max(ends[1]));
    }
    near <= far
}

/// A feature that is visible in several views: index of the view, pixel and σ.
pub type Track = Vec<(u32, [f64; 2], f64)>;

/// Content of a file of views.
#[derive(Debug, Clone, PartialEq)]
pub struct Views {
    /// The views.
    pub views: Vec<ViewFile>,
    /// Tracked features.
    pub tracks: Vec<Track>,
    /// The unit of lengths, if stated.
    pub unit: Option<Unit>,
    /// Files of contours and tracks that were read.
    pub files: Vec<PathBuf>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    unit: Option<String>,
    mask_threshold: Option<f64>,
    #[serde(rename = "mask_least_share")]
    mask_min_share: Option<f64>,
    #[serde(rename = "box")]
    object_box: Option<[[f64; 3]; 2]>,
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
    #[serde(rename = "mask_least_share")]
    mask_min_share: Option<f64>,
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

/// Reads views with their contours and tracks; pictures are not opened.
///
/// # Errors
/// `Io` if a file cannot be read; `Input` for unknown keys, more than [`MAX_VIEWS`] views, invalid cameras, σ
/// that are not positive, two views of one name, and tracks of unknown views: with file and line or view.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("views.toml");
/// std::fs::write(&path, "[[view]]\nmask = \"front.png\"\nK = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]\n\
///     R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nt = [0, 0, 500]\n")?;
/// let view = &planish_exchange::views::read_views(&path)?.views[0];
/// assert_eq!((view.name.as_str(), view.sigma_px), ("front", 0.5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_views(path: &Path) -> Result<Views> {
    let read = || parse(&read_text(path)?, path.parent().unwrap_or(Path::new("")));
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str, folder: &Path) -> Result<Views> {
    let t: Table = table(
        text,
        "expected [[view]] with K, R and t, or P, and optionally name, image, mask, contours and held_out; \
         mask_threshold, mask_least_share, box, sigma_px, sigma_rotation_deg, sigma_translation, tracks and \
         unit are optional",
    )?;
    // Before the files of contours are read.
    if t.view.len() > MAX_VIEWS {
        return Err(Error::input(format!("expected at most {MAX_VIEWS} views, found {}", t.view.len())));
    }
    let object_box = t.object_box.map(box_of).transpose()?;
    let mut files = Vec::new();
    let mut views: Vec<ViewFile> = Vec::new();
    let mut names: HashSet<String> = HashSet::new();
    for (index, view) in t.view.iter().enumerate() {
        let stem = view.mask.as_ref().or(view.image.as_ref()).and_then(|path| path.file_stem());
        let name = match (&view.name, stem) {
            (Some(name), _) => name.clone(),
            (None, Some(stem)) => stem.to_string_lossy().into_owned(),
            (None, None) => format!("view{}", index + 1),
        };
        // Tracks refer to views by name.
        if !names.insert(name.clone()) {
            return Err(Error::input(format!("expected views of different names, found two named `{name}`")));
        }
        // A closure, so that every error inside gets the name of the view.
        let read = || {
            // Both forms together could conflict.
            let camera = match (view.k, view.r, view.t, view.p) {
                (Some(k), Some(r), Some(t), None) => Camera::new(k, r, DVec3::from(t))?,
                (None, None, None, Some(p)) => Camera::from_projection(p)?,
                _ => return Err(Error::input("expected K, R and t, or P alone")),
            };
            let sigma_px = view.sigma_px.or(t.sigma_px).unwrap_or(DEFAULT_SIGMA_PX);
            let rotation = view.sigma_rotation_deg.or(t.sigma_rotation_deg);
            let translation = view.sigma_translation.or(t.sigma_translation);
            for (key, value) in [
                ("sigma_px", Some(sigma_px)),
                ("sigma_rotation_deg", rotation),
                ("sigma_translation", translation),
            ] {
                if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
                    return Err(Error::input(format!(
                        "expected a finite number above 0 for {key}, found {value}"
                    )));
                }
            }
            // With one of the two, the other would silently be exact.
            let pose = match (rotation, translation) {
                (None, None) => None,
                (Some(deg), Some(sigma_translation)) => {
                    Some(PoseNoise { sigma_rotation: deg.to_radians(), sigma_translation })
                }
                _ => {
                    return Err(Error::input(
                        "expected both sigma_rotation_deg and sigma_translation, or neither",
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
            mask_min_share: view.mask_min_share.or(t.mask_min_share),
            object_box,
            sigma_px,
            held_out: view.held_out,
        });
    }
    let mut tracks = Vec::new();
    if let Some(file) = &t.tracks {
        let file = folder.join(file);
        // A track joins several views, so only the σ that is stated for all views applies to it.
        tracks = read_tracks(&file, &views, t.sigma_px.unwrap_or(DEFAULT_SIGMA_PX))?;
        files.push(file);
    }
    Ok(Views { views, tracks, unit: t.unit.map(|name| name.parse()).transpose()?, files })
}

/// A box from two of its corners.
fn box_of(corners: [[f64; 3]; 2]) -> Result<BoundingBox> {
    let bounds: BoundingBox = corners.into_iter().map(DVec3::from).collect();
    let sides = bounds.max - bounds.min;
    match sides.is_finite() && sides.min_element() > 0.0 {
        true => Ok(bounds),
        false => Err(Error::input(format!(
            "expected opposite corners of a box with finite sides above 0, found {corners:?}"
        ))),
    }
}

/// Pixels with σ.
type Pixels = Vec<([f64; 2], f64)>;

/// Reads pixels with σ, and the indices at which the column `contour` changes (only 0 without that column).
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
    let places: HashMap<&str, u32> =
        (views.iter().zip(0..)).map(|(view, at)| (view.name.as_str(), at)).collect();
    let mut tracks: BTreeMap<String, Track> = BTreeMap::new();
    // Tracks keep the order of the file, which a map by name would change.
    let mut order = Vec::new();
    for (line, row) in rows {
        let read = || {
            let name = row[1].clone().unwrap_or_default();
            let view = *places.get(name.as_str()).ok_or_else(|| {
                Error::input(format!("line {line}: expected the name of a view, found `{name}`"))
            })?;
            let at = |k: usize, fallback, positive| number(line, row[k].as_deref(), fallback, positive);
            Ok((view, [at(2, 0.0, false)?, at(3, 0.0, false)?], at(4, sigma_px, true)?))
        };
        let sighting = read().map_err(|e: Error| e.in_context(path.display()))?;
        let track = row[0].clone().unwrap_or_default();
        if !tracks.contains_key(&track) {
            order.push(track.clone());
        }
        tracks.entry(track).or_default().push(sighting);
    }
    // A feature in one view gives no equation.
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
    fn cameras_are_read_from_k_r_t_and_from_p() {
        let found = parse(GOOD, Path::new("folder")).unwrap();
        let [a, b] = &found.views[..] else { panic!("two views") };
        assert_eq!((a.name.as_str(), b.name.as_str(), found.unit), ("a", "other", Some(Unit::Metre)));
        assert_eq!(a.mask.as_deref(), Some(Path::new("folder/a.png")));
        let [p, q] = [a.camera.pinhole, b.camera.pinhole];
        let pairs = p.k.iter().flatten().chain(p.t.as_ref()).zip(q.k.iter().flatten().chain(q.t.as_ref()));
        assert!(pairs.map(|(x, y)| (x - y).abs()).all(|off| off < 1e-9));
        assert!(a.pose.is_none() && b.pose.is_some() && b.held_out && a.sigma_px == 0.4);
    }

    #[test]
    fn tracks_and_contours_are_read_from_their_files() {
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
        let error = parse(&text, folder.path()).unwrap_err().to_string();
        assert!(
            error.contains("t.csv") && error.contains("line 2") && error.contains("elsewhere"),
            "{error}"
        );
        write("t.csv", "track,view,x\n");
        assert!(parse(&text, folder.path()).unwrap_err().to_string().contains("track,view,x,y"));
    }

    #[test]
    fn errors_name_line_or_view() {
        let with = |from: &str, to: &str| {
            assert!(GOOD.contains(from), "{from}");
            parse(&GOOD.replacen(from, to, 1), Path::new("")).unwrap_err().to_string()
        };
        assert!(with("mask =", "maske =").contains("line 4"));
        let many: String = (0..=MAX_VIEWS).map(|k| format!("[[view]]\nname = \"{k}\"\n")).collect();
        let error = parse(&many, Path::new("")).unwrap_err().to_string();
        assert!(
            error.contains(&format!("expected at most {MAX_VIEWS} views, found {}", MAX_VIEWS + 1)),
            "{error}"
        );
        assert!(with("t = [0, 0, 5]\n", "").contains("view `a`: expected K, R and t, or P alone"));
        assert!(with("\"other\"", "\"a\"").contains("two named `a`"));
        assert!(with("sigma_rotation_deg = 1", "sigma_rotation_deg = 0").contains("sigma_rotation_deg"));
        assert!(with("sigma_rotation_deg = 1\n", "").contains("or neither"));
        assert!(
            with("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nt", "[[1, 0, 0], [0, 2, 0], [0, 0, 1]]\nt")
                .contains("a rotation")
        );
    }
}
