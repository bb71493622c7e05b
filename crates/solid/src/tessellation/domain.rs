//! The part of a surface's parameters that a face covers: polygons, an outer one and holes.
//!
//! Comes in: a face with the points of its edges. Goes out: polygons of mesh vertices with parameters that do not jump by a turn. Around an axis,
//! a face between two loops is cut along a bridge from one to the other, which both sides of the cut share.

use super::Points;
use crate::brep::{Face, Surface};
use planish_estimate::{Error, Result};
use std::f64::consts::TAU;

/// A corner: the mesh's vertex and where it is, in lengths along the parameters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    pub(super) vertex: u32,
    pub(super) at: [f64; 2],
}

/// What a face covers.
pub(super) struct Domain {
    /// Polygons: where a point lies in an odd number of them, it is in the face.
    pub(super) polygons: Vec<Vec<Corner>>,
    /// Lengths for steps of the parameters.
    pub(super) steps: [f64; 2],
}

fn turn(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

impl Domain {
    pub(super) fn of(face: &Face, points: &mut Points, tolerance: f64) -> Result<Self> {
        let is_plane = matches!(face.surface, Surface::Plane { .. });
        let mut loops: Vec<Vec<Corner>> = Vec::new();
        let mut windings = Vec::new();
        for ring in &face.loops {
            let vertices: Vec<u32> = ring.iter().flat_map(|c| points.along(*c)).collect();
            let mut corners: Vec<Corner> = Vec::with_capacity(vertices.len());
            for vertex in vertices {
                let mut at = face.surface.parameters(points.positions[vertex as usize]);
                if let (false, Some(last)) = (is_plane, corners.last()) {
                    at[0] = last.at[0] + turn(at[0] - last.at[0]);
                }
                corners.push(Corner { vertex, at });
            }
            let (Some(first), Some(last)) = (corners.first(), corners.last()) else {
                continue;
            };
            let around = if is_plane {
                0.0
            } else {
                last.at[0] + turn(first.at[0] - last.at[0]) - first.at[0]
            };
            windings.push((around / TAU).round() as i32);
            loops.push(corners);
        }
        let Some(start) = loops.first().and_then(|l| l.first()) else {
            return Err(Error::unsupported("it has no loops"));
        };
        let steps = super::steps(&face.surface, start.at);
        let mut polygons = match windings.iter().filter(|w| **w != 0).count() {
            0 => loops,
            2 => {
                let first = windings.iter().position(|w| *w == 1);
                let second = windings.iter().position(|w| *w == -1);
                let (Some(first), Some(second)) = (first, second) else {
                    return Err(Error::unsupported("two of its loops run around it the same way"));
                };
                let joined = joined(face, points, &loops, [first, second], steps, tolerance)?;
                let others = loops
                    .into_iter()
                    .enumerate()
                    .filter(|(k, _)| *k != first && *k != second);
                std::iter::once(joined).chain(others.map(|(_, l)| l)).collect()
            }
            n => {
                return Err(Error::unsupported(format!(
                    "{n} of its loops run around it: needed none or two"
                )));
            }
        };
        if !is_plane {
            shift_into_outer(&mut polygons);
        }
        for corner in polygons.iter_mut().flatten() {
            corner.at = [corner.at[0] * steps[0], corner.at[1] * steps[1]];
        }
        part_touching(&mut polygons, if face.outward { 1.0 } else { -1.0 });
        Ok(Self { polygons, steps })
    }
}

/// One polygon of two loops around an axis, along a bridge that crosses no loop.
fn joined(
    face: &Face,
    points: &mut Points,
    loops: &[Vec<Corner>],
    [first, second]: [usize; 2],
    steps: [f64; 2],
    tolerance: f64,
) -> Result<Vec<Corner>> {
    let (a, b) = (&loops[first], &loops[second]);
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (i, p) in a.iter().enumerate() {
        for (j, q) in b.iter().enumerate() {
            let across = turn(q.at[0] - p.at[0]) * steps[0];
            let up = (q.at[1] - p.at[1]) * steps[1];
            // Straight up if possible: such a bridge needs no points of its own.
            pairs.push((across.abs() * 10.0 + up.abs(), i, j));
        }
    }
    pairs.sort_by(|x, y| x.0.total_cmp(&y.0));
    let crosses = |from: [f64; 2], to: [f64; 2], ends: [u32; 2]| {
        loops.iter().any(|l| {
            (0..l.len()).any(|k| {
                let (p, q) = (l[k], l[(k + 1) % l.len()]);
                let width = turn(q.at[0] - p.at[0]);
                let near = p.at[0] + TAU * ((from[0] - p.at[0]) / TAU).round();
                let is_end = |v: u32| ends.contains(&v);
                !is_end(p.vertex)
                    && !is_end(q.vertex)
                    && [-TAU, 0.0, TAU]
                        .into_iter()
                        .any(|s| segments_cross(from, to, [near + s, p.at[1]], [near + s + width, q.at[1]]))
            })
        })
    };
    let bridge = pairs.into_iter().find(|(_, i, j)| {
        let (p, q) = (a[*i], b[*j]);
        let to = [p.at[0] + turn(q.at[0] - p.at[0]), q.at[1]];
        !crosses(p.at, to, [p.vertex, q.vertex])
    });
    let Some((_, i, j)) = bridge else {
        return Err(Error::unsupported("no bridge between the loops around it was found"));
    };
    let lean = turn(b[j].at[0] - a[i].at[0]);
    let widest = 2.0 * (1.0 - (tolerance / steps[0]).min(1.0)).acos();
    let n = (lean.abs() / widest.clamp(1e-4, super::WIDEST_CHORD)).ceil().max(1.0) as usize;
    let mut polygon = unrolled(a, i, a[i].at[0]);
    let (from, to) = (a[i].at, [a[i].at[0] + lean, b[j].at[1]]);
    let between: Vec<Corner> = (1..n)
        .map(|k| {
            let at = [0, 1].map(|c| from[c] + (to[c] - from[c]) * k as f64 / n as f64);
            Corner {
                vertex: points.add(face.surface.point(at)),
                at,
            }
        })
        .collect();
    let shifted = |c: &Corner| Corner {
        at: [c.at[0] + TAU, c.at[1]],
        ..*c
    };
    polygon.extend(between.iter().map(shifted));
    polygon.extend(unrolled(b, j, to[0] + TAU));
    polygon.extend(between.iter().rev());
    Ok(polygon)
}

/// A loop around the axis from one of its corners to the same one a turn further, the first angle as given.
fn unrolled(ring: &[Corner], from: usize, angle: f64) -> Vec<Corner> {
    let mut at = angle;
    let mut found = Vec::with_capacity(ring.len() + 1);
    for k in 0..=ring.len() {
        let corner = ring[(from + k) % ring.len()];
        at += turn(corner.at[0] - at);
        found.push(Corner {
            at: [at, corner.at[1]],
            ..corner
        });
    }
    found
}

fn segments_cross(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> bool {
    let side = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    side(a, b, c) * side(a, b, d) <= 0.0 && side(c, d, a) * side(c, d, b) <= 0.0
}

/// Moves holes by whole turns into the largest polygon.
fn shift_into_outer(polygons: &mut [Vec<Corner>]) {
    let width = |p: &Vec<Corner>| {
        let (lo, hi) = p
            .iter()
            .fold((f64::MAX, f64::MIN), |(lo, hi), c| (lo.min(c.at[0]), hi.max(c.at[0])));
        hi - lo
    };
    let Some(outer) = (0..polygons.len()).max_by(|a, b| width(&polygons[*a]).total_cmp(&width(&polygons[*b]))) else {
        return;
    };
    let within = polygons[outer].clone();
    for (_, hole) in polygons.iter_mut().enumerate().filter(|(k, _)| *k != outer) {
        let at = hole[0].at;
        let turns = (-2..=2)
            .map(|k| TAU * f64::from(k))
            .find(|s| contains(&within, [at[0] + s, at[1]]));
        for corner in hole.iter_mut() {
            corner.at[0] += turns.unwrap_or(0.0);
        }
    }
}

fn contains(polygon: &[Corner], p: [f64; 2]) -> bool {
    let n = polygon.len();
    (0..n).fold(false, |inside, k| {
        let (a, b) = (polygon[k].at, polygon[(k + 1) % n].at);
        let above = (a[1] > p[1]) != (b[1] > p[1]);
        inside != (above && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
    })
}

/// Where two corners of different vertices are in one place, the second one is moved a little into its own corner, and on a straight side to the face's
/// side, which is its left where `left` is 1 and its right where it is −1: loops that touch stay apart, and slits open.
fn part_touching(polygons: &mut [Vec<Corner>], left: f64) {
    let mut seen: std::collections::HashMap<[u64; 2], u32> = std::collections::HashMap::new();
    for polygon in polygons {
        let n = polygon.len();
        for k in 0..n {
            let corner = polygon[k];
            let key = corner.at.map(|x| (x + 0.0).to_bits());
            if *seen.entry(key).or_insert(corner.vertex) != corner.vertex {
                let (before, behind) = (polygon[(k + n - 1) % n].at, polygon[(k + 1) % n].at);
                let run = [behind[0] - before[0], behind[1] - before[1]];
                let inward = [0, 1].map(|c| (before[c] + behind[c]) / 2.0 - corner.at[c]);
                let is_straight =
                    (run[0] * inward[1] - run[1] * inward[0]).abs() < 1e-6 * (run[0] * run[0] + run[1] * run[1]);
                let to = if is_straight {
                    [-left * run[1] / 2.0, left * run[0] / 2.0]
                } else {
                    inward
                };
                polygon[k].at = [0, 1].map(|c| corner.at[c] + 1e-7 * to[c]);
            }
        }
    }
}
