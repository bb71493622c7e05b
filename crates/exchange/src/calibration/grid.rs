//! Calibration of a camera and a projector of crossed stripes.
//!
//! ```toml
//! unit = "mm"                 # unit of lengths: mm, m, in or ft (optional)
//! sigma_px = 0.02             # σ of the calibration in either image (default 0.02)
//!
//! [camera]                    # x ~ K (R X + t): x right, y down, pixel centres at integers
//! K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
//! R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]   # optional with t: default is the frame of the world
//! t = [0, 0, 0]
//!
//! [projector]                 # modelled as a camera whose rays leave it
//! K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
//! R = [[0.96, 0, 0.28], [0, 1, 0], [-0.28, 0, 0.96]]
//! t = [-150, 0, 20]
//!
//! [stripes]                   # in the image of the projector
//! directions_deg = [30, 120]  # directions of both sets, from x to y
//! spacing = 20.0              # distance of neighbouring stripes in pixels
//! origin = [320, 240]         # crossing of stripes 0 of both sets
//! range = [[-20, 20], [-20, 20]]   # first and last stripe of both sets
//! ```

use planish_core::DVec3;
use std::path::Path;

use planish_core::Pinhole;
use planish_core::matrix3::IDENTITY;
use planish_estimate::{Error, Result};
use planish_sense::stripes::{GridCamera, StripePattern};
use serde::Deserialize;

use super::{check_numbers, table};
use crate::Unit;
use crate::source::read_text;

/// Default σ of a calibration in pixels: typical of a good calibration of a real camera. A smaller value
/// states points as more accurate than their calibration allows.
const DEFAULT_SIGMA_PX: f64 = 0.02;
/// Tolerance of the orthonormality of a rotation: accepts numbers written with seven digits.
const ROTATION_TOLERANCE: f64 = 1e-6;

/// A calibrated camera with its projector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridCalibration {
    /// Camera, projector and pattern.
    pub grid: GridCamera,
    /// The unit of lengths, if stated.
    pub unit: Option<Unit>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    unit: Option<String>,
    sigma_px: Option<f64>,
    camera: View,
    projector: View,
    stripes: Stripes,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct View {
    #[serde(rename = "K")]
    pub(super) k: [[f64; 3]; 3],
    #[serde(rename = "R")]
    pub(super) r: Option<[[f64; 3]; 3]>,
    pub(super) t: Option<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stripes {
    directions_deg: [f64; 2],
    spacing: f64,
    origin: [f64; 2],
    range: [[i32; 2]; 2],
}

/// Reads the calibration of a camera and a projector of crossed stripes.
///
/// # Errors
/// As [`read_calibration`](super::read_calibration).
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("stripes.toml");
/// std::fs::write(&path, "
/// [camera]
/// K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
/// [projector]
/// K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
/// R = [[0.96, 0, 0.28], [0, 1, 0], [-0.28, 0, 0.96]]
/// t = [-150, 0, 20]
/// [stripes]
/// directions_deg = [30, 120]
/// spacing = 20.0
/// origin = [320, 240]
/// range = [[-20, 20], [-20, 20]]
/// ")?;
/// let grid = planish_exchange::calibration::read_grid_calibration(&path)?.grid;
/// assert_eq!((grid.sigma_px, grid.pattern.spacing), (0.02, 20.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_grid_calibration(path: &Path) -> Result<GridCalibration> {
    let read = || parse(&read_text(path)?);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<GridCalibration> {
    let t: Table = table(
        text,
        "expected [camera] and [projector] with K (and R and t), and [stripes] with directions_deg, spacing, \
         origin and range, and optionally sigma_px and unit",
    )?;
    let sigma_px = t.sigma_px.unwrap_or(DEFAULT_SIGMA_PX);
    check_numbers(&[("sigma_px", sigma_px, sigma_px > 0.0, "a finite number above 0")])?;
    // Bounds the number of crossings.
    if t.stripes.range.iter().flatten().any(|k| k.unsigned_abs() > 1 << 10) {
        return Err(Error::input(format!(
            "expected stripes numbered from -1024 to 1024 in stripes.range, found {:?}",
            t.stripes.range
        )));
    }
    let grid = GridCamera {
        camera: pinhole("camera", &t.camera)?,
        projector: pinhole("projector", &t.projector)?,
        pattern: StripePattern {
            directions_rad: t.stripes.directions_deg.map(f64::to_radians),
            spacing: t.stripes.spacing,
            origin: t.stripes.origin,
            range: t.stripes.range,
        },
        sigma_px,
    };
    grid.pattern.sanity_check().map_err(|e| e.in_context("stripes"))?;
    Ok(GridCalibration { grid, unit: t.unit.map(|name| name.parse()).transpose()? })
}

pub(super) fn pinhole(name: &str, view: &View) -> Result<Pinhole> {
    let made =
        Pinhole { k: view.k, r: view.r.unwrap_or(IDENTITY), t: DVec3::from(view.t.unwrap_or([0.0; 3])) };
    let finite = made.k.iter().chain(&made.r).flatten().chain(made.t.as_ref()).all(|c| c.is_finite());
    let [x, y, z] = made.k;
    if !(finite && x[0] > 0.0 && y[1] > 0.0) || y[0] != 0.0 || z != [0.0, 0.0, 1.0] {
        return Err(Error::input(format!(
            "expected {name}.K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with focal lengths above 0, and \
             finite R and t, found K = {:?}",
            made.k
        )));
    }
    // Orthonormal rows and a third row that is the cross product: a mirror is rejected.
    let [a, b, c] = made.r;
    let [a, b, c] = [a, b, c].map(DVec3::from_array);
    // Unit rows, one right angle and the determinant: together they leave only c = a × b.
    let off = [
        a.length_squared() - 1.0,
        b.length_squared() - 1.0,
        a.dot(b),
        a.cross(b).dot(c) - 1.0,
        c.length_squared() - 1.0,
    ];
    match off.iter().find(|o| o.abs() > ROTATION_TOLERANCE) {
        Some(_) => Err(Error::input(format!("expected a rotation in {name}.R, found {:?}", made.r))),
        None => Ok(made),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "unit = \"mm\"
[camera]
K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
[projector]
K = [[1100, 0, 310], [0, 1100, 230], [0, 0, 1]]
R = [[0.96, 0, 0.28], [0, 1, 0], [-0.28, 0, 0.96]]
t = [-150, 0, 20]
[stripes]
directions_deg = [30, 120]
spacing = 20
origin = [320, 240]
range = [[-20, 20], [-15, 15]]
";

    #[test]
    fn missing_keys_have_defaults() {
        let found = parse(GOOD).unwrap();
        assert_eq!((found.unit, found.grid.sigma_px), (Some(Unit::Millimetre), 0.02));
        assert_eq!(found.grid.camera.center(), DVec3::ZERO);
        assert_eq!(found.grid.projector.t, DVec3::new(-150.0, 0.0, 20.0));
        assert!((found.grid.pattern.directions()[1][0] + 0.5).abs() < 1e-12);
    }

    #[test]
    fn errors_name_line_or_key() {
        let with = |from: &str, to: &str| {
            assert!(GOOD.contains(from), "{from}");
            parse(&GOOD.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert!(with("spacing", "spaceing").contains("line 10"));
        assert!(with("0.96, 0, 0.28", "1.96, 0, 0.28").contains("a rotation in projector.R"));
        assert!(with("[[1200, 0", "[[-1200, 0").contains("camera.K"));
        assert!(with("[30, 120]", "[30, 210]").contains("cross at 10°"));
        assert!(with("unit = \"mm\"", "sigma_px = 0").contains("above 0 for sigma_px"));
        assert!(with("[-15, 15]", "[-15, 1500]").contains("stripes.range"));
        assert!(with("[projector]", "[beamer]").contains("[projector] with K"));
    }
}
