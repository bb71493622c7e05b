//! Corners: points where two walls meet.

use super::super::reading::{ContourReading, ContourTarget};
use super::Wall;
use super::line::WallLine;
use std::f64::consts::{PI, TAU};

/// Walls meet if both end within this many readings of their intersection. Readings near a corner may belong
/// to the other wall, which takes one.
const END_SPACINGS: f64 = 2.5;
/// Walls of a scan meet between successive rays, of which this many may have hit something else.
const MAX_RAYS: usize = 4;

/// A point where two walls meet.
#[derive(Debug, Clone, PartialEq)]
pub struct WallCorner {
    /// Indices of the walls.
    pub walls: [usize; 2],
    /// The intersection of their lines.
    pub position: [f64; 2],
    /// Its covariance `[xx, xy, yy]`, without the correlation of the two walls.
    pub covariance: [f64; 3],
}

/// Points where two walls meet.
///
/// The intersection of two lines is a corner if it is within two and a half readings of a measured end of both, or
/// if it lies between the rays to the ends of both and these rays follow each other in a scan, up to four rays
/// that hit something nearer. The second rule finds corners of walls that are seen at a small angle, whose readings
/// are far apart. `readings` are those to which `members` of the walls refer.
///
/// The covariance is that of the intersection of two independent lines. Walls that share errors of poses are
/// correlated, which it omits.
#[must_use]
pub fn wall_corners(walls: &[Wall], readings: &[ContourReading]) -> Vec<WallCorner> {
    let mut is_on_wall = vec![false; readings.len()];
    for &i in walls.iter().flat_map(|wall| &wall.members) {
        is_on_wall[i] = true;
    }
    let mut corners = Vec::new();
    for i in 0..walls.len() {
        for j in i + 1..walls.len() {
            let pair = [&walls[i], &walls[j]];
            let lines = pair.map(|wall| WallLine::new(wall.fit.state[0], wall.fit.state[1]));
            let Some(position) = lines[0].intersection(&lines[1]) else { continue };
            let is_near = pair.iter().all(|wall| ends_near(wall, position));
            if is_near || is_between_rays(pair, lines, position, readings, &is_on_wall) {
                let covariance = covariance(pair, lines, position);
                corners.push(WallCorner { walls: [i, j], position, covariance });
            }
        }
    }
    corners
}

/// True if a measured end of the wall is near a point, in spacings of its readings there.
fn ends_near(wall: &Wall, position: [f64; 2]) -> bool {
    let ends = [wall.spans.first().map(|s| s[0]), wall.spans.last().map(|s| s[1])];
    ends.iter().zip(wall.end_spacings).any(|(end, spacing)| {
        end.is_some_and(|end| (end[0] - position[0]).hypot(end[1] - position[1]) <= END_SPACINGS * spacing)
    })
}

/// True if two successive rays of a scan hit the walls on both sides of a point.
fn is_between_rays(
    walls: [&Wall; 2],
    lines: [WallLine; 2],
    position: [f64; 2],
    readings: &[ContourReading],
    is_on_wall: &[bool],
) -> bool {
    let ends = [0, 1].map(|k| extreme_readings(walls[k], &lines[k], position, readings));
    let pairs = ends[0].iter().flat_map(|&a| ends[1].iter().map(move |&b| [a.min(b), a.max(b)]));
    pairs.into_iter().any(|[a, b]| {
        let ray = |i: usize| match readings[i].target {
            ContourTarget::Range { origin, heading_rad, .. } => Some((origin, heading_rad)),
            ContourTarget::Point { .. } => None,
        };
        let (Some((origin, first)), Some((other, last))) = (ray(a), ray(b)) else { return false };
        let rays = b - a;
        if origin != other || rays > MAX_RAYS + 1 || is_on_wall[a + 1..b].contains(&true) {
            return false;
        }
        let signed = |angle: f64| (angle + PI).rem_euclid(TAU) - PI;
        let turn = signed(last - first);
        let bearing =
            signed((position[1] - origin[1]).atan2(position[0] - origin[0]) - first) * turn.signum();
        // Noise may assign the reading at the corner to either wall: half a step on both sides.
        let margin = 0.5 * turn.abs() / rays as f64;
        (-margin..=turn.abs() + margin).contains(&bearing)
    })
}

/// The readings at the end of a wall that faces a point: both ends if the point is within the wall.
fn extreme_readings(
    wall: &Wall,
    line: &WallLine,
    position: [f64; 2],
    readings: &[ContourReading],
) -> Vec<usize> {
    let along = |i: &usize| line.along(readings[*i].point());
    let lowest = wall.members.iter().min_by(|a, b| along(a).total_cmp(&along(b)));
    let highest = wall.members.iter().max_by(|a, b| along(a).total_cmp(&along(b)));
    let (Some(&low), Some(&high)) = (lowest, highest) else { return Vec::new() };
    let t = line.along(position);
    match t < 0.5 * (along(&low) + along(&high)) {
        true => vec![low],
        false => vec![high],
    }
}

/// Covariance of the intersection of two independent lines.
fn covariance(walls: [&Wall; 2], lines: [WallLine; 2], position: [f64; 2]) -> [f64; 3] {
    // From n₁·p = c₁ and n₂·p = c₂: δp = N⁻¹ r, where row k of r is δc_k + t_k δα_k.
    let normals = lines.map(|line| line.normal());
    let cross = normals[0][0] * normals[1][1] - normals[0][1] * normals[1][0];
    let mut covariance = [0.0; 3];
    for k in 0..2 {
        let t = lines[k].along(position);
        let c = &walls[k].fit.covariance;
        let variance = c[(1, 1)] + 2.0 * t * c[(0, 1)] + t * t * c[(0, 0)];
        let other = normals[1 - k];
        let column = [other[1] / cross, -other[0] / cross];
        covariance[0] += variance * column[0] * column[0];
        covariance[1] += variance * column[0] * column[1];
        covariance[2] += variance * column[1] * column[1];
    }
    covariance
}
