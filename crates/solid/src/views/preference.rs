//! Preferences of the search: no cylinder where a surface of revolution is in the same box, and no hidden
//! edge that is not drawn.
//!
//! A view without hidden lines leaves open where faces end that it does not show. The search first looks for
//! solids with few such faces: a hole goes through rather than ends at any level of the drawing.
//!
//! A half circle above a circle may be half a ball, two crossing cylinders, or either of them in each
//! quarter. Four domes thus give hundreds of solids, more than the search enumerates. Input: cells. Output:
//! for each circle of a view, pairs of cells on both sides of its cylinder, in the boxes that contain a
//! surface of revolution. The search first gives both cells of a pair the same state, so the cylinder is not
//! used.

use super::cells::{Cells, pieces_in};
use super::profile::Profile;
use planish_core::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// Positions of samples along a piece and along the line of sight, as shares.
const SHARES: [f64; 4] = [0.07, 0.31, 0.64, 0.92];

/// Distance from the corners of a square at which cells on both sides are compared, in radii of the circle in
/// it. The circle passes at 0.29.
const CORNER: f64 = 0.02;

/// Cells that have equal states if a cylinder is not used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Preference {
    /// Cells on both sides of the cylinder.
    pub(crate) pairs: Vec<[u32; 2]>,
}

/// Maximum number of preferences for undrawn faces; with more, those of one grid plane are one preference.
const MAX_UNDRAWN: usize = 500;

/// A preference for each pair of cells whose common face would have hidden edges that are not drawn.
pub(crate) fn undrawn_faces(cells: &Cells) -> Vec<Preference> {
    let pairs = cells.undrawn_faces();
    if pairs.len() <= MAX_UNDRAWN {
        let single: BTreeSet<[u32; 2]> = pairs.into_iter().map(|(.., pair)| pair).collect();
        return single.into_iter().map(|pair| Preference { pairs: vec![pair] }).collect();
    }
    let mut planes: BTreeMap<(usize, usize), Vec<[u32; 2]>> = BTreeMap::new();
    pairs.into_iter().for_each(|(axis, at, pair)| planes.entry((axis, at)).or_default().push(pair));
    planes.into_values().map(|pairs| Preference { pairs }).collect()
}

/// Preferences for round features where a circle is a candidate: beyond the circle, the corners of the square
/// around it are as what surrounds them. One for each circle and interval along its axis.
pub(crate) fn round_candidates(cells: &Cells) -> Vec<Preference> {
    let plan = cells.plan;
    let mut found = Vec::new();
    for shown in plan.views.iter().filter(|view| view.is_candidates) {
        let [right, up, along] = shown.kind.axes();
        for carrier in &shown.carriers {
            let Profile::Circle { center, radius } = carrier.profile else { continue };
            for ends in plan.grid[along].windows(2) {
                let mut pairs = Vec::new();
                for [x, y] in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
                    let at = |share: f64| {
                        let mut p = DVec3::ZERO;
                        p[right] = center[0] + share * radius * x;
                        p[up] = center[1] + share * radius * y;
                        p[along] = (ends[0] + ends[1]) / 2.0;
                        cells.at(p)
                    };
                    pairs.push([at(1.0 - CORNER), at(1.0 + CORNER)]);
                }
                pairs.retain(|[a, b]| a != b);
                if !pairs.is_empty() {
                    found.push(Preference { pairs });
                }
            }
        }
    }
    found
}

/// A preference for each circle of a view; none if there are no surfaces of revolution.
pub(crate) fn preferences(cells: &Cells) -> Vec<Preference> {
    let plan = cells.plan;
    // Oblique walls are not combined with surfaces of revolution, so there is nothing to prefer.
    if plan.walls.is_empty() || plan.has_oblique_walls() {
        return Vec::new();
    }
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
                if !matches!(profile, Profile::Circle { .. }) {
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
