//! Readings of contours in; contours as drawings out.
//!
//! | format | |
//! |---|---|
//! | CSV with a header | `x,y,heading_deg,range` and their σ, or points `x,y` with `sigma`; in |
//! | CSV in space | `x,y,z,azimuth_deg,elevation_deg,range` and their σ, or points `x,y,z` with `sigma`; in |
//! | CARMEN log | `FLASER` lines of planar lasers, in metres; in |
//! | JSON | contours with their covariance, as `planish contour` writes them; in |
//! | DXF | LINE, ARC, CIRCLE, ELLIPSE and LWPOLYLINE on layer VISIBLE; out |
//! | SVG | the contours with their readings; out |

mod carmen;
mod dxf;
mod json;
mod rays;
mod readings;
mod svg;

pub use carmen::CarmenOptions;
pub use dxf::write_contours_dxf;
pub use json::{ContourFile, read_contour_json};
pub use rays::{RAY_COLUMNS, read_ray_readings};
pub use readings::{COLUMNS, ContourReadings, SigmaDefaults, read_contour_readings};
pub use svg::{SizeLabel, contours_svg, write_contours_svg};

use planish_contour::planar::ContourKind;

/// A contour to draw.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnContour {
    /// Its kind.
    pub kind: ContourKind,
    /// Its parameters, angles in radians.
    pub theta: Vec<f64>,
    /// The part of an endless line that was seen, from one end to the other.
    pub seen: Option<[[f64; 2]; 2]>,
}
