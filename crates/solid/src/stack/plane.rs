//! Sections in the plane: directed boundaries, and where two of them differ.

use super::SectionLoop;
use planish_estimate::{Error, Result};
use std::f64::consts::TAU;

/// Points of all sections; points that coincide are one.
pub(super) struct Points {
    at: Vec<[f64; 2]>,
    tolerance: f64,
}

impl Points {
    pub(super) fn new(tolerance: f64) -> Self {
        Self { at: Vec::new(), tolerance }
    }

    pub(super) fn at(&self, index: usize) -> [f64; 2] {
        self.at[index]
    }

    /// The index of a point, which is added if it is new.
    fn index(&mut self, p: [f64; 2]) -> usize {
        let same = self.at.iter().position(|q| distance(*q, p) <= self.tolerance);
        same.unwrap_or_else(|| {
            self.at.push(p);
            self.at.len() - 1
        })
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The curve of a piece of a boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum AtomCurve {
    Line,
    /// Counter-clockwise.
    Arc {
        center: [f64; 2],
        radius: f64,
        from_rad: f64,
        sweep_rad: f64,
    },
}

/// A piece of a boundary between two points (or from one back to it).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Atom {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) curve: AtomCurve,
}

impl Atom {
    /// The point at a share of the piece.
    fn point(&self, share: f64, points: &Points) -> [f64; 2] {
        match self.curve {
            AtomCurve::Line => {
                let (a, b) = (points.at(self.from), points.at(self.to));
                [0, 1].map(|k| a[k] + share * (b[k] - a[k]))
            }
            AtomCurve::Arc { center, radius, from_rad, sweep_rad } => {
                let (sin, cos) = (from_rad + share * sweep_rad).sin_cos();
                [center[0] + radius * cos, center[1] + radius * sin]
            }
        }
    }

    /// Share of the piece at a point strictly inside it; `None` if the point is elsewhere.
    fn share(&self, p: [f64; 2], points: &Points) -> Option<f64> {
        let (share, length) = match self.curve {
            AtomCurve::Line => {
                let (a, b) = (points.at(self.from), points.at(self.to));
                let (e, length) = ([b[0] - a[0], b[1] - a[1]], distance(a, b));
                (((p[0] - a[0]) * e[0] + (p[1] - a[1]) * e[1]) / (length * length), length)
            }
            AtomCurve::Arc { center, radius, from_rad, sweep_rad } => {
                let angle = (p[1] - center[1]).atan2(p[0] - center[0]);
                ((angle - from_rad).rem_euclid(TAU) / sweep_rad, radius * sweep_rad)
            }
        };
        let margin = points.tolerance / length;
        (share > margin && share < 1.0 - margin && distance(self.point(share, points), p) <= points.tolerance)
            .then_some(share)
    }

    /// The part between two shares.
    fn part(&self, [low, high]: [f64; 2], from: usize, to: usize) -> Self {
        let curve = match self.curve {
            AtomCurve::Line => AtomCurve::Line,
            AtomCurve::Arc { center, radius, from_rad, sweep_rad } => AtomCurve::Arc {
                center,
                radius,
                from_rad: from_rad + low * sweep_rad,
                sweep_rad: (high - low) * sweep_rad,
            },
        };
        Self { from, to, curve }
    }

    /// Direction in which the piece leaves its first point, or arrives reversed at its last.
    fn tangent(&self, forward: bool, points: &Points) -> f64 {
        let step = 1e-6;
        let (a, b) = if forward { (0.0, step) } else { (1.0, 1.0 - step) };
        let (a, b) = (self.point(a, points), self.point(b, points));
        (b[1] - a[1]).atan2(b[0] - a[0])
    }
}

/// A piece of a boundary with material on its left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) curve: AtomCurve,
    /// Whether it runs along its curve.
    pub(super) forward: bool,
}

impl Piece {
    pub(super) fn start(&self) -> usize {
        if self.forward { self.from } else { self.to }
    }

    pub(super) fn end(&self) -> usize {
        if self.forward { self.to } else { self.from }
    }

    fn atom(&self) -> Atom {
        Atom { from: self.from, to: self.to, curve: self.curve }
    }
}

/// An atom of an interface in one direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Directed {
    pub(super) atom: usize,
    pub(super) forward: bool,
}

impl Directed {
    fn ends(self, atoms: &[Atom]) -> [usize; 2] {
        let Atom { from, to, .. } = atoms[self.atom];
        if self.forward { [from, to] } else { [to, from] }
    }
}

/// A section as its boundary.
#[derive(Debug, Clone, Default)]
pub(super) struct Region {
    pub(super) pieces: Vec<Piece>,
}

/// Extreme points of a loop, for its extent.
pub(super) fn extremes(one: &SectionLoop) -> Vec<[f64; 2]> {
    match one {
        SectionLoop::Circle { center: [x, y], radius } => {
            vec![[x - radius, y - radius], [x + radius, y + radius]]
        }
        SectionLoop::Outline { vertices, .. } => vertices.clone(),
    }
}

/// Number of chords of an arc in tests of containment.
const CHORDS: usize = 48;

fn polyline(atoms: &[Atom], points: &Points) -> Vec<[[f64; 2]; 2]> {
    let mut chords = Vec::new();
    for atom in atoms {
        let count = if atom.curve == AtomCurve::Line { 1 } else { CHORDS };
        let at = |k: usize| atom.point(k as f64 / count as f64, points);
        chords.extend((0..count).map(|k| [at(k), at(k + 1)]));
    }
    chords
}

/// True if a point is inside the closed curves of chords (even–odd rule).
fn is_inside(p: [f64; 2], chords: &[[[f64; 2]; 2]]) -> bool {
    let crossings = chords.iter().filter(|[a, b]| {
        (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    });
    crossings.count() % 2 == 1
}

/// Twice the area of closed chords, positive if counter-clockwise.
fn double_area(chords: &[[[f64; 2]; 2]]) -> f64 {
    chords.iter().map(|[a, b]| a[0] * b[1] - a[1] * b[0]).sum()
}

impl Region {
    /// The boundary of loops. Those inside an odd number of others are holes.
    pub(super) fn new(loops: &[SectionLoop], points: &mut Points) -> Result<Self> {
        let mut each: Vec<Vec<Piece>> = Vec::new();
        for one in loops {
            each.push(pieces(one, points)?);
        }
        let chords: Vec<Vec<[[f64; 2]; 2]>> = (each.iter())
            .map(|pieces| polyline(&pieces.iter().map(Piece::atom).collect::<Vec<_>>(), points))
            .collect();
        let mut region = Self::default();
        for (k, pieces) in each.iter().enumerate() {
            let sample = pieces[0].atom().point(0.5, points);
            let depth = (0..each.len()).filter(|&j| j != k && is_inside(sample, &chords[j])).count();
            // Directed chords: those of pieces against their curve are reversed.
            let area: f64 = (pieces.iter())
                .map(|piece| {
                    let area = double_area(&polyline(&[piece.atom()], points));
                    if piece.forward { area } else { -area }
                })
                .sum();
            let is_wrong = (area > 0.0) == (depth % 2 == 1);
            let turned = |piece: &Piece| Piece { forward: piece.forward != is_wrong, ..*piece };
            match is_wrong {
                true => region.pieces.extend(pieces.iter().rev().map(turned)),
                false => region.pieces.extend(pieces),
            }
        }
        Ok(region)
    }

    fn atoms(&self) -> Vec<Atom> {
        self.pieces.iter().map(Piece::atom).collect()
    }
}

/// The pieces of a loop in its own direction.
fn pieces(one: &SectionLoop, points: &mut Points) -> Result<Vec<Piece>> {
    match one {
        SectionLoop::Circle { center, radius } => {
            let start = points.index([center[0] + radius, center[1]]);
            let curve = AtomCurve::Arc { center: *center, radius: *radius, from_rad: 0.0, sweep_rad: TAU };
            Ok(vec![Piece { from: start, to: start, curve, forward: true }])
        }
        SectionLoop::Outline { vertices, bulges } => {
            let count = vertices.len();
            if count < 2 || bulges.len() != count {
                return Err(Error::input("expected a closed outline with a bulge for each vertex"));
            }
            let indices: Vec<usize> = vertices.iter().map(|&p| points.index(p)).collect();
            let piece = |k: usize| {
                let (a, b, bulge) = (indices[k], indices[(k + 1) % count], bulges[k]);
                if bulge == 0.0 {
                    return Piece { from: a, to: b, curve: AtomCurve::Line, forward: true };
                }
                // A negative bulge turns clockwise: its curve runs the other way.
                let (from, to) = if bulge > 0.0 { (a, b) } else { (b, a) };
                let (p, q) = (points.at(from), points.at(to));
                let sweep_rad = 4.0 * bulge.abs().atan();
                let chord = distance(p, q);
                let radius = 0.5 * chord / (0.5 * sweep_rad).sin();
                let up = radius * (0.5 * sweep_rad).cos() / chord;
                let center =
                    [0.5 * (p[0] + q[0]) - up * (q[1] - p[1]), 0.5 * (p[1] + q[1]) + up * (q[0] - p[0])];
                let from_rad = (p[1] - center[1]).atan2(p[0] - center[0]);
                Piece {
                    from,
                    to,
                    curve: AtomCurve::Arc { center, radius, from_rad, sweep_rad },
                    forward: bulge > 0.0,
                }
            };
            Ok((0..count).map(piece).filter(|piece| piece.from != piece.to).collect())
        }
    }
}

/// Two sections that meet: their boundaries cut at each other's points, and where only one has material.
pub(super) struct Interface {
    pub(super) atoms: Vec<Atom>,
    /// Atoms of each piece of the lower section, in its direction.
    pub(super) lower: Vec<Vec<Directed>>,
    /// Atoms of each piece of the upper section.
    pub(super) upper: Vec<Vec<Directed>>,
    /// Boundary of the faces that look up: lower without upper.
    pub(super) above_free: Vec<Directed>,
    /// Boundary of the faces that look down, seen from above: upper without lower.
    pub(super) below_free: Vec<Directed>,
}

impl Interface {
    pub(super) fn new(lower: &Region, upper: &Region, points: &mut Points) -> Result<Self> {
        let both = [lower, upper];
        // Boundaries are cut at each other's points, and where lines cross. Points of other sections would
        // add vertices that nothing needs.
        let mut cuts: Vec<usize> = both.iter().flat_map(|r| &r.pieces).flat_map(|p| [p.from, p.to]).collect();
        for a in lower.atoms() {
            for b in upper.atoms() {
                cuts.extend(crossing(&a, &b, points).map(|p| points.index(p)));
            }
        }
        cuts.sort_unstable();
        cuts.dedup();
        let mut atoms: Vec<Atom> = Vec::new();
        let mut cut = both.map(|region| {
            let each = |piece: &Piece| cut_at_points(piece, &cuts, points, &mut atoms);
            region.pieces.iter().map(each).collect::<Vec<Vec<Directed>>>()
        });
        let [of_lower, of_upper] =
            [&cut[0], &cut[1]].map(|each| each.iter().flatten().copied().collect::<Vec<_>>());
        let chords = both.map(|region| polyline(&region.atoms(), points));
        let (mut above_free, mut below_free) = (Vec::new(), Vec::new());
        let reversed = |d: &Directed| Directed { atom: d.atom, forward: !d.forward };
        for (own, others, inside, free) in [
            (&of_lower, &of_upper, &chords[1], &mut above_free),
            (&of_upper, &of_lower, &chords[0], &mut below_free),
        ] {
            for d in own {
                match others.iter().find(|other| other.atom == d.atom) {
                    // Material of both on the same side: the wall goes on.
                    Some(other) if other.forward == d.forward => {}
                    Some(_) => free.push(*d),
                    None if !side(&atoms[d.atom], inside, points)? => free.push(*d),
                    None => {}
                }
            }
        }
        for (own, others, inside, free) in [
            (&of_upper, &of_lower, &chords[0], &mut above_free),
            (&of_lower, &of_upper, &chords[1], &mut below_free),
        ] {
            for d in own.iter().filter(|d| others.iter().all(|other| other.atom != d.atom)) {
                if side(&atoms[d.atom], inside, points)? {
                    free.push(reversed(d));
                }
            }
        }
        let upper = std::mem::take(&mut cut[1]);
        let lower = std::mem::take(&mut cut[0]);
        Ok(Self { atoms, lower, upper, above_free, below_free })
    }
}

/// Whether an atom lies inside a section.
///
/// # Errors
/// `Unsupported` if it lies on both sides: a curve crosses it.
fn side(atom: &Atom, chords: &[[[f64; 2]; 2]], points: &Points) -> Result<bool> {
    let tests = [0.07, 0.31, 0.5, 0.69, 0.93].map(|share| is_inside(atom.point(share, points), chords));
    if tests.iter().any(|test| *test != tests[0]) {
        return Err(Error::unsupported(
            "a curve of one section crosses the next, or nearly coincides with it: only lines may cross",
        ));
    }
    Ok(tests[0])
}

/// The point where two lines cross.
fn crossing(a: &Atom, b: &Atom, points: &Points) -> Option<[f64; 2]> {
    if a.curve != AtomCurve::Line || b.curve != AtomCurve::Line {
        return None;
    }
    let [p, q, r, s] = [a.from, a.to, b.from, b.to].map(|k| points.at(k));
    let (d, e, f) = ([q[0] - p[0], q[1] - p[1]], [s[0] - r[0], s[1] - r[1]], [r[0] - p[0], r[1] - p[1]]);
    let cross = d[0] * e[1] - d[1] * e[0];
    let (t, u) = ((f[0] * e[1] - f[1] * e[0]) / cross, (f[0] * d[1] - f[1] * d[0]) / cross);
    ((0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)).then(|| [p[0] + t * d[0], p[1] + t * d[1]])
}

/// Cuts a piece at the given points that lie on it; atoms that exist already are used again.
fn cut_at_points(piece: &Piece, at: &[usize], points: &Points, atoms: &mut Vec<Atom>) -> Vec<Directed> {
    let whole = piece.atom();
    let mut cuts: Vec<(f64, usize)> = (at.iter())
        .filter(|&&k| k != whole.from && k != whole.to)
        .filter_map(|&k| Some((whole.share(points.at(k), points)?, k)))
        .collect();
    cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let ends: Vec<(f64, usize)> =
        std::iter::once((0.0, whole.from)).chain(cuts).chain(std::iter::once((1.0, whole.to))).collect();
    let mut found: Vec<Directed> = (ends.windows(2))
        .map(|pair| {
            let part = whole.part([pair[0].0, pair[1].0], pair[0].1, pair[1].1);
            let middle = part.point(0.5, points);
            let is_same = |atom: &Atom| {
                let joins = (atom.from == part.from && atom.to == part.to)
                    || (atom.from == part.to && atom.to == part.from);
                joins && distance(atom.point(0.5, points), middle) <= 10.0 * points.tolerance
            };
            let atom = atoms.iter().position(is_same).unwrap_or_else(|| {
                atoms.push(part);
                atoms.len() - 1
            });
            // Lines of two sections may run against each other; arcs are counter-clockwise in both.
            let along = atoms[atom].from == part.from;
            Directed { atom, forward: piece.forward == along }
        })
        .collect();
    if !piece.forward {
        found.reverse();
    }
    found
}

/// Faces bounded by directed atoms with material on their left: for each, its outer loop and its holes.
pub(super) fn faces(
    directed: &[Directed],
    atoms: &[Atom],
    points: &Points,
) -> Result<Vec<Vec<Vec<Directed>>>> {
    let mut left: Vec<Directed> = directed.to_vec();
    let mut loops: Vec<Vec<Directed>> = Vec::new();
    while let Some(first) = left.pop() {
        let mut one = vec![first];
        let [start, mut at] = first.ends(atoms);
        while at != start {
            let last = one[one.len() - 1];
            let back = atoms[last.atom].tangent(!last.forward, points);
            // Of several ways on, the first clockwise from the way back bounds the same material.
            let turn = |d: &Directed| (back - atoms[d.atom].tangent(d.forward, points)).rem_euclid(TAU);
            let next = (0..left.len())
                .filter(|&k| left[k].ends(atoms)[0] == at)
                .min_by(|&a, &b| turn(&left[a]).total_cmp(&turn(&left[b])));
            let Some(next) = next else {
                return Err(Error::unsupported("sections nearly coincide: their boundaries do not close"));
            };
            let next = left.swap_remove(next);
            at = next.ends(atoms)[1];
            one.push(next);
        }
        loops.push(one);
    }
    let chords = |one: &[Directed]| {
        let directed = one.iter().flat_map(|d| {
            let mut chords = polyline(&[atoms[d.atom]], points);
            if !d.forward {
                chords.reverse();
                chords.iter_mut().for_each(|chord| chord.reverse());
            }
            chords
        });
        directed.collect::<Vec<_>>()
    };
    let area: Vec<f64> = loops.iter().map(|one| double_area(&chords(one))).collect();
    let outer: Vec<usize> = (0..loops.len()).filter(|&k| area[k] > 0.0).collect();
    let mut found: Vec<Vec<Vec<Directed>>> = outer.iter().map(|&k| vec![loops[k].clone()]).collect();
    for hole in (0..loops.len()).filter(|&k| area[k] <= 0.0) {
        let sample = atoms[loops[hole][0].atom].point(0.5, points);
        let around = (0..outer.len())
            .filter(|&k| is_inside(sample, &chords(&loops[outer[k]])))
            .min_by(|&a, &b| area[outer[a]].total_cmp(&area[outer[b]]));
        let Some(around) = around else {
            return Err(Error::unsupported("sections nearly coincide: a hole lies in no face"));
        };
        found[around].push(loops[hole].clone());
    }
    Ok(found)
}
