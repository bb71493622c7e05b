//! Outlines of hatched regions.
//!
//! A `HATCH` lists the paths of its boundary (group 92 each): polylines with bulges, or edges (group 72 each)
//! that are lines, arcs, arcs of ellipses or splines. Input: the record. Output: one polygon a path.

use super::groups::{Group, Record};
use crate::affine::Affine;
use planish_estimate::Result;
use planish_solid::drawing::Curve2;
use std::f64::consts::TAU;

/// Number of points along an arc of an ellipse.
const ELLIPSE_POINTS: usize = 64;
/// Flag of a path that is a polyline.
const POLYLINE: i64 = 2;

/// The polygons of the boundary, on the sheet.
pub(super) fn outlines(record: &Record, map: &Affine) -> Result<Vec<Vec<[f64; 2]>>> {
    // The first point is the elevation; from group 75 on, the pattern and its seeds follow.
    let boundary: Vec<&Group> =
        record.groups.iter().skip_while(|g| g.code != 91).skip(1).take_while(|g| g.code != 75).collect();
    let mut found = Vec::new();
    for path in boundary.chunk_by(|_, next| next.code != 92).filter(|path| path[0].code == 92) {
        let is_polyline = path[0].number()? as i64 & POLYLINE != 0;
        let outline = if is_polyline { polyline(path)? } else { edges(path)? };
        if outline.len() > 2 {
            found.push(outline.into_iter().map(|p| map.point(p)).collect());
        }
    }
    Ok(found)
}

/// The first value of a code.
fn value(groups: &[&Group], code: i32) -> Result<Option<f64>> {
    groups.iter().find(|g| g.code == code).map(|g| g.number()).transpose()
}

/// Points of codes 10 and 20.
fn points(groups: &[&Group]) -> Result<Vec<[f64; 2]>> {
    let of = |code: i32| -> Result<Vec<f64>> {
        groups.iter().filter(|g| g.code == code).map(|g| g.number()).collect()
    };
    Ok(of(10)?.into_iter().zip(of(20)?).map(|(x, y)| [x, y]).collect())
}

/// A polyline; a bulge is the tangent of a quarter of the angle of the arc to the next vertex.
fn polyline(path: &[&Group]) -> Result<Vec<[f64; 2]>> {
    let vertices = points(path)?;
    let mut bulges = vec![0.0; vertices.len()];
    let mut vertex = 0;
    for group in path {
        match group.code {
            10 => vertex += 1,
            42 if vertex > 0 && vertex <= bulges.len() => bulges[vertex - 1] = group.number()?,
            _ => {}
        }
    }
    let mut found = Vec::new();
    for (k, a) in vertices.iter().enumerate() {
        found.push(*a);
        let b = vertices[(k + 1) % vertices.len()];
        if bulges[k] != 0.0 && *a != b {
            found.extend(bulged(*a, b, bulges[k]));
        }
    }
    Ok(found)
}

/// Points between the ends of an arc with a bulge.
fn bulged(a: [f64; 2], b: [f64; 2], bulge: f64) -> Vec<[f64; 2]> {
    let angle = 4.0 * bulge.atan();
    // The centre is on the left of the chord for a positive bulge below a half turn.
    let off = 0.5 / (angle / 2.0).tan();
    let center = [(a[0] + b[0]) / 2.0 - off * (b[1] - a[1]), (a[1] + b[1]) / 2.0 + off * (b[0] - a[0])];
    let from = [a[0] - center[0], a[1] - center[1]];
    let count = (angle.abs() / TAU * ELLIPSE_POINTS as f64).ceil() as usize;
    (1..count)
        .map(|k| {
            let (sin, cos) = (angle * k as f64 / count as f64).sin_cos();
            [center[0] + cos * from[0] - sin * from[1], center[1] + sin * from[0] + cos * from[1]]
        })
        .collect()
}

/// Edges, in their order around the region.
fn edges(path: &[&Group]) -> Result<Vec<[f64; 2]>> {
    let mut pieces: Vec<Vec<[f64; 2]>> = Vec::new();
    let without_sources: Vec<&Group> = path.iter().copied().take_while(|g| g.code != 97).collect();
    for edge in without_sources.chunk_by(|_, next| next.code != 72).filter(|edge| edge[0].code == 72) {
        pieces.push(match edge[0].number()? as i64 {
            1 => {
                let end = value(edge, 11)?.zip(value(edge, 21)?).map(|(x, y)| [x, y]);
                points(edge)?.into_iter().take(1).chain(end).collect()
            }
            2 => arc(edge)?.map_or(Vec::new(), |curve| curve.points()),
            3 => ellipse(edge)?,
            // The control points of a spline: near the border, hatches are not judged.
            _ => points(edge)?,
        });
    }
    // Edges may run against the path.
    let mut outline: Vec<[f64; 2]> = Vec::new();
    for (k, mut piece) in pieces.iter().cloned().enumerate().filter(|(_, piece)| !piece.is_empty()) {
        let far = |p: [f64; 2], q: [f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]);
        let (first, last) = (piece[0], piece[piece.len() - 1]);
        let is_reversed = match (outline.last(), pieces.get(k + 1)) {
            (Some(end), _) => far(*end, last) < far(*end, first),
            (None, Some(next)) => next.iter().any(|q| far(*q, first) < 1e-9),
            _ => false,
        };
        if is_reversed {
            piece.reverse();
        }
        outline.extend(piece);
    }
    Ok(outline)
}

/// Start and sweep of an arc in degrees. Clockwise ones state their angles mirrored.
fn angles(edge: &[&Group]) -> Result<(f64, f64)> {
    let (from, to) = (value(edge, 50)?.unwrap_or(0.0), value(edge, 51)?.unwrap_or(360.0));
    let sweep = (to - from).rem_euclid(360.0);
    let sweep = if sweep < 1e-9 { 360.0 } else { sweep };
    let is_clockwise = value(edge, 73)? == Some(0.0);
    Ok(if is_clockwise { (-from - sweep, sweep) } else { (from, sweep) })
}

fn arc(edge: &[&Group]) -> Result<Option<Curve2>> {
    let (start, sweep) = angles(edge)?;
    let center = points(edge)?.first().copied();
    Ok(center.zip(value(edge, 40)?).filter(|(_, radius)| *radius > 0.0).map(|(center, radius)| Curve2::Arc {
        center,
        radius,
        start: start.to_radians(),
        sweep: sweep.to_radians(),
    }))
}

fn ellipse(edge: &[&Group]) -> Result<Vec<[f64; 2]>> {
    let (start, sweep) = angles(edge)?;
    let major = value(edge, 11)?.zip(value(edge, 21)?);
    let (Some(center), Some(major)) = (points(edge)?.first().copied(), major) else { return Ok(Vec::new()) };
    let ratio = value(edge, 40)?.unwrap_or(1.0);
    let at = |k: usize| {
        let (sin, cos) = (start + sweep * k as f64 / ELLIPSE_POINTS as f64).to_radians().sin_cos();
        [center[0] + cos * major.0 - ratio * sin * major.1, center[1] + cos * major.1 + ratio * sin * major.0]
    };
    Ok((0..=ELLIPSE_POINTS).map(at).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(groups: &str) -> Record {
        let words: Vec<&str> = groups.split_whitespace().collect();
        let groups = words.chunks(2).map(|pair| Group {
            code: pair[0].parse().unwrap(),
            value: pair[1].to_owned(),
            line: 1,
        });
        Record { kind: "HATCH".to_owned(), groups: groups.collect(), line: 1 }
    }

    fn area(outline: &[[f64; 2]]) -> f64 {
        let next = |k: usize| outline[(k + 1) % outline.len()];
        (0..outline.len()).map(|k| (outline[k][0] * next(k)[1] - next(k)[0] * outline[k][1]) / 2.0).sum()
    }

    #[test]
    fn paths_of_bulges_and_of_edges_bound_the_same_half_disc() {
        let bulged = record("10 0 20 0 91 1 92 2 72 1 73 1 93 2 10 1 20 0 42 1 10 -1 20 0 42 0 97 0 75 0");
        let edges = record(
            "10 0 20 0 91 1 92 1 93 2 72 2 10 0 20 0 40 1 50 0 51 180 73 1 \
             72 1 10 -1 20 0 11 1 21 0 97 0 75 0",
        );
        for record in [bulged, edges] {
            let found = outlines(&record, &Affine::IDENTITY).unwrap();
            assert_eq!(found.len(), 1);
            assert!((area(&found[0]).abs() - TAU / 4.0).abs() < 0.01, "{found:?}");
        }
    }

    #[test]
    fn clockwise_arcs_run_below() {
        // From 0° to 180° clockwise: the lower half of the circle.
        let below = record("10 0 20 0 91 1 92 1 93 1 72 2 10 0 20 0 40 1 50 0 51 180 73 0 97 0 75 0");
        let found = outlines(&below, &Affine::IDENTITY).unwrap();
        assert!(found[0].iter().all(|p| p[1] < 1e-9));
    }
}
