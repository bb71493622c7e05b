//! Corners: points where two walls meet.

use super::Wall;
use super::line::WallLine;

/// Walls meet if both end within this many readings of their intersection. Readings near a corner may belong
/// to the other wall, which takes one.
const END_SPACINGS: f64 = 2.5;

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

/// Points where two walls meet: intersections within two and a half readings of an end of a span of both.
///
/// The covariance is that of the intersection of two independent lines. Walls that share errors of poses are
/// correlated, which it omits.
#[must_use]
pub fn wall_corners(walls: &[Wall]) -> Vec<WallCorner> {
    let mut corners = Vec::new();
    for i in 0..walls.len() {
        for j in i + 1..walls.len() {
            let pair = [&walls[i], &walls[j]];
            let lines = pair.map(|wall| WallLine::new(wall.fit.state[0], wall.fit.state[1]));
            let Some(position) = lines[0].intersection(&lines[1]) else { continue };
            if pair.iter().all(|wall| ends_near(wall, position)) {
                let covariance = covariance(pair, lines, position);
                corners.push(WallCorner { walls: [i, j], position, covariance });
            }
        }
    }
    corners
}

/// True if an end of a span of the wall is near a point, in spacings of its readings there.
fn ends_near(wall: &Wall, position: [f64; 2]) -> bool {
    let is_near = |end: &[f64; 2], spacing: f64| {
        (end[0] - position[0]).hypot(end[1] - position[1]) <= END_SPACINGS * spacing
    };
    (wall.spans.iter().zip(&wall.end_spacings))
        .any(|(span, spacings)| (0..2).any(|k| is_near(&span[k], spacings[k])))
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
