//! Creases of a mesh whose faces change.
//!
//! A crease vertex may move or merge along its curve only, and a corner not at all. Every change asks
//! [`CreaseEdges::allows_merge`], so no crease is removed and no two become one.

use super::faces::{EdgeMap, Face, Faces};
use std::collections::HashMap;

/// Where a vertex may lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum VertexKind {
    /// Between creases.
    #[default]
    Free,
    /// On the curve with a number.
    OnCurve(u32),
    /// At the corner with a number.
    Corner(u32),
}

/// The side `2 c` or `2 c + 1` of curve `c`: that at the left of its direction, or at the right.
pub(super) type CurveSide = u32;

/// The creases of faces, and the kind of each vertex. Without creases, both are empty.
#[derive(Debug, Clone, Default)]
pub(super) struct CreaseEdges {
    /// For each directed edge on a crease, the side of its curve that lies at its left.
    pub(super) sides: EdgeMap<CurveSide>,
    pub(super) kinds: Vec<VertexKind>,
}

impl CreaseEdges {
    pub(super) fn is_empty(&self) -> bool {
        self.sides.is_empty()
    }

    pub(super) fn kind(&self, v: u32) -> VertexKind {
        self.kinds.get(v as usize).copied().unwrap_or_default()
    }

    pub(super) fn is_free(&self, v: u32) -> bool {
        self.kind(v) == VertexKind::Free
    }

    pub(super) fn has(&self, (a, b): (u32, u32)) -> bool {
        self.side((a, b)).is_some()
    }

    /// The number of the curve on which an edge lies.
    pub(super) fn curve(&self, edge: (u32, u32)) -> Option<u32> {
        self.side(edge).map(|side| side / 2)
    }

    /// The side of a curve at the left of an edge.
    pub(super) fn side(&self, edge: (u32, u32)) -> Option<CurveSide> {
        if self.sides.is_empty() { None } else { self.sides.get(&edge).copied() }
    }

    pub(super) fn set(&mut self, (a, b): (u32, u32), side: CurveSide) {
        self.sides.insert((a, b), side);
        self.sides.insert((b, a), side ^ 1);
    }

    fn remove(&mut self, (a, b): (u32, u32)) -> Option<CurveSide> {
        self.sides.remove(&(b, a));
        self.sides.remove(&(a, b))
    }

    /// Creases from the smaller vertex to the larger one, in ascending order.
    pub(super) fn sorted(&self) -> Vec<(u32, u32)> {
        let mut all: Vec<(u32, u32)> = self.sides.keys().copied().filter(|(a, b)| a < b).collect();
        all.sort_unstable();
        all
    }

    /// True if creases stay what they are when a vertex becomes another one.
    pub(super) fn allows_merge(&self, faces: &Faces, kept: u32, gone: u32) -> bool {
        if self.is_empty() {
            return true;
        }
        match self.kind(gone) {
            VertexKind::Free => true,
            VertexKind::Corner(_) => false,
            // Beyond the vertex, the curve must not return to the one that is kept: both edges would be one.
            VertexKind::OnCurve(curve) => {
                self.curve((kept, gone)) == Some(curve)
                    && (faces.neighbours(gone).iter()).all(|&w| {
                        w == kept
                            || !self.has((gone, w))
                            || !faces.are_joined(kept, w)
                            || !self.has((kept, w))
                    })
            }
        }
    }

    /// Moves the creases of a vertex that became another one. `near` are its former neighbours.
    pub(super) fn merged(&mut self, kept: u32, gone: u32, near: &[u32]) {
        if self.is_free(gone) {
            return;
        }
        for &w in near {
            if let Some(side) = self.remove((gone, w)).filter(|_| w != kept) {
                self.set((kept, w), side);
            }
        }
    }

    /// Puts a new vertex between the ends of a crease.
    pub(super) fn insert_vertex(&mut self, (a, b): (u32, u32), between: u32) {
        let Some(side) = self.remove((a, b)) else { return };
        self.kinds.resize((between as usize + 1).max(self.kinds.len()), VertexKind::Free);
        self.kinds[between as usize] = VertexKind::OnCurve(side / 2);
        self.set((a, between), side);
        self.set((between, b), side);
    }

    /// The same creases after vertices were numbered anew. Those without a number are [`u32::MAX`].
    pub(super) fn renumbered(&self, numbers: &[u32]) -> Self {
        if self.is_empty() {
            return Self::default();
        }
        let is_used = |v: &u32| *v != u32::MAX;
        let new = |v: u32| numbers.get(v as usize).copied().filter(is_used);
        let count = numbers.iter().filter(|v| is_used(v)).max().map_or(0, |v| *v as usize + 1);
        let mut kinds = vec![VertexKind::Free; count];
        for (old, &number) in (0_u32..).zip(numbers).filter(|(_, number)| is_used(number)) {
            kinds[number as usize] = self.kind(old);
        }
        let edges = self.sides.iter().filter_map(|(&(a, b), &side)| Some(((new(a)?, new(b)?), side)));
        Self { sides: edges.collect(), kinds }
    }
}

/// Target numbers of quads of the fans at corners: for each corner, by the side of the curve at which the fan
/// starts, counter-clockwise.
pub(super) type FanTargets = Vec<HashMap<CurveSide, usize>>;

/// The quads around a vertex between two creases, or all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Fan {
    pub(super) kind: VertexKind,
    pub(super) quads: usize,
    pub(super) target: usize,
}

/// Defect of a vertex or fan with so few quads that a spline has no angle for them.
const TOO_FEW: i64 = 100;
/// Defect of a fan that bends to the wrong side: convex with three quads, or concave with two.
const WRONG_BEND: i64 = 20;
/// Defect of a side of a smooth crease with a single quad: it would have 180°.
pub(super) const STRAIGHT_QUAD: i64 = 9;

impl Fan {
    /// The fan of a face at one of its corners.
    pub(super) fn new(faces: &Faces, creases: &CreaseEdges, targets: &FanTargets, v: u32, face: u32) -> Self {
        let kind = creases.kind(v);
        let all = faces.valence(v);
        let whole = Self { kind, quads: all, target: 4 };
        let Some(first) = (kind != VertexKind::Free).then(|| faces.face(face)).flatten() else {
            return whole;
        };
        let after = |face: Face| face.corners_from(v).nth(1);
        let before = |face: Face| face.corners_from(v).last();
        // Clockwise to the crease at which the fan starts, then counter-clockwise to its end.
        let mut start = after(first);
        let mut steps = 0;
        let side = loop {
            let Some(w) = start else { return whole };
            if let Some(side) = creases.side((v, w)) {
                break side;
            }
            steps += 1;
            if steps > all {
                return whole;
            }
            start = faces.left_of(w, v).and_then(|(_, face)| after(face));
        };
        let (mut quads, mut at) = (0, start);
        while let Some((_, face)) = at.and_then(|w| faces.left_of(v, w)) {
            quads += 1;
            at = before(face);
            if quads >= all || at.is_some_and(|w| creases.has((v, w))) {
                break;
            }
        }
        let target = match kind {
            VertexKind::Corner(number) => {
                targets.get(number as usize).and_then(|fans| fans.get(&side)).copied().unwrap_or(1)
            }
            _ => 2,
        };
        Self { kind, quads, target }
    }

    /// How far the fan is from its target if the number of its quads changes.
    pub(super) fn defect(&self, change: i64) -> i64 {
        let (quads, target) = (self.quads as i64 + change, self.target as i64);
        let own = (quads - target).pow(2);
        match self.kind {
            VertexKind::Free if quads <= 2 => TOO_FEW,
            _ if quads <= 0 => TOO_FEW,
            VertexKind::OnCurve(_) if quads == 1 => STRAIGHT_QUAD,
            VertexKind::Corner(_) if (target <= 2) != (quads <= 2) => own + WRONG_BEND,
            _ => own,
        }
    }
}
