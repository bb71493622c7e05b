//! Identifies the projector stripes of crossings by epipolar consistency.
//!
//! In: pieces of the net, camera, projector and pattern. Out: the two stripes of every crossing.
//!
//! A pixel of the projector appears on its epipolar line in the camera's image. The stripes of a piece are
//! known up to a shift by whole stripes and a quarter turn. Each such hypothesis assigns lines to all
//! crossings, and only the correct one has all crossings near their lines. More crossings make the choice
//! more certain. A piece with two equally good hypotheses is rejected, as happens for stripes along the
//! baseline.
//!
//! # References
//! - Hartley and Zisserman, *Multiple View Geometry*, 2004, section 9.1, for epipolar lines.

use super::crossings::Crossing;
use super::network::Knot;
use super::pattern::StripePattern;
use planish_core::matrix3::{from_rows, inverse, times, transposed_times};
use planish_core::{DVec3, Pinhole};

/// Limit of the distance of a crossing from its line, in pixels, so that outliers do not dominate the mean
/// square.
const FAR_OFF_PX: f64 = 2.0;
/// Maximum mean square of an accepted hypothesis, in pixels², and the minimum ratio of that of every other
/// one to it.
const GOOD_PX2: f64 = 0.5;
const MIN_RATIO: f64 = 4.0;
/// Floor of a mean square in that ratio, in pixels²: the accuracy of the calibration.
const MIN_SQUARE_PX2: f64 = 0.01;
/// Minimum number of crossings of a piece.
pub(super) const MIN_KNOTS: usize = 6;

/// Two views of one scene: lines of one for pixels of the other.
pub(super) struct EpipolarLines {
    baseline: DVec3,
    /// From a projector's pixel to a direction in the world.
    ray: [[f64; 3]; 3],
    /// From a plane through both centres to a line of the camera's image.
    line: [[f64; 3]; 3],
}

impl EpipolarLines {
    /// `None` if a matrix of intrinsics is singular.
    pub fn new(camera: &Pinhole, projector: &Pinhole) -> Option<Self> {
        let column = |m: &[[f64; 3]; 3], k: usize| DVec3::from_array(m.map(|row| row[k]));
        let (of_projector, of_camera) = (inverse(&projector.k)?, inverse(&camera.k)?);
        // Rᵀ K⁻¹ and K⁻ᵀ R, row by row.
        let ray = from_rows([0, 1, 2].map(|i| transposed_times(&of_projector, column(&projector.r, i))));
        let line = from_rows([0, 1, 2].map(|i| transposed_times(&camera.r, column(&of_camera, i))));
        Some(Self { baseline: projector.center() - camera.center(), ray, line })
    }

    /// The line `l · (x, y, 1) = 0` of a projector's pixel, with a unit normal: the product is a distance in
    /// pixels.
    pub fn line(&self, projector: [f64; 2]) -> Option<DVec3> {
        let along = times(&self.ray, DVec3::new(projector[0], projector[1], 1.0));
        let line = times(&self.line, self.baseline.cross(along));
        let length = line[0].hypot(line[1]);
        (length > 0.0).then(|| line / length)
    }
}

/// A crossing with its stripes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Indexed {
    /// Index of the crossing.
    pub crossing: usize,
    /// Its stripes of both sets.
    pub stripes: [i32; 2],
    /// Which of the crossing's stripes is that of the first set.
    pub first: usize,
}

/// The stripes of a piece; `None` if no hypothesis, or more than one, is accepted.
pub(super) fn index(
    piece: &[Knot],
    crossings: &[Crossing],
    lines: &EpipolarLines,
    pattern: &StripePattern,
) -> Option<Vec<Indexed>> {
    if piece.len() < MIN_KNOTS {
        return None;
    }
    let [d0, d1] = pattern.directions();
    // The piece's coordinates are counted in the image's orientation, the stripes in the pattern's.
    let sense = if d0[0] * d1[1] - d0[1] * d1[0] > 0.0 { 1 } else { -1 };
    // How the stripes change along the first set's direction, and after quarter turns.
    let steps = [[0, -sense], [1, 0], [0, sense], [-1, 0]];
    // Lines depend only on the crossing of the pattern, and each is used by many hypotheses.
    let [[a0, a1], [b0, b1]] = pattern.range;
    let width = (b1 - b0 + 1) as usize;
    let known: Vec<Option<DVec3>> = (a0..=a1)
        .flat_map(|a| (b0..=b1).map(move |b| [a, b]))
        .map(|of| lines.line(pattern.crossing(of.map(f64::from))))
        .collect();
    let line = |of: [i32; 2]| known[(of[0] - a0) as usize * width + (of[1] - b0) as usize];
    let (mut best, mut second): (Option<(f64, usize, [i32; 2])>, f64) = (None, f64::INFINITY);
    for turn in 0..4 {
        let (e, f) = (steps[turn], steps[(turn + 1) % 4]);
        let relative: Vec<[i32; 2]> =
            (piece.iter()).map(|k| [0, 1].map(|s| k.at[0] * e[s] + k.at[1] * f[s])).collect();
        let reach = |s: usize| {
            let numbers = relative.iter().map(|r| r[s]);
            (numbers.clone().min().unwrap_or(0), numbers.max().unwrap_or(0))
        };
        let ((low0, high0), (low1, high1)) = (reach(0), reach(1));
        // All shifts that keep the piece inside of the pattern. The cost is the number of shifts times that
        // of crossings, which is small for a pattern of some hundred stripes.
        for first in a0 - low0..=a1 - high0 {
            for other in b0 - low1..=b1 - high1 {
                let off = |(k, r): (&Knot, &[i32; 2])| {
                    let [x, y] = crossings[k.crossing].image;
                    let distance = line([first + r[0], other + r[1]])
                        .map_or(f64::INFINITY, |l| l.dot(DVec3::new(x, y, 1.0)));
                    distance.powi(2).min(FAR_OFF_PX * FAR_OFF_PX)
                };
                let mean = piece.iter().zip(&relative).map(off).sum::<f64>() / piece.len() as f64;
                // The second best is tracked as well: a hypothesis is accepted only if it is much better than
                // all others.
                match best {
                    Some((lowest, ..)) if mean >= lowest => second = second.min(mean),
                    _ => {
                        second = best.map_or(f64::INFINITY, |(lowest, ..)| lowest);
                        best = Some((mean, turn, [first, other]));
                    }
                }
            }
        }
    }
    let (mean, turn, shift) = best?;
    if mean > GOOD_PX2 || second < MIN_RATIO * mean.max(MIN_SQUARE_PX2) {
        return None;
    }
    let (e, f) = (steps[turn], steps[(turn + 1) % 4]);
    let indexed = |k: &Knot| Indexed {
        crossing: k.crossing,
        stripes: [0, 1].map(|s| shift[s] + k.at[0] * e[s] + k.at[1] * f[s]),
        first: (turn + k.turn) % 2,
    };
    Some(piece.iter().map(indexed).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corresponding_pixels_satisfy_the_epipolar_constraint() {
        let k = [[900.0, 2.0, 310.0], [0.0, 910.0, 250.0], [0.0, 0.0, 1.0]];
        let camera = Pinhole {
            k,
            r: [[0.96, 0.0, -0.28], [0.0, 1.0, 0.0], [0.28, 0.0, 0.96]],
            t: DVec3::new(3.0, -4.0, 10.0),
        };
        let projector = Pinhole {
            k,
            r: [[1.0, 0.0, 0.0], [0.0, 0.8, 0.6], [0.0, -0.6, 0.8]],
            t: DVec3::new(-90.0, 20.0, 30.0),
        };
        let lines = EpipolarLines::new(&camera, &projector).unwrap();
        for point in [[10.0, 20.0, 500.0], [-60.0, -30.0, 420.0], [80.0, 60.0, 610.0]] {
            let point = DVec3::from_array(point);
            let (seen, projected) = (camera.project(point).unwrap(), projector.project(point).unwrap());
            let line = lines.line(projected).unwrap();
            assert!(line.dot(DVec3::new(seen[0], seen[1], 1.0)).abs() < 1e-9);
        }
    }
}
