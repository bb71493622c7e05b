//! Checks of the topology and geometry of a solid.

use super::Solid;
use planish_estimate::{Error, Result};
use std::collections::BTreeSet;

/// Number of intervals of an edge at whose ends it is compared with its faces.
const SAMPLES: usize = 5;

impl Solid {
    /// Checks topology and geometry.
    ///
    /// Every edge is used once in each direction (closed and oriented). Loops are connected. Edges end at
    /// their vertices and lie on their faces within `tolerance`. The Euler–Poincaré formula holds:
    /// `V − E + F − (L − F) = 2 (S − G)` with L loops, S shells, and an integer genus G ≥ 0. A face of a
    /// cylinder between two loops around it counts as if it had a seam.
    ///
    /// ```
    /// use planish_solid::brep::Solid;
    ///
    /// // A solid needs at least one face.
    /// assert!(Solid::default().check(1e-6).is_err());
    /// ```
    ///
    /// # Errors
    /// [`Input`](planish_estimate::ErrorKind::Input), naming the edge or face that does not fit.
    pub fn check(&self, tolerance: f64) -> Result<()> {
        if self.faces.is_empty() {
            return Err(Error::input("expected at least one face, found none"));
        }
        let mut used = vec![[0_u32; 2]; self.edges.len()];
        for (index, face) in self.faces.iter().enumerate() {
            for ring in &face.loops {
                for (k, coedge) in ring.iter().enumerate() {
                    let next = ring[(k + 1) % ring.len()];
                    if self.ends(*coedge)[1] != self.ends(next)[0] {
                        return Err(Error::input(format!(
                            "face {index}: edges {} and {} do not meet",
                            coedge.edge, next.edge
                        )));
                    }
                    used[coedge.edge][usize::from(coedge.forward)] += 1;
                    self.check_edge(index, coedge.edge, tolerance)?;
                }
            }
        }
        // One use in each direction makes the boundary closed, manifold along edges, and oriented. A seam has
        // both uses in one face.
        if let Some(edge) = used.iter().position(|u| *u != [1, 1]) {
            return Err(Error::input(format!(
                "edge {edge}: expected one use in each direction, found {} backward and {} forward",
                used[edge][0], used[edge][1]
            )));
        }
        self.check_euler()
    }

    /// Compares the ends of an edge with its vertices, and points along it with the surface of a face.
    fn check_edge(&self, face: usize, index: usize, tolerance: f64) -> Result<()> {
        let edge = &self.edges[index];
        for (vertex, t) in [(edge.start, edge.range[0]), (edge.end, edge.range[1])] {
            let apart = (self.vertices[vertex] - edge.curve.point(t)).length();
            if apart > tolerance {
                return Err(Error::input(format!("edge {index} ends {apart:e} away from vertex {vertex}")));
            }
        }
        for k in 0..=SAMPLES {
            let t = edge.range[0] + (edge.range[1] - edge.range[0]) * k as f64 / SAMPLES as f64;
            let apart = self.faces[face].surface.distance(edge.curve.point(t)).abs();
            if apart > tolerance {
                return Err(Error::input(format!("edge {index} lies {apart:e} off face {face}")));
            }
        }
        Ok(())
    }

    /// Tests that the genus in the Euler–Poincaré formula is an integer ≥ 0.
    fn check_euler(&self) -> Result<()> {
        let vertices: BTreeSet<usize> = self.edges.iter().flat_map(|e| [e.start, e.end]).collect();
        let loops: usize = self.faces.iter().map(|f| f.loops.len()).sum();
        let count = |n: usize| n as i64;
        // Each loop after the first one lowers the Euler characteristic of a face (1 for a disc) by one.
        let euler =
            count(vertices.len()) - count(self.edges.len()) + 2 * count(self.faces.len()) - count(loops);
        let genus2 = 2 * count(self.shells().len()) - euler;
        match genus2 >= 0 && genus2 % 2 == 0 {
            true => Ok(()),
            false => Err(Error::input(format!(
                "Euler–Poincaré: V − E + 2F − L = {euler} does not fit {} shells",
                self.shells().len()
            ))),
        }
    }
}
