//! Errors that neighbouring readings share, as a part of σ.
//!
//! Scanner software smooths its points, and a mesh that was fitted before is smooth altogether. Their σ is
//! that of a single point, but neighbours are wrong in the same way, so a mean over many of them is hardly
//! better than one. Residuals do not show such errors, because the surface follows them. What they do show is
//! that the points agree far better than their σ allows:
//!
//! ```text
//! c² = σ²_stated − σ²_residuals
//! ```
//!
//! is the variance that the readings have in common. It is added to the variance of the surface as it is:
//! nothing is known of the distance over which the errors are common, so no mean over readings reduces it.
//!
//! A stated σ can also be too large for independent errors; residuals cannot tell the two apart. Up to
//! [`MAX_OVERSTATEMENT`] it counts as cautiously stated, beyond as shared.

use super::leaves::neighbourhood;
use super::noise::SensorNoise;
use crate::observe::{Foot, FootChannels, Quantity, by_leaf};
use planish_spline::Surface;

/// Largest ratio of a stated σ to that of the residuals that counts as a cautious statement about independent
/// errors. Beyond it, the errors count as shared by neighbours.
///
/// Data sheets state two or three times the scatter that an instrument shows on a good surface, because
/// they include errors that neighbouring readings share. A larger limit would take those for independent:
/// readings with errors of 0.05 over 4 mm and of 0.02 each, stated as 0.054, were covered to 0.5. A smaller
/// one would state too large a σ where σ is stated a little too large. See decision 0092.
pub(super) const MAX_OVERSTATEMENT: f64 = 1.5;

/// For each leaf the variance along the normal that its readings have in common; empty if no sensor has any.
///
/// A leaf with readings of several sensors takes their shares of the information `information`: an
/// independent sensor beside a smoothed one reduces what is common.
pub(super) fn shared_variance(
    surface: &Surface,
    channels: &FootChannels<'_>,
    feet: &[Foot],
    information: &[f64],
    noise: &SensorNoise,
) -> Vec<f64> {
    if noise.shared_share.iter().all(|share| *share == 0.0) {
        return Vec::new();
    }
    let leaves = surface.space().leaves().len();
    let (start, order) = by_leaf(feet, leaves);
    let own: Vec<Common> = (0..leaves)
        .map(|leaf| {
            let mut sums = Common::new(noise.shared_share.len());
            for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
                let (foot, w) = (&feet[k as usize], information[k as usize]);
                if w > 0.0 && foot.quantity == Quantity::Position {
                    sums.add(channels.channel(k as usize), w, foot.variance);
                }
            }
            sums
        })
        .collect();
    let mut all = Common::new(noise.shared_share.len());
    own.iter().for_each(|sums| all.merge(sums));
    (0..leaves)
        .map(|leaf| {
            // Beside the readings the prior continues their common error, so empty leaves have it, too.
            let mut near = Common::new(noise.shared_share.len());
            neighbourhood(surface.space(), leaf).into_iter().for_each(|other| near.merge(&own[other]));
            near.variance(&noise.shared_share).or_else(|| all.variance(&noise.shared_share)).unwrap_or(0.0)
        })
        .collect()
}

/// For each channel, the sums of information and of stated variance times information.
struct Common(Vec<[f64; 2]>);

impl Common {
    fn new(channels: usize) -> Self {
        Self(vec![[0.0; 2]; channels])
    }

    fn add(&mut self, channel: usize, information: f64, variance: f64) {
        let [sum, weighted] = &mut self.0[channel];
        *sum += information;
        *weighted += information * variance;
    }

    fn merge(&mut self, other: &Self) {
        for (own, other) in self.0.iter_mut().zip(&other.0) {
            *own = [own[0] + other[0], own[1] + other[1]];
        }
    }

    /// Variance that the readings have in common. `None` without readings.
    fn variance(&self, shares: &[f64]) -> Option<f64> {
        let sensors = (self.0.iter().zip(shares))
            .filter(|([sum, _], _)| *sum > 0.0)
            .map(|([sum, weighted], share)| [*sum, share * weighted / sum]);
        combined_variance(sensors)
    }
}

/// `Σ_s (W_s/W)² c_s²` over sensors `s` with the information `W_s` and the common variance `c_s²`: errors of
/// different sensors are independent. `None` without information.
pub(super) fn combined_variance(sensors: impl Iterator<Item = [f64; 2]> + Clone) -> Option<f64> {
    let total: f64 = sensors.clone().map(|[information, _]| information).sum();
    (total > 0.0).then(|| sensors.map(|[information, common]| (information / total).powi(2) * common).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_independent_sensor_reduces_what_a_smoothed_one_has_in_common() {
        let mut sums = Common::new(2);
        assert_eq!(sums.variance(&[0.9, 0.0]), None);
        sums.add(0, 4.0, 0.25);
        sums.add(0, 4.0, 0.75);
        assert!((sums.variance(&[0.9, 0.0]).unwrap() - 0.45).abs() < 1e-15);
        sums.add(1, 8.0, 0.1);
        assert!((sums.variance(&[0.9, 0.0]).unwrap() - 0.25 * 0.45).abs() < 1e-15);
    }
}
