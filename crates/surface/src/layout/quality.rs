//! How far a layout with creases is from a good one.

use super::Layout;
use super::network::CreaseNetwork;
use std::collections::BTreeSet;

/// A crease is lost if it is farther than this from all of its creases in the layout, as a share of a quad's
/// side.
const MAX_GAP: f64 = 0.6;
/// Defect of a quad that is folded, or turned over beside its neighbour.
const FOLDED: f64 = 50.0;
/// Defect of a corner of nearly 180°, and the sine below which it is one.
const STRAIGHT: f64 = 10.0;
const MIN_SINE: f64 = 0.1;
/// Least cosine between normals of neighbours without a crease between them.
const MIN_COSINE: f64 = -0.2;

/// What is wrong with a layout.
#[derive(Debug, Clone, Copy)]
pub(super) struct Defects {
    /// Number of vertices without a uniform spline.
    special: usize,
    /// Sum over quads on which a surface folds.
    folds: f64,
    pub(super) loses_creases: bool,
}

impl Defects {
    pub(super) fn is_better_than(&self, other: &Self) -> bool {
        let rank = |own: &Self| (own.loses_creases, own.special as f64 + own.folds);
        rank(self) < rank(other)
    }

    pub(super) fn has_folds(&self) -> bool {
        self.folds > 0.0 || self.loses_creases
    }

    pub(super) fn is_regular(&self) -> bool {
        self.special == 0 && !self.has_folds()
    }
}

/// Measures a layout of a part of a mesh.
pub(super) fn defects(layout: &Layout, network: &CreaseNetwork, side: f64) -> Defects {
    let domain = &layout.domain;
    let corners = |q: usize| domain.cells()[q].map(|v| layout.positions[v as usize]);
    let normal = |q: usize| {
        let [a, b, c, d] = corners(q);
        (c - a).cross(d - b).normalize_or_zero()
    };
    let mut special: BTreeSet<u32> = BTreeSet::new();
    let mut folds = 0.0;
    for (q, quad) in domain.cells().iter().enumerate() {
        let (own, at) = (normal(q), corners(q));
        let mut is_folded = false;
        for k in 0..4 {
            let [x, y] = [1, 3].map(|j| (at[(k + j) % 4] - at[k]).normalize_or_zero());
            let sine = x.cross(y).dot(own);
            is_folded |= sine <= 0.0;
            // Small angles are no harm: creases may meet at them.
            if sine < MIN_SINE && x.dot(y) < 0.0 {
                folds += STRAIGHT;
            }
            if domain.is_extraordinary_corner(q, k) {
                special.insert(quad[k]);
            }
            let over = domain.neighbour(q as u32, k as u32);
            is_folded |= !domain.is_crease([quad[k], quad[(k + 1) % 4]])
                && over.is_some_and(|(over, _)| own.dot(normal(over as usize)) < MIN_COSINE);
        }
        if is_folded {
            folds += FOLDED;
        }
    }
    let loses_creases = network.largest_gap(layout) > MAX_GAP * side;
    Defects { special: special.len(), folds, loses_creases }
}
