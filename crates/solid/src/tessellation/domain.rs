//! The region of a face in the plane of its chart: an outer polygon and holes.
//!
//! Input: a face with the points of its edges. Output: polygons of mesh vertices in a plane ([`Chart`]).
//! Angles along a polygon do not jump by a turn. A face between two loops around an axis, or around the tube
//! of a torus, is therefore cut along a bridge between them. Both sides of the cut have the same vertices.

use super::Points;
use super::chart::Chart;
use super::polygon::{Corner, part_touching, segments_cross, shift_into_outer, signed_area};
use crate::brep::{Face, FaceSurface, unit};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use std::f64::consts::TAU;

/// Number of directions from which the projection pole of a sphere is chosen, in addition to those beside its
/// loops. More of them find poles farther from the face, which distorts triangles less.
const DIRECTIONS: usize = 200;

/// The region of a face in the plane.
pub(super) struct Domain {
    /// Polygons. A point in an odd number of them is in the face.
    pub(super) polygons: Vec<Vec<Corner>>,
    /// Points within the face that must be vertices: the apex of a cone.
    pub(super) inner: Vec<Corner>,
    pub(super) chart: Chart,
}

/// The difference of two angles in [−π, π].
fn turn(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

impl Domain {
    pub(super) fn new(face: &Face, points: &mut Points, tolerance: f64) -> Result<Self> {
        let rings: Vec<Vec<u32>> = face
            .loops
            .iter()
            .map(|ring| ring.iter().flat_map(|c| points.along(*c)).collect())
            .filter(|ring: &Vec<u32>| !ring.is_empty())
            .collect();
        if rings.is_empty() {
            return Err(Error::unsupported("it has no loops"));
        }
        let mut domain = match face.surface {
            FaceSurface::Sphere { center, radius, .. } => on_sphere(face, points, &rings, center, radius)?,
            FaceSurface::Cone { .. } => match with_tip(face, points, &rings) {
                Some(domain) => domain,
                None => in_parameters(face, points, &rings, tolerance)?,
            },
            _ => in_parameters(face, points, &rings, tolerance)?,
        };
        let left = if face.outward == domain.chart.is_mirrored() { -1.0 } else { 1.0 };
        part_touching(&mut domain.polygons, left);
        Ok(domain)
    }
}

/// The polygons of loops in a chart without angles.
fn flat(chart: &Chart, points: &Points, rings: &[Vec<u32>]) -> Vec<Vec<Corner>> {
    let corner = |vertex: &u32| Corner { vertex: *vertex, at: chart.at(points.positions[*vertex as usize]) };
    rings.iter().map(|ring| ring.iter().map(corner).collect()).collect()
}

/// The region of a face of a sphere, projected from the point outside of the face farthest from its loops.
fn on_sphere(face: &Face, points: &Points, rings: &[Vec<u32>], center: DVec3, radius: f64) -> Result<Domain> {
    let sense = if face.outward { 1.0 } else { -1.0 };
    let direction = |vertex: &u32| unit(points.positions[*vertex as usize] - center);
    let directions: Vec<Vec<DVec3>> = rings.iter().map(|ring| ring.iter().map(direction).collect()).collect();
    let mut poles: Vec<DVec3> = (0..DIRECTIONS)
        .map(|k| {
            // Fibonacci lattice: points spread evenly over the sphere.
            let z = 1.0 - (2 * k + 1) as f64 / DIRECTIONS as f64;
            let angle = TAU * 0.618_033_988_749_895 * k as f64;
            let across = (1.0 - z * z).sqrt();
            DVec3::new(across * angle.cos(), across * angle.sin(), z)
        })
        .collect();
    for ring in &directions {
        let sum = ring.iter().sum::<DVec3>();
        if sum.length() > 1e-9 {
            poles.extend([unit(sum), unit(-sum)]);
        }
        for k in 0..ring.len() {
            // A point just to the right of the loop, seen from outside. It is outside of the face, also if
            // the face covers nearly all of the sphere and none of the directions above is outside.
            let (a, b) = (ring[k], ring[(k + 1) % ring.len()]);
            let right = (b - a).cross(sense * (a + b));
            poles.push(unit(a + b + 0.5 * right));
        }
    }
    let clearance =
        |pole: &DVec3| directions.iter().flatten().map(|d| -d.dot(*pole)).fold(f64::MAX, f64::min);
    let mut order: Vec<(f64, DVec3)> = poles.into_iter().map(|p| (clearance(&p), p)).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, pole) in order {
        let chart = Chart::sphere(center, radius, pole);
        let polygons = flat(&chart, points, rings);
        // Projected from a point of the face itself, the loops would enclose the rest of the sphere, with a
        // negative area.
        if sense * signed_area(&polygons) > 0.0 {
            return Ok(Domain { polygons, inner: Vec::new(), chart });
        }
    }
    Err(Error::unsupported("no point of the sphere was found outside of its loops"))
}

/// The region of a face of a cone that contains the apex or has a corner there; `None` for other faces.
fn with_tip(face: &Face, points: &mut Points, rings: &[Vec<u32>]) -> Option<Domain> {
    let chart = Chart::cone(&face.surface)?;
    let polygons = flat(&chart, points, rings);
    let reach = polygons.iter().flatten().map(|c| c.at[0].hypot(c.at[1])).fold(0.0, f64::max);
    let at_tip = |c: &Corner| c.at[0].hypot(c.at[1]) < 1e-9 * reach;
    if polygons.iter().flatten().any(at_tip) {
        let inner = Vec::new();
        return Some(Domain { polygons, inner, chart });
    }
    let around = |polygon: &Vec<Corner>| -> f64 {
        let angle = |k: usize| {
            let at = polygon[k % polygon.len()].at;
            at[1].atan2(at[0])
        };
        (0..polygon.len()).map(|k| turn(angle(k + 1) - angle(k))).sum()
    };
    // Loops around the axis bound the face on one side each. With an odd number of them, the other side is
    // the apex.
    let windings = polygons.iter().filter(|p| around(p).abs() > TAU / 2.0).count();
    (windings % 2 == 1).then(|| {
        let tip = Corner { vertex: points.add(chart.point([0.0; 2])), at: [0.0; 2] };
        let inner = vec![tip];
        Domain { polygons, inner, chart }
    })
}

/// The region of a face in the parameters of its surface.
fn in_parameters(face: &Face, points: &mut Points, rings: &[Vec<u32>], tolerance: f64) -> Result<Domain> {
    let has_period = face.surface.periods().map(|p| p.is_some());
    let mut loops: Vec<Vec<Corner>> = Vec::new();
    let mut windings: Vec<[i32; 2]> = Vec::new();
    for ring in rings {
        let mut corners: Vec<Corner> = Vec::with_capacity(ring.len());
        let after = |last: [f64; 2], at: [f64; 2]| {
            [0, 1].map(|k| match has_period[k] {
                true => last[k] + turn(at[k] - last[k]),
                false => at[k],
            })
        };
        // Angles follow the previous corner, so that a loop across ±π is continuous.
        for &vertex in ring {
            let mut at = face.surface.parameters(points.positions[vertex as usize]);
            if let Some(last) = corners.last() {
                at = after(last.at, at);
            }
            corners.push(Corner { vertex, at });
        }
        let (first, last) = (corners[0].at, corners[corners.len() - 1].at);
        let close = after(last, first);
        windings.push([0, 1].map(|k| match has_period[k] {
            true => ((close[k] - first[k]) / TAU).round() as i32,
            false => 0,
        }));
        loops.push(corners);
    }
    // Loops that go around the tube only: the parameters are swapped, so that the code below, which cuts
    // along the first parameter, handles both.
    let is_swapped = windings.iter().all(|w| w[0] == 0) && windings.iter().any(|w| w[1] != 0);
    // Lengths instead of angles, so that triangles in the plane are nearly similar to those in space.
    let mut steps = super::steps(&face.surface, loops[0][0].at);
    if is_swapped {
        steps.reverse();
        for corner in loops.iter_mut().flatten() {
            corner.at.reverse();
        }
    }
    let turns_around = |w: &[i32; 2]| w[usize::from(is_swapped)];
    let unit_chart = Chart::Parameters { surface: face.surface, steps: [1.0; 2], is_swapped };
    let mut polygons = match windings.iter().filter(|w| turns_around(w) != 0).count() {
        0 => loops,
        2 => {
            let first = windings.iter().position(|w| turns_around(w) == 1);
            let second = windings.iter().position(|w| turns_around(w) == -1);
            let (Some(first), Some(second)) = (first, second) else {
                return Err(Error::unsupported("two loops run around the axis in the same direction"));
            };
            if has_period[usize::from(!is_swapped)] {
                // On a torus, both parameters are angles, so the second loop may be off by a whole turn. The
                // face is on the left of the first loop, and the second one is the next on that side.
                let up = if face.outward == is_swapped { -1.0 } else { 1.0 };
                let apart = up * (loops[second][0].at[1] - loops[first][0].at[1]);
                let shift = up * (apart.rem_euclid(TAU) - apart);
                for corner in &mut loops[second] {
                    corner.at[1] += shift;
                }
            }
            let joined = joined(&unit_chart, points, &loops, [first, second], steps, tolerance)?;
            let others = loops.into_iter().enumerate().filter(|(k, _)| *k != first && *k != second);
            std::iter::once(joined).chain(others.map(|(_, l)| l)).collect()
        }
        n => {
            return Err(Error::unsupported(format!("{n} loops run around the axis: expected none or two")));
        }
    };
    let periods = [usize::from(is_swapped), usize::from(!is_swapped)].map(|k| has_period[k].then_some(TAU));
    if periods != [None; 2] {
        shift_into_outer(&mut polygons, periods);
    }
    for corner in polygons.iter_mut().flatten() {
        corner.at = [corner.at[0] * steps[0], corner.at[1] * steps[1]];
    }
    Ok(Domain {
        polygons,
        inner: Vec::new(),
        chart: Chart::Parameters { surface: face.surface, steps, is_swapped },
    })
}

/// One polygon of two loops around an axis, along a bridge that crosses no loop.
fn joined(
    chart: &Chart,
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
            // Along a line of constant angle if possible: on cylinders and cones, such a bridge is straight
            // and needs no further points.
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
        return Err(Error::unsupported("no bridge between the loops around the axis was found"));
    };
    let lean = turn(b[j].at[0] - a[i].at[0]);
    let widest = 2.0 * (1.0 - (tolerance / steps[0]).min(1.0)).acos();
    let n = (lean.abs() / widest.clamp(1e-4, super::WIDEST_CHORD)).ceil().max(1.0) as usize;
    let mut polygon = unrolled(a, i, a[i].at[0]);
    let (from, to) = (a[i].at, [a[i].at[0] + lean, b[j].at[1]]);
    let between: Vec<Corner> = (1..n)
        .map(|k| {
            let at = [0, 1].map(|c| from[c] + (to[c] - from[c]) * k as f64 / n as f64);
            Corner { vertex: points.add(chart.point(at)), at }
        })
        .collect();
    // Once around the first loop, over the bridge, back around the second loop, and over the bridge again.
    // Both sides of the bridge have the same vertices, a turn apart.
    let shifted = |c: &Corner| Corner { at: [c.at[0] + TAU, c.at[1]], ..*c };
    polygon.extend(between.iter().map(shifted));
    polygon.extend(unrolled(b, j, to[0] + TAU));
    polygon.extend(between.iter().rev());
    Ok(polygon)
}

/// A loop around the axis from one of its corners to the same corner a turn further, with a given first
/// angle.
fn unrolled(ring: &[Corner], from: usize, angle: f64) -> Vec<Corner> {
    let mut at = angle;
    let mut found = Vec::with_capacity(ring.len() + 1);
    for k in 0..=ring.len() {
        let corner = ring[(from + k) % ring.len()];
        at += turn(corner.at[0] - at);
        found.push(Corner { at: [at, corner.at[1]], ..corner });
    }
    found
}
