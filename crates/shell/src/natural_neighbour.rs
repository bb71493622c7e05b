//! Natural-neighbour coordinates in space (R. Sibson 1980): weights of the points around a query point.
//!
//! In: sites in a box. Out: for a point `x` weights `w_j ≥ 0` of its natural neighbours with `Σ w_j = 1` and
//! `Σ w_j p_j = x`, and `w_j(p_j) = 1`.
//!
//! Inserting `x` gives it a Voronoi cell, and `w_j` is the share of that cell that belonged to `p_j` before.
//! The part `R_j` taken from `p_j` is a convex polytope. Its faces lie on the bisectors of `p_j` with `x` and
//! with other neighbours. Their corners are circumcentres of the old tetrahedra in conflict with `x`, and of
//! the new ones over the boundary of these. By the divergence theorem with the origin at `x`,
//!
//! `6 |R_j| = Σ_k m_jk · S_jk`,
//!
//! with `m` the midpoint of the two points and `S = Σ p × q` twice the vector area of the face, a sum over
//! its sides `pq`. A side belongs to the three faces dual to the edges of one triangle, so a loop over
//! triangles computes all sums without ordering polygons. D. F. Watson's formula is not used: its
//! determinants are 0/0 if `x` is in the plane of a face of an old tetrahedron.
//!
//! Rounding errors are removed by the smallest relative change of the weights that makes both sums exact.

use crate::delaunay::{BorderFace, Cavity, Delaunay, FACES};
use nalgebra::{Matrix4, Vector4};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::BoundingBox;
use rayon::prelude::*;

/// Size of the box relative to the points. A larger box extrapolates more smoothly and loses precision.
const BOX: f64 = 2.0;
/// A point closer to a site than this share of the box coincides with it.
const COINCIDENT: f64 = 1e-13;
/// Sites closer to each other than this share of the box are merged.
const MERGE_DISTANCE: f64 = 1e-12;
/// Number of corners of the box, which are sites too.
pub(crate) const BOX_CORNERS: usize = 8;
/// Points per task: within a task each search starts where the last one ended.
const PLACES_AT_ONCE: usize = 256;

/// The weight of a site at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weight {
    /// Index of the site: the eight corners of the box first, then the distinct points in the order given.
    pub site: u32,
    /// Its weight, from 0 to 1.
    pub weight: f64,
}

/// Sites in a box, for queries of natural-neighbour weights.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_shell::NaturalNeighbours;
/// let sites = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(1.0, 1.0, 1.0)];
/// let neighbours = NaturalNeighbours::new(&sites, &[])?;
/// let place = DVec3::new(0.3, 0.4, 0.5);
/// let weights = neighbours.weights(place)?;
/// for axis in 0..3 {
///     let sum: f64 = weights.iter().map(|w| w.weight * neighbours.site(w.site)[axis]).sum();
///     assert!((sum - place[axis]).abs() < 1e-12);
/// }
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct NaturalNeighbours {
    delaunay: Delaunay,
    site_of: Vec<u32>,
    size: f64,
}

/// Buffers that are reused between queries.
#[derive(Default)]
struct Query {
    cavity: Cavity,
    /// Circumcentres of the tetrahedra in conflict and of the new ones over the border, relative to the
    /// point.
    old_centers: Vec<DVec3>,
    new_centers: Vec<DVec3>,
    /// For each tetrahedron of the cavity, its index in it.
    place_in_cavity: Vec<u32>,
    /// Volumes, by site; zero between queries.
    volumes: Vec<f64>,
    touched: Vec<u32>,
    edges: Vec<([u32; 2], u32, bool)>,
    last: u32,
}

impl NaturalNeighbours {
    /// Sites in a box around them and the points `also`, twice as large as both together. The corners of the
    /// box are sites 0 to 7. Coincident points are one site.
    ///
    /// # Errors
    /// `Input` for points that are not finite, or none at all.
    pub fn new(points: &[DVec3], also: &[DVec3]) -> Result<Self> {
        for (k, point) in points.iter().enumerate() {
            if !point.is_finite() {
                return Err(Error::input(format!(
                    "control point {k}: expected finite coordinates, found {:?}",
                    point.to_array()
                )));
            }
        }
        let bounds = BoundingBox::around(points.iter().chain(also).copied())
            .filter(|_| !points.is_empty())
            .ok_or_else(|| Error::input("expected at least one point for natural neighbours"))?;
        let extent = bounds.longest_side();
        let half = 0.5 * BOX * if extent > 0.0 { extent } else { 1.0 };
        // The corners of the box are sites as well, so queries outside of the points' hull also have weights.
        let middle = bounds.center();
        let around = BoundingBox { min: middle.map(|x| x - half), max: middle.map(|x| x + half) };
        let mut delaunay = Delaunay::new(&around)?;
        let size = around.diagonal();
        let mut site_of = Vec::with_capacity(points.len());
        for point in points {
            let near = nearest_site(&delaunay, *point).filter(|(_, off)| *off < MERGE_DISTANCE * size);
            site_of.push(match near {
                Some((site, _)) => site,
                None => delaunay.insert(*point)?,
            });
        }
        Ok(Self { delaunay, site_of, size })
    }

    /// The position of a site.
    #[must_use]
    pub fn site(&self, site: u32) -> DVec3 {
        self.delaunay.points()[site as usize]
    }

    /// The site of each point.
    #[must_use]
    pub fn site_of(&self) -> &[u32] {
        &self.site_of
    }

    /// Length of the box's diagonal.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.size
    }

    /// The weights at a point.
    ///
    /// # Errors
    /// `Input` for a point outside of the box.
    pub fn weights(&self, at: DVec3) -> Result<Vec<Weight>> {
        let mut weights = Vec::new();
        self.weigh(at, &mut Query::default(), &mut weights)?;
        Ok(weights)
    }

    /// The weights at many points, computed in parallel. Cost: about 10 µs each.
    ///
    /// # Errors
    /// As for [`Self::weights`].
    pub fn weights_of_all(&self, places: &[DVec3]) -> Result<Vec<Vec<Weight>>> {
        let chunks: Vec<Result<Vec<Vec<Weight>>>> = places
            .par_chunks(PLACES_AT_ONCE)
            .map(|places| {
                let mut query = Query::default();
                places
                    .iter()
                    .map(|&at| {
                        let mut weights = Vec::new();
                        self.weigh(at, &mut query, &mut weights)?;
                        Ok(weights)
                    })
                    .collect()
            })
            .collect();
        let mut all = Vec::with_capacity(places.len());
        for chunk in chunks {
            all.extend(chunk?);
        }
        Ok(all)
    }

    fn weigh(&self, at: DVec3, query: &mut Query, weights: &mut Vec<Weight>) -> Result<()> {
        if !self.delaunay.holds(at) {
            return Err(Error::input(format!(
                "expected a point inside the box around the control points, found {:?}",
                at.to_array()
            )));
        }
        let points = self.delaunay.points();
        let start = self.delaunay.locate(at, query.last);
        // Neighbouring queries start near each other; the walk is then a few steps.
        query.last = start;
        let near = |site: &u32| points[*site as usize].distance(at) < COINCIDENT * self.size;
        if let Some(site) = self.delaunay.corners(start).into_iter().find(near) {
            weights.push(Weight { site, weight: 1.0 });
            return Ok(());
        }
        let mut cavity = std::mem::take(&mut query.cavity);
        self.delaunay.cavity(at, start, &mut cavity);
        self.measure(at, &cavity, query);
        query.cavity = cavity;
        for site in query.touched.drain(..) {
            // A sum that passed through zero is listed twice; the second entry finds zero.
            let weight = std::mem::take(&mut query.volumes[site as usize]);
            if weight > 0.0 {
                weights.push(Weight { site, weight });
            }
        }
        let total: f64 = weights.iter().map(|w| w.weight).sum();
        for w in weights.iter_mut() {
            w.weight /= total;
        }
        weights.sort_unstable_by_key(|w| w.site);
        self.exact(at, weights);
        Ok(())
    }

    /// Volumes `|R_j|` times twelve.
    fn measure(&self, at: DVec3, cavity: &Cavity, query: &mut Query) {
        let points = self.delaunay.points();
        // Relative to the query: circumcentres are differences of squares, which cancel far from the origin.
        let from_place = |site: u32| points[site as usize] - at;
        query.volumes.resize(points.len(), 0.0);
        query.old_centers.clear();
        let end = cavity.tetrahedra.iter().max().map_or(0, |t| *t as usize + 1);
        query.place_in_cavity.resize(query.place_in_cavity.len().max(end), u32::MAX);
        for (place, &t) in cavity.tetrahedra.iter().enumerate() {
            let [a, b, c, d] = self.delaunay.corners(t).map(from_place);
            let center = circumcenter_from([b, c, d].map(|p| p - a));
            query.old_centers.push(a + center);
            query.place_in_cavity[t as usize] = place as u32;
        }
        query.new_centers.clear();
        (query.new_centers)
            .extend(cavity.border.iter().map(|face| circumcenter_from(face.corners.map(from_place))));
        let (volumes, touched) = (&mut query.volumes, &mut query.touched);
        let mut give = |site: u32, volume: f64| {
            let own = &mut volumes[site as usize];
            if *own == 0.0 {
                touched.push(site);
            }
            *own += volume;
        };
        // Sides dual to a triangle `abc` of old points, counter-clockwise as seen from the end of the side.
        let mut old = |[a, b, c]: [u32; 3], from: DVec3, to: DVec3| {
            let w = from.cross(to);
            let [pa, pb, pc] = [a, b, c].map(from_place);
            give(a, (pb - pc).dot(w));
            give(b, (pc - pa).dot(w));
            give(c, (pa - pb).dot(w));
        };
        for (place, &t) in cavity.tetrahedra.iter().enumerate() {
            let (corners, neighbours) = (self.delaunay.corners(t), self.delaunay.neighbours(t));
            for k in 0..4 {
                let across = query.place_in_cavity.get(neighbours[k] as usize).copied().unwrap_or(u32::MAX);
                if across != u32::MAX && place < across as usize {
                    let [from, to] = [place, across as usize].map(|p| query.old_centers[p]);
                    old(FACES[k].map(|c| corners[c]), from, to);
                }
            }
        }
        for (BorderFace { corners, inside, .. }, to) in cavity.border.iter().zip(&query.new_centers) {
            old(*corners, query.old_centers[query.place_in_cavity[*inside as usize] as usize], *to);
        }
        // Sides dual to a triangle of the place and an edge of the border, where two new tetrahedra meet.
        query.edges.clear();
        for (k, face) in cavity.border.iter().enumerate() {
            let [a, b, c] = face.corners;
            for [p, q] in [[a, b], [b, c], [c, a]] {
                query.edges.push(([p.min(q), p.max(q)], k as u32, p < q));
            }
        }
        // Each edge of the border belongs to exactly two faces, so sorting pairs them without a table.
        query.edges.sort_unstable_by_key(|(edge, _, forward)| (*edge, !*forward));
        for pair in query.edges.chunks_exact(2) {
            let ([a, b], of) = (pair[0].0, [pair[0].1, pair[1].1]);
            let [from, to] = of.map(|k| query.new_centers[k as usize]);
            let w = from.cross(to);
            give(b, -from_place(a).dot(w));
            give(a, from_place(b).dot(w));
        }
        for &t in &cavity.tetrahedra {
            query.place_in_cavity[t as usize] = u32::MAX;
        }
    }

    /// Makes both sums exact by the smallest relative change `δw_j = w_j (λ₀ + λ·p_j)`, which preserves signs
    /// and zeros.
    fn exact(&self, at: DVec3, weights: &mut [Weight]) {
        let reach = (weights.iter()).map(|w| self.site(w.site).distance(at)).fold(0.0, f64::max);
        if reach == 0.0 {
            return;
        }
        // The second round removes the rounding of the first.
        for _ in 0..2 {
            let (mut normal, mut left) = (Matrix4::zeros(), Vector4::new(1.0, 0.0, 0.0, 0.0));
            for w in weights.iter() {
                let DVec3 { x, y, z } = 1.0 / reach * (self.site(w.site) - at);
                let row = Vector4::new(1.0, x, y, z);
                normal += w.weight * row * row.transpose();
                left -= w.weight * row;
            }
            // If the point and all its neighbours are on a line or in a plane, the matrix is singular in the
            // other directions, where no correction is needed.
            let ridge = 1e-14 * normal.trace();
            let Some(factor) = (normal + Matrix4::from_diagonal_element(ridge)).cholesky() else {
                return;
            };
            let multiplier = factor.solve(&left);
            for w in weights.iter_mut() {
                let DVec3 { x, y, z } = 1.0 / reach * (self.site(w.site) - at);
                let change = multiplier.dot(&Vector4::new(1.0, x, y, z));
                // The limit keeps signs, whatever the condition of the system.
                w.weight *= 1.0 + change.clamp(-0.5, 0.5);
            }
        }
    }
}

/// The circumcentre of the origin and three points; zero if it is not finite, because they are coplanar.
fn circumcenter_from([a, b, c]: [DVec3; 3]) -> DVec3 {
    let (bc, ca, ab) = (b.cross(c), c.cross(a), a.cross(b));
    let six = a.dot(bc);
    let [aa, bb, cc] = [a, b, c].map(|p| p.length_squared());
    let sum = aa * bc + bb * ca + cc * ab;
    let center = 0.5 / six * sum;
    if center.length().is_finite() { center } else { DVec3::ZERO }
}

fn nearest_site(delaunay: &Delaunay, at: DVec3) -> Option<(u32, f64)> {
    (delaunay.points().iter().enumerate().skip(BOX_CORNERS))
        .map(|(k, p)| (k as u32, p.distance(at)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random_points(count: usize, seed: u64) -> Vec<DVec3> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..count)
            .map(|_| DVec3::from_array(std::array::from_fn(|_| random.random_range(0.0..1.0))))
            .collect()
    }

    /// Sibson (1980): weights are non-negative, add up to one, and reproduce the position as the weighted
    /// mean of the sites.
    fn judge(points: &[DVec3], places: &[DVec3]) {
        let neighbours = NaturalNeighbours::new(points, places).unwrap();
        let all = neighbours.weights_of_all(places).unwrap();
        for (place, weights) in places.iter().zip(&all) {
            let (mut sum, mut mean) = (0.0, DVec3::ZERO);
            for w in weights {
                assert!(w.weight >= 0.0);
                sum += w.weight;
                mean += w.weight * neighbours.site(w.site);
            }
            assert!((sum - 1.0).abs() < 1e-10, "{place:?}: {sum}");
            let off = mean.distance(*place) / neighbours.size();
            assert!(off < 1e-10, "{place:?} of {points:?}: {off:e} of the box off");
        }
    }

    #[test]
    fn weights_have_sibsons_properties_for_all_kinds_of_sites() {
        let places: Vec<DVec3> = (random_points(2000, 7).iter()).map(|p| p.map(|x| 1.4 * x - 0.2)).collect();
        let grid: Vec<DVec3> = (0..125)
            .map(|k| DVec3::from_array([k % 5, k / 5 % 5, k / 25].map(|i| f64::from(i) / 4.0)))
            .collect();
        let coplanar: Vec<DVec3> = random_points(40, 3).iter().map(|p| DVec3::new(p.x, p.y, 0.5)).collect();
        let mut twice = random_points(30, 4);
        twice.extend(twice.clone());
        let on_grid: Vec<DVec3> = (0..1331)
            .map(|k| DVec3::from_array([k % 11, k / 11 % 11, k / 121].map(|i| f64::from(i) / 8.0 - 0.125)))
            .collect();
        let nearly: Vec<DVec3> =
            (grid.iter().zip(random_points(125, 5))).map(|(p, noise)| p + 1e-9 * noise).collect();
        for points in [
            random_points(200, 1),
            grid,
            nearly,
            coplanar,
            twice,
            vec![DVec3::splat(0.5)],
            random_points(2, 2),
        ] {
            judge(&points, &places);
            judge(&points, &on_grid);
            judge(&points, &points);
        }
    }

    /// Weights are ratios of volumes, checked by Monte Carlo sampling in a box.
    #[test]
    fn weights_are_ratios_of_volumes() {
        let points = random_points(60, 11);
        let neighbours = NaturalNeighbours::new(&points, &[]).unwrap();
        let at = DVec3::new(0.45, 0.55, 0.5);
        let weights = neighbours.weights(at).unwrap();
        let sites: Vec<DVec3> = (0..points.len() as u32 + 8).map(|s| neighbours.site(s)).collect();
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let (mut in_cell, mut of) = (0.0, vec![0.0; sites.len()]);
        for _ in 0..200_000 {
            let p: DVec3 = DVec3::from_array(std::array::from_fn(|k| at[k] + random.random_range(-0.4..0.4)));
            let (nearest, off) = (sites.iter().enumerate())
                .map(|(k, s)| (k, s.distance(p)))
                .min_by(|a, b| a.1.total_cmp(&b.1))
                .unwrap();
            if at.distance(p) < off {
                in_cell += 1.0;
                of[nearest] += 1.0;
            }
        }
        for (site, count) in of.iter().enumerate() {
            let stated = weights.iter().find(|w| w.site == site as u32).map_or(0.0, |w| w.weight);
            assert!(
                (count / in_cell - stated).abs() < 0.02,
                "site {site}: {} counted, {stated}",
                count / in_cell
            );
        }
    }

    #[test]
    fn a_site_has_weight_one_at_its_position() {
        let points = random_points(50, 9);
        let neighbours = NaturalNeighbours::new(&points, &[]).unwrap();
        for (k, point) in points.iter().enumerate() {
            let weights = neighbours.weights(*point).unwrap();
            assert_eq!(weights, [Weight { site: k as u32 + 8, weight: 1.0 }]);
        }
        // Next to a site its weight is almost one, because weights are continuous.
        let nearby = neighbours.weights(points[3] + DVec3::new(1e-7, -1e-7, 2e-7)).unwrap();
        assert!(nearby.iter().any(|w| w.site == 11 && w.weight > 1.0 - 1e-4));
    }

    #[test]
    fn messages_name_the_invalid_value() {
        let at = |result: Result<NaturalNeighbours>| result.unwrap_err().to_string();
        assert!(at(NaturalNeighbours::new(&[], &[])).contains("at least one"));
        assert!(
            at(NaturalNeighbours::new(&[DVec3::ZERO, DVec3::new(f64::NAN, 0.0, 0.0)], &[]))
                .contains("point 1")
        );
        let neighbours = NaturalNeighbours::new(&[DVec3::ZERO, DVec3::splat(1.0)], &[]).unwrap();
        assert!(neighbours.weights(DVec3::splat(9.0)).is_err());
    }
}
