//! Colour of a place on a surface in one calibrated picture, and whether the picture sees the place.
//!
//! Input: a camera, its picture, an optional mask, and the mesh. Output: [`ColourSample`]s: a colour, and a
//! weight that increases with the resolution and decreases with the slant of the view.
//!
//! A place is visible if no facet in its pixel is nearer. This is decided by a depth buffer of the size of
//! the picture, interpolated between four pixels. Pixels at a depth edge or at the border of the mask are
//! ignored, and their neighbours have less weight: the mesh is not accurate to a pixel there, and the colour
//! could be that of the background. Memory: eight bytes per pixel.
//!
//! Not guaranteed: parts thinner than two pixels in a picture get no colour from it. Highlights and shadows
//! are treated as colours.

use planish_core::DVec3;
use planish_exchange::picture::Picture;
use planish_mesh::{DepthBuffer, TriangleMesh};
use planish_shell::Camera;
use planish_shell::projected_vertices;
use rayon::prelude::*;
use std::collections::VecDeque;

/// Distance from the nearest depth edge, in pixels, from which a pixel has full weight. A fitted mesh is
/// accurate to a few pixels (`docs/decisions/0064`).
const CLEAR_PX: u8 = 5;
/// Second difference of depth at a depth edge, in pixel widths. A plane has zero.
const DEPTH_EDGE: f64 = 10.0;
/// Maximum distance of a visible place behind the depth buffer, in pixel widths. Interpolation between pixels
/// cuts corners.
const MAX_DEPTH_BEHIND: f64 = 3.0;
/// Minimum cosine between normal and line of sight (81°). Beyond it, a pixel covers too much of the surface.
const MIN_COSINE: f64 = 0.15;
/// Power of the number of pixels per area in the weight of a view. With a higher power, borders between views
/// become visible. With 1, distant views blur the best one.
const SHARPNESS: f64 = 2.0;

/// A view that is prepared for sampling.
#[derive(Debug)]
pub(super) struct ColourView {
    pub camera: Camera,
    columns: usize,
    rows: usize,
    colours: Vec<[u8; 3]>,
    /// Depth of each pixel; infinite without surface.
    depth: Vec<f32>,
    /// Distance to the nearest depth edge in pixels; zero for ignored pixels.
    clear: Vec<u8>,
    /// The mesh's size, which makes weights free of units.
    size: f64,
}

/// Colour of a place in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ColourSample {
    /// Colour from 0 to 255, as the picture has it.
    pub colour: [f64; 3],
    /// Squared number of pixels per area at this angle, reduced near depth edges.
    pub weight: f64,
}

impl ColourView {
    /// Draws the mesh as the camera sees it. A mask has as many pixels as the picture.
    pub(super) fn new(
        camera: Camera,
        picture: &Picture,
        mask: Option<&[bool]>,
        mesh: &TriangleMesh,
        size: f64,
    ) -> Self {
        let (columns, rows) = (picture.columns, picture.rows);
        let corners = projected_vertices(mesh, &camera);
        let buffer = DepthBuffer::draw(columns, rows, &corners, &mesh.triangles);
        let depth: Vec<f32> = (0..columns * rows)
            .map(|k| match mask.is_none_or(|mask| mask[k]) {
                true => buffer.at(k % columns, k / columns).map_or(f32::INFINITY, |seen| seen.depth as f32),
                false => f32::INFINITY,
            })
            .collect();
        // Bytes and 32-bit depths: all views are in memory at once.
        let byte = |v: f32| (255.0 * v / picture.white).clamp(0.0, 255.0).round() as u8;
        let colours = (picture.values.chunks_exact(picture.channels))
            // The same expression reads grey pictures (one channel) and colours.
            .map(|p| [byte(p[0]), byte(p[p.len() / 2]), byte(p[p.len() - 1])])
            .collect();
        let clear = clear_of_jumps(&depth, columns, rows, camera.pinhole.focal_px());
        Self { camera, columns, rows, colours, depth, clear, size }
    }

    /// Colour of a place with a normal; `None` if the view does not see it. With `two_sided` the sign of the
    /// normal is ignored.
    pub(super) fn sample(&self, at: DVec3, normal: DVec3, two_sided: bool) -> Option<ColourSample> {
        let (pixel, depth) = self.camera.project(at)?;
        let corner = |x: f64, count: usize| {
            let low = x.floor();
            // Places between the outermost pixel centres and the frame are not interpolated.
            (low >= 0.0 && x <= count as f64 - 1.0 && count > 1).then_some((low as usize).min(count - 2))
        };
        let (column, row) = (corner(pixel[0], self.columns)?, corner(pixel[1], self.rows)?);
        let (x, y) = (pixel[0] - column as f64, pixel[1] - row as f64);
        let first = row * self.columns + column;
        let around = [
            (first, (1.0 - x) * (1.0 - y)),
            (first + 1, x * (1.0 - y)),
            (first + self.columns, (1.0 - x) * y),
            (first + self.columns + 1, x * y),
        ];
        let clear = around.iter().map(|(k, _)| self.clear[*k]).min().unwrap_or(0);
        // One of four pixels at an edge is enough to mix in the background.
        if clear == 0 {
            return None;
        }
        // The size of a pixel at this depth makes all limits independent of the unit.
        let width = depth / self.camera.pinhole.focal_px();
        let front: f64 = around.iter().map(|(k, w)| w * f64::from(self.depth[*k])).sum();
        if depth > front + MAX_DEPTH_BEHIND * width {
            return None;
        }
        let cosine = normal.dot((self.camera.center() - at).try_normalize()?);
        let cosine = if two_sided { cosine.abs() } else { cosine };
        // Also rejects back faces, whose cosine is negative.
        if cosine < MIN_COSINE {
            return None;
        }
        let pixels = cosine * (self.size / width).powi(2);
        Some(ColourSample {
            colour: [0, 1, 2].map(|c| around.iter().map(|(k, w)| w * f64::from(self.colours[*k][c])).sum()),
            weight: pixels.powf(SHARPNESS) * f64::from(clear) / f64::from(CLEAR_PX),
        })
    }

    /// Rms difference between the picture and the colours of the mesh, over all pixels away from depth edges.
    /// The colour is given for a triangle and barycentric weights. `None` if there are no such pixels.
    pub(super) fn difference(
        &self,
        mesh: &TriangleMesh,
        colour: impl Fn(u32, [f64; 3]) -> [f64; 3] + Sync,
    ) -> Option<f64> {
        let buffer = DepthBuffer::draw(
            self.columns,
            self.rows,
            &projected_vertices(mesh, &self.camera),
            &mesh.triangles,
        );
        let of_row = |row: usize| {
            let (mut sum, mut count) = (0.0, 0_usize);
            for column in 0..self.columns {
                let k = row * self.columns + column;
                let Some(seen) = buffer.at(column, row).filter(|_| self.clear[k] > 1) else {
                    continue;
                };
                let made = colour(seen.triangle, seen.barycentric);
                sum += (0..3).map(|c| (made[c] - f64::from(self.colours[k][c])).powi(2)).sum::<f64>();
                count += 3;
            }
            (sum, count)
        };
        let rows: Vec<(f64, usize)> = (0..self.rows).into_par_iter().map(of_row).collect();
        let (sum, count) = rows.iter().fold((0.0, 0), |(s, n), row| (s + row.0, n + row.1));
        (count > 0).then(|| (sum / count as f64).sqrt())
    }

    /// Approximate number of pixels of a triangle, visible or hidden; zero if seen from behind.
    pub(super) fn pixels_on(&self, corners: [DVec3; 3]) -> f64 {
        let mut at = [[0.0; 2]; 3];
        for (to, corner) in at.iter_mut().zip(corners) {
            match self.camera.project(corner) {
                Some((pixel, _)) => *to = pixel,
                None => return 0.0,
            }
        }
        let [a, b, c] = at;
        0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])).abs()
    }
}

/// Distances to the nearest jump of the depth in steps to one of eight neighbours, up to [`CLEAR_PX`]; the
/// picture's own border is none.
fn clear_of_jumps(depth: &[f32], columns: usize, rows: usize, focal: f64) -> Vec<u8> {
    let at = |column: usize, row: usize| f64::from(depth[row * columns + column]);
    let jumps = |column: usize, row: usize| {
        let pixel_depth = at(column, row);
        if !pixel_depth.is_finite() {
            return true;
        }
        let max_step = DEPTH_EDGE * pixel_depth / focal;
        // Along four lines through the pixel. At the border of the picture, only one side is checked.
        [(1, 0), (0, 1), (1, 1), (1, -1)].into_iter().any(|(dx, dy)| {
            let along = |sign: i64| {
                let (x, y) = (column as i64 + sign * dx, row as i64 + sign * dy);
                let inside = (0..columns as i64).contains(&x) && (0..rows as i64).contains(&y);
                inside.then(|| at(x as usize, y as usize))
            };
            match (along(-1), along(1)) {
                // The second difference, because a slanted plane has a large first one.
                (Some(a), Some(b)) => {
                    !(a.is_finite() && b.is_finite() && (a + b - 2.0 * pixel_depth).abs() <= max_step)
                }
                (Some(a), None) | (None, Some(a)) => !a.is_finite(),
                (None, None) => false,
            }
        })
    };
    let mut clear = vec![CLEAR_PX; depth.len()];
    let mut queue = VecDeque::new();
    for row in 0..rows {
        for column in 0..columns {
            if jumps(column, row) {
                clear[row * columns + column] = 0;
                queue.push_back((column, row));
            }
        }
    }
    // Breadth first, so each pixel gets its smallest distance.
    while let Some((column, row)) = queue.pop_front() {
        let next = clear[row * columns + column] + 1;
        for y in row.saturating_sub(1)..(row + 2).min(rows) {
            for x in column.saturating_sub(1)..(column + 2).min(columns) {
                let own = &mut clear[y * columns + x];
                if next < *own {
                    *own = next;
                    queue.push_back((x, y));
                }
            }
        }
    }
    clear
}
