//! Consistent orientation of the triangles of a mesh.
//!
//! In: a mesh whose vertices are welded. Out: the same triangles, of which some are reversed. Not guaranteed:
//! which way a part faces; it keeps the side of most of its area.

use super::TriangleMesh;
use crate::edges::EdgeTable;
use planish_estimate::{Error, Result};

impl TriangleMesh {
    /// Reverses triangles so that neighbours across an edge face the same way; returns their number as well.
    ///
    /// Each part keeps the side of the larger area. Edges with more than two triangles do not connect parts.
    /// Cost O(n log n).
    ///
    /// # Errors
    /// `Undetermined` for a part with one side only, such as a Möbius strip.
    ///
    /// # Examples
    /// ```
    /// let mut ball = planish_mesh::icosphere(1.0, 2);
    /// ball.triangles[7].swap(0, 1);
    /// let (oriented, reversed) = ball.consistently_oriented()?;
    /// assert_eq!(reversed, 1);
    /// assert!(oriented.check().oriented);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn consistently_oriented(&self) -> Result<(Self, usize)> {
        let table = EdgeTable::new(&self.triangles);
        let start = |half: u32| self.triangles[half as usize / 3][half as usize % 3];
        // Across each edge of two triangles: the other triangle, and whether both run the same way.
        let mut links: Vec<[Option<(u32, bool)>; 3]> = vec![[None; 3]; self.triangles.len()];
        for edge in 0..table.len() {
            if let [a, b] = *table.half_edges(edge) {
                let against = start(a) == start(b);
                links[a as usize / 3][a as usize % 3] = Some((b / 3, against));
                links[b as usize / 3][b as usize % 3] = Some((a / 3, against));
            }
        }
        let mut reverse: Vec<Option<bool>> = vec![None; self.triangles.len()];
        for first in 0..self.triangles.len() {
            if reverse[first].is_some() {
                continue;
            }
            reverse[first] = Some(false);
            let mut part = vec![first];
            let mut next = 0;
            while let Some(&t) = part.get(next) {
                next += 1;
                let own = reverse[t] == Some(true);
                for (other, against) in links[t].into_iter().flatten() {
                    let wanted = own != against;
                    match reverse[other as usize] {
                        None => {
                            reverse[other as usize] = Some(wanted);
                            part.push(other as usize);
                        }
                        Some(found) if found != wanted => {
                            return Err(Error::undetermined(format!(
                                "expected a surface with two sides: its triangles cannot all face the same \
                                 way, found at triangle {other} (counted from 0)"
                            )));
                        }
                        Some(_) => {}
                    }
                }
            }
            let area = |t: &usize| {
                let [a, b, c] = self.corners(*t);
                (b - a).cross(c - a).length()
            };
            let all: f64 = part.iter().map(area).sum();
            let reversed: f64 = part.iter().filter(|t| reverse[**t] == Some(true)).map(area).sum();
            if reversed > 0.5 * all {
                for t in part {
                    reverse[t] = reverse[t].map(|is| !is);
                }
            }
        }
        let mut oriented = self.clone();
        let mut count = 0;
        for (t, _) in oriented.triangles.iter_mut().zip(&reverse).filter(|(_, r)| **r == Some(true)) {
            t.swap(1, 2);
            count += 1;
        }
        Ok((oriented, count))
    }
}

#[cfg(test)]
mod tests {
    use crate::mesh::TriangleMesh;
    use crate::primitives::icosphere;
    use planish_core::DVec3;

    /// Any minority of reversed triangles is found, in each part on its own.
    #[test]
    fn reversed_triangles_are_found_in_each_part() {
        let ball = icosphere(1.0, 2);
        let mut two = ball.clone();
        let count = ball.positions.len() as u32;
        two.positions.extend(ball.positions.iter().map(|p| *p + DVec3::splat(5.0)));
        two.triangles.extend(ball.triangles.iter().map(|t| t.map(|v| v + count)));
        let right = two.clone();
        for t in two.triangles.iter_mut().step_by(3) {
            t.swap(1, 2);
        }
        let (found, reversed) = two.consistently_oriented().unwrap();
        assert_eq!(reversed, two.triangles.len().div_ceil(3));
        let rotated = |t: &[u32; 3]| {
            let mut t = *t;
            let least = (0..3).min_by_key(|k| t[*k]).unwrap();
            t.rotate_left(least);
            t
        };
        let same = found.triangles.iter().map(rotated).eq(right.triangles.iter().map(rotated));
        assert!(same && found.check().oriented);
    }

    /// A strip of one side is refused.
    #[test]
    fn moebius_strip_is_refused() {
        let n = 12_u32;
        let positions = (0..2 * n)
            .map(|k| {
                let angle = std::f64::consts::TAU * f64::from(k / 2) / f64::from(n);
                let (s, c) = angle.sin_cos();
                let (half, side) = ((0.5 * angle).sin_cos(), f64::from(k % 2) - 0.5);
                DVec3::new(c * (3.0 + side * half.1), s * (3.0 + side * half.1), side * half.0)
            })
            .collect();
        let triangles = (0..n)
            .flat_map(|k| {
                let (a, b) = (2 * k, 2 * k + 1);
                // The last pair joins the first one with its ends exchanged.
                let (c, d) = if k + 1 == n { (1, 0) } else { (2 * k + 2, 2 * k + 3) };
                [[a, c, b], [b, c, d]]
            })
            .collect();
        let strip = TriangleMesh::try_new(positions, triangles).unwrap();
        assert!(strip.consistently_oriented().is_err());
    }
}
