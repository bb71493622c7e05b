//! Reads measurements of contours, and writes contours as drawings.
//!
//! | format | |
//! |---|---|
//! | CSV with a header | read: `x,y,heading_deg,range` and their σ, or points `x,y` with `sigma` |
//! | CSV in space | read: `x,y,z,azimuth_deg,elevation_deg,range` and σ, or points `x,y,z` with `sigma` |
//! | CARMEN log | read: `FLASER` lines of planar lasers, in metres |
//! | JSON | read: contours with their covariance, as `planish contour` writes them |
//! | DXF | written: LINE, CIRCLE, ELLIPSE and LWPOLYLINE on layer VISIBLE |
//! | SVG | written: the contours with their readings |

mod carmen;
mod dxf;
mod json;
mod rays;
mod readings;
mod svg;

pub use carmen::{CarmenOptions, DEFAULT_SIGMA_RANGE};
pub use dxf::write_contours_dxf;
pub use json::{ContourFile, read_contour_json};
pub use rays::{RAY_COLUMNS, read_ray_readings};
pub use readings::{COLUMNS, ContourReadings, SigmaDefaults, read_contour_readings};
pub use svg::{SizeLabel, contours_svg, write_contours_svg};

use planish_contour::planar::ContourKind;

/// A contour to draw.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnContour {
    /// Kind of the contour.
    pub kind: ContourKind,
    /// Parameters, with angles in radians.
    pub theta: Vec<f64>,
    /// Ends of the observed part of an infinite line.
    pub seen: Option<[[f64; 2]; 2]>,
}
