//! Missing normals, their orientation, and the separation of the ground.

use super::Observations;
use super::intake::{MIN_POINTS, has_ground};
use crate::observe::{Quantity, RejectionCause};
use planish_core::{DVec3, Vec3};
use planish_estimate::{Error, Result};
use planish_mesh::BoundingBox;
use planish_sense::{
    Ground, GroundOptions, Scan, classify_ground, cloud_geometry, local_roughness, neighbour_noise,
    orient_normals,
};
use planish_spline::principal_axes;

/// Smallest mean number of points with the same coordinate that shows rounding.
const MIN_SHARING: usize = 4;
/// Relative deviation of gaps between coordinates from multiples of a step.
const ROUNDING: f64 = 0.01;

impl Observations {
    /// Estimates missing normals and rejects isolated points among them; with `orient`, normals of unknown
    /// side get a consistent orientation.
    ///
    /// Touches (`touched`, by sensor) are few and placed on purpose, so they are rejected only if they are
    /// isolated among touches, too.
    pub(super) fn complete_normals(
        &mut self,
        neighbours: usize,
        orient: bool,
        touched: impl Fn(usize) -> bool,
    ) -> Result<()> {
        if self.readings.oriented.iter().all(|&o| o) {
            return Ok(());
        }
        let unknown =
            |made: &Self, i: usize| !made.readings.oriented[i] && made.readings.normals[i] == Vec3::ZERO;
        if (0..self.len()).any(|i| unknown(self, i)) {
            // Among all scans: a point that is alone in its own scan may have neighbours in another.
            let cloud = cloud_geometry(&self.readings.points, neighbours)?;
            let touch = |i: usize| touched(self.channels[self.channel(i)].sensor);
            let mut dropped: Vec<bool> =
                (0..self.len()).map(|i| unknown(self, i) && cloud.isolated[i]).collect();
            if (0..self.len()).any(|i| dropped[i] && touch(i)) {
                let touches: Vec<usize> = (0..self.len()).filter(|&i| touch(i)).collect();
                let points: Vec<DVec3> = touches.iter().map(|&i| self.readings.points[i]).collect();
                let among_touches = match points.len() {
                    0..MIN_POINTS => vec![false; points.len()],
                    _ => cloud_geometry(&points, neighbours)?.isolated,
                };
                for (i, isolated) in touches.into_iter().zip(among_touches) {
                    dropped[i] &= isolated;
                }
            }
            for i in (0..self.len()).filter(|&i| !dropped[i]) {
                // Neighbours of a reading off the surface show no normal of its own.
                if unknown(self, i) && self.readings.on_surface[i] {
                    self.readings.normals[i] = cloud.normals[i].as_vec3();
                }
            }
            self.reject(&dropped, RejectionCause::Isolated);
        }
        if !orient {
            return Ok(());
        }
        // Normals of known side keep it, and pass it on to their neighbours.
        // Gross errors would pass on wrong sides, so only readings on the surface take part.
        let on: Vec<usize> = (0..self.len()).filter(|&i| self.readings.on_surface[i]).collect();
        if on.len() < 3 {
            return Ok(());
        }
        let points: Vec<DVec3> = on.iter().map(|&i| self.readings.points[i]).collect();
        let oriented: Vec<bool> = on.iter().map(|&i| self.readings.oriented[i]).collect();
        let mut normals: Vec<DVec3> = on.iter().map(|&i| self.normal(i)).collect();
        orient_normals(&points, &mut normals, &oriented, neighbours)?;
        for (&i, normal) in on.iter().zip(&normals) {
            self.readings.normals[i] = normal.as_vec3();
        }
        // The side of other readings stays open, so their normals select none.
        for i in 0..self.len() {
            if !self.readings.on_surface[i] && !self.readings.oriented[i] {
                self.readings.normals[i] = Vec3::ZERO;
            }
        }
        Ok(())
    }

    /// Rejects points above the ground or far below it, except in scans whose classes mark the ground.
    pub(super) fn keep_ground(&mut self, scans: &[&Scan], options: &GroundOptions) -> Result<()> {
        self.intake.ground = true;
        let mut found = classify_ground(&self.readings.points, options)?;
        let is_classified: Vec<bool> = scans.iter().map(|scan| has_ground(scan)).collect();
        for (what, &scan) in found.iter_mut().zip(&self.readings.scan) {
            if is_classified[scan as usize] {
                *what = Ground::Bare;
            }
        }
        let left = found.iter().filter(|&&what| what == Ground::Bare).count();
        if left < MIN_POINTS {
            return Err(Error::undetermined(format!(
                "expected at least {MIN_POINTS} readings on the ground, found {left} of {}",
                found.len()
            )));
        }
        // Two passes, so that each cause has its own count.
        let below: Vec<bool> = found.iter().map(|&what| what == Ground::Below).collect();
        self.reject(&below, RejectionCause::BelowGround);
        // `reject` has removed readings, and `found` must stay in step with those that are left.
        found.retain(|&what| what != Ground::Below);
        let above: Vec<bool> = found.iter().map(|&what| what == Ground::Above).collect();
        self.reject(&above, RejectionCause::AboveGround);
        Ok(())
    }

    /// Turns normals of unknown side to the upper side of the best plane, where the largest coordinate of its
    /// normal is positive.
    ///
    /// Normals that are steep against that plane are dropped: where readings are few or lie in rows, planes
    /// of neighbours can be vertical without any vertical surface.
    pub(super) fn turn_upwards(&mut self) {
        /// Cosine of 60° against the normal of the plane. Steeper normals are dropped.
        const MIN_STEEP_COSINE: f64 = 0.5;
        let (_, axes, _) = principal_axes(&self.readings.points);
        let flat = axes[2];
        let largest = flat.to_array().into_iter().fold(0.0_f64, |a, b| if b.abs() > a.abs() { b } else { a });
        for i in (0..self.len()).filter(|&i| !self.readings.oriented[i]) {
            let up = self.normal(i).dot(flat) * largest.signum();
            if up < -MIN_STEEP_COSINE {
                self.readings.normals[i] = -self.readings.normals[i];
            } else if up < MIN_STEEP_COSINE {
                self.readings.normals[i] = Vec3::ZERO;
            }
        }
    }

    /// Turns all normals around, because they face into the volume that the readings enclose; false, and no
    /// change, if some of them are measurements.
    pub(crate) fn turn_normals(&mut self) -> bool {
        if self.channels.iter().any(|channel| channel.quantity != Quantity::Position) {
            return false;
        }
        self.readings.normals.iter_mut().for_each(|normal| *normal = -*normal);
        self.intake.are_normals_turned = true;
        true
    }

    /// Computes [`Self::min_variance`], [`Self::rounding_variance`], and for every channel the roughness
    /// and the noise by neighbours.
    pub(super) fn measure_roughness(&mut self, scans: &[&Scan], sensors: usize, neighbours: usize) {
        let size = BoundingBox::from_points(&self.readings.points).map_or(0.0, |b| b.diagonal());
        self.min_variance = (1e-12 * size).powi(2).max(f64::MIN_POSITIVE);
        self.rounding_variance = rounding_step(&self.readings.points).map_or(0.0, |step| step * step / 12.0);
        for sensor in 0..sensors {
            // One scan, because errors of poses between scans would count as roughness.
            let Some(largest) = (0..scans.len())
                .filter(|&s| self.scans.channel[s] == sensor)
                .max_by_key(|&s| scans[s].points.len())
            else {
                continue;
            };
            // Differences from gross errors are no noise.
            let known = |i: usize| self.readings.normals[i] != Vec3::ZERO && self.readings.on_surface[i];
            let own: Vec<usize> =
                (0..self.len()).filter(|&i| self.readings.scan[i] as usize == largest && known(i)).collect();
            let points: Vec<DVec3> = own.iter().map(|&i| self.readings.points[i]).collect();
            let variance = |&i: &usize| self.covariance(i).along(self.normal(i));
            let stated = own.iter().map(variance).sum::<f64>() / own.len().max(1) as f64;
            let roughness = local_roughness(&points, neighbours)
                .filter(|_| stated > 0.0)
                .map(|roughness| (roughness * roughness).max(self.min_variance) / stated);
            let noise = neighbour_noise(&points, |k, normal| self.covariance(own[k]).along(normal));
            let channel = &mut self.channels[sensor];
            (channel.roughness, channel.neighbour_noise) = (roughness, noise);
        }
    }
}

/// The step to whose multiples all coordinates were rounded, if many points share a coordinate; none if
/// they were not. Readings on a grid, as those of depth images, share two of their coordinates only.
fn rounding_step(points: &[DVec3]) -> Option<f64> {
    let steps: Vec<f64> = (0..3).map(|axis| step_of(points, axis)).collect::<Option<_>>()?;
    let largest = steps.iter().copied().fold(0.0, f64::max);
    let is_common = |step: &f64| *step == 0.0 || (step / largest - 1.0).abs() < ROUNDING;
    (largest > 0.0 && steps.iter().all(is_common)).then_some(largest)
}

/// The common step of one coordinate, 0 if it is the same for all points.
fn step_of(points: &[DVec3], axis: usize) -> Option<f64> {
    let mut values: Vec<f64> = points.iter().map(|p| p[axis]).collect();
    values.sort_unstable_by(f64::total_cmp);
    let size = values.last()? - values.first()?;
    values.dedup_by(|a, b| (*a - *b).abs() <= 1e-9 * size);
    if values.len() > points.len() / MIN_SHARING {
        return None;
    }
    let gaps = || values.windows(2).map(|pair| pair[1] - pair[0]);
    let step = gaps().fold(f64::INFINITY, f64::min);
    if step.is_infinite() {
        return Some(0.0);
    }
    let is_multiple = |gap: f64| (gap / step - (gap / step).round()).abs() < ROUNDING;
    gaps().all(is_multiple).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_that_were_rounded_show_their_step() {
        let exact: Vec<DVec3> = (0..3000)
            .map(|k| [0.618_034, 0.754_878, 0.569_840].map(|c| 37.0 * (f64::from(k) * c).fract()).into())
            .collect();
        assert_eq!(rounding_step(&exact), None);
        for step in [0.1, 1.0, 2.5] {
            let rounded: Vec<DVec3> = exact.iter().map(|p| step * (*p / step).round()).collect();
            let found = rounding_step(&rounded).unwrap();
            assert!((found / step - 1.0).abs() < 1e-6, "{step}: {found}");
        }
        // Heights over a grid are not rounded.
        let heights: Vec<DVec3> = (0..3000_u32)
            .map(|k| DVec3::new(f64::from(k % 50), f64::from(k / 50), f64::from(k).sin()))
            .collect();
        assert_eq!(rounding_step(&heights), None);
    }
}
