//! Converts entities to curves.

use super::groups::Record;
use super::smooth::with_chains;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_solid::views::Curve2;
use std::f64::consts::TAU;

/// Number of segments of an ellipse. Chords deviate by 0.2 % of the radius (1 − cos(π/48)); more segments
/// reduce the deviation and enlarge the drawing.
const CURVE_SEGMENTS: usize = 48;
/// Number of segments of a span of a spline.
const SPAN_SEGMENTS: usize = 8;

/// Curves of an entity; none if its kind draws no edges.
pub(super) fn curves_of(record: &Record) -> Result<Option<Vec<Curve2>>> {
    let turned = record.number(230)?.is_some_and(|z| z < 0.0);
    let flat = record.number(210)?.unwrap_or(0.0).abs() + record.number(220)?.unwrap_or(0.0).abs() < 1e-9;
    let curves = match record.kind.as_str() {
        "LINE" => vec![Curve2::Segment(point(record, 10)?, point(record, 11)?)],
        "CIRCLE" => vec![arc(record, 0.0, 360.0)?],
        "ARC" => {
            let (from, to) = (record.required(50, "a start angle")?, record.required(51, "an end angle")?);
            vec![arc(record, from, to)?]
        }
        "ELLIPSE" => vec![ellipse(record)?],
        "LWPOLYLINE" => polyline(record)?,
        "SPLINE" => vec![spline(record)?],
        _ => return Ok(None),
    };
    if !flat {
        return Err(Error::input("expected an entity in the xy plane, found another extrusion direction"));
    }
    // An extrusion direction of −z mirrors x (arbitrary axis algorithm of the DXF reference). Lines, ellipses
    // and splines are stored in world coordinates and are not affected.
    let planar = matches!(record.kind.as_str(), "CIRCLE" | "ARC" | "LWPOLYLINE");
    Ok(Some(match turned && planar {
        true => curves.iter().map(|curve| curve.moved(|[x, y]| [-x, y], true)).collect(),
        false => curves,
    }))
}

fn point(record: &Record, code: i32) -> Result<[f64; 2]> {
    Ok([record.required(code, "an x")?, record.required(code + 10, "a y")?])
}

fn points(record: &Record, code: i32) -> Result<Vec<[f64; 2]>> {
    let mut found = Vec::new();
    let mut x = None;
    for group in &record.groups {
        if group.code == code {
            x = Some(group.number()?);
        } else if group.code == code + 10
            && let Some(x) = x.take()
        {
            found.push([x, group.number()?]);
        }
    }
    Ok(found)
}

fn numbers(record: &Record, code: i32) -> Result<Vec<f64>> {
    record.groups.iter().filter(|g| g.code == code).map(|g| g.number()).collect()
}

fn arc(record: &Record, from: f64, to: f64) -> Result<Curve2> {
    let radius = record.required(40, "a radius")?;
    if radius < 0.0 {
        return Err(Error::input(format!("expected a radius > 0, found {radius}")));
    }
    if radius == 0.0 {
        // A curve without length, which the caller ignores with a warning.
        let center = point(record, 10)?;
        return Ok(Curve2::Segment(center, center));
    }
    // Arcs run counter-clockwise and may cross angle 0.
    let sweep = (to - from).rem_euclid(360.0);
    Ok(Curve2::Arc {
        center: point(record, 10)?,
        radius,
        start: from.to_radians(),
        sweep: if sweep < 1e-9 { TAU } else { sweep.to_radians() },
    })
}

fn ellipse(record: &Record) -> Result<Curve2> {
    let (center, major) = (point(record, 10)?, point(record, 11)?);
    let ratio = record.required(40, "a ratio of the axes")?;
    let from = record.number(41)?.unwrap_or(0.0);
    let sweep = (record.number(42)?.unwrap_or(TAU) - from).rem_euclid(TAU);
    // The remainder of a whole turn is zero, so zero stands for the whole ellipse.
    let sweep = if sweep < 1e-9 { TAU } else { sweep };
    let turned = if record.number(230)?.is_some_and(|z| z < 0.0) { -1.0 } else { 1.0 };
    let minor = [-major[1] * ratio * turned, major[0] * ratio * turned];
    Ok(Curve2::Chain(
        (0..=CURVE_SEGMENTS)
            .map(|k| {
                let (s, c) = (from + sweep * k as f64 / CURVE_SEGMENTS as f64).sin_cos();
                [0, 1].map(|a| center[a] + c * major[a] + s * minor[a])
            })
            .collect(),
    ))
}

fn polyline(record: &Record) -> Result<Vec<Curve2>> {
    let vertices = points(record, 10)?;
    let mut bulges = Vec::new();
    for group in &record.groups {
        match group.code {
            // A bulge follows its vertex and is omitted if it is 0, so the order of groups assigns it.
            10 => bulges.push(0.0),
            42 => {
                if let Some(last) = bulges.last_mut() {
                    *last = group.number()?;
                }
            }
            _ => {}
        }
    }
    let n = vertices.len();
    let closed = record.number(70)?.unwrap_or(0.0) as i64 & 1 == 1;
    let spans = if closed { n } else { n.saturating_sub(1) };
    let spans =
        (0..spans).map(|k| span(vertices[k], vertices[(k + 1) % n], bulges.get(k).copied().unwrap_or(0.0)));
    Ok(with_chains(spans.collect()))
}

/// Curves of an old-style polyline with its vertices; none for meshes (flags 16 and 64).
pub(super) fn polyline_curves(record: &Record, vertices: &[Record]) -> Result<Option<Vec<Curve2>>> {
    let flags = record.number(70)?.unwrap_or(0.0) as i64;
    if flags & (16 | 64) != 0 {
        return Ok(None);
    }
    if record.number(210)?.unwrap_or(0.0).abs() + record.number(220)?.unwrap_or(0.0).abs() > 1e-9 {
        return Err(Error::input("expected an entity in the xy plane, found another extrusion direction"));
    }
    let mut corners: Vec<([f64; 2], f64)> = Vec::with_capacity(vertices.len());
    for vertex in vertices {
        // Flag 16 marks control points of a spline frame, which are not on the curve.
        if vertex.number(70)?.unwrap_or(0.0) as i64 & 16 == 0 {
            let at = point(vertex, 10).map_err(|e| e.in_context(vertex.name()))?;
            corners.push((at, vertex.number(42)?.unwrap_or(0.0)));
        }
    }
    let n = corners.len();
    let spans = if flags & 1 == 1 { n } else { n.saturating_sub(1) };
    let curves = (0..spans).map(|k| span(corners[k].0, corners[(k + 1) % n].0, corners[k].1));
    let curves = with_chains(curves.collect());
    let mirrored = record.number(230)?.is_some_and(|z| z < 0.0);
    Ok(Some(match mirrored {
        true => curves.into_iter().map(|c| c.moved(|[x, y]| [-x, y], true)).collect(),
        false => curves,
    }))
}

/// Span of a polyline with bulge `b = tan(θ/4)`, where θ is the angle of its arc. Positive bulges run
/// counter-clockwise.
fn span(a: [f64; 2], b: [f64; 2], bulge: f64) -> Curve2 {
    if bulge == 0.0 {
        return Curve2::Segment(a, b);
    }
    let chord = [b[0] - a[0], b[1] - a[1]];
    // Distance of the centre from the chord, as a share of the chord; negative beyond half a turn.
    let off = (1.0 - bulge * bulge) / (4.0 * bulge);
    let center = [(a[0] + b[0]) / 2.0 - chord[1] * off, (a[1] + b[1]) / 2.0 + chord[0] * off];
    let begin = if bulge > 0.0 { a } else { b };
    Curve2::Arc {
        center,
        radius: (a[0] - center[0]).hypot(a[1] - center[1]),
        start: (begin[1] - center[1]).atan2(begin[0] - center[0]),
        sweep: 4.0 * bulge.abs().atan(),
    }
}

/// Converts a spline to a chain: through its fit points if it has them, else by de Boor's algorithm.
fn spline(record: &Record) -> Result<Curve2> {
    let fit = points(record, 11)?;
    // Fit points are on the curve and need no evaluation.
    if fit.len() >= 2 {
        return Ok(Curve2::Chain(fit));
    }
    let poles = points(record, 10)?;
    let knots = numbers(record, 40)?;
    let weights = numbers(record, 41)?;
    let degree = record.required(71, "a degree")? as usize;
    let ascending = knots.windows(2).all(|k| k[0] <= k[1]);
    // de Boor's algorithm costs the square of the degree; the limit bounds the work of a damaged file.
    if !(1..=15).contains(&degree)
        || poles.len() <= degree
        || knots.len() != poles.len() + degree + 1
        || !ascending
        || knots[degree] >= knots[poles.len()]
    {
        return Err(Error::input(format!(
            "expected ascending knots, poles + degree + 1 in number, found degree {degree}, {} poles, {} \
             knots",
            poles.len(),
            knots.len()
        )));
    }
    let at = |span: usize, t: f64| de_boor(&poles, &knots, &weights, degree, span, t);
    let mut chain = Vec::new();
    // Repeated knots bound empty spans.
    let spans = || (degree..poles.len()).filter(|&j| knots[j] < knots[j + 1]);
    for j in spans() {
        let step = (knots[j + 1] - knots[j]) / SPAN_SEGMENTS as f64;
        chain.extend((0..SPAN_SEGMENTS).map(|k| at(j, knots[j] + step * k as f64)));
    }
    // The last pole is the end only if the last knot has full multiplicity.
    chain.extend(spans().next_back().map(|j| at(j, knots[j + 1])));
    Ok(Curve2::Chain(chain))
}

/// Evaluates a rational B-spline in homogeneous coordinates (C. de Boor, *A Practical Guide to Splines*,
/// 1978).
fn de_boor(
    poles: &[[f64; 2]],
    knots: &[f64],
    weights: &[f64],
    degree: usize,
    span: usize,
    t: f64,
) -> [f64; 2] {
    let mut d: Vec<DVec3> = (0..=degree)
        .map(|i| {
            let at = span - degree + i;
            let w = weights.get(at).copied().filter(|w| *w > 0.0).unwrap_or(1.0);
            DVec3::new(poles[at][0] * w, poles[at][1] * w, w)
        })
        .collect();
    for r in 1..=degree {
        for i in (r..=degree).rev() {
            let (from, to) = (knots[span - degree + i], knots[span + 1 + i - r]);
            // Repeated knots would give 0/0.
            let a = if to > from { (t - from) / (to - from) } else { 0.0 };
            d[i] = (1.0 - a) * d[i - 1] + a * d[i];
        }
    }
    let [x, y, w] = d[degree].to_array();
    [x / w, y / w]
}
