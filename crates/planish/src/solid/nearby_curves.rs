//! Curves of a view near a point, found by a search tree.
//!
//! In: a view. Out: the curves that may come within a distance of a point. Not guaranteed: an answer after
//! [`MAX_VISITS`] visits. Near misses are hints for the user, which may be incomplete.

use planish_core::DVec3;
use planish_mesh::FacetTree;
use planish_solid::views::{Curve2, View};
use std::cell::Cell;

/// Maximum number of straight pieces of a view; each takes about 100 bytes.
const MAX_PIECES: usize = 500_000;
/// Maximum number of pieces that all searches visit. It bounds the time to a second where all curves meet.
const MAX_VISITS: usize = 50_000_000;
/// Distance of an arc from the polygon through its points, relative to its radius (half of 3.75° per chord).
const CHORD_ERROR: f64 = 1e-3;

/// The curves of a view in a search tree.
pub(super) struct NearbyCurves {
    tree: FacetTree,
    curve_of_piece: Vec<u32>,
    reach: f64,
    visits: Cell<usize>,
}

impl NearbyCurves {
    /// Prepares the search within the distance `reach`; none for a view without pieces, or with too many.
    pub(super) fn new(view: &View, reach: f64) -> Option<Self> {
        let mut pieces: Vec<[DVec3; 2]> = Vec::new();
        let mut curve_of_piece = Vec::new();
        let mut bulge: f64 = 0.0;
        for (curve, drawn) in view.curves.iter().enumerate() {
            if let Curve2::Arc { radius, .. } = &drawn.curve {
                bulge = bulge.max(CHORD_ERROR * radius);
            }
            let at = |p: [f64; 2]| DVec3::new(p[0], p[1], 0.0);
            pieces.extend(drawn.curve.points().windows(2).map(|p| [at(p[0]), at(p[1])]));
            if pieces.len() > MAX_PIECES {
                return None;
            }
            curve_of_piece.resize(pieces.len(), curve as u32);
        }
        if pieces.is_empty() || pieces.iter().flatten().any(|p| !p.is_finite()) {
            return None;
        }
        let tree = FacetTree::new(pieces.len(), |k| [pieces[k][0], pieces[k][1], pieces[k][1]]);
        Some(Self { tree, curve_of_piece, reach: reach + bulge, visits: Cell::new(0) })
    }

    /// Indices of curves that may come within reach of a point on the curve `own`, without this one;
    /// ascending. None if the searches have taken too long.
    pub(super) fn around(&self, [x, y]: [f64; 2], own: usize) -> Option<Vec<usize>> {
        if self.visits.get() > MAX_VISITS {
            return None;
        }
        let mut found = Vec::new();
        let mut visits = 0;
        // The own curve has distance zero, so the slack is the whole distance.
        self.tree.visit_near(DVec3::new(x, y, 0.0), self.reach, |near| {
            visits += 1;
            let curve = self.curve_of_piece[near.facet as usize] as usize;
            if curve != own && near.distance <= self.reach {
                found.push(curve);
            }
        });
        self.visits.set(self.visits.get() + visits);
        found.sort_unstable();
        found.dedup();
        Some(found)
    }
}
