//! Maps texture pixels to a mesh.
//!
//! Input: texture coordinates. Without them, every triangle gets half a square of an atlas. Output: a
//! [`Chart`], and for each pixel its triangle and the position on it.
//!
//! All squares of an atlas have the same number of pixels, so large triangles have a lower resolution.

use planish_exchange::textured::{NO_UV, TexturedMesh};
use planish_mesh::{DepthBuffer, Projected, TriangleMesh};

/// Pixels between a triangle of an atlas and the side of its square. Bilinear sampling reads half a pixel
/// beyond a triangle; a smaller margin would mix in the neighbour.
const MARGIN: f64 = 1.5;
/// Minimum side of an atlas square, in pixels. In smaller ones, the margins leave a triangle hardly any
/// pixels.
pub(super) const MIN_SQUARE: usize = 10;

/// Texture coordinates of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chart {
    /// From the lower left, 0 to 1.
    pub uv: Vec<[f64; 2]>,
    /// Those of each triangle's corners, or [`NO_UV`].
    pub triangles: Vec<[u32; 3]>,
}

impl Chart {
    /// The coordinates that a mesh has.
    pub(super) fn from_mesh(mesh: &TexturedMesh) -> Option<Self> {
        (!mesh.uv_triangles.is_empty())
            .then(|| Self { uv: mesh.uv.clone(), triangles: mesh.uv_triangles.clone() })
    }

    /// An atlas with two triangles in each square of a grid, for a picture of `side` × `side` pixels.
    pub(super) fn atlas(triangles: usize, side: usize) -> Self {
        let grid = squares_along(triangles);
        let square = (side / grid) as f64;
        let mut chart =
            Self { uv: Vec::with_capacity(3 * triangles), triangles: Vec::with_capacity(triangles) };
        for t in 0..triangles {
            let (cell, upper) = (t / 2, t % 2 == 1);
            let corner = [cell % grid, cell / grid].map(|k| k as f64 * square);
            // The two keep their margins from the sides, and twice as much from the diagonal between them.
            let (near, far) = (MARGIN, square - 2.5 * MARGIN);
            let of = |[x, y]: [f64; 2]| match upper {
                false => [x, y],
                true => [square - x, square - y],
            };
            let first = chart.uv.len() as u32;
            for place in [[near, near], [far, near], [near, far]] {
                let [x, y] = of(place);
                chart.uv.push([(corner[0] + x) / side as f64, (corner[1] + y) / side as f64]);
            }
            chart.triangles.push([first, first + 1, first + 2]);
        }
        chart
    }

    /// The triangle in each pixel of a picture. If several overlap, the first one is used.
    pub(super) fn drawn(&self, columns: usize, rows: usize) -> DepthBuffer {
        let mut corners: Vec<Projected> = (self.uv.iter())
            .map(|[u, v]| Projected { at: [u * columns as f64, (1.0 - v) * rows as f64], depth: 1.0 })
            .collect();
        let undefined_corner = corners.len() as u32;
        // A corner that is not a number keeps its triangle out of the buffer, and the numbering of triangles
        // intact.
        corners.push(Projected { at: [f64::NAN; 2], depth: 1.0 });
        let triangles: Vec<[u32; 3]> = (self.triangles.iter())
            .map(|t| t.map(|uv| if uv == NO_UV { undefined_corner } else { uv }))
            .collect();
        DepthBuffer::draw(columns, rows, &corners, &triangles)
    }

    /// Fraction of the picture covered by triangles. Overlaps are counted several times.
    pub(super) fn covered(&self) -> f64 {
        let place = |uv: u32| self.uv.get(uv as usize).copied();
        (self.triangles.iter())
            .filter_map(|t| Some([place(t[0])?, place(t[1])?, place(t[2])?]))
            // Without a sign, because parts of a chart may be mirrored.
            .map(|[a, b, c]| 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])).abs())
            .sum()
    }

    /// Triangles that have no coordinates, or reach out of the picture.
    pub(super) fn outside(&self) -> usize {
        let inside = |uv: &u32| {
            // Coordinates in files are rounded.
            (self.uv.get(*uv as usize)).is_some_and(|at| at.iter().all(|x| (-1e-6..=1.0 + 1e-6).contains(x)))
        };
        self.triangles.iter().filter(|t| !t.iter().all(inside)).count()
    }

    /// The texture coordinates of a place on a triangle.
    pub(super) fn place(&self, triangle: u32, weights: [f64; 3]) -> Option<[f64; 2]> {
        let mut at = [0.0; 2];
        for (uv, w) in self.triangles[triangle as usize].iter().zip(weights) {
            let corner = self.uv.get(*uv as usize)?;
            at = [at[0] + w * corner[0], at[1] + w * corner[1]];
        }
        Some(at)
    }
}

/// Number of squares along a side of an atlas.
pub(super) fn squares_along(triangles: usize) -> usize {
    ((triangles.div_ceil(2) as f64).sqrt().ceil() as usize).max(1)
}

/// The share of an atlas's picture that its triangles cover.
pub(super) fn atlas_share(triangles: usize) -> f64 {
    triangles as f64 / (2.0 * (squares_along(triangles) as f64).powi(2))
}

/// A value of the corners at a place on a triangle.
pub(super) fn at_place(
    mesh: &TriangleMesh,
    values: &[[f64; 3]],
    triangle: u32,
    weights: [f64; 3],
) -> [f64; 3] {
    let corners = mesh.triangles[triangle as usize];
    [0, 1, 2].map(|c| (corners.iter().zip(weights)).map(|(v, w)| w * values[*v as usize][c]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every triangle of an atlas has its own pixels, and each pixel maps to a position on it.
    #[test]
    fn every_triangle_fits_on_the_atlas() {
        let (count, side) = (45, 64);
        let chart = Chart::atlas(count, side);
        let drawn = chart.drawn(side, side);
        let mut pixels = vec![0; count];
        for row in 0..side {
            for column in 0..side {
                if let Some(seen) = drawn.at(column, row) {
                    pixels[seen.triangle as usize] += 1;
                    let [u, v] = chart.place(seen.triangle, seen.barycentric).unwrap();
                    let at = [u * side as f64 - 0.5, (1.0 - v) * side as f64 - 0.5];
                    assert!((at[0] - column as f64).abs() < 1e-4 && (at[1] - row as f64).abs() < 1e-4);
                }
            }
        }
        assert!(pixels.iter().all(|n| *n >= 6), "{pixels:?}");
        assert_eq!(chart.outside(), 0);
    }
}
