//! Short tours through points.
//!
//! In: points and an order of some of them. Out: an order with a shorter closed tour. Not guaranteed: the
//! shortest tour; it is one that neither reversing a part nor moving up to three points shortens.

/// Maximum number of passes over all pairs; a few suffice, each shortens the tour.
const MAX_PASSES: usize = 60;

/// Shortens a closed tour by reversing parts (2-opt, Croes 1958) and by moving up to three successive points
/// (Or 1976), begun from the given order and from that of nearest neighbours. Cost: a few times `n²`.
pub(super) fn shortened(points: &[[f64; 2]], order: Vec<usize>) -> Vec<usize> {
    let [first, second] = [nearest_neighbours(points, &order), order].map(|order| improved(points, order));
    if length(points, &first) < length(points, &second) { first } else { second }
}

fn apart(points: &[[f64; 2]], a: usize, b: usize) -> f64 {
    (points[a][0] - points[b][0]).hypot(points[a][1] - points[b][1])
}

/// Length of the closed tour through the points in an order.
pub(super) fn length(points: &[[f64; 2]], order: &[usize]) -> f64 {
    (0..order.len()).map(|k| apart(points, order[k], order[(k + 1) % order.len()])).sum()
}

/// Each point is followed by the nearest one that is not in the tour yet.
fn nearest_neighbours(points: &[[f64; 2]], among: &[usize]) -> Vec<usize> {
    let mut left = among.to_vec();
    let mut order = Vec::with_capacity(left.len());
    let mut at = left.pop();
    while let Some(current) = at {
        order.push(current);
        let nearest = (0..left.len())
            .min_by(|&a, &b| apart(points, current, left[a]).total_cmp(&apart(points, current, left[b])));
        at = nearest.map(|k| left.swap_remove(k));
    }
    order
}

fn improved(points: &[[f64; 2]], mut order: Vec<usize>) -> Vec<usize> {
    // Smaller gains are rounding errors.
    let least = 1e-12 * length(points, &order);
    for _ in 0..MAX_PASSES {
        let reversed = reverse_parts(points, &mut order, least);
        let moved = move_points(points, &mut order, least);
        if !reversed && !moved {
            break;
        }
    }
    order
}

/// Reverses each part whose reversal shortens the tour by more than `least`; true if there was one.
fn reverse_parts(points: &[[f64; 2]], order: &mut [usize], least: f64) -> bool {
    let n = order.len();
    let mut any = false;
    for i in 0..n.saturating_sub(2) {
        for j in i + 2..n {
            let (a, b, c, d) = (order[i], order[i + 1], order[j], order[(j + 1) % n]);
            let before = apart(points, a, b) + apart(points, c, d);
            let after = apart(points, a, c) + apart(points, b, d);
            if a != d && before - after > least {
                order[i + 1..=j].reverse();
                any = true;
            }
        }
    }
    any
}

/// Moves runs of one to three points between two others where that shortens the tour by more than `least`;
/// true if there was one.
fn move_points(points: &[[f64; 2]], order: &mut Vec<usize>, least: f64) -> bool {
    let n = order.len();
    let mut any = false;
    for count in 1..=3.min(n.saturating_sub(3)) {
        for _ in 0..n {
            // The run is always at the start of a rotated order, so that it does not wrap around.
            order.rotate_left(1);
            let (first, last) = (order[0], order[count - 1]);
            let (before, after) = (order[n - 1], order[count]);
            let freed =
                apart(points, before, first) + apart(points, last, after) - apart(points, before, after);
            let cost = |k: usize| {
                let (a, b) = (order[k], order[k + 1]);
                let [ahead, back] = [(first, last), (last, first)]
                    .map(|(from, to)| apart(points, a, from) + apart(points, to, b) - apart(points, a, b));
                if ahead <= back { (ahead, false) } else { (back, true) }
            };
            let best = (count..n - 1).map(|k| (k, cost(k))).min_by(|a, b| a.1.0.total_cmp(&b.1.0));
            let Some((at, (_, is_reversed))) = best.filter(|(_, (added, _))| freed - added > least) else {
                continue;
            };
            let mut run: Vec<usize> = order.drain(..count).collect();
            if is_reversed {
                run.reverse();
            }
            let at = at + 1 - count;
            order.splice(at..at, run);
            any = true;
        }
    }
    any
}

#[cfg(test)]
mod tests {
    use super::{length, shortened};

    #[test]
    fn a_tour_follows_a_spiral_that_no_view_point_sees() {
        // A band around a spiral: out along one side, back along the other.
        let at = |k: usize, radius: f64| {
            let turn = 0.06 * k as f64;
            [(radius + turn) * turn.cos(), (radius + turn) * turn.sin()]
        };
        let outline: Vec<[f64; 2]> =
            (0..100).map(|k| at(k, 2.0)).chain((0..100).rev().map(|k| at(k, 4.0))).collect();
        let truth = length(&outline, &(0..200).collect::<Vec<_>>());
        let mixed: Vec<usize> = (0..200).map(|k| (k * 73) % 200).collect();
        let tour = shortened(&outline, mixed);
        let mut each = tour.clone();
        each.sort_unstable();
        assert_eq!(each, (0..200).collect::<Vec<_>>());
        let found = length(&outline, &tour);
        assert!(found < 1.02 * truth, "{found} against {truth}");
    }
}
