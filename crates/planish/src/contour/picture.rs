//! The edges of a picture as readings of contours.

use super::parts::Part;
use planish_contour::planar::{ContourReading, ContourTarget};
use planish_estimate::Result;
use planish_exchange::contours::ContourReadings;
use planish_exchange::{extension, picture::read_brightness};
use planish_sense::{EdgeOptions, edge_points};
use std::f64::consts::TAU;
use std::path::Path;

pub(super) fn is_picture(path: &Path) -> bool {
    ["png", "jpg", "jpeg"].contains(&extension(path).as_str())
}

/// Edges of a picture as readings.
pub(super) struct Edges {
    pub(super) readings: ContourReadings,
    pub(super) sampling: Sampling,
}

/// How the pixels of a picture displace its edges.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sampling {
    /// Axis along which each edge was located: 0 for x, 1 for y.
    axes: Vec<usize>,
    pixel: f64,
    /// σ of the displacement that a side along the rows shares, in pixels; zero for pixels that average over
    /// their area.
    sigma_px: f64,
}

/// Points on the edges of a picture taken perpendicular to the object. A pixel has the side `pixel`. x is to
/// the right and y upwards from the centre of the lower left pixel.
///
/// # Errors
/// Those of the picture's reader and of [`edge_points`].
pub(super) fn edges_of(path: &Path, pixel: f64) -> Result<Edges> {
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
    let sampling = Sampling {
        axes: points.iter().map(|point| point.axis).collect(),
        pixel,
        sigma_px: points.first().map_or(0.0, |point| point.sampling_px),
    };
    Ok(Edges {
        readings: ContourReadings { sightings: sightings.collect(), ..ContourReadings::default() },
        sampling,
    })
}

impl Sampling {
    /// Number of samples per pixel and axis, if so few that they displace edges.
    pub(super) fn samples(&self) -> Option<usize> {
        (self.sigma_px > 0.0).then(|| (1.0 / (12f64.sqrt() * self.sigma_px)).round() as usize)
    }

    /// Adds the covariance of displaced sides to a part.
    ///
    /// With samples `1/n` pixel apart, an edge at `x` is displaced by about `A cos(2π n x + ψ)` along its
    /// axis, with the same unknown phase `ψ` along a side. Sides along the rows have one `x` and one
    /// displacement; across the rows of an inclined side, displacements cancel. Each side has a phase of
    /// its own.
    pub(super) fn add_to(&self, part: &mut Part, sightings: &[ContourReading]) {
        let Some(samples) = self.samples() else { return };
        let readings: Vec<ContourReading> = part.members.iter().map(|&i| sightings[i]).collect();
        let feet = part.choice.fit.feet(&readings);
        let key = |k: usize| {
            let foot = feet[k]?;
            let axis = self.axes[part.members[k]];
            Some((foot.piece, axis, foot.normal[axis] > 0.0))
        };
        let mut sides: Vec<(usize, usize, bool)> = (0..readings.len()).filter_map(key).collect();
        sides.sort_unstable();
        sides.dedup();
        let amplitude = self.pixel * self.sigma_px;
        let mut modes = Vec::new();
        for side in sides {
            for wave in [f64::cos, f64::sin] {
                let displacement = |k: usize| {
                    let mut by = [0.0; 2];
                    if let (Some(foot), true) = (feet[k], key(k) == Some(side)) {
                        let phase = TAU * samples as f64 * foot.position[side.1] / self.pixel;
                        by[side.1] = amplitude * wave(phase);
                    }
                    by
                };
                modes.push((0..readings.len()).map(displacement).collect());
            }
        }
        let added = part.choice.fit.covariance_of_modes(&readings, &modes);
        part.choice.fit.covariance += added;
    }
}
