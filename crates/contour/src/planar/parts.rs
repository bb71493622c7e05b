//! Readings of several things told apart.

use super::kind::Outline;
use super::reading::ContourReading;
use planish_core::BoundingBox;
use std::collections::BTreeMap;

/// Groups of indices of readings whose points hang together: single linkage over gaps of at most `gap`.
///
/// Largest group first. Points in a grid of cells of that size, which lose what has been grouped: cost about
/// `n`.
#[must_use]
pub fn separate(sightings: &[ContourReading], gap: f64) -> Vec<Vec<usize>> {
    let points: Vec<[f64; 2]> = sightings.iter().map(ContourReading::point).collect();
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
            let [cx, cy] = cell(p);
            for place in
                (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [cx.saturating_add(dx), cy.saturating_add(dy)]))
            {
                // Cells keep those that belong to no group: dense readings are looked at a few times each.
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

/// A gap that readings of one contour hardly ever leave: neighbours along an outline of the readings' extent
/// are exponentially apart, and the largest of `n` such gaps is about `ln n` of the mean; and noise.
#[must_use]
pub fn usual_gap(sightings: &[ContourReading]) -> f64 {
    let mut bounds = BoundingBox::EMPTY;
    let mut variance = 0.0;
    for sighting in sightings {
        bounds.include(sighting.point());
        let [xx, _, yy] = sighting.covariance();
        variance += 0.5 * (xx + yy);
    }
    let n = sightings.len() as f64;
    let [width, height] = bounds.extent();
    let extent = width + height;
    let spacing = 2.0 * extent / n;
    (spacing * (n.ln() + 4.0)).max(6.0 * (variance / n).sqrt())
}

/// Whether a point lies inside a closed outline, whose arcs count as their chords.
#[must_use]
pub fn contains(outline: &Outline, p: [f64; 2]) -> bool {
    let count = outline.vertices.len();
    let crossings = (0..count).filter(|&i| {
        let (a, b) = (outline.vertices[i], outline.vertices[(i + 1) % count]);
        (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    });
    outline.closed && crossings.count() % 2 == 1
}
