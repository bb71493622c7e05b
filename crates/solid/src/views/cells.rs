//! Division of space into cells, each of which is either solid or empty.
//!
//! The pieces of all views divide each box of the grid. An *atom* is a part of a box with the same sign for
//! each of them. If a view shows no line between two atoms, no surface can separate them, and they are merged
//! into one cell (union–find).

use super::column::SurfaceId;
use super::drawing_grid::{DrawingGrid, ViewGrid, coordinate_counts};
use crate::drawing::Drawing;
use planish_core::{DVec3, DisjointSets};
use planish_estimate::{Error, Result};
use std::collections::{BTreeSet, HashSet};

/// Maximum number of grid boxes. It bounds run time and memory; larger drawings are rejected.
const MAX_BOXES: usize = 1_000_000;
/// Maximum number of atoms. It bounds memory; larger drawings are rejected.
const MAX_ATOMS: usize = 8_000_000;

/// Whether a solid may have faces across an axis at places that no view shows edge-on.
///
/// Only views without hidden lines leave this open. Such a face has a depth that nothing on the drawing
/// shows, as the floor of a blind hole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum UnseenFaces {
    /// A face is where at least one view that sees it edge-on draws a line. Holes go through.
    Excluded,
    /// Faces may be at any coordinate of the drawing.
    Allowed,
}

/// Space divided into cells.
pub(crate) struct Cells<'a> {
    pub(crate) plan: &'a DrawingGrid,
    unseen_faces: UnseenFaces,
    /// First atom of each box, third coordinate fastest.
    first: Vec<u32>,
    /// The cell of each atom: the smallest atom of the cell.
    cell_of_atom: Vec<u32>,
    /// Cells thicker than the tolerance somewhere; empty without candidate surfaces.
    thick: HashSet<u32>,
    /// Cells in boxes with walls in which no sample point is clear of all surfaces.
    slivers: HashSet<u32>,
}

/// Rejects a drawing whose grid would have far too many boxes, before any curve is placed on it.
///
/// The factor allows for coordinates that the grid merges; [`Cells::new`] applies the exact limit.
///
/// # Errors
/// `Unsupported` if there would be more than four times [`MAX_BOXES`].
pub(crate) fn check_size(drawing: &Drawing) -> Result<()> {
    let n = coordinate_counts(drawing);
    match n.into_iter().fold(1, usize::saturating_mul) > 4 * MAX_BOXES {
        true => Err(too_many_boxes(n)),
        false => Ok(()),
    }
}

fn too_many_boxes(n: [usize; 3]) -> Error {
    Error::unsupported(format!(
        "the drawing's lines make a grid of {} x {} x {} boxes: expected at most {MAX_BOXES}; lines that \
         end or turn at fewer places make fewer boxes",
        n[0], n[1], n[2]
    ))
}

/// True if the grid exceeds [`MAX_BOXES`].
pub(crate) fn is_too_fine(plan: &DrawingGrid) -> bool {
    (0..3).map(|a| plan.intervals(a)).product::<usize>() > MAX_BOXES
}

impl<'a> Cells<'a> {
    /// Divides space and merges atoms that no line separates.
    ///
    /// # Errors
    /// `Unsupported` if there are too many boxes or atoms.
    pub(crate) fn new(plan: &'a DrawingGrid, unseen_faces: UnseenFaces) -> Result<Self> {
        let n = [0, 1, 2].map(|a| plan.intervals(a));
        if is_too_fine(plan) {
            return Err(too_many_boxes(n));
        }
        let mut first = Vec::with_capacity(n[0] * n[1] * n[2] + 1);
        let mut total = 0_usize;
        for i in 0..n[0] {
            for j in 0..n[1] {
                for k in 0..n[2] {
                    first.push(total as u32);
                    let pieces: usize =
                        (0..plan.views.len()).map(|v| pieces_in(plan, v, [i, j, k]).len()).sum();
                    // One bit for each surface that passes through the box. Most of the 2^cuts atoms contain
                    // no point; they cost memory but are never joined. The shift is bounded, so it does not
                    // overflow before the limit below applies.
                    let cuts = pieces + plan.walls_in([i, j, k]).len();
                    total += 1_usize << cuts.min(24);
                    if total > MAX_ATOMS {
                        return Err(Error::unsupported(format!(
                            "expected a drawing that divides space into at most {MAX_ATOMS} parts, found \
                             more: simplify the drawing"
                        )));
                    }
                }
            }
        }
        let mut cells = Self {
            plan,
            unseen_faces,
            first,
            cell_of_atom: Vec::new(),
            thick: HashSet::new(),
            slivers: HashSet::new(),
        };
        let mut sets = DisjointSets::new(total);
        for axis in 0..3 {
            cells.join_across(&mut sets, axis);
        }
        cells.cell_of_atom = sets.into_roots();
        cells.find_thick();
        Ok(cells)
    }

    /// Finds the cells that are thicker than rounding errors, along lines through every box with walls.
    ///
    /// Where a wall and a drawn circle mean the same curve, rounding leaves slivers between them. A sliver
    /// counts as a cell only if the cell is thick somewhere.
    fn find_thick(&mut self) {
        const SHARES: [f64; 7] = [0.03, 0.14, 0.32, 0.51, 0.68, 0.87, 0.97];
        let plan = self.plan;
        let n = [0, 1, 2].map(|a| plan.intervals(a));
        let mut thick = HashSet::new();
        let (mut walled, mut real) = (HashSet::new(), HashSet::new());
        for place in 0..n[0] * n[1] * n[2] {
            let cell = [place / (n[1] * n[2]), place / n[2] % n[1], place % n[2]];
            let last = self.first.get(place + 1).map_or(self.cell_of_atom.len(), |next| *next as usize);
            let roots = self.cell_of_atom[self.first[place] as usize..last].iter().copied();
            // Without candidate surfaces there are no slivers.
            if plan.walls_in(cell).is_empty() {
                real.extend(roots);
                continue;
            }
            walled.extend(roots);
            let (lo, hi) = plan.bounds(cell);
            for along in 0..3 {
                let [a, b] = [(along + 1) % 3, (along + 2) % 3];
                for s in SHARES {
                    for t in SHARES {
                        let mut p = DVec3::ZERO;
                        p[a] = lo[a] + s * (hi[a] - lo[a]);
                        p[b] = lo[b] + t * (hi[b] - lo[b]);
                        let mut cuts: Vec<f64> = self.cuts(cell, along, p).into_iter().map(|c| c.0).collect();
                        cuts.extend([lo[along], hi[along]]);
                        cuts.sort_by(f64::total_cmp);
                        for pair in cuts.windows(2).filter(|c| c[1] - c[0] > 10.0 * plan.tolerance) {
                            p[along] = (pair[0] + pair[1]) / 2.0;
                            let atom = self.at_in(cell, p);
                            thick.insert(atom);
                            if !real.contains(&atom) && self.has_room(cell, p) {
                                real.insert(atom);
                            }
                        }
                    }
                }
            }
        }
        self.slivers = walled.difference(&real).copied().collect();
        self.thick = thick;
    }

    /// True if no surface in a box, and no side of the box, is near a point of it in any direction.
    fn has_room(&self, cell: [usize; 3], p: DVec3) -> bool {
        let room = 10.0 * self.plan.tolerance;
        let (lo, hi) = self.plan.bounds(cell);
        (0..3).all(|a| p[a] > lo[a] + room && p[a] < hi[a] - room) && !self.is_near_cut(cell, p, room)
    }

    /// True if a cell consists of slivers only, which rounding leaves where walls and other surfaces mean
    /// the same curve.
    pub(crate) fn is_sliver_only(&self, atom: u32) -> bool {
        self.slivers.contains(&atom)
    }

    /// True if an interval of a line through a box is a sliver: it is shorter than the tolerance, and its
    /// cell is nowhere thicker.
    ///
    /// Only boxes with walls have slivers. Grid lines and drawn curves are snapped to common coordinates.
    pub(crate) fn is_sliver(&self, cell: [usize; 3], length: f64, atom: u32) -> bool {
        !self.plan.walls_in(cell).is_empty() && length < self.plan.tolerance && !self.thick.contains(&atom)
    }

    /// Intersections of the line along an axis through a point with the surfaces in a box; not sorted.
    pub(crate) fn cuts(&self, cell: [usize; 3], along: usize, p: DVec3) -> Vec<(f64, SurfaceId)> {
        let plan = self.plan;
        let mut cuts: Vec<(f64, SurfaceId)> = Vec::new();
        for (v, view) in plan.views.iter().enumerate() {
            let axes = view.kind.axes();
            if axes[2] == along {
                continue;
            }
            let known = usize::from(axes[0] == along);
            let value = p[axes[known]];
            for &piece in pieces_in(plan, v, cell) {
                let id = SurfaceId::Carrier(v, view.pieces[piece as usize].carrier);
                let crossings = view.profile(piece).crossings(known, value, 0.0);
                cuts.extend(crossings.into_iter().map(|depth| (depth, id)));
            }
        }
        let walls = self.wall_crossings(cell, along, p);
        cuts.extend(walls.into_iter().map(|(depth, wall)| (depth, SurfaceId::Wall(wall))));
        let (lo, hi) = (plan.grid[along][cell[along]], plan.grid[along][cell[along] + 1]);
        cuts.retain(|c| c.0 > lo && c.0 < hi);
        cuts
    }

    /// The atom of a point in a box: one bit for the sign of each surface in the box.
    ///
    /// The order of the bits (views, pieces, walls) must be the same as when the atoms were counted.
    fn atom(&self, cell: [usize; 3], p: DVec3) -> u32 {
        let n = [1, 2].map(|a| self.plan.intervals(a));
        let mut bits = 0;
        let mut place = 0;
        for (v, view) in self.plan.views.iter().enumerate() {
            let axes = view.kind.axes();
            let q = [p[axes[0]], p[axes[1]]];
            for &piece in pieces_in(self.plan, v, cell) {
                bits |= u32::from(view.profile(piece).value(q) > 0.0) << place;
                place += 1;
            }
        }
        for &(wall, side) in self.plan.walls_in(cell) {
            bits |= u32::from(self.plan.walls[wall as usize].value_of(side, p) > 0.0) << place;
            place += 1;
        }
        self.first[(cell[0] * n[0] + cell[1]) * n[1] + cell[2]] + bits
    }

    /// The grid box that contains a point.
    pub(crate) fn box_of(&self, p: DVec3) -> [usize; 3] {
        [0, 1, 2].map(|a| self.plan.interval(a, p[a]))
    }

    /// The cell of a point. All points of a cell have the same number.
    pub(crate) fn at(&self, p: DVec3) -> u32 {
        self.cell_of_atom[self.atom(self.box_of(p), p) as usize]
    }

    /// The cell around the part, which is empty.
    pub(crate) fn outside(&self) -> u32 {
        let margin = 1e-3 * self.plan.size;
        self.at_in([0; 3], DVec3::from_array([0, 1, 2].map(|a| self.plan.grid[a][0] + margin)))
    }

    /// The cell of a point whose box is known.
    pub(crate) fn at_in(&self, cell: [usize; 3], p: DVec3) -> u32 {
        self.cell_of_atom[self.atom(cell, p) as usize]
    }

    /// Joins atoms on both sides of the grid planes across an axis, unless every view that sees the plane
    /// edge-on draws a line there.
    ///
    /// A face in the plane would be a line in each of these views, so one view without a line excludes it.
    fn join_across(&self, sets: &mut DisjointSets, axis: usize) {
        let plan = self.plan;
        let is_edge_on = |v: &usize| plan.views[*v].kind.axes()[2] != axis;
        let is_seen = (0..plan.views.len()).any(|v| is_edge_on(&v));
        let drawn_in = |is_used: &dyn Fn(&ViewGrid) -> bool| -> Vec<Drawn> {
            let views = (0..plan.views.len()).filter(|v| is_used(&plan.views[*v]));
            views.filter_map(|v| Drawn::new(plan, v, axis)).collect()
        };
        // In a view without hidden lines, a missing line excludes no face.
        let drawn = drawn_in(&|view| view.shows_hidden);
        let visible = match self.unseen_faces {
            UnseenFaces::Excluded if drawn.is_empty() => {
                drawn_in(&|view| !view.is_candidates && !view.is_doubtful)
            }
            _ => Vec::new(),
        };
        let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
        for at in 1..plan.grid[axis].len() - 1 {
            for i in 0..plan.intervals(a) {
                for j in 0..plan.intervals(b) {
                    let covers = |d: &Drawn| d.covers(at, if d.other == a { i } else { j });
                    let is_unseen = !visible.is_empty() && !visible.iter().any(covers);
                    if is_unseen || !drawn.iter().all(covers) || !is_seen {
                        self.each_pair(axis, at, [i, j], |first, second| {
                            sets.join(first, second);
                        });
                    }
                }
            }
        }
    }

    /// Cells on both sides of places of grid planes at which a view without hidden lines draws no line. A
    /// face there would have hidden edges in this view. Each pair is listed once, by axis and grid plane.
    pub(crate) fn undrawn_faces(&self) -> BTreeSet<(usize, usize, [u32; 2])> {
        let plan = self.plan;
        let mut found = BTreeSet::new();
        for axis in 0..3 {
            let drawn: Vec<Drawn> = (0..plan.views.len())
                .filter(|v| !plan.views[*v].shows_hidden && !plan.views[*v].is_candidates)
                .filter_map(|v| Drawn::new(plan, v, axis))
                .collect();
            let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
            for at in (1..plan.grid[axis].len() - 1).filter(|_| !drawn.is_empty()) {
                for i in 0..plan.intervals(a) {
                    for j in 0..plan.intervals(b) {
                        if drawn.iter().all(|d| d.covers(at, if d.other == a { i } else { j })) {
                            continue;
                        }
                        self.each_pair(axis, at, [i, j], |first, second| {
                            let cells = [first, second].map(|atom| self.cell_of_atom[atom as usize]);
                            if cells[0] != cells[1] {
                                found.insert((axis, at, cells));
                            }
                        });
                    }
                }
            }
        }
        found
    }

    /// True if a point is so near a surface of its box that rounding may put it on either side.
    fn near_piece(&self, cell: [usize; 3], p: DVec3) -> bool {
        self.is_near_cut(cell, p, 0.1 * self.plan.tolerance)
    }

    /// True if a piece or a wall of a box is nearer to a point than a distance.
    fn is_near_cut(&self, cell: [usize; 3], p: DVec3, near: f64) -> bool {
        let at_piece = self.plan.views.iter().enumerate().any(|(v, view)| {
            let axes = view.kind.axes();
            let q = [p[axes[0]], p[axes[1]]];
            pieces_in(self.plan, v, cell).iter().any(|n| view.profile(*n).value(q).abs() < near)
        });
        let walls = self.plan.walls_in(cell);
        at_piece
            || walls.iter().any(|&(wall, side)| self.plan.walls[wall as usize].value_of(side, p).abs() < near)
    }

    /// Intersections of the line along an axis through a point with the walls of a box.
    pub(crate) fn wall_crossings(&self, cell: [usize; 3], along: usize, p: DVec3) -> Vec<(f64, usize)> {
        let mut found = Vec::new();
        for &(wall, side) in self.plan.walls_in(cell) {
            let crossings = self.plan.walls[wall as usize].crossings(side, along, p, 0.0);
            found.extend(crossings.into_iter().map(|at| (at, wall as usize)));
        }
        found
    }

    /// Coordinates along one axis at which surfaces edge-on along the third axis cross a plane in some
    /// boxes. Includes the ends of the boxes; ascending.
    fn sections(&self, boxes: &[[usize; 3]], axis: usize, value: f64, along: usize) -> Vec<f64> {
        let cell = boxes[0][along];
        let ends = [self.plan.grid[along][cell], self.plan.grid[along][cell + 1]];
        let mut cuts = ends.to_vec();
        for (v, view) in self.plan.views.iter().enumerate() {
            let axes = view.kind.axes();
            if axes[2] == axis || axes[2] == along {
                continue;
            }
            let known = usize::from(axes[1] == axis);
            for &piece in boxes.iter().flat_map(|b| pieces_in(self.plan, v, *b)) {
                cuts.extend(view.profile(piece).crossings(known, value, 0.0));
            }
        }
        within(cuts, &ends)
    }

    /// True if the view along an axis has pieces in a box.
    fn has_pieces(&self, cell: [usize; 3], axis: usize) -> bool {
        (0..self.plan.views.len())
            .any(|v| self.plan.views[v].kind.axes()[2] == axis && !pieces_in(self.plan, v, cell).is_empty())
    }

    /// Intersections of the pieces of a box, seen along an axis, with the line at `x` on axis `a`.
    fn crossed(&self, cell: [usize; 3], axis: usize, a: usize, x: f64) -> Vec<f64> {
        let mut cuts = Vec::new();
        for (v, view) in self.plan.views.iter().enumerate() {
            let axes = view.kind.axes();
            if axes[2] != axis {
                continue;
            }
            let known = usize::from(axes[1] == a);
            for &piece in pieces_in(self.plan, v, cell) {
                cuts.extend(view.profile(piece).crossings(known, x, 0.0));
            }
        }
        cuts
    }

    /// Lists the atoms on both sides of each part of a grid plane between two boxes, which are in the
    /// intervals `[i, j]` of the next two axes.
    ///
    /// The plane is divided where surfaces cross it.
    fn each_pair(&self, axis: usize, at: usize, [i, j]: [usize; 2], mut list: impl FnMut(u32, u32)) {
        let plan = self.plan;
        let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
        let mut before = [0; 3];
        (before[axis], before[a], before[b]) = (at - 1, i, j);
        let mut behind = before;
        behind[axis] = at;
        // The usual case: each box is one atom.
        let plain = |cell| is_plain(plan, cell);
        if plain(before) && plain(behind) {
            let place = |c: [usize; 3]| (c[0] * plan.intervals(1) + c[1]) * plan.intervals(2) + c[2];
            list(self.first[place(before)], self.first[place(behind)]);
            return;
        }
        let value = plan.grid[axis][at];
        let mut across_a = self.sections(&[before, behind], axis, value, a);
        let across_b = self.sections(&[before, behind], axis, value, b);
        let curved = self.has_pieces(before, axis) || self.has_pieces(behind, axis);
        // Sections of surfaces parallel to the plane's sides divide it into rectangles, for which one sample
        // is enough. Curved sections start and end anywhere, so each strip is sampled at several places.
        let walled = [before, behind].iter().any(|c| !plan.walls_in(*c).is_empty());
        let curved = curved || walled;
        if walled {
            let mut p = DVec3::ZERO;
            p[axis] = value;
            // Walls may enter a strip through its ends; their crossings there are cuts as well.
            for border in [across_b[0], across_b[across_b.len() - 1]] {
                p[b] = border;
                for cell in [before, behind] {
                    across_a.extend(self.wall_crossings(cell, a, p).into_iter().map(|c| c.0));
                }
            }
            let ends = [plan.grid[a][before[a]], plan.grid[a][before[a] + 1]];
            across_a = within(across_a, &ends);
        }
        // Cuts closer than the accuracy of the drawing are the same cut. A sample between them would join
        // atoms that exist only by rounding.
        let min_distance = 2.0 * plan.tolerance;
        for x in samples(&across_a, if curved { 5 } else { 1 }, min_distance) {
            let mut cuts = across_b.clone();
            for cell in [before, behind] {
                cuts.extend(self.crossed(cell, axis, a, x));
                let mut p = DVec3::ZERO;
                (p[axis], p[a]) = (value, x);
                cuts.extend(self.wall_crossings(cell, b, p).into_iter().map(|c| c.0));
            }
            for y in samples(&within(cuts, &across_b), 1, min_distance) {
                let mut p = DVec3::ZERO;
                (p[a], p[b]) = (x, y);
                // On the plane itself: between a point beside it and the plane, there may be a surface that
                // touches the plane.
                p[axis] = value;
                if self.near_piece(before, p) || self.near_piece(behind, p) {
                    continue;
                }
                list(self.atom(before, p), self.atom(behind, p));
            }
        }
    }
}

/// Keeps the cuts from the first to the last of `ends`, inclusive, and sorts them.
fn within(mut cuts: Vec<f64>, ends: &[f64]) -> Vec<f64> {
    let (lo, hi) = (ends[0], ends[ends.len() - 1]);
    cuts.retain(|c| *c >= lo && *c <= hi);
    cuts.sort_by(f64::total_cmp);
    cuts
}

/// One or five values between each two neighbours that are farther apart than `min_distance`.
fn samples(cuts: &[f64], each: usize, min_distance: f64) -> Vec<f64> {
    // Not symmetric and not simple fractions: symmetric parts have surfaces exactly at such places.
    let shares: &[f64] = if each > 1 { &[0.021, 0.237, 0.487, 0.763, 0.979] } else { &[0.487] };
    cuts.windows(2)
        .filter(|c| c[1] - c[0] > min_distance)
        .flat_map(|c| shares.iter().map(|s| c[0] + s * (c[1] - c[0])))
        .collect()
}

/// True if no piece and no wall passes through a box.
pub(crate) fn is_plain(plan: &DrawingGrid, cell: [usize; 3]) -> bool {
    plan.walls_in(cell).is_empty() && (0..plan.views.len()).all(|v| pieces_in(plan, v, cell).is_empty())
}

/// The pieces of a view that pass through a box.
pub(crate) fn pieces_in(plan: &DrawingGrid, view: usize, cell: [usize; 3]) -> &[u32] {
    let axes = plan.views[view].kind.axes();
    plan.views[view].pieces_of([cell[axes[0]], cell[axes[1]]], plan.intervals(axes[1]))
}

/// Intervals of the grid lines of one axis that a view draws.
struct Drawn {
    /// The axis along which the lines run.
    other: usize,
    /// By grid line and interval.
    covered: Vec<Vec<bool>>,
}

impl Drawn {
    /// `None` if the view does not see planes across the axis edge-on.
    fn new(plan: &DrawingGrid, view: usize, axis: usize) -> Option<Self> {
        let view = &plan.views[view];
        let axes = view.kind.axes();
        let k = (0..2).find(|&k| axes[k] == axis)?;
        let other = axes[1 - k];
        let covered = view.lines[k]
            .iter()
            .map(|runs| {
                plan.grid[other]
                    .windows(2)
                    .map(|g| {
                        let middle = (g[0] + g[1]) / 2.0;
                        runs.iter().any(|r| r.from <= middle && middle <= r.to)
                    })
                    .collect()
            })
            .collect();
        Some(Self { other, covered })
    }

    fn covers(&self, line: usize, interval: usize) -> bool {
        self.covered[line][interval]
    }
}
