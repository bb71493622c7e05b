//! Convex polygons from the hull of the readings.

/// The convex polygon of `count` corners that is left of the points' hull when corners are taken away one by
/// one, always the one that costs the least area. Counter-clockwise; `None` where the hull has fewer corners.
///
/// A corner as sharp as a few readings' noise is one that segments along the outline easily miss. Cost: `h²`
/// for a hull of `h`.
///
/// # References
/// Andrew 1979, *Another efficient algorithm for convex hulls in two dimensions*.
pub(super) fn polygon(points: &[[f64; 2]], count: usize) -> Option<Vec<f64>> {
    let mut corners = hull(points);
    while corners.len() > count {
        let n = corners.len();
        let area = |i: usize| turn(corners[(i + n - 1) % n], corners[i], corners[(i + 1) % n]);
        let least = (0..n).min_by(|&a, &b| area(a).total_cmp(&area(b)))?;
        corners.remove(least);
    }
    (corners.len() == count).then(|| corners.into_iter().flatten().collect())
}

/// Twice the area of a triangle, positive where it turns to the left.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn hull(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut sorted: Vec<[f64; 2]> = points.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while chain.len() > 1 && turn(chain[chain.len() - 2], chain[chain.len() - 1], p) <= 0.0 {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut corners = half(&mut sorted.iter().copied());
    corners.extend(half(&mut sorted.iter().rev().copied()));
    corners
}
