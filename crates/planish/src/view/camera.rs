//! Cameras: view directions by angles or names, and the projection onto a picture.

use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, Projected};
use std::str::FromStr;

/// Distance of the camera from the centre of an object, relative to the diagonal of its box. Larger values
/// lose the impression of depth; smaller ones distort the object.
const DISTANCE: f64 = 2.6;
/// Azimuth and elevation of `iso`, in degrees: equal angles with all three axes.
const ISO_DEG: [f64; 2] = [45.0, 35.264_389_682_754_654];

/// Largest accepted azimuth, in degrees: ten turns. A larger one is a typing error.
const MAX_TURN_DEG: f64 = 3600.0;

/// A direction along an axis that is up in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Up {
    axis: usize,
    sign: f64,
}

impl Default for Up {
    fn default() -> Self {
        Self { axis: 2, sign: 1.0 }
    }
}

impl FromStr for Up {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        // Also the minus sign of typography, which text copied from documents may have.
        let (sign, name) = match text.strip_prefix(['-', '−']) {
            Some(name) => (-1.0, name),
            None => (1.0, text),
        };
        match ["x", "y", "z"].iter().position(|axis| *axis == name) {
            Some(axis) => Ok(Self { axis, sign }),
            None => Err(format!("expected an axis: x, y, z, -x, -y or -z; found {text:?}")),
        }
    }
}

impl Up {
    /// The direction.
    #[must_use]
    pub fn direction(self) -> DVec3 {
        let mut up = DVec3::ZERO;
        up[self.axis] = self.sign;
        up
    }

    /// The right-hand direction in the front view: x, or y if x is up.
    fn right(self) -> DVec3 {
        // x cannot point both up and to the right.
        if self.axis == 0 { DVec3::Y } else { DVec3::X }
    }
}

/// A view direction by angles, with a zoom factor.
///
/// Azimuth 0 is the view from the front: from −y if z is up, from z if y is up. It grows to the right: 90 is
/// the view from the right side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraAngles {
    /// Angle about the up axis, in degrees.
    pub azimuth_deg: f64,
    /// Above the level of the object, in degrees from −90 to 90.
    pub elevation_deg: f64,
    /// Magnification relative to the view in which the object just fits.
    pub zoom: f64,
}

impl FromStr for CameraAngles {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        const NEEDED: &str = "expected AZIMUTH,ELEVATION in degrees, optionally followed by ,ZOOM (30,20 \
            or 30,20,1.5), or front, back, left, right, top, bottom or iso";
        let named = |[azimuth_deg, elevation_deg]: [f64; 2]| Self { azimuth_deg, elevation_deg, zoom: 1.0 };
        let (name, zoom) = match text.split_once(',') {
            // `top,1.5` is a name with a zoom; `30,20` are two angles.
            Some((name, zoom)) if name.parse::<f64>().is_err() => (name, Some(zoom)),
            _ => (text, None),
        };
        let mut found = match name {
            "front" => named([0.0, 0.0]),
            "right" => named([90.0, 0.0]),
            "back" => named([180.0, 0.0]),
            "left" => named([-90.0, 0.0]),
            "top" => named([0.0, 90.0]),
            "bottom" => named([0.0, -90.0]),
            "iso" => named(ISO_DEG),
            _ => {
                let numbers: std::result::Result<Vec<f64>, _> =
                    text.split(',').map(|n| n.trim().parse()).collect();
                match numbers.as_deref() {
                    Ok(&[azimuth, elevation]) => named([azimuth, elevation]),
                    Ok(&[azimuth, elevation, zoom]) => Self { zoom, ..named([azimuth, elevation]) },
                    _ => return Err(format!("{NEEDED}; found {text:?}")),
                }
            }
        };
        if let Some(zoom) = zoom {
            found.zoom = zoom.trim().parse().map_err(|_| format!("{NEEDED}; found {text:?}"))?;
        }
        // `contains` also refuses NaN, which a comparison with `>` would accept.
        if !(-MAX_TURN_DEG..=MAX_TURN_DEG).contains(&found.azimuth_deg) {
            return Err(format!("expected an azimuth from -3600 to 3600 degrees; found {text:?}"));
        }
        if !(-90.0..=90.0).contains(&found.elevation_deg) {
            return Err(format!("expected an elevation from -90 to 90 degrees; found {text:?}"));
        }
        if !(0.01..=1000.0).contains(&found.zoom) {
            return Err(format!("expected a zoom from 0.01 to 1000; found {text:?}"));
        }
        Ok(found)
    }
}

/// The directions of a picture: to the right, up, and from the object to the camera.
pub(crate) type Axes = [DVec3; 3];

/// Axes of a camera at the given angles.
pub(super) fn axes_at(angles: &CameraAngles, up: Up) -> Axes {
    let (upwards, across) = (up.direction(), up.right());
    let front = across.cross(upwards);
    let [azimuth, elevation] = [angles.azimuth_deg, angles.elevation_deg].map(f64::to_radians);
    // From angles and not from a cross product with `up`, which vanishes in views from above.
    let level = azimuth.sin() * across + azimuth.cos() * front;
    let from = elevation.cos() * level + elevation.sin() * upwards;
    let right = azimuth.cos() * across + -azimuth.sin() * front;
    [right, from.cross(right), from]
}

/// The axes of a camera that looks from this direction.
pub(super) fn axes_from(from: DVec3, up: DVec3) -> Result<Axes> {
    let found = from.try_normalize().and_then(|from| Some((from, up.cross(from).try_normalize()?)));
    let (from, right) =
        found.ok_or_else(|| Error::input("expected a camera that does not look along the up direction"))?;
    Ok([right, from.cross(right), from])
}

/// Area of the picture for the object, from the left and the top, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub low: [f64; 2],
    pub high: [f64; 2],
}

/// A pinhole camera.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Camera {
    /// Its place.
    pub at: DVec3,
    /// The directions of the picture.
    pub axes: Axes,
    /// Pixels over tangents.
    pub focal: f64,
    /// Column and row of the optical axis.
    pub middle: [f64; 2],
    /// Diagonal of the object's box.
    pub diagonal: f64,
}

impl Camera {
    /// A camera that sees all points within a frame; a zoom enlarges them about its middle.
    pub(super) fn from_points(points: &[DVec3], axes: Axes, frame: Frame, zoom: f64) -> Result<Self> {
        let bounds = BoundingBox::from_points(points)
            .ok_or_else(|| Error::input("expected an object with an extent, found nothing to draw"))?;
        // A single point has no size, but must not give NaN.
        let diagonal = bounds.diagonal().max(f64::MIN_POSITIVE);
        let mut camera = Self {
            at: bounds.center() + DISTANCE * diagonal * axes[2],
            axes,
            focal: 1.0,
            middle: [0.0; 2],
            diagonal,
        };
        let seen: BoundingBox<[f64; 2]> = points.iter().map(|p| camera.project(*p).at).collect();
        let BoundingBox { min: low, max: high } = seen;
        // The distance is fixed and the focal length follows, so the perspective is the same for all objects.
        let room = |k: usize| (frame.high[k] - frame.low[k]).max(1.0) / (high[k] - low[k]).max(1e-12);
        camera.focal = zoom * room(0).min(room(1));
        camera.middle =
            [0, 1].map(|k| 0.5 * (frame.low[k] + frame.high[k]) - camera.focal * 0.5 * (low[k] + high[k]));
        Ok(camera)
    }

    /// Column and row, from the left and the top, and the distance along the camera's axis.
    pub(crate) fn project(&self, p: DVec3) -> Projected {
        let off = p - self.at;
        let depth = -off.dot(self.axes[2]);
        Projected {
            at: [
                self.middle[0] + self.focal * off.dot(self.axes[0]) / depth,
                self.middle[1] - self.focal * off.dot(self.axes[1]) / depth,
            ],
            depth,
        }
    }

    /// A place of the picture at a depth: to the right, up, and towards the camera, from the camera.
    pub(super) fn place(&self, [column, row]: [f64; 2], depth: f64) -> DVec3 {
        DVec3::new(
            (column - self.middle[0]) / self.focal * depth,
            -(row - self.middle[1]) / self.focal * depth,
            -depth,
        )
    }

    /// A direction of the world in the picture's axes.
    pub(super) fn turned(&self, direction: DVec3) -> DVec3 {
        DVec3::from(self.axes.map(|axis| axis.dot(direction)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: DVec3, b: DVec3) {
        assert!((a - b).length() < 1e-12, "{a:?} {b:?}");
    }

    #[test]
    fn named_views_have_their_directions() {
        let z = Up::default();
        let axes = |text: &str, up: Up| axes_at(&text.parse().unwrap(), up);
        close(axes("front", z)[2], DVec3::new(0.0, -1.0, 0.0));
        close(axes("right", z)[2], DVec3::X);
        close(axes("left", z)[2], DVec3::new(-1.0, 0.0, 0.0));
        close(axes("back", z)[2], DVec3::Y);
        close(axes("top", z)[2], DVec3::Z);
        // In the view from above, the back of the object is at the top.
        close(axes("top", z)[1], DVec3::Y);
        close(axes("bottom", z)[1], DVec3::new(0.0, -1.0, 0.0));
        close(axes("iso", z)[2], DVec3::new(1.0, -1.0, 1.0).map(|c: f64| c / 3.0_f64.sqrt()));
        let y: Up = "y".parse().unwrap();
        close(axes("front", y)[2], DVec3::Z);
        close(axes("right", y)[2], DVec3::X);
        for up in ["x", "-x", "y", "-y", "z", "-z"] {
            let [right, upwards, from] = axes("0,0", up.parse().unwrap());
            close(right.cross(upwards), from);
            close(upwards, up.parse::<Up>().unwrap().direction());
        }
    }

    #[test]
    fn cameras_are_parsed_or_rejected_with_the_expected_form() {
        let read = |text: &str| text.parse::<CameraAngles>();
        assert_eq!(read("-30,20,2").unwrap().zoom, 2.0);
        assert_eq!(read("top,1.5").unwrap(), CameraAngles { zoom: 1.5, ..read("top").unwrap() });
        for (text, words) in [
            ("side", "front, back"),
            ("1", "AZIMUTH,ELEVATION"),
            ("0,91", "-90 to 90"),
            ("0,0,0", "zoom from"),
            ("nan,0", "azimuth from"),
            ("1e99,0", "azimuth from"),
            ("iso,big", "ZOOM"),
        ] {
            let e = read(text).unwrap_err();
            assert!(e.contains(words), "{text}: {e}");
        }
        assert!("w".parse::<Up>().is_err());
    }

    #[test]
    fn the_object_is_completely_within_the_frame() {
        let points: Vec<DVec3> = (0..8)
            .map(|k| [k & 1, k >> 1 & 1, k >> 2].map(f64::from))
            .map(|[x, y, z]| DVec3::new(5.0 * x + 100.0, y, 3.0 * z))
            .collect();
        let frame = Frame { low: [10.0, 20.0], high: [200.0, 120.0] };
        let angles: CameraAngles = "25,15".parse().unwrap();
        let camera = Camera::from_points(&points, axes_at(&angles, Up::default()), frame, 1.0).unwrap();
        let at: Vec<[f64; 2]> = points.iter().map(|p| camera.project(*p).at).collect();
        let reach = |k: usize| {
            let values = at.iter().map(|a| a[k]);
            [values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max)]
        };
        let [columns, rows] = [reach(0), reach(1)];
        assert!(columns[0] >= 10.0 - 1e-9 && columns[1] <= 200.0 + 1e-9);
        assert!(rows[0] >= 20.0 - 1e-9 && rows[1] <= 120.0 + 1e-9);
        // One of the two directions is filled, and the object is in the middle of both.
        assert!((columns[1] - columns[0] - 190.0).abs() < 1e-6 || (rows[1] - rows[0] - 100.0).abs() < 1e-6);
        assert!((columns[0] + columns[1] - 210.0).abs() < 1e-6 && (rows[0] + rows[1] - 140.0).abs() < 1e-6);
        // Places are the inverse of projections.
        let seen = camera.project(points[3]);
        let expected = points[3] - camera.at;
        close(camera.place(seen.at, seen.depth), camera.turned(expected));
    }
}
