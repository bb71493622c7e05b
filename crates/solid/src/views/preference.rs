//! Preferences of the search: equal features, no cylinder where a surface of revolution is in the same box,
//! and no hidden edge that is not drawn.
//!
//! A view without hidden lines leaves open where faces end that it does not show. The search first looks for
//! solids with few such faces: a hole goes through rather than ends at any level of the drawing.
//!
//! A row of equal holes has one image in the view along the row, and one of the holes explains it: nine
//! countersunk holes in three rows may be six dimples and three holes. Output of [`patterns`]: pairs of cells
//! at the same place of two equal circles of a view. Engineers draw equal circles for equal features, so both
//! cells first have the same state.
//!
//! A half circle above a circle may be half a ball, two crossing cylinders, or either of them in each
//! quarter. Four domes thus give hundreds of solids, more than the search enumerates. Input: cells. Output:
//! for each circle of a view, pairs of cells on both sides of its cylinder, in the boxes that contain a
//! surface of revolution. The search first gives both cells of a pair the same state, so the cylinder is not
//! used.

use super::cells::{Cells, pieces_in};
use super::drawing_grid::{ViewGrid, stretches};
use super::profile::Profile;
use planish_core::DVec3;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

/// Positions of samples along a piece and along the line of sight, as shares.
const SHARES: [f64; 4] = [0.07, 0.31, 0.64, 0.92];

/// Distance from the sides of a square at which cells on both sides are compared, in radii of the circle in
/// it.
const CORNER: f64 = 1e-3;
/// Places along a side of the square, in radii from its middle. At these, the circle is farther from the side
/// than [`CORNER`].
const BESIDE_CIRCLE: [f64; 6] = [0.1, 0.26, 0.43, 0.61, 0.82, 0.97];

/// Cells that have equal states if a cylinder is not used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Preference {
    /// Cells on both sides of the cylinder.
    pub(crate) pairs: Vec<[u32; 2]>,
}

/// Maximum number of preferences for undrawn faces; with more, those of one grid plane are one preference.
const MAX_UNDRAWN: usize = 500;

/// A preference for each pair of cells whose common face would have hidden edges that are not drawn.
fn undrawn_faces(cells: &Cells) -> Vec<Preference> {
    let pairs = cells.undrawn_faces();
    if pairs.len() <= MAX_UNDRAWN {
        let single: BTreeSet<[u32; 2]> = pairs.into_iter().map(|(.., pair)| pair).collect();
        return single.into_iter().map(|pair| Preference { pairs: vec![pair] }).collect();
    }
    let mut planes: BTreeMap<(usize, usize), Vec<[u32; 2]>> = BTreeMap::new();
    pairs.into_iter().for_each(|(axis, at, pair)| planes.entry((axis, at)).or_default().push(pair));
    planes.into_values().map(|pairs| Preference { pairs }).collect()
}

/// Preferences for round features where a circle is a candidate: between the circle and the square around it
/// is the material of its surroundings. One for each circle and interval along its axis.
fn round_candidates(cells: &Cells) -> Vec<Preference> {
    let plan = cells.plan;
    let mut found = Vec::new();
    for shown in plan.views.iter().filter(|view| view.is_candidates) {
        let [right, up, along] = shown.kind.axes();
        for carrier in &shown.carriers {
            let Profile::Circle { center, radius } = carrier.profile else { continue };
            for ends in plan.grid[along].windows(2) {
                let at = |x: f64, y: f64| {
                    let mut p = DVec3::ZERO;
                    p[right] = center[0] + radius * x;
                    p[up] = center[1] + radius * y;
                    p[along] = (ends[0] + ends[1]) / 2.0;
                    cells.at(p)
                };
                // Along the four sides of the square around the circle, on both of their sides.
                let mut pairs: Vec<[u32; 2]> = BESIDE_CIRCLE
                    .into_iter()
                    .flat_map(|u| [u, -u])
                    .flat_map(|u| [1.0, -1.0].map(|side| (u, side)))
                    .flat_map(|(u, side)| {
                        let [inner, outer] = [side * (1.0 - CORNER), side * (1.0 + CORNER)];
                        [[at(u, inner), at(u, outer)], [at(inner, u), at(outer, u)]]
                    })
                    .collect();
                pairs.retain(|[a, b]| a != b);
                pairs.sort_unstable();
                pairs.dedup();
                if !pairs.is_empty() {
                    found.push(Preference { pairs });
                }
            }
        }
    }
    found
}

/// Circles about one centre that are drawn as a whole: the radii, ascending.
struct Concentric {
    center: [f64; 2],
    radii: Vec<f64>,
}

/// The whole circles of a view by their centres.
fn concentric_circles(shown: &ViewGrid, tolerance: f64) -> Vec<Concentric> {
    let mut found: Vec<Concentric> = Vec::new();
    for carrier in &shown.carriers {
        let Profile::Circle { center, radius } = carrier.profile else {
            continue;
        };
        let gap = 10.0 * tolerance / radius;
        let is_whole = stretches(&carrier.runs, gap).iter().any(|s| s[1] - s[0] > TAU - gap);
        if !is_whole {
            continue;
        }
        match found.iter_mut().find(|c| crate::drawing::distance(c.center, center) < 10.0 * tolerance) {
            Some(known) => known.radii.push(radius),
            None => found.push(Concentric { center, radii: vec![radius] }),
        }
    }
    found.iter_mut().for_each(|c| c.radii.sort_by(f64::total_cmp));
    found
}

/// Preferences for equal states of the cells within equal circles of a view: one for each pair of
/// neighbouring circles and each interval of the grid along the line of sight.
fn patterns(cells: &Cells) -> Vec<Preference> {
    let plan = cells.plan;
    let mut found = Vec::new();
    for shown in &plan.views {
        let along = shown.kind.axes()[2];
        let circles = concentric_circles(shown, plan.tolerance);
        for (index, first) in circles.iter().enumerate() {
            let equal = |other: &&Concentric| {
                let near = |(a, b): (&f64, &f64)| (a - b).abs() < 10.0 * plan.tolerance;
                other.radii.len() == first.radii.len() && other.radii.iter().zip(&first.radii).all(near)
            };
            // Each circle is paired with the next equal one only: equality is transitive.
            let Some(second) = circles[index + 1..].iter().find(equal) else {
                continue;
            };
            for interval in 1..plan.intervals(along) - 1 {
                let pairs = pairs_within(cells, shown, [first, second], interval);
                if !pairs.is_empty() {
                    found.push(Preference { pairs: pairs.into_iter().collect() });
                }
            }
        }
    }
    found
}

/// Cells at the same places within two groups of equal circles, in an interval along the line of sight.
fn pairs_within(
    cells: &Cells,
    shown: &ViewGrid,
    groups: [&Concentric; 2],
    interval: usize,
) -> BTreeSet<[u32; 2]> {
    // Two angles in each quarter, none of them on a line of symmetry.
    const ANGLES: usize = 8;
    let [right, up, along] = shown.kind.axes();
    let [from, to] = [0, 1].map(|k| cells.plan.grid[along][interval + k]);
    let mut pairs = BTreeSet::new();
    for (k, outer) in groups[0].radii.iter().enumerate() {
        let inner = if k == 0 { 0.0 } else { groups[0].radii[k - 1] };
        for (s, t) in SHARES.into_iter().flat_map(|s| SHARES.map(|t| (s, t))) {
            let radius = inner + s * (outer - inner);
            for turn in 0..ANGLES {
                let (sin, cos) = (TAU * (turn as f64 + 0.437) / ANGLES as f64).sin_cos();
                let pair = groups.map(|group| {
                    let mut p = DVec3::ZERO;
                    p[right] = group.center[0] + radius * cos;
                    p[up] = group.center[1] + radius * sin;
                    p[along] = from + t * (to - from);
                    cells.at(p)
                });
                if pair[0] != pair[1] {
                    pairs.insert(pair);
                }
            }
        }
    }
    pairs
}

/// All preferences of a search.
pub(crate) struct Preferences {
    /// Round features instead of square ones, and few faces with hidden edges that are not drawn.
    pub(crate) undrawn: Vec<Preference>,
    /// Equal features.
    pub(crate) patterns: Vec<Preference>,
    /// Surfaces of revolution instead of cylinders.
    pub(crate) surfaces: Vec<Preference>,
}

impl Preferences {
    pub(crate) fn of_cells(cells: &Cells) -> Self {
        Self {
            undrawn: [round_candidates(cells), undrawn_faces(cells)].concat(),
            patterns: patterns(cells),
            surfaces: surfaces(cells),
        }
    }
}

/// A preference for each circle of a view, and for each slanted line beside candidates of circles; none if
/// there are no surfaces of revolution.
fn surfaces(cells: &Cells) -> Vec<Preference> {
    let plan = cells.plan;
    // Oblique walls are not combined with surfaces of revolution, so there is nothing to prefer.
    if plan.walls.is_empty() || plan.has_oblique_walls() {
        return Vec::new();
    }
    let has_candidates = plan.views.iter().any(|view| view.is_candidates);
    let mut pairs: BTreeMap<(usize, usize), Vec<[u32; 2]>> = BTreeMap::new();
    let n = [0, 1, 2].map(|a| plan.intervals(a));
    for place in 0..n[0] * n[1] * n[2] {
        let cell = [place / (n[1] * n[2]), place / n[2] % n[1], place % n[2]];
        if plan.walls_in(cell).is_empty() {
            continue;
        }
        let (lo, hi) = plan.bounds(cell);
        for (view, shown) in plan.views.iter().enumerate() {
            let [right, up, along] = shown.kind.axes();
            for &index in pieces_in(plan, view, cell) {
                let piece = &shown.pieces[index as usize];
                let profile = shown.profile(index);
                // Where a circle is a candidate, a pyramid could be in the place of a cone.
                if !has_candidates && !matches!(profile, Profile::Circle { .. }) {
                    continue;
                }
                for s in SHARES {
                    let at = profile.point(piece.from + s * (piece.to - piece.from));
                    let normal = profile.normal(at);
                    for t in SHARES {
                        let sides = [-1.0, 1.0].map(|sign| {
                            let mut p = DVec3::ZERO;
                            p[right] = at[0] + sign * 1e-6 * plan.size * normal[0];
                            p[up] = at[1] + sign * 1e-6 * plan.size * normal[1];
                            p[along] = lo[along] + t * (hi[along] - lo[along]);
                            cells.at(p)
                        });
                        let known = pairs.entry((view, piece.carrier)).or_default();
                        if sides[0] != sides[1] && !known.contains(&sides) {
                            known.push(sides);
                        }
                    }
                }
            }
        }
    }
    pairs.into_values().filter(|pairs| !pairs.is_empty()).map(|pairs| Preference { pairs }).collect()
}
