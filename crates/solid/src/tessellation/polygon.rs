//! Polygons of mesh vertices in a plane: area, point location, crossings and contacts.

use std::collections::HashMap;

/// A corner of a polygon: a vertex of the mesh and its position in the plane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Corner {
    pub(crate) vertex: u32,
    pub(crate) at: [f64; 2],
}

/// Signed area of polygons, positive if they are counter-clockwise.
pub(crate) fn signed_area(polygons: &[Vec<Corner>]) -> f64 {
    let area_of = |polygon: &Vec<Corner>| -> f64 {
        let n = polygon.len();
        (0..n)
            .map(|k| {
                let (a, b) = (polygon[k].at, polygon[(k + 1) % n].at);
                (a[0] * b[1] - b[0] * a[1]) / 2.0
            })
            .sum()
    };
    polygons.iter().map(area_of).sum()
}

/// True if two segments cross or touch.
pub(crate) fn segments_cross(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> bool {
    let side =
        |p: [f64; 2], q: [f64; 2], r: [f64; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    // With equality, so that a bridge through a corner of a loop counts as crossing.
    side(a, b, c) * side(a, b, d) <= 0.0 && side(c, d, a) * side(c, d, b) <= 0.0
}

/// Moves holes by whole periods of the coordinates into the widest polygon.
pub(crate) fn shift_into_outer(polygons: &mut [Vec<Corner>], periods: [Option<f64>; 2]) {
    let width = |p: &Vec<Corner>| {
        let (lo, hi) = p.iter().fold((f64::MAX, f64::MIN), |(lo, hi), c| (lo.min(c.at[0]), hi.max(c.at[0])));
        hi - lo
    };
    let Some(outer) =
        (0..polygons.len()).max_by(|a, b| width(&polygons[*a]).total_cmp(&width(&polygons[*b])))
    else {
        return;
    };
    let within = polygons[outer].clone();
    let turns = periods.map(|p| if p.is_some() { -2..=2 } else { 0..=0 });
    let by = periods.map(|p| p.unwrap_or(0.0));
    let shifts: Vec<[f64; 2]> = turns[0]
        .clone()
        .flat_map(|i| turns[1].clone().map(move |j| [by[0] * f64::from(i), by[1] * f64::from(j)]))
        .collect();
    for (_, hole) in polygons.iter_mut().enumerate().filter(|(k, _)| *k != outer) {
        // One corner decides: loops do not cross, so all of a hole is inside or outside.
        let at = hole[0].at;
        let found = shifts.iter().find(|s| contains(&within, [at[0] + s[0], at[1] + s[1]]));
        let [across, up] = found.copied().unwrap_or_default();
        for corner in hole.iter_mut() {
            corner.at = [corner.at[0] + across, corner.at[1] + up];
        }
    }
}

/// True if a point lies in a polygon: a ray to the right crosses an odd number of sides.
pub(crate) fn contains(polygon: &[Corner], p: [f64; 2]) -> bool {
    let n = polygon.len();
    (0..n).fold(false, |inside, k| {
        let (a, b) = (polygon[k].at, polygon[(k + 1) % n].at);
        let above = (a[1] > p[1]) != (b[1] > p[1]);
        inside != (above && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
    })
}

/// Separates corners of different vertices at the same position.
///
/// The second corner is moved slightly towards the inside of its own corner. On a straight side, it is moved
/// into the face, which is on the left if `left` is 1 and on the right if it is −1. Loops that touch then
/// stay apart, and slits open. The triangulation would otherwise use one vertex for both.
pub(crate) fn part_touching(polygons: &mut [Vec<Corner>], left: f64) {
    let mut seen: HashMap<[u64; 2], u32> = HashMap::new();
    for polygon in polygons {
        let n = polygon.len();
        for k in 0..n {
            let corner = polygon[k];
            // Bit patterns as keys, since equal positions come from the same computation; adding zero turns
            // −0 into 0.
            let key = corner.at.map(|x| (x + 0.0).to_bits());
            if *seen.entry(key).or_insert(corner.vertex) != corner.vertex {
                let (before, behind) = (polygon[(k + n - 1) % n].at, polygon[(k + 1) % n].at);
                let run = [behind[0] - before[0], behind[1] - before[1]];
                let inward = [0, 1].map(|c| (before[c] + behind[c]) / 2.0 - corner.at[c]);
                let is_straight = (run[0] * inward[1] - run[1] * inward[0]).abs()
                    < 1e-6 * (run[0] * run[0] + run[1] * run[1]);
                let to = if is_straight { [-left * run[1] / 2.0, left * run[0] / 2.0] } else { inward };
                polygon[k].at = [0, 1].map(|c| corner.at[c] + 1e-7 * to[c]);
            }
        }
    }
}
