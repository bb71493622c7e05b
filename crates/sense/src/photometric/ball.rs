//! Directions of lights from images of a mirror ball.

use crate::Image;
use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// Directions towards the lights from images of a mirror ball: `l = 2 (n·v) n − v`, with the ball's normal n
/// at the highlight and v towards the camera.
///
/// The ball is the disc with the area and the centroid of the mask, in parallel projection. A highlight is
/// the centroid of the pixels above 95 % of the maximum.
///
/// # Errors
/// `Input` for images whose size differs from the mask; `Undetermined` for a mask below 100 pixels, and an
/// image without a highlight on the ball.
pub fn lights_from_ball(images: &[Image], mask: &Image) -> Result<Vec<DVec3>> {
    let half = 0.5 * mask.values.iter().copied().fold(0.0_f32, f32::max);
    let inside: Vec<usize> = (0..mask.values.len()).filter(|k| mask.values[*k] > half).collect();
    if inside.len() < 100 {
        return Err(Error::undetermined(format!(
            "expected a ball of 100 pixels or more, found {}",
            inside.len()
        )));
    }
    let place = |k: usize| [(k % mask.columns) as f64, (k / mask.columns) as f64];
    let middle = |pixels: &mut dyn Iterator<Item = (usize, f64)>| {
        let mut sums = DVec3::ZERO;
        for (k, w) in pixels {
            let [x, y] = place(k);
            sums = DVec3::new(sums[0] + w * x, sums[1] + w * y, sums[2] + w);
        }
        [sums[0] / sums[2], sums[1] / sums[2]]
    };
    let centre = middle(&mut inside.iter().map(|k| (*k, 1.0)));
    // From the area: more accurate than from the extreme pixels of the mask.
    let radius = (inside.len() as f64 / std::f64::consts::PI).sqrt();
    let light = |(number, image): (usize, &Image)| {
        if (image.columns, image.rows) != (mask.columns, mask.rows) {
            return Err(Error::input(format!(
                "image {number} of the ball: expected {} × {} pixels like its mask, found {} × {}",
                mask.columns, mask.rows, image.columns, image.rows
            )));
        }
        let maximum = inside.iter().map(|k| image.values[*k]).fold(0.0_f32, f32::max);
        // The centroid of a saturated highlight; its brightest pixel is arbitrary.
        let bright = inside.iter().copied().filter(|k| image.values[*k] > 0.95 * maximum);
        let spot = middle(&mut bright.map(|k| (k, f64::from(image.values[k]))));
        let (x, y) = ((spot[0] - centre[0]) / radius, (spot[1] - centre[1]) / radius);
        let square = x * x + y * y;
        if !(maximum > 0.0 && square < 1.0) {
            return Err(Error::undetermined(format!(
                "image {number} of the ball: expected a highlight, found none"
            )));
        }
        let n = DVec3::new(x, y, -(1.0 - square).sqrt());
        // v = (0, 0, −1).
        let along = -2.0 * n.z;
        Ok(DVec3::new(along * n.x, along * n.y, along * n.z + 1.0))
    };
    images.iter().enumerate().map(light).collect()
}
