//! Random points, for comparison with the chosen ones.
//!
//! Input: the factor of a model's information, and its places. Output: the largest σ of the region after
//! 1, 2, 3 … points of every draw. Points are leaf centres, drawn with replacement in proportion to area.

use super::{NextOptions, Place, columns, figures};
use planish_core::{Progress, ProgressPart, Setting};
use planish_estimate::sparse::CholeskyFactor;
use planish_estimate::{Error, Result};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

/// Maximum number of draws that are processed together.
const DRAWS_PER_BATCH: usize = 8;
/// Memory for the columns of all points of the draws that are processed together, in numbers (400 MB). A
/// column has one number per place.
const DRAWN_NUMBERS: usize = 50_000_000;

/// Result of points drawn at random: one number for each count of points, starting with one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RandomDraws {
    /// Number of sets.
    pub draws: usize,
    /// The median of the largest σ of the region.
    pub worst_sigma_median: Vec<f64>,
    /// 10 % quantile of the largest σ.
    pub worst_sigma_p10: Vec<f64>,
    /// 90 % quantile of the largest σ.
    pub worst_sigma_p90: Vec<f64>,
}

/// State of a model before the planned readings.
#[derive(Clone, Copy)]
pub(super) struct InitialState<'a> {
    /// Factor of the model's information, and its number of unknowns.
    pub factor: &'a CholeskyFactor,
    pub unknowns: usize,
    /// The places that may be read, and the variance of the surface at each.
    pub places: &'a [Place],
    pub variances: &'a [f64],
    /// Variance of a reading to come.
    pub reading: f64,
}

/// Draws sets of `options.count` places and evaluates the first 1, 2, 3 … places of each.
pub(super) fn at_random(
    before: InitialState<'_>,
    options: &NextOptions,
    draws: usize,
    progress: &dyn Progress,
) -> Result<RandomDraws> {
    let InitialState { factor, unknowns, places, .. } = before;
    let most = DRAWN_NUMBERS / places.len().max(1);
    if options.count > most {
        let error = format!(
            "expected at most {most} points to compare with random sets, because the region has {} places, \
             found {}",
            places.len(),
            options.count
        );
        return Err(Error::input(error).with_setting(Setting::Count));
    }
    let per_batch = (most / options.count.max(1)).clamp(1, DRAWS_PER_BATCH);
    let mut sums: Vec<f64> = Vec::with_capacity(places.len());
    for place in places {
        sums.push(sums.last().copied().unwrap_or(0.0) + place.area);
    }
    let area = sums.last().copied().unwrap_or(0.0);
    let drawn = |draw: usize| -> Vec<usize> {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        // A stream per draw: the points of a draw depend neither on threads nor on the number of draws.
        rng.set_stream(draw as u64);
        (0..options.count)
            .map(|_| {
                let at = area * rng.random::<f64>();
                // Rounding of the last sum may put `at` beyond the end.
                sums.partition_point(|&s| s <= at).min(places.len() - 1)
            })
            .collect()
    };
    let part = ProgressPart::new(progress, 0.15, 0.2);
    let mut worst: Vec<Vec<f64>> = Vec::with_capacity(draws);
    for first in (0..draws).step_by(per_batch) {
        part.check("random draws", first as f64 / draws as f64)?;
        part.items(first, "draws");
        let together: Vec<usize> = (first..draws.min(first + per_batch)).collect();
        let judged: Vec<Vec<f64>> = together
            .into_par_iter()
            .map(|draw| {
                let at = drawn(draw);
                let mut seen: Vec<Vec<f64>> =
                    columns(factor, unknowns, places, at.clone(), &planish_core::Silent)?
                        .iter()
                        .map(|c| places.iter().map(|place| place.dot(&c.column)).collect())
                        .collect();
                Ok(one_by_one(before, &at, &mut seen))
            })
            .collect::<Result<_>>()?;
        worst.extend(judged);
    }
    let quantile = |share: f64| -> Vec<f64> {
        (0..options.count)
            .map(|k| {
                let mut all: Vec<f64> = worst.iter().map(|draw| draw[k]).collect();
                all.sort_by(f64::total_cmp);
                planish_mesh::quantile_of_sorted(&all, share)
            })
            .collect()
    };
    Ok(RandomDraws {
        draws,
        worst_sigma_median: quantile(0.5),
        worst_sigma_p10: quantile(0.1),
        worst_sigma_p90: quantile(0.9),
    })
}

/// The largest σ after each reading. `seen[k]` is the covariance of every place with reading `k`, and is
/// updated in place.
fn one_by_one(
    InitialState { places, variances, reading, .. }: InitialState<'_>,
    at: &[usize],
    seen: &mut [Vec<f64>],
) -> Vec<f64> {
    let mut variances = variances.to_vec();
    (0..at.len())
        .map(|k| {
            // Only later readings change: those before are already used.
            let (before, later) = seen.split_at_mut(k + 1);
            let column = &before[k];
            let own = column[at[k]] + reading;
            for (variance, c) in variances.iter_mut().zip(column) {
                // Rounding can take a variance that nearly vanishes below zero.
                *variance = (*variance - c * c / own).max(0.0);
            }
            for other in later {
                // The same reading also reduces the covariances with all later ones (rank one).
                let share = other[at[k]] / own;
                other.iter_mut().zip(column).for_each(|(o, c)| *o -= share * c);
            }
            figures(places, &variances).0
        })
        .collect()
}
