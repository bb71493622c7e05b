//! Sight tests of planes and cylinders oblique to all views: outlines of cylinders, and the curves in which
//! such walls intersect.

use super::candidate_surface::CandidateSurface;
use super::candidates::{Candidate, Samples, corners, curves};
use super::cells::Cells;
use super::oblique_wall::Oblique;
use super::sight::SightTests;
use super::surfaces::Curve3;
use crate::drawing::Drawing;
use std::f64::consts::TAU;
use std::rc::Rc;

/// Number of tests along an outline. More find shorter missing lines and take more time.
const ALONG: usize = 24;
/// Positions of tests between two corners, as shares of the interval.
const SHARES: [f64; 3] = [0.13, 0.47, 0.86];

impl SightTests {
    /// Adds tests along the outlines of an oblique cylinder.
    pub(super) fn oblique_outlines(&mut self, cells: &Cells, drawing: &Drawing, view: usize, wall: &Oblique) {
        let sight = cells.plan.views[view].kind.axes()[2];
        let Some((points, direction)) = wall.outlines(sight) else {
            return;
        };
        let [from, to] = wall.span();
        for point in points {
            for k in 0..ALONG {
                let share = (k as f64 + 0.37) / ALONG as f64;
                let p = point + (from + share * (to - from)) * direction;
                self.at_point(cells, drawing, view, p, direction);
            }
        }
    }

    /// Adds tests along the intersection curves of two walls, at least one of them oblique.
    ///
    /// Third walls cut a curve, and each interval has tests of its own.
    pub(super) fn oblique_crossings(&mut self, cells: &Cells, drawing: &Drawing, view: usize) {
        let plan = cells.plan;
        let walls: Vec<Candidate> = plan.walls.iter().cloned().map(Candidate::Wall).collect();
        let bounds = [0, 1, 2].map(|a| [plan.grid[a][0], plan.grid[a][plan.grid[a].len() - 1]]);
        for i in 0..walls.len() {
            for j in i + 1..walls.len() {
                let oblique = [i, j].iter().any(|k| matches!(plan.walls[*k], CandidateSurface::Oblique(_)));
                // Curves of two surfaces of revolution are tested box by box in `wall_sight`.
                if !oblique || !overlap(&plan.walls[i], &plan.walls[j], plan.tolerance) {
                    continue;
                }
                for meeting in curves(&walls[i], &walls[j], plan.size, plan.tolerance) {
                    let mut cuts = Vec::new();
                    let samples = Rc::new(Samples::new(&meeting.curve, bounds));
                    for k in (0..walls.len()).filter(|k| *k != i && *k != j) {
                        let three = [&walls[i], &walls[j], &walls[k]];
                        let found = corners(three, &meeting.curve, || samples.clone(), plan.tolerance);
                        cuts.extend(
                            found.into_iter().filter_map(|p| meeting.curve.parameter(p, plan.tolerance)),
                        );
                    }
                    for t in stretches(&meeting.curve, cuts) {
                        let p = meeting.curve.point(t);
                        let in_box = cells.box_of(p);
                        // Beyond the extents of a wall, the curve is no edge.
                        let has_wall = |k: usize| plan.walls_in(in_box).iter().any(|w| w.0 as usize == k);
                        if has_wall(i) && has_wall(j) {
                            let tangent = walls[i].normal(p).cross(walls[j].normal(p));
                            if tangent.length() > 1e-6 {
                                self.at_point(cells, drawing, view, p, tangent);
                            }
                        }
                    }
                }
            }
        }
    }
}

/// True if the boxes around two walls overlap.
fn overlap(a: &CandidateSurface, b: &CandidateSurface, tolerance: f64) -> bool {
    let (a, b) = (a.bounds(), b.bounds());
    (0..3).all(|k| a[k][0] < b[k][1] + tolerance && b[k][0] < a[k][1] + tolerance)
}

/// Parameters of tests between each two neighbouring cuts of a curve.
fn stretches(curve: &Curve3, mut cuts: Vec<f64>) -> Vec<f64> {
    cuts.sort_by(f64::total_cmp);
    if let Some(period) = curve.period() {
        // A closed curve without corners is tested at four intervals.
        if cuts.is_empty() {
            cuts.extend([0.0, 0.25 * period, 0.5 * period, 0.75 * period]);
        }
        cuts.push(cuts[0] + period);
    }
    let length = |from: f64, to: f64| (curve.point(to) - curve.point(from)).length();
    let within = |c: &&[f64]| c[1] - c[0] > 1e-9 * TAU && length(c[0], c[1]) > 0.0 || c[1] - c[0] > 1.0;
    cuts.windows(2).filter(within).flat_map(|c| SHARES.map(|s| c[0] + s * (c[1] - c[0]))).collect()
}
