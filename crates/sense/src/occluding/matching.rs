//! Matches points of adjacent views on the same epipolar curve.
//!
//! In: a point of a contour, and the contours of two other views. Out: the admissible pair of points with the
//! smallest radius, or the reason why there is none.
//!
//! An epipolar line crosses the contours of another view several times. Candidates must face the same way,
//! turn little, and form with the other view a circle on the inner side of the line of sight. The last
//! condition holds because an opaque surface is convex along a line of sight at its contour (J. Koenderink,
//! *What does the occluding contour tell us about solid shape?*, 1984).
//!
//! Not guaranteed: two silhouettes with similar motion may be confused; `joining` rejects inconsistent
//! matches later.

use super::circle::{Placed, Sight, meet, placed};
use super::curve::Local;
use super::{Contour, ContourView, OccludingOptions, Ready, Spot};

/// Tolerance of consistency tests, in σ.
const SIGMAS: f64 = 3.0;
/// Maximum radius as a share of the depth: the object must fit into the view.
const MAX_RADIUS: f64 = 1.0;
/// Tolerance of a point outside of another silhouette, in pixels, in addition to its σ; masks consist of
/// whole pixels.
const OUTSIDE_PX: f64 = 1.5;

/// A point with a depth.
pub(super) struct Found {
    pub placed: Placed,
    pub sight: Sight,
    pub local: Local,
    /// Its matches before and after.
    pub spots: [Spot; 2],
}

/// A point of another view on the epipolar line.
struct Candidate {
    spot: Spot,
    local: Local,
}

/// The points of a view on the epipolar plane of a line of sight; an error if that plane is tangent to the
/// surface.
fn candidates(
    sight: &Sight,
    of: &Ready<'_>,
    options: &OccludingOptions,
) -> Result<Vec<Candidate>, &'static str> {
    let plane = sight.epipolar_plane(of.eye.centre).ok_or("along_baseline")?;
    let min_sine = options.frontier_deg.to_radians().sin();
    let (outward, cosine) = sight.outward_in(plane).ok_or("frontier")?;
    if cosine < min_sine {
        return Err("frontier");
    }
    let line = of.eye.line(plane);
    let length = line[0].hypot(line[1]);
    if length == 0.0 {
        return Ok(Vec::new());
    }
    let line = line.map(|l| l / length);
    let off = |p: [f64; 2]| line[0] * p[0] + line[1] * p[1] + line[2];
    let min_cosine = options.max_turn_deg.to_radians().cos();
    let mut found = Vec::new();
    for (index, contour) in of.lines.iter().enumerate() {
        let count = contour.places.len();
        let last = if contour.curve.closed() { count } else { count - 1 };
        for k in 0..last {
            let (Some(a), Some(b)) = (&contour.places[k], &contour.places[(k + 1) % count]) else {
                continue;
            };
            let (da, db) = (off(a.place), off(b.place));
            // A change of sign, also from zero, so that a crossing at a point is counted once.
            if (da > 0.0) == (db > 0.0) {
                continue;
            }
            let refine = || {
                // Linear interpolation first, then two Newton steps on the fitted parabola.
                let mut at = (k as f64 + da / (da - db)) * contour.step;
                for _ in 0..2 {
                    let local = contour.curve.at(at)?;
                    let (_, by) = meet(line, local.place, local.along)?;
                    (by.abs() < 2.0 * contour.step).then_some(())?;
                    at = contour.curve.wrapped(at + by);
                }
                Some((at, contour.curve.at(at)?))
            };
            let Some((at, local)) = refine() else { continue };
            // A tangent along the epipolar line indicates a frontier point of that view.
            let slant = (line[0] * local.along[0] + line[1] * local.along[1]).abs();
            if local.corner || slant < min_sine {
                continue;
            }
            let seen = Sight::new(&of.eye, local.place, local.along);
            let facing = seen.and_then(|seen| Some((seen.way, seen.outward_in(plane)?.0)));
            if let Some((way, out)) = facing
                && out.dot(outward) > 0.0
                && way.dot(sight.way) > min_cosine
            {
                let spot = Spot { line: index, length: at };
                found.push(Candidate { spot, local });
            }
        }
    }
    Ok(found)
}

/// The best pair of matches.
pub(super) fn matched(
    view: &Ready<'_>,
    local: &Local,
    others: [&Ready<'_>; 2],
    options: &OccludingOptions,
) -> Result<Found, &'static str> {
    let sight = Sight::new(&view.eye, local.place, local.along).ok_or("corner")?;
    let [before, after] = [candidates(&sight, others[0], options)?, candidates(&sight, others[1], options)?];
    let mut best: Option<(f64, Found)> = None;
    let mut is_uncertain = false;
    for a in &before {
        for b in &after {
            let eyes = [&view.eye, &others[0].eye, &others[1].eye];
            let Some(placed) = placed(eyes, local, [&a.local, &b.local]) else {
                continue;
            };
            let solved = placed.solved;
            let sigma = placed.radius.sqrt();
            let allowed = solved.depth > 0.0
                && solved.radius > -SIGMAS * sigma
                && solved.radius - SIGMAS * sigma < MAX_RADIUS * solved.depth;
            if !allowed {
                continue;
            }
            if placed.depth.sqrt() > options.max_sigma_share * solved.depth {
                is_uncertain = true;
                continue;
            }
            // The smallest radius: a wrong match on a farther contour makes a large circle.
            let score = solved.radius.abs();
            if best.as_ref().is_none_or(|(lowest, _)| score < *lowest) {
                best = Some((score, Found { placed, sight, local: *local, spots: [a.spot, b.spot] }));
            }
        }
    }
    match best {
        Some((_, found)) => Ok(found),
        None if is_uncertain => Err("uncertain"),
        None => Err("no_match"),
    }
}

/// True if a point projects into all other silhouettes or onto their borders, within its σ.
pub(super) fn in_all_silhouettes(
    views: &[ContourView],
    own: usize,
    ready: &[Ready<'_>],
    found: &Found,
) -> bool {
    let sigma = found.placed.depth.sqrt();
    let at = found.placed.position;
    views.iter().zip(ready).enumerate().all(|(k, (view, ready))| {
        // An open outline has no inside.
        if k == own || view.silhouette.is_empty() || view.silhouette.iter().any(|c| !c.closed) {
            return true;
        }
        let camera = &ready.eye.camera;
        let Some(pixel) = camera.project(at) else {
            return false;
        };
        if inside(&view.silhouette, pixel) {
            return true;
        }
        let moved = camera.project(at + sigma * found.sight.way).unwrap_or(pixel);
        // σ of the depth, seen from the other view.
        let spread = (moved[0] - pixel[0]).hypot(moved[1] - pixel[1]);
        let allowed = OUTSIDE_PX + SIGMAS * (view.sigma_px + spread);
        near(&view.silhouette, pixel, allowed)
    })
}

/// True if a pixel is inside closed contours.
pub(super) fn inside(contours: &[Contour], at: [f64; 2]) -> bool {
    let mut inside = false;
    for contour in contours {
        let count = contour.places.len();
        for k in 0..count {
            let (p, q) = (contour.places[k], contour.places[(k + 1) % count]);
            if (p[1] > at[1]) != (q[1] > at[1])
                && at[0] < p[0] + (at[1] - p[1]) / (q[1] - p[1]) * (q[0] - p[0])
            {
                inside = !inside;
            }
        }
    }
    inside
}

fn near(contours: &[Contour], at: [f64; 2], distance: f64) -> bool {
    contours.iter().flat_map(|c| &c.places).any(|p| (p[0] - at[0]).hypot(p[1] - at[1]) <= distance)
}
