//! Poles of a ball: node numbering and polar extraction.
//!
//! Input: the functions of the tube that covers the ball. Output: three nodes per pole that replace the two
//! rings of functions next to it, and the expansion of these functions in the nodes.
//!
//! # References
//! Toshniwal, Speleers, Hiemstra, Hughes, *Multi-degree smooth polar splines*, CMAME 2017.

use super::layout::Functions;
use super::{Cell, Hierarchy, grid};
use std::collections::HashMap;

/// Extraction at a pole: two rings of tube functions from three pole nodes and the third ring.
#[derive(Debug, Clone)]
pub(super) struct PoleMap {
    pub(super) level: usize,
    pub(super) at_top: bool,
    /// First of the three pole nodes.
    pub(super) first_node: u32,
    /// Ring values of the two splines that represent cosine and sine around the pole.
    pub(super) cosine: Vec<f64>,
    pub(super) sine: Vec<f64>,
}

/// Angles of the three pole vertices.
pub(super) const POLE_ANGLES: [f64; 3] =
    [0.0, 2.0 * std::f64::consts::FRAC_PI_3, 4.0 * std::f64::consts::FRAC_PI_3];

impl PoleMap {
    /// Weights (nonnegative, sum one) of the three pole nodes in the ring-1 coefficient
    /// `β1_i = p + a cos_i + b sin_i`, with `T_k = p + 2 (a cos φ_k + b sin φ_k)`.
    fn ring_weights(&self, i: usize) -> [f64; 3] {
        POLE_ANGLES.map(|phi| (1.0 + self.cosine[i] * phi.cos() + self.sine[i] * phi.sin()) / 3.0)
    }
}

impl Hierarchy {
    /// The tube function in ring `r` (0 nearest the pole) and column `i`.
    pub(super) fn ring_function(&self, pole: &PoleMap, r: usize, i: usize) -> Cell {
        let rows = grid(self.base, pole.level)[1];
        let j = if pole.at_top { rows + 2 - r } else { r };
        Cell { level: pole.level as u8, i: i as u32, j: j as u32 }
    }

    /// Numbers the nodes: functions in their order, without two rings at each pole. These are replaced by
    /// three pole nodes at the end.
    pub(super) fn number_nodes(&mut self) {
        let mut replaced = vec![false; self.functions.len()];
        if self.polar() {
            for at_top in [false, true] {
                let at_pole = |level: usize| {
                    let last_row = grid(self.base, level)[1] as u32 - 1;
                    Cell { level: level as u8, i: 0, j: if at_top { last_row } else { 0 } }
                };
                let mut levels = (0..self.cells.levels()).rev();
                let level = levels.find(|&level| self.cells.contains(at_pole(level))).unwrap_or(0);
                let (mut cosine, mut sine) = (Vec::new(), Vec::new());
                let n = self.base[0];
                for i in 0..n {
                    // Greville point of function i: (i − 1) cells.
                    let angle = std::f64::consts::TAU * (i as f64 - 1.0) / n as f64;
                    cosine.push(angle.cos());
                    sine.push(angle.sin());
                }
                // The splines of cosine and sine come from the base grid and are refined with it. Computed
                // anew at each level they would be other splines, and levels would not be nested.
                for l in 0..level {
                    let basis = crate::basis::UniformBasis::new(3, n << l, crate::basis::End::Periodic)
                        .expect("a ball has at least four columns");
                    cosine = basis.refine(&cosine);
                    sine = basis.refine(&sine);
                }
                self.poles.push(PoleMap { level, at_top, first_node: 0, cosine, sine });
            }
            for (n, f) in self.functions.iter().enumerate() {
                for pole in &self.poles {
                    let rows = grid(self.base, pole.level)[1];
                    let ring =
                        if pole.at_top { rows + 2 - (f.j as usize).min(rows + 2) } else { f.j as usize };
                    replaced[n] |= usize::from(f.level) == pole.level && ring < 2;
                }
            }
        }
        for (n, f) in self.functions.iter().enumerate() {
            if replaced[n] {
                self.node_of_function.push(None);
                continue;
            }
            self.node_of_function.push(Some(self.node_anchors.len() as u32));
            let side = f.side();
            let mut anchor = [(f64::from(f.i) - 1.0) * side, (f64::from(f.j) - 1.0) * side];
            if self.periodic_u() {
                anchor[0] = anchor[0].rem_euclid(self.base[0] as f64);
            }
            if self.periodic_v() {
                anchor[1] = anchor[1].rem_euclid(self.base[1] as f64);
            }
            self.node_anchors.push(anchor);
        }
        for pole in &mut self.poles {
            pole.first_node = self.node_anchors.len() as u32;
            let v = if pole.at_top { self.base[1] as f64 } else { 0.0 };
            for k in 0..3 {
                self.node_anchors.push([self.base[0] as f64 * k as f64 / 3.0, v]);
            }
        }
    }

    /// For every tube function near a pole, the nodes of its coefficient with their weights.
    ///
    /// With clamped coefficients β0, β1, β2 of a meridian, the uniform ones are `c2 = β2`,
    /// `c1 = 1.5 β1 − 0.5 β2`, `c0 = 6 β0 − 6 β1 + β2` (blossoming); β0 is the pole, β1 the ring that spans
    /// its tangent plane.
    pub(super) fn pole_expansion(&self, functions: &Functions) -> HashMap<u32, Vec<(u32, f64)>> {
        let mut expansion = HashMap::new();
        for pole in &self.poles {
            let [columns, _] = grid(self.base, pole.level);
            for i in 0..columns {
                let at = |r: usize| {
                    functions[&self.ring_function(pole, r, i)].expect("functions at a pole are active")
                };
                let outer = self.node_of_function[at(2) as usize]
                    .expect("the third ring is not replaced by pole nodes");
                let ring = pole.ring_weights(i);
                let mut first = vec![(outer, -0.5)];
                let mut zeroth = vec![(outer, 1.0)];
                for (k, w) in ring.iter().enumerate() {
                    let node = pole.first_node + k as u32;
                    first.push((node, 1.5 * w));
                    // `6 β0`: the pole is the mean of the three vertices, so each has weight 6/3.
                    zeroth.push((node, 2.0 - 6.0 * w));
                }
                expansion.insert(at(1), first);
                expansion.insert(at(0), zeroth);
            }
        }
        expansion
    }
}
