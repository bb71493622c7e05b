//! A depth buffer: the visible triangle in each pixel of an image.
//!
//! In: projected corners and triangles. Out: for each pixel, the nearest triangle, the point on it, and its
//! depth. Cost: one step for each pixel that a triangle covers, and one for each of its rows; threads share
//! the image in bands of rows. Copies of a triangle are drawn once.
//!
//! Not guaranteed: triangles that reach behind the camera are not drawn at all.

use crate::copies::distinct_triangles;
use rayon::prelude::*;
use std::ops::Range;

/// Number of rows in one parallel task; every task visits all triangles, so small bands would waste time.
const TASK_ROWS: usize = 64;
/// Copies of triangles are left out where triangles cover the image more often than this.
const MANY_LAYERS: f64 = 50.0;
/// Index of the triangle of an empty pixel.
const NO_TRIANGLE: u32 = u32::MAX;

/// A corner, projected into the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected {
    /// Column and row in pixels; the centre of the first pixel is (0.5, 0.5).
    pub at: [f64; 2],
    /// Distance along the optical axis; triangles with a corner at or behind the camera are not drawn.
    pub depth: f64,
}

/// The visible point in a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthVisibility {
    /// Index of the triangle.
    pub triangle: u32,
    /// Barycentric coordinates of the point, correct for a central projection.
    pub barycentric: [f64; 3],
    /// Distance along the optical axis.
    pub depth: f64,
}

/// The nearest triangle in every pixel.
///
/// # Examples
/// ```
/// use planish_mesh::{DepthBuffer, Projected};
/// let corners = [[0.0, 0.0], [8.0, 0.0], [0.0, 8.0]].map(|at| Projected { at, depth: 2.0 });
/// let buffer = DepthBuffer::draw(8, 8, &corners, &[[0, 1, 2]]);
/// assert_eq!(buffer.at(1, 1).map(|point| point.triangle), Some(0));
/// assert_eq!(buffer.at(7, 7), None);
/// ```
#[derive(Debug, Clone)]
pub struct DepthBuffer {
    columns: usize,
    first_row: usize,
    places: Vec<Place>,
}

/// A pixel. Weights are single precision: large images have millions of pixels.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// Inverse depth: larger is nearer.
    nearness: f64,
    triangle: u32,
    /// Barycentric weights of the second and third corner.
    weights: [f32; 2],
}

impl DepthBuffer {
    /// Draws triangles into an image of `columns` × `rows` pixels. Of two triangles at the same depth, the
    /// first is visible.
    #[must_use]
    pub fn draw(columns: usize, rows: usize, corners: &[Projected], triangles: &[[u32; 3]]) -> Self {
        Self::draw_rows(columns, 0..rows, corners, triangles)
    }

    /// Draws some rows of a larger image, to draw it part by part; see [`DepthBuffer::draw`].
    #[must_use]
    pub fn draw_rows(
        columns: usize,
        rows: Range<usize>,
        corners: &[Projected],
        triangles: &[[u32; 3]],
    ) -> Self {
        let empty = Place { nearness: 0.0, triangle: NO_TRIANGLE, weights: [0.0; 2] };
        let mut places = vec![empty; columns * rows.len()];
        let drawn = drawn_triangles((columns * rows.len()) as f64, corners, triangles);
        (places.par_chunks_mut((TASK_ROWS * columns).max(1)).enumerate()).for_each(|(band, places)| {
            let first_row = rows.start + band * TASK_ROWS;
            for &t in drawn.iter() {
                let corners = triangles[t as usize].map(|c| corners[c as usize]);
                draw_triangle(places, columns, first_row, &corners, t);
            }
        });
        Self { columns, first_row: rows.start, places }
    }

    /// The visible point in a pixel; `None` for the background.
    ///
    /// # Panics
    /// If the row was not drawn or the column is outside the image.
    #[must_use]
    pub fn at(&self, column: usize, row: usize) -> Option<DepthVisibility> {
        let place = self.places[(row - self.first_row) * self.columns + column];
        let [b, c] = place.weights.map(f64::from);
        (place.triangle != NO_TRIANGLE).then(|| DepthVisibility {
            triangle: place.triangle,
            barycentric: [1.0 - b - c, b, c],
            depth: 1.0 / place.nearness,
        })
    }
}

/// The triangles that are drawn: where triangles cover the image many times, those that are no copies.
///
/// A copy costs as much as the first and is never visible; a search for copies costs more than it saves in an
/// ordinary mesh.
fn drawn_triangles(pixels: f64, corners: &[Projected], triangles: &[[u32; 3]]) -> Vec<u32> {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|k| corners[k as usize].at);
        let twice = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        // The smaller number also where the area is not a number.
        (0.5 * twice.abs()).min(pixels)
    };
    match triangles.iter().map(area).sum::<f64>() > MANY_LAYERS * pixels {
        true => distinct_triangles(triangles),
        false => (0..triangles.len() as u32).collect(),
    }
}

/// Draws one triangle into a band of rows.
///
/// In the image, the inverse depth is an affine function of the position. So is each barycentric weight
/// divided by the depth. Both are interpolated linearly; the weights are divided at the end.
fn draw_triangle(
    places: &mut [Place],
    columns: usize,
    first_row: usize,
    corners: &[Projected; 3],
    name: u32,
) {
    // A triangle that reaches behind the camera would have to be clipped before projection.
    let usable = |c: &Projected| c.depth > 0.0 && c.at.iter().all(|x| x.is_finite());
    if !corners.iter().all(usable) {
        return;
    }
    let [a, b, c] = corners.map(|corner| corner.at);
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    // Both orientations are drawn: dividing by the signed area makes the weights positive inside either
    // way.
    if area == 0.0 {
        return;
    }
    let rows = places.len() / columns.max(1);
    let range = |k: usize, from: usize, count: usize| {
        let (low, high) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
        let place = |x: f64| (x - from as f64).clamp(0.0, count as f64) as usize;
        place((low - 0.5).ceil())..place((high - 0.5).floor() + 1.0)
    };
    let nearness = corners.map(|corner| 1.0 / corner.depth);
    let columns_covered = range(0, 0, columns);
    let weights = |x: f64, y: f64| {
        let in_second = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area;
        let in_third = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area;
        [1.0 - in_second - in_third, in_second, in_third]
    };
    // Growth of the weights from one column to the next.
    let growth = [(b[1] - c[1]) / area, (c[1] - a[1]) / area, (a[1] - b[1]) / area];
    for row in range(1, first_row, rows) {
        let y = (first_row + row) as f64 + 0.5;
        let left = columns_covered.start as f64 + 0.5;
        for column in columns_inside(columns_covered.clone(), weights(left, y), growth) {
            let [in_first, in_second, in_third] = weights(column as f64 + 0.5, y);
            // Borders count as inside for both neighbours. Open borders could leave pixels between them
            // empty.
            if in_first < 0.0 || in_second < 0.0 || in_third < 0.0 {
                continue;
            }
            let near = in_first * nearness[0] + in_second * nearness[1] + in_third * nearness[2];
            let place = &mut places[row * columns + column];
            // Strictly nearer: of equal depths the first triangle stays, whatever the number of threads.
            if near > place.nearness {
                *place = Place {
                    nearness: near,
                    triangle: name,
                    weights: [in_second * nearness[1] / near, in_third * nearness[2] / near]
                        .map(|w| w as f32),
                };
            }
        }
    }
}

/// The part of a row of columns where three affine functions, given by their values in the first column and
/// their growth, are positive; a column more on either side, for rounding.
///
/// Without it, a row would cost as much as the box about the triangle, which for slivers is many times more.
fn columns_inside(columns: Range<usize>, first: [f64; 3], growth: [f64; 3]) -> Range<usize> {
    let (mut low, mut high) = (0.0_f64, columns.len() as f64);
    for (value, growth) in first.into_iter().zip(growth) {
        let zero = -value / growth;
        // Not a number where the function is zero everywhere; infinite where it is constant.
        match growth {
            0.0.. if zero.is_finite() => low = low.max(zero.floor() - 1.0),
            ..0.0 if zero.is_finite() => high = high.min(zero.ceil() + 2.0),
            _ => {}
        }
    }
    let end = columns.start + high.max(0.0) as usize;
    let start = (columns.start + low as usize).min(end);
    start..end
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MeshSearch, icosphere};
    use planish_core::DVec3;

    /// The buffer shows the triangles that rays hit, at the same depth.
    #[test]
    fn visible_points_match_ray_hits() {
        let ball = icosphere(1.0, 3);
        let search = MeshSearch::try_new(&ball).unwrap();
        let (eye, focal, size) = (DVec3::new(0.1, -0.2, 3.0), 60.0, 101_usize);
        let middle = 0.5 * size as f64;
        // The camera looks down; rows increase with y.
        let corners: Vec<Projected> = (ball.positions.iter())
            .map(|p| {
                let depth = eye[2] - p[2];
                Projected { at: [0, 1].map(|k| middle + focal * (p[k] - eye[k]) / depth), depth }
            })
            .collect();
        let buffer = DepthBuffer::draw(size, size, &corners, &ball.triangles);
        let part = DepthBuffer::draw_rows(size, 40..60, &corners, &ball.triangles);
        let (mut seen_by_both, mut other) = (0, 0);
        for row in 0..size {
            for column in 0..size {
                let [x, y] = [column, row].map(|k| (k as f64 + 0.5 - middle) / focal);
                let hit = search.first_hit(eye, DVec3::new(x, y, -1.0));
                if (40..60).contains(&row) {
                    assert_eq!(part.at(column, row), buffer.at(column, row));
                }
                match (buffer.at(column, row), hit) {
                    (Some(seen), Some(hit)) => {
                        seen_by_both += 1;
                        let corners =
                            ball.triangles[seen.triangle as usize].map(|c| ball.positions[c as usize]);
                        let place = (corners.iter().zip(seen.barycentric))
                            .fold(DVec3::ZERO, |sum, (corner, w)| sum + w * *corner);
                        assert!((place - hit.point).length() < 1e-6, "{place:?} {hit:?}");
                        assert!((eye[2] - place[2] - seen.depth).abs() < 1e-6);
                    }
                    (None, None) => {}
                    _ => other += 1,
                }
            }
        }
        assert!(seen_by_both > 1000 && other == 0, "{seen_by_both} {other}");
    }

    /// Triangles behind the camera, without area, or with NaN coordinates are not drawn.
    #[test]
    fn invalid_triangles_are_not_drawn() {
        let at = |x: f64, y: f64, depth: f64| Projected { at: [x, y], depth };
        let corners = [
            at(0.0, 0.0, 1.0),
            at(4.0, 0.0, 1.0),
            at(0.0, 4.0, -1.0),
            at(f64::NAN, 4.0, 1.0),
            at(2.0, 0.0, 1.0),
            at(1e300, 1e300, 1.0),
        ];
        let triangles = [[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 5]];
        let buffer = DepthBuffer::draw(4, 4, &corners, &triangles);
        for row in 0..4 {
            for column in 0..4 {
                let seen = buffer.at(column, row).map(|seen| seen.triangle);
                assert!(seen.is_none_or(|triangle| triangle == 3), "{seen:?}");
            }
        }
        assert!(DepthBuffer::draw(0, 0, &corners, &triangles).places.is_empty());
    }
}
