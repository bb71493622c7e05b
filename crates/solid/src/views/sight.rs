//! Tests of visibility along drawn lines, and where a line could be drawn but is not.
//!
//! At a point of a line, one ray passes on each of its sides. Both are followed through the cells. Where
//! their depths agree at the line, the cells form a ring of sectors around a line in space
//! ([`EdgeSectors`]). The states of the sectors decide whether there is an edge or an outline: there is none
//! if all states are equal or the boundary passes through smoothly. A visible line needs an edge in front of
//! all solid cells, a hidden line only an edge behind one. Where nothing is drawn, there may be no edge.

use super::candidate_surface::Side;
use super::cells::{Cells, pieces_in};
use super::column::{Break, Column, SurfaceId};
use super::drawing_grid::{Carrier, runs_within};
use super::profile::Profile;
use crate::drawing::{Drawing, LineStyle, distance_to_segment};
use planish_core::DVec3;
use std::collections::HashMap;
use std::f64::consts::TAU;

/// Maximum distance of a point on a polygonal curve, relative to the size of the drawing.
///
/// A larger value confuses neighbouring curves; a smaller one misses curves of coarse polygons.
const ON_CURVE: f64 = 2e-5;
/// Sine of the angle below which two curves are treated as parallel.
///
/// Images of smooth curves by polygons have directions that are off by half the angle between chords.
const PARALLEL: f64 = 0.1;
/// Factor by which the distance of the rays is reduced to confirm a test.
///
/// A test counts only if both distances give the same result, which excludes rays that cross another line.
const REDUCTION: f64 = 100.0;

/// Cells arranged as sectors around a line in space.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) struct EdgeSectors {
    /// Cells around the line, in order.
    pub(crate) sectors: Vec<u32>,
    /// Pairs of half-surfaces that continue each other smoothly; half-surface `h` lies behind sector `h`.
    pub(crate) smooth: Vec<[u8; 2]>,
    /// Pairs of `smooth` that belong to two surfaces. If they bound a solid, they form a tangent edge, which
    /// some drawings show.
    pub(crate) tangent: Vec<[u8; 2]>,
}

/// What a drawing shows at a point of a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum Expected {
    /// An edge or outline, visible or hidden.
    Line(LineStyle),
    /// No edge, neither visible nor hidden.
    NoEdge,
    /// No visible edge: the view does not draw hidden ones.
    NoVisibleEdge,
    /// In a section, that the first cell is solid (hatched) or empty.
    Material(bool),
}

/// The cells along the two rays beside a point, and what is drawn there.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) struct SightTest {
    pub(crate) expected: Expected,
    /// First cell of each ray.
    pub(crate) start: [u32; 2],
    /// Rings of sectors along the line of sight, nearest first.
    pub(crate) groups: Vec<EdgeSectors>,
}

/// Position of a sight test.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SightTestPlace {
    pub(crate) view: usize,
    pub(crate) at: [f64; 2],
    /// Index of the curve drawn at this position.
    pub(crate) curve: Option<usize>,
}

/// All distinct sight tests of a drawing, each with the positions that require it.
pub(crate) struct SightTests {
    pub(crate) tests: Vec<(SightTest, Vec<SightTestPlace>)>,
    /// Index of each test. Most positions repeat a test, which then adds no clauses.
    seen: HashMap<SightTest, usize>,
}

impl SightTests {
    /// Collects the tests of every line, and of places where a line may be missing.
    pub(crate) fn at(cells: &Cells, drawing: &Drawing) -> Self {
        let mut sight_tests = Self { tests: Vec::new(), seen: HashMap::new() };
        for view in (0..cells.plan.views.len()).filter(|v| !cells.plan.views[*v].is_candidates) {
            sight_tests.along_grid(cells, view);
            sight_tests.along_pieces(cells, view);
            sight_tests.at_crossings(cells, drawing, view);
            sight_tests.at_walls(cells, drawing, view);
            sight_tests.at_hatches(cells, drawing, view);
        }
        sight_tests
    }

    /// Adds the test at a position of a view, unless nearby lines or surfaces make it unreliable.
    ///
    /// `normal` is the direction across the line, and `step` the distance of the rays from it.
    pub(super) fn add(
        &mut self,
        cells: &Cells,
        place: SightTestPlace,
        style: Option<LineStyle>,
        normal: [f64; 2],
        step: f64,
    ) {
        let shown = &cells.plan.views[place.view];
        if style.is_none() && shown.is_doubtful || is_crowded(cells, place.view, place.at, normal, 2.0 * step)
        {
            return;
        }
        let Some(sight_test) = sight_test(cells, place.view, place.at, normal, step, style) else {
            return;
        };
        // Where surfaces touch close by, rays at some distance pass on another side of them than nearer rays.
        // Such a position is skipped: a wrong test would exclude the right solid, and there are others.
        let nearer = self::sight_test(cells, place.view, place.at, normal, step / REDUCTION, style);
        if nearer.as_ref() != Some(&sight_test) {
            return;
        }
        self.add_test(sight_test, place);
    }

    /// Adds a test, or a position to a known one.
    pub(super) fn add_test(&mut self, sight_test: SightTest, place: SightTestPlace) {
        let next = self.tests.len();
        let at = *self.seen.entry(sight_test.clone()).or_insert(next);
        if at == next {
            self.tests.push((sight_test, Vec::new()));
        }
        self.tests[at].1.push(place);
    }

    /// Tests along the grid lines of a view, drawn or not.
    fn along_grid(&mut self, cells: &Cells, view: usize) {
        let plan = cells.plan;
        let shown = &plan.views[view];
        let axes = shown.kind.axes();
        for k in 0..2 {
            let (across, along) = (&plan.grid[axes[k]], &plan.grid[axes[1 - k]]);
            let busy = busy_along(cells, view, axes[k]);
            let curved = busy_along(cells, view, axes[1 - k]);
            for i in 1..across.len() - 1 {
                // The rays must stay within the neighbouring intervals of the grid.
                let step =
                    (1e-5 * plan.size).min(0.2 * (across[i] - across[i - 1]).min(across[i + 1] - across[i]));
                let at_curves = !shown.shows_hidden || busy[i - 1] || busy[i];
                for j in 0..along.len() - 1 {
                    let (lo, hi) = (along[j], along[j + 1]);
                    let samples: &[f64] = if curved[j] { &[0.13, 0.47, 0.86] } else { &[0.47] };
                    let runs =
                        runs_within(&shown.lines[k][i], lo, hi, (1e-4 * plan.size).min((hi - lo) / 4.0));
                    let mut normal = [0.0; 2];
                    normal[k] = 1.0;
                    let mut place = |from: f64, to: f64, curve| {
                        for share in samples {
                            let mut at = [0.0; 2];
                            at[k] = across[i];
                            at[1 - k] = from + (to - from) * share;
                            let (place, style): (SightTestPlace, Option<LineStyle>) = match curve {
                                Some((curve, style)) => {
                                    (SightTestPlace { view, at, curve: Some(curve) }, Some(style))
                                }
                                None => (SightTestPlace { view, at, curve: None }, None),
                            };
                            self.add(cells, place, style, normal, step);
                        }
                    };
                    for run in &runs {
                        place(run.from, run.to, Some((run.curve, run.style)));
                    }
                    // Between boxes without curves, join_across has already excluded faces at undrawn lines.
                    if runs.is_empty() && at_curves {
                        place(lo, hi, None);
                    }
                }
            }
        }
    }

    /// Tests along the drawn parts of slanted lines and circles.
    fn along_pieces(&mut self, cells: &Cells, view: usize) {
        let plan = cells.plan;
        let shown = &plan.views[view];
        for (index, piece) in shown.pieces.iter().enumerate() {
            let profile = shown.profile(index as u32);
            let extent = (0..2).map(|k| piece.range[k][1] - piece.range[k][0]).fold(0.0, f64::max);
            let step = (1e-5 * plan.size).min(0.02 * extent);
            for run in &piece.runs {
                for share in [0.13, 0.47, 0.86] {
                    let at = profile.point(run.from + (run.to - run.from) * share);
                    let place = SightTestPlace { view, at, curve: Some(run.curve) };
                    self.add(cells, place, Some(run.style), profile.normal(at), step);
                }
            }
        }
    }

    /// Tests where surfaces of the two other views cross between grid planes.
    ///
    /// Such an edge is drawn in this view as a curve that lies on no grid line and no profile, or not at all.
    fn at_crossings(&mut self, cells: &Cells, drawing: &Drawing, view: usize) {
        let plan = cells.plan;
        let [right, up, along] = plan.views[view].kind.axes();
        let sharing = |axis: usize| {
            (0..plan.views.len()).find(|v| *v != view && plan.views[*v].kind.axes()[..2].contains(&axis))
        };
        let (Some(a), Some(b)) = (sharing(right), sharing(up)) else {
            return;
        };
        // Walls divide a crossing further, so one test does not cover all of its parts.
        let shares: &[f64] = if plan.walls.is_empty() { &[0.47] } else { &[0.47, 0.16, 0.86] };
        let place = |v: usize, axis: usize| usize::from(plan.views[v].kind.axes()[1] == axis);
        let [a_at, a_depth, b_at, b_depth] =
            [place(a, right), place(a, along), place(b, up), place(b, along)];
        for i in 0..plan.intervals(right) {
            for k in 0..plan.intervals(along) {
                let mut cell = [0; 3];
                (cell[right], cell[along]) = (i, k);
                for &first in pieces_in(plan, a, cell) {
                    for j in 0..plan.intervals(up) {
                        cell[up] = j;
                        for &second in pieces_in(plan, b, cell) {
                            let (p, q) = (
                                &plan.views[a].pieces[first as usize],
                                &plan.views[b].pieces[second as usize],
                            );
                            // The depths that both pieces have; too short a range may be rounding.
                            let lo = p.range[a_depth][0].max(q.range[b_depth][0]);
                            let hi = p.range[a_depth][1].min(q.range[b_depth][1]);
                            if hi - lo < 1e-4 * plan.size {
                                continue;
                            }
                            for &share in shares {
                                let depth = lo + share * (hi - lo);
                                let point_on = |v: usize, piece: u32, known: usize, range: [f64; 2]| {
                                    let profile = plan.views[v].profile(piece);
                                    let at = profile.crossings(known, depth, 0.0).into_iter().find(|x| {
                                        *x >= range[0] - plan.tolerance && *x <= range[1] + plan.tolerance
                                    })?;
                                    let mut point = [0.0; 2];
                                    (point[known], point[1 - known]) = (depth, at);
                                    let normal = profile.normal(point);
                                    (normal[known].abs() > 1e-3)
                                        .then(|| (at, -normal[1 - known] / normal[known]))
                                };
                                let Some((u, du)) = point_on(a, first, a_depth, p.range[a_at]) else {
                                    continue;
                                };
                                let Some((w, dw)) = point_on(b, second, b_depth, q.range[b_at]) else {
                                    continue;
                                };
                                // Both slopes over the depth give the tangent of the edge in this view, and a
                                // quarter turn its normal.
                                let length = du.hypot(dw);
                                let at = [u, w];
                                if length < 1e-6 {
                                    continue;
                                }
                                let Some(style) = style_near(cells, drawing, view, at, None) else {
                                    continue;
                                };
                                let place = SightTestPlace { view, at, curve: style.map(|s| s.1) };
                                self.add(
                                    cells,
                                    place,
                                    style.map(|s| s.0),
                                    [du / length, -dw / length],
                                    1e-5 * plan.size,
                                );
                            }
                        }
                    }
                }
            }
        }
    }
}

/// The style and curve drawn at a point that lies on no surface seen edge-on.
///
/// `Some(None)` if nothing is drawn, `None` if this is uncertain: near other lines, or if curves of both
/// styles pass. With `normal`, a drawn curve must be perpendicular to it.
pub(super) fn style_near(
    cells: &Cells,
    drawing: &Drawing,
    view: usize,
    at: [f64; 2],
    normal: Option<[f64; 2]>,
) -> Option<Option<(LineStyle, usize)>> {
    let plan = cells.plan;
    let shown = &plan.views[view];
    let axes = shown.kind.axes();
    // Near grid lines and profiles, other tests decide. A polygon of a curve may be off by as much as this.
    let near = 1e-3 * plan.size;
    for k in 0..2 {
        let grid = &plan.grid[axes[k]];
        let i = grid.partition_point(|g| *g < at[k]);
        for line in [i.wrapping_sub(1), i] {
            let touches = grid.get(line).is_some_and(|g| (g - at[k]).abs() < near)
                && shown.lines[k][line].iter().any(|r| at[1 - k] > r.from - near && at[1 - k] < r.to + near);
            if touches {
                return None;
            }
        }
    }
    let on_carrier = |carrier: &Carrier| {
        // With walls, the point may lie on a carrier beyond its drawn part, where it is a valid position.
        carrier.profile.value(at).abs() < near && (plan.walls.is_empty() || is_drawn(carrier, at, near))
    };
    if shown.carriers.iter().any(on_carrier) {
        return None;
    }
    // Chains and other curves that are not the edge-on image of a surface: edges between curved faces.
    let mut found: Vec<(LineStyle, usize)> = Vec::new();
    let curves = &drawing.views[view].curves;
    // Curves of walls may approach others before they meet them. A point that is near a drawn curve but not
    // on it is therefore uncertain.
    let on = if plan.walls.is_empty() { near / 2.0 } else { ON_CURVE * plan.size };
    let rough = if plan.has_oblique_walls() { near } else { near / 2.0 };
    for &index in &shown.others {
        let points = curves[index].curve.points();
        let (far, across) = points
            .windows(2)
            .map(|p| {
                let d = [p[1][0] - p[0][0], p[1][1] - p[0][1]];
                let length = d[0].hypot(d[1]).max(f64::MIN_POSITIVE);
                let across = normal.map_or(0.0, |n| (n[0] * d[0] + n[1] * d[1]).abs() / length);
                (distance_to_segment(at, p[0], p[1]), across)
            })
            .fold((f64::MAX, 0.0), |best, p| if p.0 < best.0 { p } else { best });
        if far < on && across > PARALLEL {
            return None;
        }
        if far < on {
            found.push((curves[index].style, index));
        } else if far < rough {
            return None;
        }
    }
    match found.split_first() {
        None => Some(None),
        Some((first, rest)) if rest.iter().all(|r| r.0 == first.0) => Some(Some(*first)),
        _ => None,
    }
}

/// True if a run of a carrier is near a point on it.
fn is_drawn(carrier: &Carrier, at: [f64; 2], near: f64) -> bool {
    let t = carrier.profile.parameter(at);
    let (t, margin) = match carrier.profile {
        Profile::Circle { radius, .. } => (t.rem_euclid(TAU), near / radius),
        Profile::Line { .. } => (t, near),
    };
    let within = |t: f64| carrier.runs.iter().any(|r| t > r.from - margin && t < r.to + margin);
    within(t) || matches!(carrier.profile, Profile::Circle { .. }) && (within(t - TAU) || within(t + TAU))
}

/// Intervals of an axis in which a view other than the given one has pieces.
fn busy_along(cells: &Cells, view: usize, axis: usize) -> Vec<bool> {
    let plan = cells.plan;
    let mut found = vec![!plan.walls.is_empty(); plan.intervals(axis)];
    for (v, other) in plan.views.iter().enumerate().filter(|(v, _)| *v != view) {
        let axes = plan.views[v].kind.axes();
        let Some(k) = (0..2).find(|&k| axes[k] == axis) else {
            continue;
        };
        let columns = plan.intervals(axes[1]);
        for (at, _) in other.cells.iter().enumerate().filter(|(_, p)| !p.is_empty()) {
            found[[at / columns, at % columns][k]] = true;
        }
    }
    found
}

/// A half-surface that ends at the line of a group.
#[derive(Clone, Copy)]
enum Half {
    /// On the side of the first ray.
    Before(SurfaceId, Option<DVec3>),
    /// On the side of the second ray.
    Behind(SurfaceId, Option<DVec3>),
    /// The surface between the two rays: seen edge-on from the eye.
    Wall,
}

/// A break of a column, at the line between the two rays.
struct Limit {
    depth: f64,
    surface: SurfaceId,
    normal: Option<DVec3>,
    cell: u32,
}

/// Depth and surface normal of a break, moved from the ray to the line itself.
///
/// At the ray, surfaces that meet in the line have different depths; at the line they agree, and the breaks
/// can be grouped. Of several intersections, the one nearest to that of the ray belongs to the same branch.
fn limit(cells: &Cells, view: usize, at: [f64; 2], entry: &Break, step: f64) -> Limit {
    let plan = cells.plan;
    let kind = plan.views[view].kind;
    let [right, up, along] = kind.axes();
    let sign = if kind.depth_increases_away() { 1.0 } else { -1.0 };
    let mut normal = DVec3::ZERO;
    match entry.surface {
        SurfaceId::Grid(..) | SurfaceId::Cut => {
            normal[along] = 1.0;
            Limit { depth: entry.depth, surface: entry.surface, normal: Some(normal), cell: entry.cell }
        }
        SurfaceId::Wall(index) => {
            let wall = &plan.walls[index];
            let mut p = DVec3::ZERO;
            (p[right], p[up]) = (at[0], at[1]);
            let approximate = entry.depth * sign;
            let depth = wall
                .crossings(Side::Both, along, p, step)
                .into_iter()
                .min_by(|a, b| (a - approximate).abs().total_cmp(&(b - approximate).abs()))
                .unwrap_or(approximate);
            p[along] = depth;
            Limit {
                depth: depth * sign,
                surface: entry.surface,
                normal: Some(wall.normal_of(p)),
                cell: entry.cell,
            }
        }
        SurfaceId::Carrier(v, c) => {
            let axes = plan.views[v].kind.axes();
            let profile = &plan.views[v].carriers[c].profile;
            let known = usize::from(axes[0] == along);
            let value = if axes[known] == right { at[0] } else { at[1] };
            debug_assert!(axes[known] == right || axes[known] == up);
            let approximate = entry.depth * sign;
            let depth = profile
                .crossings(known, value, step)
                .into_iter()
                .min_by(|a, b| (a - approximate).abs().total_cmp(&(b - approximate).abs()))
                .unwrap_or(approximate);
            let mut point = [0.0; 2];
            (point[known], point[1 - known]) = (value, depth);
            let n = profile.normal(point);
            (normal[axes[0]], normal[axes[1]]) = (n[0], n[1]);
            Limit { depth: depth * sign, surface: entry.surface, normal: Some(normal), cell: entry.cell }
        }
    }
}

/// True if two surfaces have the same tangent plane, so the boundary passes from one to the other smoothly.
fn parallel(a: Option<DVec3>, b: Option<DVec3>) -> bool {
    let (Some(a), Some(b)) = (a, b) else { return false };
    (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).abs() > 1.0 - 1e-6
}

/// True if another line of the view passes so near a position that the rays beside it may be on the other
/// side of that line.
fn is_crowded(cells: &Cells, view: usize, at: [f64; 2], normal: [f64; 2], near: f64) -> bool {
    let plan = cells.plan;
    let shown = &plan.views[view];
    let axes = shown.kind.axes();
    let crosses = |k: usize| {
        let own = normal[k].abs() > 1.0 - 1e-9;
        let grid = &plan.grid[axes[k]];
        let from = grid.partition_point(|g| *g <= at[k] - near * normal[k].abs());
        let passing = grid[from..].iter().take_while(|g| **g < at[k] + near * normal[k].abs());
        passing.filter(|g| !own || (**g - at[k]).abs() > plan.tolerance).count() > 0
    };
    if crosses(0) || crosses(1) {
        return true;
    }
    let mut boxes: Vec<[usize; 2]> = Vec::new();
    for sign in [-1.0, 1.0] {
        let q = [0, 1].map(|k| at[k] + sign * near * normal[k]);
        boxes.push([0, 1].map(|k| plan.interval(axes[k], q[k])));
    }
    boxes.dedup();
    boxes.iter().any(|cell| {
        shown.pieces_of(*cell, plan.intervals(axes[1])).iter().any(|&piece| {
            let profile = shown.profile(piece);
            let n = profile.normal(at);
            let off = profile.value(at).abs();
            // The tested line itself does not count: it passes through the position in the same direction.
            let same = off < plan.tolerance && (n[0] * normal[0] + n[1] * normal[1]).abs() > 1.0 - 1e-9;
            off < near && !same
        })
    })
}

/// Follows both rays and groups their breaks to rings of sectors.
///
/// `None` where nothing is drawn and both rays pass through the same cells: no edge is possible.
fn sight_test(
    cells: &Cells,
    view: usize,
    at: [f64; 2],
    normal: [f64; 2],
    step: f64,
    style: Option<LineStyle>,
) -> Option<SightTest> {
    let plan = cells.plan;
    let column_at =
        |sign: f64| cells.column(view, [at[0] + sign * step * normal[0], at[1] + sign * step * normal[1]]);
    // Two columns on either side of the line: on the line itself, rounding would decide between cells.
    let columns: [Column; 2] = [column_at(-1.0), column_at(1.0)];
    if style.is_none() && columns[0] == columns[1] {
        return None;
    }
    let mut limits: Vec<(usize, Limit)> = Vec::new();
    for (side, column) in columns.iter().enumerate() {
        let mut last = f64::MIN;
        for entry in &column.breaks {
            let mut limit = limit(cells, view, at, entry, step);
            // Moving breaks to the line must not change their order along one ray.
            limit.depth = limit.depth.max(last);
            last = limit.depth;
            limits.push((side, limit));
        }
    }
    // Breaks closer than five tolerances belong to one line in space.
    limits.sort_by(|a, b| a.1.depth.total_cmp(&b.1.depth).then(a.0.cmp(&b.0)));
    let near = 5.0 * plan.tolerance;
    let mut now = [columns[0].start, columns[1].start];
    let start = now;
    let mut groups = Vec::new();
    let mut from = 0;
    while from < limits.len() {
        let to = (from + 1..limits.len())
            .find(|&n| limits[n].1.depth - limits[n - 1].1.depth > near)
            .unwrap_or(limits.len());
        groups.push(group(&limits[from..to], &mut now));
        from = to;
    }
    let expected = match style {
        Some(style) => Expected::Line(style),
        None if plan.views[view].shows_hidden => Expected::NoEdge,
        None => Expected::NoVisibleEdge,
    };
    Some(SightTest { expected, start, groups })
}

/// The ring of sectors of breaks with one depth. `now` are the cells of both rays before it, then behind it.
fn group(limits: &[(usize, Limit)], now: &mut [u32; 2]) -> EdgeSectors {
    let before = *now;
    let mut sides: [Vec<&Limit>; 2] = Default::default();
    for (side, limit) in limits {
        sides[*side].push(limit);
        now[*side] = limit.cell;
    }
    // Around the line: along the first ray away from the eye, to the second ray behind the line, back along
    // the second ray, and to the first ray in front of the line.
    let mut sectors = vec![before[0]];
    let mut halves: Vec<Half> = Vec::new();
    for limit in &sides[0] {
        halves.push(Half::Before(limit.surface, limit.normal));
        sectors.push(limit.cell);
    }
    halves.push(Half::Wall);
    let second: Vec<u32> =
        std::iter::once(before[1]).chain(sides[1].iter().map(|limit| limit.cell)).collect();
    for k in (0..second.len()).rev() {
        sectors.push(second[k]);
        halves.push(match k {
            0 => Half::Wall,
            _ => Half::Behind(sides[1][k - 1].surface, sides[1][k - 1].normal),
        });
    }
    // The surface between the rays continues straight through the line. Half-surfaces on different sides
    // continue each other if their tangent planes agree.
    let (mut smooth, mut tangent) = (Vec::new(), Vec::new());
    for i in 0..halves.len() {
        for j in i + 1..halves.len() {
            let pair = [i as u8, j as u8];
            match (halves[i], halves[j]) {
                (Half::Wall, Half::Wall) => smooth.push(pair),
                (Half::Before(s, a), Half::Behind(t, b)) | (Half::Behind(t, b), Half::Before(s, a))
                    if parallel(a, b) =>
                {
                    smooth.push(pair);
                    if s != t {
                        tangent.push(pair);
                    }
                }
                _ => {}
            }
        }
    }
    EdgeSectors { sectors, smooth, tangent }
}
