//! Blends the colours that several views measure at one place, robust against outliers.
//!
//! The start is the view that differs least from all others (the medoid, with the fourth roots of the
//! weights, so that no single view outvotes two others). It is followed by an iterated weighted mean with
//! Tukey's biweight (A. Beaton, J. Tukey 1974). All places share one scale: the spread of colours at places
//! that three or more views see.
//!
//! A view that is an outlier at most of the places seen by two others is rejected everywhere.
//!
//! Not guaranteed: if only two views see a place and differ, the one with the larger weight is used.

/// Tukey's constant: 95 % efficiency where errors are normal.
const TUKEY: f64 = 4.685;
/// Iterations of the mean. It starts at the medoid and settles in a few.
const ROUNDS: usize = 5;
/// Minimum scale, of 255. Pictures are rounded; a smaller scale would reject views for that.
const MIN_SCALE: f64 = 2.0;
/// The median of the length of three standard normal numbers, over √3.
const MEDIAN_OF_THREE: f64 = 0.888;

/// Colour that one view measures at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ViewColour {
    /// The view.
    pub view: usize,
    /// Its colour, from 0 to 255.
    pub colour: [f64; 3],
    /// Its weight.
    pub weight: f64,
}

/// Colour blended from several views.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Blended {
    /// The colour, from 0 to 255.
    pub colour: [f64; 3],
    /// Number of views that contribute.
    pub views: usize,
    /// Views that are outliers and do not contribute.
    pub outliers: Vec<usize>,
}

/// Root mean square difference over the three channels.
fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    ((0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>() / 3.0).sqrt()
}

/// The colour that differs least from all others.
fn medoid(colours: &[ViewColour]) -> Option<&ViewColour> {
    let cost = |one: &ViewColour| -> f64 {
        (colours.iter()).map(|other| other.weight.powf(0.25) * apart(one.colour, other.colour)).sum()
    };
    colours.iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))
}

/// σ of the colour of one view, from 0 to 255: from the median difference between views and their medoid, at
/// places that three or more views see. About a tenth too large with many views, because the medoid has an
/// error as well.
pub(super) fn scale<'a>(places: impl Iterator<Item = &'a [ViewColour]>) -> f64 {
    let mut differences = Vec::new();
    for colours in places.filter(|colours| colours.len() > 2) {
        if let Some(middle) = medoid(colours) {
            let others = colours.iter().filter(|one| one.view != middle.view);
            // Without the medoid itself, whose difference is always zero.
            differences.extend(others.map(|one| apart(one.colour, middle.colour)));
        }
    }
    differences.sort_unstable_by(f64::total_cmp);
    let median = differences.get(differences.len() / 2).copied().unwrap_or(0.0);
    (median / MEDIAN_OF_THREE).max(MIN_SCALE)
}

/// For each view, the share of the places seen by three or more views at which it is an outlier.
pub(super) fn outlier_shares(
    views: usize,
    colours: &[Vec<ViewColour>],
    blended: &[Option<Blended>],
) -> Vec<f64> {
    let mut counts = vec![(0_usize, 0_usize); views];
    for (colours, blended) in colours.iter().zip(blended).filter(|(colours, _)| colours.len() > 2) {
        colours.iter().for_each(|one| counts[one.view].0 += 1);
        (blended.iter().flat_map(|b| &b.outliers)).for_each(|view| counts[*view].1 += 1);
    }
    counts.iter().map(|(all, outliers)| *outliers as f64 / (*all).max(1) as f64).collect()
}

/// Blends several colours to one. `None` for an empty list.
pub(super) fn blend(colours: &[ViewColour], scale: f64) -> Option<Blended> {
    let mut colour = medoid(colours)?.colour;
    let robust_weight = |colour: [f64; 3], one: &ViewColour| {
        let share = apart(one.colour, colour) / (TUKEY * scale);
        (1.0 - share * share).max(0.0).powi(2)
    };
    for _ in 0..ROUNDS {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for one in colours {
            let weight = one.weight * robust_weight(colour, one);
            sum = [0, 1, 2].map(|c| sum[c] + weight * one.colour[c]);
            total += weight;
        }
        // If all weights vanish, the medoid remains.
        if total > 0.0 {
            colour = sum.map(|s| s / total);
        }
    }
    // The biweight is exactly zero beyond its limit, so the comparison needs no tolerance.
    let outliers: Vec<usize> =
        (colours.iter().filter(|one| robust_weight(colour, one) == 0.0)).map(|one| one.view).collect();
    Some(Blended { colour, views: colours.len() - outliers.len(), outliers })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view_colour(view: usize, level: f64, weight: f64) -> ViewColour {
        ViewColour { view, colour: [level, 0.5 * level, 10.0], weight }
    }

    /// The outlier has the largest weight and is outvoted nevertheless.
    #[test]
    fn an_outlying_view_is_rejected() {
        let colours = [
            view_colour(0, 100.0, 1.0),
            view_colour(1, 104.0, 2.0),
            view_colour(2, 220.0, 4.0),
            view_colour(3, 101.0, 1.0),
        ];
        let found = blend(&colours, 3.0).unwrap();
        assert_eq!((found.outliers, found.views), (vec![2], 3));
        // The weighted mean of the others is 102.25.
        assert!((found.colour[0] - 102.25).abs() < 0.5, "{:?}", found.colour);
        assert!(blend(&[], 3.0).is_none());
    }

    /// Views with known noise: the estimated scale equals it.
    #[test]
    fn the_scale_is_that_of_the_noise() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut noise = || {
            let x: f64 = StandardNormal.sample(&mut random);
            6.0 * x
        };
        let places: Vec<Vec<ViewColour>> = (0..400)
            .map(|_| {
                (0..8)
                    .map(|view| ViewColour {
                        view,
                        colour: [100.0 + noise(), 80.0 + noise(), 60.0 + noise()],
                        weight: 1.0,
                    })
                    .collect()
            })
            .collect();
        let found = scale(places.iter().map(|p| &p[..]));
        assert!((5.5..8.0).contains(&found), "{found}");
    }
}
