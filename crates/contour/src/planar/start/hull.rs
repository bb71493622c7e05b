//! Convex polygons from the convex hull of the readings.

/// A convex polygon of `count` corners, counter-clockwise; `None` if the hull has fewer corners.
///
/// Removes corners of the hull one by one, always the one that costs the least area. It finds sharp corners
/// with only a few readings, which a segmentation along the outline easily misses. Cost: `h²` for a hull of
/// `h` corners.
///
/// # References
/// Andrew 1979, *Another efficient algorithm for convex hulls in two dimensions*.
pub(super) fn polygon(points: &[[f64; 2]], count: usize) -> Option<Vec<f64>> {
    let mut corners = hull(points);
    // The area lost is the triangle of a corner and its neighbours; noise adds many corners of tiny area.
    while corners.len() > count {
        let n = corners.len();
        let area = |i: usize| turn(corners[(i + n - 1) % n], corners[i], corners[(i + 1) % n]);
        let smallest = (0..n).min_by(|&a, &b| area(a).total_cmp(&area(b)))?;
        corners.remove(smallest);
    }
    (corners.len() == count).then(|| corners.into_iter().flatten().collect())
}

/// Twice the signed area of a triangle, positive if it turns left.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Convex hull, counter-clockwise (Andrew's monotone chain).
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
        // The last point is the first one of the other half.
        chain.pop();
        chain
    };
    let mut corners = half(&mut sorted.iter().copied());
    corners.extend(half(&mut sorted.iter().rev().copied()));
    corners
}
