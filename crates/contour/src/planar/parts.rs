//! Separation of readings into objects, and containment of points in outlines.

use super::kind::Outline;
use super::reading::ContourReading;
use planish_core::BoundingBox;
use std::collections::BTreeMap;

/// Groups readings whose points are connected by gaps of at most `gap` (single linkage); largest group first.
///
/// Each group holds indices of `readings` in increasing order. The cost is about linear in their number: a
/// grid of cells of size `gap` limits the search, and grouped points leave it.
///
/// # Examples
/// ```
/// use planish_contour::planar::{ContourKind, points, separate, typical_gap};
///
/// let mut readings = points(&ContourKind::Circle, &[0.0, 0.0, 5.0], 200, 0.01, 1).noisy;
/// readings.extend(points(&ContourKind::Circle, &[40.0, 0.0, 3.0], 100, 0.01, 2).noisy);
/// let groups = separate(&readings, typical_gap(&readings));
/// assert_eq!(groups.iter().map(Vec::len).collect::<Vec<_>>(), [200, 100]);
/// ```
#[must_use]
pub fn separate(readings: &[ContourReading], gap: f64) -> Vec<Vec<usize>> {
    let points: Vec<[f64; 2]> = readings.iter().map(ContourReading::point).collect();
    let cell = |p: [f64; 2]| p.map(|c| (c / gap).floor() as i64);
    let mut cells: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (i, &p) in points.iter().enumerate() {
        cells.entry(cell(p)).or_default().push(i);
    }
    let mut groups: Vec<Vec<usize>> = Vec::new();
    let mut is_grouped = vec![false; points.len()];
    for seed in 0..points.len() {
        if std::mem::replace(&mut is_grouped[seed], true) {
            continue;
        }
        let mut members = vec![seed];
        let mut next = 0;
        while next < members.len() {
            let p = points[members[next]];
            next += 1;
            // Cells are as wide as the gap: partners are in the 3 × 3 neighbourhood.
            let [cx, cy] = cell(p);
            for place in
                (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [cx.saturating_add(dx), cy.saturating_add(dy)]))
            {
                // Cells keep only ungrouped points. Without this, n readings in one cell cost n² comparisons.
                let Some(free) = cells.get_mut(&place) else {
                    continue;
                };
                free.retain(|&j| {
                    let is_near = (points[j][0] - p[0]).hypot(points[j][1] - p[1]) <= gap;
                    if is_near && !std::mem::replace(&mut is_grouped[j], true) {
                        members.push(j);
                    }
                    !is_grouped[j]
                });
            }
        }
        members.sort_unstable();
        groups.push(members);
    }
    groups.sort_by_key(|members| std::cmp::Reverse(members.len()));
    groups
}

/// A gap that neighbouring readings of one contour rarely exceed, in the unit of the readings.
///
/// Neighbours on an outline as long as the bounding box of the readings have exponentially distributed gaps.
/// The largest of `n` is about `ln n` times the mean; a margin of four means and at least 6 σ of noise are
/// allowed for.
#[must_use]
pub fn typical_gap(readings: &[ContourReading]) -> f64 {
    let mut bounds = BoundingBox::EMPTY;
    let mut variance = 0.0;
    for reading in readings {
        bounds.include(reading.point());
        let [xx, _, yy] = reading.covariance();
        variance += 0.5 * (xx + yy);
    }
    let n = readings.len() as f64;
    let [width, height] = bounds.extent();
    let extent = width + height;
    // The perimeter of the bounding box stands for the length of the outline.
    let spacing = 2.0 * extent / n;
    (spacing * (n.ln() + 4.0)).max(6.0 * (variance / n).sqrt())
}

/// True if a point lies inside a closed outline; arcs are replaced by their chords.
#[must_use]
pub fn contains(outline: &Outline, p: [f64; 2]) -> bool {
    let count = outline.vertices.len();
    let crossings = (0..count).filter(|&i| {
        let (a, b) = (outline.vertices[i], outline.vertices[(i + 1) % count]);
        // Half-open in y: a ray through a vertex counts once.
        (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    });
    outline.closed && crossings.count() % 2 == 1
}
