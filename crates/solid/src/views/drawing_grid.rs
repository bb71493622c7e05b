//! A grid shared by all views, with the drawn curves placed on and between its lines.
//!
//! Input: a drawing. Output: for each axis, the coordinates at which any curve begins, ends or turns. For
//! each view, the runs along grid lines, and the pieces of oblique lines and circles. Each piece lies within
//! one cell of the grid.
//!
//! Not guaranteed: coordinates closer than the tolerance stay distinct.

use super::candidate_surface::{CandidateSurface, Side};
use super::profile::Profile;
use crate::drawing::{Curve2, Drawing, Hatch, LineStyle, View, ViewContent, ViewKind};
use planish_core::DVec3;
use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};

/// An interval of a line with one style, drawn by one entity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Run {
    pub(crate) from: f64,
    pub(crate) to: f64,
    pub(crate) style: LineStyle,
    pub(crate) curve: usize,
}

/// A piece of a profile within one cell.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Piece {
    pub(crate) carrier: usize,
    /// Parameters of the profile at its ends.
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Minimum and maximum of both coordinates at its ends.
    pub(crate) range: [[f64; 2]; 2],
    /// The parts of it that are drawn.
    pub(crate) runs: Vec<Run>,
}

/// A profile with all runs drawn along it.
#[derive(Debug, Clone)]
pub(crate) struct Carrier {
    pub(crate) profile: Profile,
    pub(crate) runs: Vec<Run>,
}

/// The curves of one view on the grid.
#[derive(Debug, Clone)]
pub(crate) struct ViewGrid {
    pub(crate) kind: ViewKind,
    /// Runs along grid lines: `lines[k][i]` are those where coordinate k has the i-th grid value.
    pub(crate) lines: [Vec<Vec<Run>>; 2],
    pub(crate) carriers: Vec<Carrier>,
    pub(crate) pieces: Vec<Piece>,
    /// Pieces of each cell, the second coordinate fastest.
    pub(crate) cells: Vec<Vec<u32>>,
    /// Indices of curves that are not the edge-on image of a surface.
    pub(crate) others: Vec<usize>,
    /// True if it shows nothing: its curves are candidates.
    pub(crate) is_candidates: bool,
    /// True if its lines may be wrong or missing.
    pub(crate) is_doubtful: bool,
    /// False if a missing line may mean a hidden edge.
    pub(crate) shows_hidden: bool,
    /// The cutting plane (coordinate along the line of sight) and what is hatched, if it is a section.
    pub(crate) cut: Option<(f64, Hatch)>,
}

/// The grid and the views on it.
#[derive(Debug, Clone)]
pub(crate) struct DrawingGrid {
    /// Grid coordinates of the three axes, ascending; the first and last lie outside of everything.
    pub(crate) grid: [Vec<f64>; 3],
    pub(crate) views: Vec<ViewGrid>,
    pub(crate) size: f64,
    /// Coordinates closer than this are equal.
    pub(crate) tolerance: f64,
    /// Candidate surfaces that no view sees edge-on.
    pub(crate) walls: Vec<CandidateSurface>,
    /// Walls that pass through each box of the grid, third coordinate fastest; empty if there are none.
    walls_of: Vec<Vec<(u16, Side)>>,
}

/// Representatives of values that are equal within a tolerance.
struct Cluster {
    values: Vec<f64>,
}

impl Cluster {
    /// Groups values of which each is within the tolerance of the next.
    fn new(mut raw: Vec<f64>, tolerance: f64) -> Self {
        raw.sort_by(f64::total_cmp);
        let mut values = Vec::new();
        let mut at = 0;
        while at < raw.len() {
            let end = (at + 1..raw.len()).find(|&k| raw[k] - raw[k - 1] > tolerance).unwrap_or(raw.len());
            values.push(representative(&raw[at..end]));
            at = end;
        }
        Self { values }
    }

    /// The representative nearest to a value, or the value itself if none is near.
    fn snap(&self, value: f64, tolerance: f64) -> f64 {
        // A representative may be off by one tolerance from the members of its group, hence twice this.
        let at = self.values.partition_point(|v| *v < value);
        let near = [at.wrapping_sub(1), at].into_iter().filter_map(|k| self.values.get(k));
        near.copied()
            .filter(|v| (v - value).abs() <= 2.0 * tolerance)
            .min_by(|a, b| (a - value).abs().total_cmp(&(b - value).abs()))
            .unwrap_or(value)
    }
}

/// Chooses one of several equal values: a multiple of 10⁻⁴ within 10⁻⁶ of one of them, else the first value
/// with more than six decimals, else the first value.
///
/// Designed coordinates are usually round. A value with six decimals or fewer may have been rounded when the
/// drawing was written; one with more decimals was not, so it is more accurate.
fn representative(values: &[f64]) -> f64 {
    let round = |v: f64| (v * 1e4).round() / 1e4;
    let nearest =
        values.iter().copied().min_by(|a, b| (a - round(*a)).abs().total_cmp(&(b - round(*b)).abs()));
    match nearest {
        Some(v) if (v - round(v)).abs() < 1e-6 => round(v),
        _ => values
            .iter()
            .copied()
            .find(|v| (v * 1e6 - (v * 1e6).round()).abs() > 1e-3)
            .or(values.first().copied())
            .unwrap_or(0.0),
    }
}

/// What a curve is drawn along.
enum Along {
    Grid { axis: usize, at: f64 },
    Profile(Profile),
    Other,
}

/// What a curve is drawn along, and the parameters of its ends there.
fn along(curve: &Curve2, tolerance: f64) -> (Along, f64, f64) {
    match curve {
        Curve2::Segment(a, b) => {
            for axis in 0..2 {
                if (a[axis] - b[axis]).abs() <= tolerance {
                    let (p, q) = (a[1 - axis], b[1 - axis]);
                    return (Along::Grid { axis, at: a[axis] }, p.min(q), p.max(q));
                }
            }
            let profile = Profile::line(*a, *b);
            let (s, t) = (profile.parameter(*a), profile.parameter(*b));
            (Along::Profile(profile), s.min(t), s.max(t))
        }
        Curve2::Arc { center, radius, start, sweep } => {
            let profile = Profile::Circle { center: *center, radius: *radius };
            (Along::Profile(profile), *start, start + sweep)
        }
        Curve2::Chain(_) => (Along::Other, 0.0, 0.0),
    }
}

/// Maps a run of angles into `[0, 2π]`. A run that passes 0 is split there.
fn unwrap_angles(run: Run) -> Vec<Run> {
    if run.to - run.from >= TAU - 1e-9 {
        return vec![Run { from: 0.0, to: TAU, ..run }];
    }
    let from = run.from.rem_euclid(TAU);
    let to = from + (run.to - run.from);
    match to > TAU {
        false => vec![Run { from, to, ..run }],
        true => vec![Run { from, to: TAU, ..run }, Run { from: 0.0, to: to - TAU, ..run }],
    }
}

/// Merges touching runs of any style into intervals.
pub(crate) fn stretches(runs: &[Run], gap: f64) -> Vec<[f64; 2]> {
    let mut sorted: Vec<[f64; 2]> = runs.iter().map(|r| [r.from, r.to]).collect();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut merged: Vec<[f64; 2]> = Vec::new();
    for run in sorted {
        match merged.last_mut() {
            Some(last) if run[0] <= last[1] + gap => last[1] = last[1].max(run[1]),
            _ => merged.push(run),
        }
    }
    merged
}

/// The drawn parts of a range that are longer than `shortest`.
///
/// Where both styles overlap, the part is visible: in drafting, visible lines take precedence.
pub(crate) fn runs_within(runs: &[Run], from: f64, to: f64, shortest: f64) -> Vec<Run> {
    let mut cuts: Vec<f64> =
        runs.iter().flat_map(|r| [r.from, r.to]).filter(|t| *t > from && *t < to).collect();
    cuts.extend([from, to]);
    cuts.sort_by(f64::total_cmp);
    let mut found: Vec<Run> = Vec::new();
    for cut in cuts.windows(2) {
        let middle = (cut[0] + cut[1]) / 2.0;
        let Some(best) = runs.iter().filter(|r| r.from <= middle && middle <= r.to).min_by_key(|r| r.style)
        else {
            continue;
        };
        // Neighbouring parts of one style are joined, so that short ones are not dropped below.
        match found.last_mut() {
            Some(last) if last.style == best.style && last.to >= cut[0] => last.to = cut[1],
            _ => found.push(Run { from: cut[0], to: cut[1], ..*best }),
        }
    }
    found.retain(|r| r.to - r.from > shortest);
    found
}

impl DrawingGrid {
    /// Places a drawing on its grid.
    pub(crate) fn new(drawing: &Drawing) -> Self {
        Self::without(drawing, &BTreeSet::new())
    }

    /// Places a drawing on its grid. The `explained` curves (view and index) are no edge-on images of
    /// surfaces.
    pub(crate) fn without(drawing: &Drawing, explained: &BTreeSet<(usize, usize)>) -> Self {
        let size = drawing.size();
        let tolerance = tolerance_of(size);
        let clusters = clusters(drawing, tolerance);
        let gap = 1e-5 * size;
        let mut found: Vec<ViewCurves> = Vec::new();
        for (at, view) in drawing.views.iter().enumerate() {
            let axes = view.kind.axes();
            let snap = |k: usize, value: f64| clusters[axes[k]].snap(value, tolerance);
            let (mut on_grid, mut carriers, mut others) = (Vec::new(), Vec::<Carrier>::new(), Vec::new());
            // Circles first: short chords that lie on a known circle are part of it and not planes.
            let order = |c: &Curve2| usize::from(!matches!(c, Curve2::Arc { .. }));
            let mut sorted: Vec<usize> = (0..view.curves.len()).collect();
            sorted.sort_by_key(|&c| order(&view.curves[c].curve));
            for index in sorted {
                if explained.contains(&(at, index)) {
                    others.push(index);
                    continue;
                }
                let drawn = &view.curves[index];
                let curve = snapped(&drawn.curve, &snap);
                let (way, from, to) = along(&curve, tolerance);
                let run = Run { from, to, style: drawn.style, curve: index };
                match way {
                    Along::Grid { axis, at } => on_grid.push((axis, at, run)),
                    // A polygon on a known circle is a part of it: exporters write some arcs in this way.
                    Along::Other => {
                        if !overlay(&mut carriers, &curve, run, 2e-5 * size) {
                            others.push(index);
                        }
                    }
                    Along::Profile(profile) => {
                        let is_line = matches!(profile, Profile::Line { .. });
                        if is_line && overlay(&mut carriers, &curve, run, 2e-5 * size) {
                            continue;
                        }
                        let runs = if is_line { vec![run] } else { unwrap_angles(run) };
                        match carriers.iter_mut().find(|c| c.profile.same(&profile, 5.0 * tolerance, size)) {
                            Some(carrier) => carrier.runs.extend(runs),
                            None => carriers.push(Carrier { profile, runs }),
                        }
                    }
                }
            }
            found.push((view.kind, on_grid, carriers, others));
        }
        // Explained curves are not on the grid, but it must still reach around them.
        let mut outer: [Vec<f64>; 3] = Default::default();
        if !explained.is_empty() {
            outer = drawing.bounds().map(|b| b.to_vec());
        }
        let grid = grid_of(&found, outer, &clusters, size, tolerance, gap);
        let views = found
            .into_iter()
            .zip(&drawing.views)
            .map(|(curves, view)| ViewGrid::new(curves, view, &grid, tolerance, gap))
            .collect();
        Self { grid, views, size, tolerance, walls: Vec::new(), walls_of: Vec::new() }
    }

    /// The same grid with candidate surfaces that no view sees edge-on.
    pub(crate) fn with_walls(mut self, walls: Vec<CandidateSurface>) -> Self {
        let n = [0, 1, 2].map(|a| self.intervals(a));
        // Listed for each box: most walls pass through few of them, and every point location asks for this
        // list.
        self.walls_of = vec![Vec::new(); n[0] * n[1] * n[2]];
        for (index, wall) in walls.iter().enumerate() {
            for i in 0..n[0] {
                for j in 0..n[1] {
                    for k in 0..n[2] {
                        let (lo, hi) = self.bounds([i, j, k]);
                        if let Some(side) = wall.passes(lo, hi, 5.0 * self.tolerance) {
                            self.walls_of[(i * n[1] + j) * n[2] + k].push((index as u16, side));
                        }
                    }
                }
            }
        }
        self.walls = walls;
        self
    }

    /// True if any wall is oblique to all views. Exporters draw the intersection curves of such faces less
    /// accurately.
    pub(crate) fn has_oblique_walls(&self) -> bool {
        self.walls.iter().any(|w| matches!(w, CandidateSurface::Oblique(_)))
    }

    /// The walls that pass through a box.
    pub(crate) fn walls_in(&self, cell: [usize; 3]) -> &[(u16, Side)] {
        let at = (cell[0] * self.intervals(1) + cell[1]) * self.intervals(2) + cell[2];
        self.walls_of.get(at).map_or(&[], Vec::as_slice)
    }

    /// The minimum and maximum corner of a box.
    pub(crate) fn bounds(&self, cell: [usize; 3]) -> (DVec3, DVec3) {
        let at = |up: usize| DVec3::from_array([0, 1, 2].map(|a| self.grid[a][cell[a] + up]));
        (at(0), at(1))
    }

    /// The interval of an axis that contains a value.
    pub(crate) fn interval(&self, axis: usize, value: f64) -> usize {
        let grid = &self.grid[axis];
        grid.partition_point(|g| *g < value).clamp(1, grid.len() - 1) - 1
    }

    /// Number of intervals of an axis.
    pub(crate) fn intervals(&self, axis: usize) -> usize {
        self.grid[axis].len() - 1
    }
}

/// Adds a curve that lies on a known circle to its runs. Returns false if there is no such circle.
fn overlay(carriers: &mut [Carrier], curve: &Curve2, run: Run, tolerance: f64) -> bool {
    let mut points = curve.points();
    if let Curve2::Segment(a, b) = curve {
        points = vec![*a, [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0], *b];
    }
    // The middle of a segment is tested, too: both ends of any chord are on the circle.
    let under = carriers.iter_mut().find(|c| {
        matches!(c.profile, Profile::Circle { .. })
            && points.iter().all(|p| c.profile.value(*p).abs() < tolerance)
    });
    let Some(carrier) = under else { return false };
    let mut angle = carrier.profile.parameter(points[0]);
    let (mut from, mut to) = (angle, angle);
    // The angle is followed from point to point: the difference of the ends alone does not show a turn by
    // more than π.
    for point in &points[1..] {
        let turn = carrier.profile.parameter(*point) - angle;
        angle += turn - TAU * (turn / TAU).round();
        from = from.min(angle);
        to = to.max(angle);
    }
    carrier.runs.extend(unwrap_angles(Run { from, to, ..run }));
    true
}

/// A curve with ends and centres at common coordinates. Chains stay: their points are only approximate.
fn snapped(curve: &Curve2, snap: &impl Fn(usize, f64) -> f64) -> Curve2 {
    let both = |p: [f64; 2]| [snap(0, p[0]), snap(1, p[1])];
    match curve {
        Curve2::Segment(a, b) => Curve2::Segment(both(*a), both(*b)),
        Curve2::Arc { center, radius, start, sweep } => Curve2::Arc {
            center: both(*center),
            radius: representative(&[*radius]),
            start: *start,
            sweep: *sweep,
        },
        Curve2::Chain(points) => Curve2::Chain(points.clone()),
    }
}

/// Number of different coordinates of each axis at which curves end or turn; much cheaper than the grid.
pub(crate) fn coordinate_counts(drawing: &Drawing) -> [usize; 3] {
    clusters(drawing, tolerance_of(drawing.size())).map(|cluster| cluster.values.len())
}

/// Coordinates closer than this are equal, in a drawing of some size.
fn tolerance_of(size: f64) -> f64 {
    // A relative part for the arithmetic of exporters, and an absolute one for coordinates with six decimals.
    1e-7 * size + 2e-6
}

/// Common coordinates of each axis, from ends of segments, and centres and extremes of circles.
fn clusters(drawing: &Drawing, tolerance: f64) -> [Cluster; 3] {
    let mut raw: [Vec<f64>; 3] = Default::default();
    for view in &drawing.views {
        let axes = view.kind.axes();
        for drawn in &view.curves {
            match &drawn.curve {
                Curve2::Segment(a, b) => {
                    for k in 0..2 {
                        raw[axes[k]].extend([a[k], b[k]]);
                    }
                }
                Curve2::Arc { center, radius, .. } => {
                    for k in 0..2 {
                        let r = representative(&[*radius]);
                        let c = representative(&[center[k]]);
                        raw[axes[k]].extend([c, c - r, c + r]);
                    }
                }
                Curve2::Chain(_) => {}
            }
        }
    }
    raw.map(|values| Cluster::new(values, tolerance))
}

/// A view with its runs along grid lines (coordinate, value, run), its carriers, and indices of other curves.
type ViewCurves = (ViewKind, Vec<(usize, f64, Run)>, Vec<Carrier>, Vec<usize>);

/// Collects the grid coordinates of all axes and adds a margin on both sides.
fn grid_of(
    found: &[ViewCurves],
    mut grid: [Vec<f64>; 3],
    clusters: &[Cluster; 3],
    size: f64,
    tolerance: f64,
    gap: f64,
) -> [Vec<f64>; 3] {
    for (kind, on_grid, carriers, _) in found {
        let axes = kind.axes();
        // Stable, so that the runs of a line keep their order.
        let mut lines: Vec<&(usize, f64, Run)> = on_grid.iter().collect();
        lines.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        for line in lines.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let (axis, at) = (line[0].0, line[0].1);
            grid[axes[axis]].push(at);
            let runs: Vec<Run> = line.iter().map(|g| g.2).collect();
            // Ends of the merged runs only: cuts within a line, as exporters make at crossings, need no grid
            // line.
            for stretch in stretches(&runs, gap) {
                grid[axes[1 - axis]].extend(stretch);
            }
        }
        for carrier in carriers {
            // Parameters of circles are angles, so lengths are divided by the radius.
            let turn = match carrier.profile {
                Profile::Line { .. } => 1.0,
                Profile::Circle { radius, .. } => radius,
            };
            let all = stretches(&carrier.runs, gap / turn);
            let circle = matches!(carrier.profile, Profile::Circle { .. });
            let closed = circle && all.iter().any(|s| s[1] - s[0] > TAU - gap / turn);
            for [from, to] in all {
                let mut at = vec![from, to];
                // A whole circle has no ends. All arcs are cut at their extremes, so each coordinate is a
                // monotonic function along a piece.
                if circle {
                    if closed {
                        at.clear();
                    }
                    at.extend(
                        (0..=4)
                            .map(|q| f64::from(q) * PI / 2.0)
                            .filter(|a| *a > from - 1e-6 && *a < to + 1e-6),
                    );
                }
                for t in at {
                    let p = carrier.profile.point(t);
                    for k in 0..2 {
                        grid[axes[k]].push(clusters[axes[k]].snap(p[k], tolerance));
                    }
                }
            }
        }
    }
    grid.map(|values| {
        // Five tolerances: points of profiles come from square roots and are less accurate than drawn ends.
        let mut values = Cluster::new(values, 5.0 * tolerance).values;
        let (lo, hi) = (values.first().copied().unwrap_or(0.0), values.last().copied().unwrap_or(0.0));
        // Boxes around everything, which are empty: the search needs a known state outside of the part.
        let margin = 0.1 * size;
        values.insert(0, lo - margin);
        values.push(hi + margin);
        values
    })
}

/// Index of the grid value nearest to a value.
fn nearest(grid: &[f64], value: f64) -> usize {
    let at = grid.partition_point(|g| *g < value);
    match at {
        0 => 0,
        _ if at == grid.len() || value - grid[at - 1] < grid[at] - value => at - 1,
        _ => at,
    }
}

impl ViewGrid {
    /// Assigns runs to grid lines and cuts the carriers into pieces.
    fn new(
        (kind, on_grid, carriers, others): ViewCurves,
        view: &View,
        grid: &[Vec<f64>; 3],
        tolerance: f64,
        gap: f64,
    ) -> Self {
        let axes = kind.axes();
        let mut lines = [0, 1].map(|k| vec![Vec::new(); grid[axes[k]].len()]);
        for (axis, at, run) in on_grid {
            lines[axis][nearest(&grid[axes[axis]], at)].push(run);
        }
        let sizes = [0, 1].map(|k| grid[axes[k]].len() - 1);
        let mut plan = Self {
            kind,
            lines,
            carriers,
            pieces: Vec::new(),
            cells: vec![Vec::new(); sizes[0] * sizes[1]],
            others,
            is_candidates: view.content == ViewContent::Candidates,
            is_doubtful: view.content == ViewContent::Doubtful,
            shows_hidden: view.shows_hidden_edges(),
            cut: view.section().map(|section| {
                // A plane through an axis must pass exactly through it.
                let level = grid[axes[2]][nearest(&grid[axes[2]], section.at)];
                let is_near = (level - section.at).abs() <= 20.0 * tolerance;
                (if is_near { level } else { section.at }, section.hatch.clone())
            }),
        };
        for carrier in 0..plan.carriers.len() {
            plan.cut(carrier, grid, tolerance, gap);
        }
        plan
    }

    /// Cuts a carrier at the lines of the grid.
    fn cut(&mut self, carrier: usize, grid: &[Vec<f64>; 3], tolerance: f64, gap: f64) {
        let axes = self.kind.axes();
        let Carrier { profile, runs } = self.carriers[carrier].clone();
        let turn = match profile {
            Profile::Line { .. } => 1.0,
            Profile::Circle { radius, .. } => radius,
        };
        for [from, to] in stretches(&runs, gap / turn) {
            let mut cuts = vec![from, to];
            for known in 0..2 {
                for value in &grid[axes[known]] {
                    for other in profile.crossings(known, *value, 5.0 * tolerance) {
                        let p = if known == 0 { [*value, other] } else { [other, *value] };
                        let t = profile.parameter(p);
                        let t = if matches!(profile, Profile::Line { .. }) { t } else { t.rem_euclid(TAU) };
                        if t > from && t < to {
                            cuts.push(t);
                        }
                    }
                }
            }
            cuts.sort_by(f64::total_cmp);
            // Lines of both directions may cut at one point; a piece between such cuts would have no length.
            cuts.dedup_by(|b, a| *b - *a < 2.0 * tolerance / turn);
            for cut in cuts.windows(2) {
                self.add_piece(carrier, [cut[0], cut[1]], grid, gap / turn);
            }
        }
    }

    /// Adds the piece of a carrier between two cuts, to the cell of its middle.
    ///
    /// The ends lie on grid lines, where rounding decides between two cells; the middle lies within one.
    fn add_piece(&mut self, carrier: usize, [from, to]: [f64; 2], grid: &[Vec<f64>; 3], shortest: f64) {
        let axes = self.kind.axes();
        let profile = self.carriers[carrier].profile;
        let middle = profile.point((from + to) / 2.0);
        let cell = [0, 1].map(|k| {
            let grid = &grid[axes[k]];
            grid.partition_point(|g| *g < middle[k]).clamp(1, grid.len() - 1) - 1
        });
        let (p, q) = (profile.point(from), profile.point(to));
        let runs = runs_within(&self.carriers[carrier].runs, from, to, shortest.min((to - from) / 4.0));
        let at = cell[0] * (grid[axes[1]].len() - 1) + cell[1];
        self.cells[at].push(self.pieces.len() as u32);
        self.pieces.push(Piece {
            carrier,
            from,
            to,
            range: [0, 1].map(|k| [p[k].min(q[k]), p[k].max(q[k])]),
            runs,
        });
    }

    /// The pieces of a cell.
    pub(crate) fn pieces_of(&self, cell: [usize; 2], columns: usize) -> &[u32] {
        &self.cells[cell[0] * columns + cell[1]]
    }

    /// The profile of a piece.
    pub(crate) fn profile(&self, piece: u32) -> &Profile {
        &self.carriers[self.pieces[piece as usize].carrier].profile
    }
}
