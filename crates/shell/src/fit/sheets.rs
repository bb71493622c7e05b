//! Assigns a point to the sheets of a mesh near it, with probabilities.
//!
//! In: a point, and the facets near it. Out: sheets, which are groups of facets with similar normals and
//! heights; for each the height of the point over it, and the probability that the point was measured on it.
//!
//! Where sheets meet, cross or overlap, the mean of their heights is not a distance from any of them, and the
//! nearest sheet is too often the wrong one. A point measured with noise of σ somewhere on the mesh has the
//! density
//!
//! `Σ_g m_g exp(−ρ(h_g/σ))`,
//!
//! with `h_g` its height over sheet `g`. The mass `m_g` is the part of a Gaussian of σ in the plane, centred
//! at the foot point, that is on the sheet. The logarithm has the derivative `Σ_g p_g ρ'(h_g/σ) ∂h_g/σ`, with
//! `p_g` the share of sheet `g` in the sum. So every sheet has its own equation, weighted by the probability
//! that it is the correct one (A. Dempster, N. Laird, D. Rubin, *Maximum likelihood from incomplete data via
//! the EM algorithm*, 1977).
//!
//! With a Gaussian density the mean of these derivatives is zero on the true surface. A redescending loss has
//! longer tails. It leaves a part of the bias of the nearest sheet, with the opposite sign, but finds parts
//! that start far away. The orientation of normals does not matter: a flipped sheet has the same equation
//! with both signs changed.
//!
//! Not guaranteed: `m` is approximated by half planes at the facet's sides, or by a small piece. Its change
//! with the mesh is neglected, and so is the information lost by not knowing the sheet.

use crate::field::{FacetShare, Shell};
use planish_core::DVec3;
use planish_estimate::Loss;
use std::f64::consts::TAU;

/// Minimum cosine between the normals of facets of one sheet: 26°. A smaller cosine joins the sides of edges,
/// a larger one divides curved surfaces with coarse facets.
const SAME_DIRECTION: f64 = 0.9;
/// Maximum difference between the heights over facets of one sheet, in σ. Closer sheets cannot be
/// distinguished by one point.
const SAME_HEIGHT: f64 = 1.0;
/// Minimum probability of a sheet with an equation. Less probable ones would cost time and change nothing.
const MIN_PROBABILITY: f64 = 0.01;
/// In-plane distance in σ beyond which a facet has no mass: 10⁻⁷ of the mass at the foot point.
const CUTOFF: f64 = 5.7;

/// A facet near the point, as a member of a sheet.
#[derive(Debug, Clone, Copy)]
struct Member {
    normal: DVec3,
    height: f64,
    /// Mass `m` of the facet around the foot point.
    mass: f64,
    /// `m` times the density of its height.
    weight: f64,
    /// Its share of the sheet's height.
    part: f64,
    sheet: usize,
}

/// A sheet near a point.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sheet {
    /// The point's height over it.
    pub height: f64,
    /// The normal of its nearest facet.
    pub normal: DVec3,
    /// The probability that the point was measured on it.
    pub probability: f64,
    /// `ln(p/m)`, with masses `m` that sum to one over the sheets.
    pub log_ratio: f64,
    mass: f64,
    /// The height over its nearest facet.
    first: f64,
}

/// The sheets near a point; the buffers are reused for the next point.
#[derive(Debug, Default)]
pub(super) struct Sheets {
    members: Vec<Member>,
    order: Vec<usize>,
    pub list: Vec<Sheet>,
}

/// The normal distribution function `Φ(t)`, with an error below 0.01.
fn up_to(t: f64) -> f64 {
    // A shortcut, because most sides are far away.
    if t > CUTOFF {
        return 1.0;
    }
    let beyond = 0.5 * (-t.abs() * (0.717 + 0.416 * t.abs())).exp();
    if t < 0.0 { beyond } else { 1.0 - beyond }
}

/// Mass of a facet around the foot point. A small facet has the density times its area; a large one is
/// bounded by its sides. The smaller value holds.
fn mass(across: f64, area: f64, sigma: f64, within: impl FnOnce() -> [f64; 3]) -> f64 {
    let in_plane = across / sigma;
    if in_plane > CUTOFF {
        return 0.0;
    }
    // Two approximations of the Gaussian mass over a facet: density times area for small ones, a product over
    // the three sides for large ones. Each is an upper bound in the other's regime, so the minimum is used.
    let small = area / (TAU * sigma * sigma) * (-0.5 * in_plane * in_plane).exp();
    let large: f64 = within().iter().map(|d| up_to(d / sigma)).product();
    small.min(large)
}

impl Sheets {
    /// Finds the sheets among the facets of `shares`. `sigma` is the root mean square σ of the point over all
    /// directions. No sheet is found if no facet has an area.
    pub(super) fn find(
        &mut self,
        shell: &Shell<'_>,
        at: DVec3,
        shares: &[FacetShare],
        sigma: f64,
        loss: &Loss,
    ) {
        self.members.clear();
        self.order.clear();
        self.list.clear();
        for one in shares {
            let over = shell.over(at, one);
            let mass = mass(over.across, over.area, sigma, || shell.within(at, one));
            if mass > 0.0 {
                self.order.push(self.members.len());
            }
            // Facets without mass stay in the list, because its indices are those of `shares`.
            self.members.push(Member {
                normal: over.normal,
                height: over.height,
                mass,
                weight: mass * (-0.5 * (over.height / sigma).powi(2)).exp(),
                part: 0.0,
                sheet: usize::MAX,
            });
        }
        let (members, order) = (&mut self.members, &mut self.order);
        // The most likely facet defines its sheet, and others join it. Ties go by index.
        order.sort_unstable_by(|a, b| members[*b].weight.total_cmp(&members[*a].weight).then(a.cmp(b)));
        for &i in order.iter() {
            let own = members[i];
            let found = (self.list.iter()).position(|sheet| {
                sheet.normal.dot(own.normal) > SAME_DIRECTION
                    && (sheet.first - own.height).abs() < SAME_HEIGHT * sigma
            });
            let g = found.unwrap_or(self.list.len());
            if found.is_none() {
                self.list.push(Sheet { normal: own.normal, first: own.height, ..Sheet::default() });
            }
            let sheet = &mut self.list[g];
            sheet.height += own.mass * own.height;
            sheet.mass += own.mass;
            members[i].sheet = g;
        }
        for sheet in &mut self.list {
            sheet.height /= sheet.mass;
        }
        for &i in order.iter() {
            members[i].part = members[i].mass / self.list[members[i].sheet].mass;
        }
        self.weigh(sigma, loss);
    }

    /// Computes the probabilities of the sheets.
    fn weigh(&mut self, sigma: f64, loss: &Loss) {
        let cost = |sheet: &Sheet| loss.rho(sheet.height / sigma);
        // Costs relative to the smallest one: far from all sheets every exponential would be zero.
        let minimum = self.list.iter().map(cost).fold(f64::INFINITY, f64::min);
        let masses: f64 = self.list.iter().map(|sheet| sheet.mass).sum();
        let density = |sheet: &Sheet| sheet.mass * (minimum - cost(sheet)).exp();
        let all: f64 = self.list.iter().map(density).sum();
        for sheet in &mut self.list {
            sheet.probability = density(sheet) / all;
            sheet.log_ratio = (minimum - cost(sheet)).exp().ln() - (all / masses).ln();
        }
    }

    /// The sheets with an equation, with their indices.
    pub(super) fn likely(&self) -> impl Iterator<Item = (usize, &Sheet)> {
        (self.list.iter().enumerate()).filter(|(_, sheet)| sheet.probability >= MIN_PROBABILITY)
    }

    /// `∂h_g/∂V_j` for every vertex that the height over sheet `g` depends on.
    pub(super) fn by_vertices(
        &self,
        g: usize,
        shell: &Shell<'_>,
        at: DVec3,
        shares: &[FacetShare],
        mut visit: impl FnMut(u32, DVec3),
    ) {
        for (one, member) in shares.iter().zip(&self.members) {
            if member.sheet == g && member.part > 1e-3 {
                shell.height_by_vertices(at, one, member.part, &mut visit);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{Metaball, ShellOptions};
    use planish_mesh::TriangleMesh;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const SIGMA: f64 = 0.05;

    /// A floor, facets 0 and 1, and a fin along `y` that rises from it.
    fn floor_with_a_fin() -> TriangleMesh {
        let positions = vec![
            DVec3::new(-1.0, -1.0, 0.0),
            DVec3::new(1.0, -1.0, 0.0),
            DVec3::new(1.0, 1.0, 0.0),
            DVec3::new(-1.0, 1.0, 0.0),
            DVec3::new(0.0, -1.0, 0.0),
            DVec3::Y,
            DVec3::new(0.0, 1.0, 1.0),
            DVec3::new(0.0, -1.0, 1.0),
        ];
        TriangleMesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]] }
    }

    /// If each point belonged to its nearest sheet, the floor next to a fin would be pressed down: the points
    /// above it that are nearer to the fin would be missing.
    #[test]
    fn a_floor_next_to_a_fin_is_not_biased() {
        let mesh = floor_with_a_fin();
        let shell = Shell::new(&mesh, &ShellOptions::new(Metaball::Triangular, 20.0)).unwrap();
        let loss = Loss::tukey();
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let (mut shares, mut sheets) = (Vec::new(), Sheets::default());
        let (mut by_probability, mut by_nearest, mut squares, count) = (0.0, 0.0, 0.0, 40_000);
        for _ in 0..count {
            let (s, y) = (random.random_range(-0.25..0.5), random.random_range(-0.5..0.5));
            let on = if s < 0.25 { DVec3::new(s, y, 0.0) } else { DVec3::new(0.0, y, s - 0.25) };
            let at = on.map(|x| {
                let noise: f64 = StandardNormal.sample(&mut random);
                x + SIGMA * noise
            });
            let found = shell.distance(at, &mut shares).unwrap();
            sheets.find(&shell, at, &shares, SIGMA, &loss);
            let total: f64 = sheets.list.iter().map(|sheet| sheet.probability).sum();
            assert!((total - 1.0).abs() < 1e-9, "{total}");
            for (_, sheet) in sheets.likely().filter(|(_, sheet)| sheet.normal[2] > 0.5) {
                let pull = sheet.probability * loss.weight(sheet.height / SIGMA) * sheet.height / SIGMA;
                by_probability += pull;
                squares += pull * pull;
            }
            if found.facet < 2 {
                by_nearest += loss.weight(at[2] / SIGMA) * at[2] / SIGMA;
            }
        }
        let noise = squares.sqrt();
        assert!(by_nearest < -10.0 * noise, "{by_nearest} of {noise}");
        assert!(
            by_probability.abs() < 0.5 * by_nearest.abs(),
            "{by_probability} of {by_nearest}, noise {noise}"
        );
    }

    /// Derivatives are those of the height above the plane, both above a facet and outside of it.
    #[test]
    fn derivatives_agree_with_the_height() {
        let mut mesh = floor_with_a_fin();
        mesh.triangles = vec![[0, 1, 2]];
        let height = |mesh: &TriangleMesh, at: DVec3| {
            let [a, b, c] = mesh.corners(0);
            let m = (b - a).cross(c - a);
            m.dot(at - a) / m.length()
        };
        for at in [[0.3, -0.2, 0.1], [1.1, 0.3, -0.05], [-0.3, 0.2, 0.2], [1.05, 1.1, 0.1]] {
            let at = DVec3::from_array(at);
            let mut by = [DVec3::ZERO; 3];
            {
                let shell = Shell::new(&mesh, &ShellOptions::new(Metaball::Triangular, 20.0)).unwrap();
                let (mut shares, mut sheets) = (Vec::new(), Sheets::default());
                shell.distance(at, &mut shares).unwrap();
                sheets.find(&shell, at, &shares, 0.2, &Loss::tukey());
                assert!((sheets.list[0].height - height(&mesh, at)).abs() < 1e-12);
                sheets.by_vertices(0, &shell, at, &shares, |v, d| {
                    (0..3).for_each(|k| by[v as usize][k] += d[k]);
                });
            }
            for (v, by) in by.iter().enumerate() {
                for (k, by) in by.to_array().into_iter().enumerate() {
                    let moved = |step: f64| {
                        let mut other = mesh.clone();
                        other.positions[v][k] += step;
                        height(&other, at)
                    };
                    let difference = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                    assert!((by - difference).abs() < 1e-6, "{at:?} {v} {k}: {by} {difference}");
                }
            }
        }
    }

    /// Two parallel sheets with equal orientation are two: a point between them belongs to one of them, not
    /// to their mean.
    #[test]
    fn parallel_sheets_are_separated() {
        let mut mesh = floor_with_a_fin();
        mesh.triangles.truncate(2);
        for k in 0..4 {
            mesh.positions[4 + k] = mesh.positions[k].with_z(3.0 * SIGMA);
        }
        mesh.triangles.extend([[4, 5, 6], [4, 6, 7]]);
        let shell = Shell::new(&mesh, &ShellOptions::new(Metaball::Triangular, 20.0)).unwrap();
        let (mut shares, mut sheets) = (Vec::new(), Sheets::default());
        let at = DVec3::new(0.3, -0.2, SIGMA);
        shell.distance(at, &mut shares).unwrap();
        sheets.find(&shell, at, &shares, SIGMA, &Loss::Gaussian);
        assert_eq!(sheets.list.len(), 2, "{:?}", sheets.list);
        let ratio = sheets.list[0].probability / sheets.list[1].probability;
        assert!((ratio.ln() - 1.5).abs() < 0.05, "{ratio}");
        assert!((sheets.list[1].height + 2.0 * SIGMA).abs() < 1e-9);
    }
}
