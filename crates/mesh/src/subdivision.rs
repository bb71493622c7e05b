//! Smooth subdivision of triangle meshes.
//!
//! In: a mesh. Out: a mesh with four times as many triangles that is closer to a smooth surface. Vertices at
//! equal positions are merged. Not guaranteed: sharp edges and corners become round; only open borders keep
//! their curves.
//!
//! # References
//! - Loop, *Smooth subdivision surfaces based on triangles*, 1987; borders as in Hoppe et al., *Piecewise
//!   smooth surface reconstruction*, 1994.

use planish_core::DVec3;
use planish_estimate::Result;

use crate::edges::{EdgeTable, is_collapsed};
use crate::mesh::TriangleMesh;

impl TriangleMesh {
    /// One step of Loop's subdivision.
    ///
    /// A vertex of valence n becomes `(1 − nβ) p + β Σ qᵢ` with `β = (5/8 − (3/8 + cos(2π/n)/4)²)/n`. The new
    /// vertex of an edge is `3/8 (a + b) + 1/8 (c + d)`. On borders and non-manifold edges, these are
    /// `3/4 p + 1/8 (q₁ + q₂)` and the midpoint.
    ///
    /// # Errors
    /// As [`TriangleMesh::try_new`].
    ///
    /// # Examples
    /// ```
    /// let coarse = planish_mesh::icosphere(1.0, 1);
    /// let fine = coarse.subdivided()?;
    /// assert_eq!(fine.triangles.len(), 4 * coarse.triangles.len());
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn subdivided(&self) -> Result<Self> {
        self.sanity_check()?;
        let welded = self.welded();
        let triangles: Vec<[u32; 3]> =
            (welded.triangles.iter().copied()).filter(|t| !is_collapsed(*t)).collect();
        let table = EdgeTable::new(&triangles);
        let old = &welded.positions;
        let inner = |edge: usize| table.half_edges(edge).len() == 2;
        let mut around: Vec<(usize, DVec3)> = vec![(0, DVec3::ZERO); old.len()];
        // Border curves depend on border vertices only, so that two meshes with the same border still
        // fit.
        let mut border: Vec<(usize, DVec3)> = around.clone();
        for (edge, ends) in table.ends.iter().enumerate() {
            for (own, other) in [(ends[0], ends[1]), (ends[1], ends[0])] {
                let lists = if inner(edge) { vec![&mut around] } else { vec![&mut around, &mut border] };
                for list in lists {
                    let (count, sum) = &mut list[own as usize];
                    *count += 1;
                    *sum += old[other as usize];
                }
            }
        }
        let mut positions: Vec<DVec3> = (old.iter().zip(&around).zip(&border))
            .map(|((p, (n, sum)), (on_border, neighbours))| match (n, on_border) {
                (0, _) => *p,
                (_, 2) => 0.75 * *p + 0.125 * *neighbours,
                // Several borders meet here, and no curve passes through: the vertex is a corner and stays.
                (_, 1 | 3..) => *p,
                (n, _) => {
                    let n = *n as f64;
                    let share = 0.375 + 0.25 * (std::f64::consts::TAU / n).cos();
                    let beta = (0.625 - share * share) / n;
                    (1.0 - n * beta) * *p + beta * *sum
                }
            })
            .collect();
        let first_middle = positions.len() as u32;
        for (edge, ends) in table.ends.iter().enumerate() {
            let [a, b] = ends.map(|v| old[v as usize]);
            let middle = match table.half_edges(edge) {
                [s, t] => {
                    // Half-edges are numbered 3 t + k, so the opposite corner is that after the next.
                    let apex =
                        |half: u32| old[triangles[half as usize / 3][(half as usize % 3 + 2) % 3] as usize];
                    0.375 * (a + b) + 0.125 * (apex(*s) + apex(*t))
                }
                _ => 0.5 * (a + b),
            };
            positions.push(middle);
        }
        let mut finer = Vec::with_capacity(4 * triangles.len());
        for (corners, edges) in triangles.iter().zip(&table.triangle_edges) {
            let [ab, bc, ca] = edges.map(|e| first_middle + e);
            let [a, b, c] = *corners;
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        Self::try_new(positions, finer)
    }
}

#[cfg(test)]
mod tests {
    use crate::primitives::{grid_sheet, icosphere};

    #[test]
    fn a_ball_stays_watertight_and_becomes_rounder() {
        let coarse = icosphere(1.0, 1);
        let fine = coarse.subdivided().unwrap().subdivided().unwrap();
        assert_eq!(fine.triangles.len(), 16 * coarse.triangles.len());
        assert!(fine.check().watertight);
        let radii: Vec<f64> = fine.positions.iter().map(|p| p.length()).collect();
        let (smallest, largest) = radii.iter().fold((f64::MAX, 0.0_f64), |(a, b), &r| (a.min(r), b.max(r)));
        // Facets of the coarse ball are 6 % nearer to the centre than its corners. The limit surface of few
        // facets is not exactly a sphere.
        assert!(largest / smallest < 1.02, "{smallest} {largest}");
    }

    #[test]
    fn a_flat_sheet_stays_flat_and_keeps_its_border() {
        let sheet = grid_sheet(4.0, 2.0, 4, 2);
        let fine = sheet.subdivided().unwrap();
        assert!(fine.positions.iter().all(|p| p[2] == sheet.positions[0][2]));
        let (a, b) = (sheet.bounding_box().unwrap(), fine.bounding_box().unwrap());
        // Corners of the border become round, its straight parts stay.
        assert!((a.diagonal() - b.diagonal()).abs() < 0.5);
        assert!((fine.area() / sheet.area() - 1.0).abs() < 0.05);
    }
}
