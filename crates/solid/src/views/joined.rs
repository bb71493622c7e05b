//! A drawing whose coordinates that nearly agree are one.
//!
//! Input: a drawing and a tolerance. Output: the same drawing, where coordinates of an axis that are no
//! farther apart than the tolerance, in any view, have one value: ends of lines, centres of circles, and how
//! far circles reach. Points along other curves stay.
//!
//! Not guaranteed: that coordinates which are different stay so; a row of values, each within the tolerance
//! of the next, becomes one.

use crate::drawing::{Curve2, Drawing};
use planish_estimate::{Error, Result};

/// Joins coordinates that are no farther apart than `tolerance`, in the drawing's unit.
///
/// # Errors
/// `Input` for a tolerance that is not positive or as large as a hundredth of the drawing, and where a line
/// would lose its length, naming it.
pub fn joined(drawing: &Drawing, tolerance: f64) -> Result<Drawing> {
    let size = drawing.size();
    if !(tolerance > 0.0 && tolerance <= 0.01 * size) {
        return Err(Error::input(format!(
            "needed a tolerance above 0 and at most a hundredth of the drawing ({:.3e}), found {tolerance:e}",
            0.01 * size
        )));
    }
    let mut values: [Vec<f64>; 3] = Default::default();
    for view in &drawing.views {
        let axes = view.kind.axes();
        for drawn in &view.curves {
            for k in 0..2 {
                match &drawn.curve {
                    Curve2::Segment(a, b) => values[axes[k]].extend([a[k], b[k]]),
                    Curve2::Arc { center, radius, .. } => {
                        values[axes[k]].extend([center[k] - radius, center[k], center[k] + radius]);
                    }
                    Curve2::Chain(_) => {}
                }
            }
        }
    }
    let groups = values.map(|values| grouped(values, tolerance));
    let mut found = drawing.clone();
    for view in &mut found.views {
        let axes = view.kind.axes();
        let to = |k: usize, value: f64| representative(&groups[axes[k]], value);
        for drawn in &mut view.curves {
            match &mut drawn.curve {
                Curve2::Segment(a, b) => {
                    let ends = [*a, *b];
                    (*a, *b) = ([to(0, a[0]), to(1, a[1])], [to(0, b[0]), to(1, b[1])]);
                    if a == b && ends[0] != ends[1] {
                        return Err(Error::input(format!(
                            "{} is not longer than the tolerance {tolerance:e}: needed a smaller one, or a \
                             drawing without it",
                            drawn.entity
                        )));
                    }
                }
                Curve2::Arc { center, radius, .. } => {
                    let reach = to(0, center[0] + *radius) - to(0, center[0]);
                    *center = [to(0, center[0]), to(1, center[1])];
                    *radius = if reach > 0.0 { reach } else { *radius };
                }
                Curve2::Chain(_) => {}
            }
        }
    }
    Ok(found)
}

/// Values in groups: ascending, each no farther from the next than the tolerance; the least and greatest of a
/// group, and what stands for it.
fn grouped(mut values: Vec<f64>, tolerance: f64) -> Vec<[f64; 3]> {
    values.sort_by(f64::total_cmp);
    let mut groups: Vec<Vec<f64>> = Vec::new();
    for value in values {
        match groups.last_mut() {
            Some(group) if value - group[group.len() - 1] <= tolerance => group.push(value),
            _ => groups.push(vec![value]),
        }
    }
    let one = |group: Vec<f64>| [group[0], group[group.len() - 1], most_frequent(&group)];
    groups.into_iter().map(one).collect()
}

/// The value that most lines have; of equally frequent ones the one with the fewest decimals, then the least.
fn most_frequent(group: &[f64]) -> f64 {
    let count = |v: f64| group.iter().filter(|w| **w == v).count();
    let decimals = |v: f64| {
        let is_whole = |d: &i32| {
            let scaled = v * 10_f64.powi(*d);
            (scaled - scaled.round()).abs() < 1e-6
        };
        (0..9).find(is_whole).unwrap_or(9)
    };
    let key = |v: f64| (std::cmp::Reverse(count(v)), decimals(v));
    group.iter().copied().min_by_key(|v| key(*v)).unwrap_or(0.0)
}

fn representative(groups: &[[f64; 3]], value: f64) -> f64 {
    let at = groups.partition_point(|g| g[1] < value);
    groups.get(at).filter(|g| g[0] <= value).map_or(value, |g| g[2])
}

#[cfg(test)]
mod tests {
    use super::super::tests::{rectangle, segment};
    use super::super::{LineStyle, View, ViewKind, solve};
    use super::*;

    fn block(gap: f64, scale: f64) -> Drawing {
        let view = |kind, curves| View { kind, curves };
        let mut front = rectangle([0.0, 0.0], [40.0, 20.0]);
        front[0] = segment([0.0, 0.0], [40.0 - gap, 0.0], LineStyle::Visible);
        Drawing {
            views: vec![
                view(ViewKind::Front, front),
                view(ViewKind::Top, rectangle([0.0, 0.0], [40.0 * scale, 30.0 * scale])),
                view(ViewKind::Side, rectangle([0.0, 0.0], [30.0, 20.0])),
            ],
        }
    }

    #[test]
    fn ends_that_nearly_meet_and_views_that_nearly_fit_become_one_solid() {
        for (drawing, tolerance) in [(block(1e-3, 1.0), 2e-3), (block(0.0, 1.001), 0.05)] {
            let best = solve(&joined(&drawing, tolerance).unwrap()).unwrap().solutions.remove(0);
            assert!((best.measures.volume - 24_000.0).abs() < 1e-6, "{}", best.measures.volume);
        }
    }

    #[test]
    fn a_line_that_would_vanish_is_named() {
        let mut drawing = block(0.0, 1.0);
        let mut short = segment([10.0, 0.0], [10.0, 0.1], LineStyle::Visible);
        short.entity = "LINE 2A".to_owned();
        drawing.views[0].curves.push(short);
        let told = joined(&drawing, 0.2).unwrap_err().to_string();
        assert!(told.contains("LINE 2A is not longer than the tolerance"), "{told}");
        assert!(joined(&drawing, 1.0).is_err() && joined(&drawing, 0.0).is_err());
    }
}
