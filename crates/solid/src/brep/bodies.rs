//! The bodies of a solid: its connected parts, each with the voids within it.

use super::{Solid, TrimmedFace};
use planish_core::{BoundingBox, DVec3};

/// Direction of rays. It is oblique to all usual faces, so that a ray does not run along one.
const RAY: DVec3 = DVec3::new(0.577_31, 0.211_93, 0.788_54);

/// A connected part of a solid.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Indices of the faces of the outer shell.
    pub outer: Vec<usize>,
    /// Indices of the faces of each void.
    pub voids: Vec<Vec<usize>>,
}

impl Solid {
    /// The bodies, largest first. A void belongs to the smallest outer shell around it.
    ///
    /// Shells with a negative volume are voids: their faces are oriented towards the void. A ray from one of
    /// its points determines which shells are around a void.
    #[must_use]
    pub fn bodies(&self) -> Vec<Body> {
        let mut shells: Vec<(f64, Vec<usize>)> =
            self.shells().into_iter().map(|s| (self.volume_of(&s), s)).collect();
        shells.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (outer, voids): (Vec<_>, Vec<_>) = shells.into_iter().partition(|s| s.0 > 0.0);
        if outer.is_empty() {
            // Without any positive shell, the solid is inside out: every shell stands for a body.
            return voids.into_iter().rev().map(|(_, outer)| Body { outer, voids: Vec::new() }).collect();
        }
        let mut bodies: Vec<Body> =
            outer.into_iter().map(|(_, outer)| Body { outer, voids: Vec::new() }).collect();
        for (_, void) in voids {
            // With one body, no ray is needed.
            let around = match bodies.len() {
                1 => 0,
                // The bodies are sorted by volume, so the first match from the end is the smallest.
                n => (0..n).rev().find(|k| self.is_around(&bodies[*k].outer, &void)).unwrap_or(0),
            };
            bodies[around].voids.push(void);
        }
        bodies
    }

    /// True if a shell is around another one: a ray from the latter crosses the shell an odd number of times.
    fn is_around(&self, shell: &[usize], inner: &[usize]) -> bool {
        let Some(edge) = self.faces[inner[0]].loops.iter().flatten().next() else {
            return false;
        };
        let edge = &self.edges[edge.edge];
        let from = edge.curve.point(0.37 * edge.range[0] + 0.63 * edge.range[1]);
        let bounds: BoundingBox = self.vertices.iter().copied().collect();
        // No face bulges beyond this margin. The seam of a whole sphere or torus has vertices, too, so even
        // such a shell has a box of a comparable size.
        let far = 4.0 * bounds.diagonal();
        let reach = [bounds.min - far, bounds.max + far];
        let crossings: usize = shell
            .iter()
            .map(|f| {
                let face = TrimmedFace::new(self, &self.faces[*f], reach);
                let met = face.met(from, RAY, [0.0, 3.0 * far]);
                met.into_iter().filter(|t| *t > 0.0 && face.contains(from + *t * RAY)).count()
            })
            .sum();
        crossings % 2 == 1
    }
}
