//! The edges of a picture as readings of contours.

use planish_contour::planar::{ContourReading, ContourTarget};
use planish_estimate::Result;
use planish_exchange::contours::ContourReadings;
use planish_exchange::{extension, picture::read_brightness};
use planish_sense::{EdgeOptions, edge_points};
use std::path::Path;

pub(super) fn is_picture(path: &Path) -> bool {
    ["png", "jpg", "jpeg"].contains(&extension(path).as_str())
}

/// Points on the edges of a picture taken perpendicular to the object. A pixel has the side `pixel`. x is to
/// the right and y upwards from the centre of the lower left pixel.
///
/// # Errors
/// Those of the picture's reader and of [`edge_points`].
pub(super) fn edges_of(path: &Path, pixel: f64) -> Result<ContourReadings> {
    let image = read_brightness(path)?;
    let points = edge_points(&image, &EdgeOptions::default()).map_err(|e| e.in_context(path.display()))?;
    // Images count rows from the top; y of contours points upwards.
    let lowest = (image.rows - 1) as f64;
    let sightings = points.iter().enumerate().map(|(k, point)| ContourReading {
        target: ContourTarget::Point {
            position: [pixel * point.position[0], pixel * (lowest - point.position[1])],
            sigma: pixel * point.sigma_px,
        },
        pose: None,
        time_s: 0.0,
        // Edge points have no line in a file, so messages name them by their number.
        line: k + 1,
    });
    Ok(ContourReadings { sightings: sightings.collect(), ..ContourReadings::default() })
}
