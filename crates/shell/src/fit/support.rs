//! Where points support a fitted mesh, and shape that the mesh does not follow, vertex by vertex.
//!
//! In: the fitted mesh, the points with their residuals, and which of them the fit rejected. Out: for each
//! vertex whether points are near it on its side of the sheet, and the σ of unresolved shape there.
//!
//! A vertex is supported if at least [`MIN_NEAR`] feet lie within [`REACH`] times their own spacing from
//! it, on facets that face the same way. The information of a vertex does not show this: a few parameters
//! that points determine elsewhere move unseen vertices as well.
//!
//! Residuals `r_i = n_i + m(x_i)` contain noise and unresolved shape ([`super::correlation`]). The
//! product of a residual and the mean of its neighbours' has the expectation `m²`, because their noise is
//! independent. Its mean over the points around a vertex is the local `m²`. The mean of this field is
//! scaled to the `m²` of all points, which takes into account what the fit removes.
//!
//! The loss rejects points that are far from the mesh, whether they are gross errors or the mesh is wrong.
//! Rejected points that lie on a plane through their neighbours are surface that the mesh does not follow;
//! gross errors have no such neighbours. The squares of their distances are added to `m²`.
//!
//! Not guaranteed: shape finer than about eight spacings is averaged, and points on the other side of a
//! thin sheet support a vertex if their feet do. Gross errors that lie on a common surface, as of another
//! object, are taken for shape.

use crate::point_tree::{PointTree, plane_through};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::{MeshSearch, TriangleMesh};
use rayon::prelude::*;

/// Largest distance of a vertex from a foot that supports it, in spacings of the foot. Gaps between points
/// are up to two spacings wide by chance.
const REACH: f64 = 2.0;
/// Minimum number of feet near a supported vertex. Single points may be gross errors.
const MIN_NEAR: usize = 3;
/// The spacing of a foot is its distance from this many others, at most [`MAX_SPACING`] times the median.
const SPACING_RANK: usize = 4;
const MAX_SPACING: f64 = 3.0;
/// Number of neighbours whose mean residual is multiplied with that of a point.
const PRODUCT_NEIGHBOURS: usize = 12;
/// Number of feet around a vertex over which products are averaged. Fewer follow changes of `m` more
/// closely; for 64, the σ of `m²` from noise alone is about 0.08 times the variance of a point.
const WINDOW: usize = 64;
/// Number of neighbours to which the plane of a rejected point is fitted, and of those that it uses: the
/// others may be gross errors.
const PLANE_NEIGHBOURS: (usize, usize) = (12, 9);
/// Maximum thickness of a flat neighbourhood relative to its width. A sphere of 12 points has 1, a surface
/// with a radius of curvature of twice the width has 0.2.
const MAX_THICKNESS: f64 = 0.25;
/// Maximum distance of a point from the plane of its neighbours, in their thickness or its σ.
const MAX_OFF_PLANE: f64 = 3.0;
/// Number of feet around a vertex of which half must follow, or the vertex does not.
const NEAREST_FEET: usize = 12;
/// Minimum cosine between normals on one side of a sheet.
const MIN_COSINE: f64 = 0.3;

/// A point on the fitted mesh.
#[derive(Debug, Clone, Copy)]
pub(super) struct PointFoot {
    /// The foot on the mesh.
    pub at: DVec3,
    /// Distance of the point from the mesh.
    pub residual: f64,
    /// Its stated σ.
    pub sigma: f64,
    /// False if the fit rejected the point although it agrees with its neighbours.
    pub follows: bool,
}

/// How points support a vertex of a fitted mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VertexSupport {
    /// No points are near it on its side of the sheet.
    None,
    /// Points are near it, and the mesh follows them.
    Points,
    /// Points are near it, but the mesh does not follow half of them.
    NotFollowed,
}

/// Sums over the points that are nearer to a vertex than to others.
///
/// The sum of squares contains noise and shape that the mesh does not follow, that of products only the
/// latter, because the noise of neighbours is independent.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VertexResiduals {
    /// Number of points that the fit did not reject.
    pub points: u32,
    /// Sum of their squared residuals, in stated σ.
    pub squares: f64,
    /// Sum of the products of their residuals with the mean of their twelve neighbours'.
    pub products: f64,
    /// Number of rejected points that agree with their neighbours.
    pub unfollowed: u32,
    /// Sum of their squared residuals.
    pub unfollowed_squares: f64,
}

impl VertexResiduals {
    /// Number of neighbours whose mean residual is one factor of a product.
    pub const NEIGHBOURS: usize = PRODUCT_NEIGHBOURS;

    /// Adds the sums of another vertex.
    pub fn add(&mut self, other: &Self) {
        self.points += other.points;
        self.squares += other.squares;
        self.products += other.products;
        self.unfollowed += other.unfollowed;
        self.unfollowed_squares += other.unfollowed_squares;
    }
}

/// Support and unresolved shape of all vertices.
#[derive(Debug, Clone, Default)]
pub(super) struct Support {
    pub of_vertices: Vec<VertexSupport>,
    /// σ of the unresolved shape.
    pub shape: Vec<f64>,
    /// Number of rejected points that agree with their neighbours.
    pub unfollowed: usize,
    /// Sums of residuals of the nearest points of each vertex.
    pub residuals: Vec<VertexResiduals>,
}

impl Support {
    /// The same with at least the given error at each vertex. Residuals show a part of errors of
    /// interpolation, so these are not added to what they show.
    pub(super) fn with_errors(mut self, errors: &[f64]) -> Self {
        self.shape.iter_mut().zip(errors).for_each(|(shape, error)| *shape = shape.max(*error));
        self
    }
}

/// Rejected points that lie on a plane through their neighbours; `sigmas` are those of one point each.
///
/// # Errors
/// As [`PointTree::new`].
pub(super) fn unfollowed(points: &[DVec3], sigmas: &[f64], rejected: &[bool]) -> Result<Vec<u32>> {
    let tree = PointTree::new(points)?;
    let (count, used) = PLANE_NEIGHBOURS;
    let around = |i: u32| {
        let mut near = tree.nearest(points[i as usize], count + 1);
        near.retain(|(_, j)| *j != i);
        near
    };
    let reach = |near: &[(f64, u32)]| near.last().map_or(0.0, |(distance, _)| *distance);
    let mut reaches: Vec<f64> = (0..points.len() as u32)
        .into_par_iter()
        .filter(|i| !rejected[*i as usize])
        .map(|i| reach(&around(i)))
        .collect();
    reaches.sort_unstable_by(f64::total_cmp);
    let longest = MAX_SPACING * reaches.get(reaches.len() / 2).copied().unwrap_or(0.0);
    let agrees = |i: &u32| {
        let at = points[*i as usize];
        let near = around(*i);
        // Gross errors are sparse, and a few of them are flat by chance.
        if near.len() < count || reach(&near) > longest {
            return false;
        }
        let mut near: Vec<DVec3> = near.into_iter().map(|(_, j)| points[j as usize]).collect();
        let rough = plane_through(&near);
        near.sort_by(|a, b| rough.distance(*a).total_cmp(&rough.distance(*b)));
        near.truncate(used);
        let plane = plane_through(&near);
        let sigma = sigmas[*i as usize];
        (plane.thickness < MAX_THICKNESS * plane.width || plane.thickness < sigma)
            && plane.distance(at) < MAX_OFF_PLANE * plane.thickness.max(sigma)
    };
    let found: Vec<u32> =
        (0..points.len() as u32).into_par_iter().filter(|i| rejected[*i as usize]).filter(agrees).collect();
    let mut is_found = vec![false; points.len()];
    found.iter().for_each(|i| is_found[*i as usize] = true);
    let has_company = |i: &u32| around(*i).iter().filter(|(_, j)| is_found[*j as usize]).count() >= MIN_NEAR;
    Ok(found.into_par_iter().filter(has_company).collect())
}

/// Support of the vertices of a fitted mesh by points; `shape` is the σ of unresolved shape over all of
/// them.
///
/// # Errors
/// As [`MeshSearch::try_new`] and [`PointTree::new`].
pub(super) fn support(mesh: &TriangleMesh, points: &[PointFoot], shape: f64) -> Result<Support> {
    let search = MeshSearch::try_new(mesh)?;
    let normals = mesh.face_normals();
    // For each foot the normal of its facet, and the corner of the facet that is nearest to it.
    let (sides, corners): (Vec<DVec3>, Vec<u32>) = (points.par_iter())
        .map(|p| {
            search.closest(p.at).map_or((DVec3::ZERO, 0), |foot| {
                let mut corners = [0, 1, 2];
                corners.sort_by(|a, b| foot.barycentric[*b].total_cmp(&foot.barycentric[*a]));
                (normals[foot.triangle as usize], mesh.triangles[foot.triangle as usize][corners[0]])
            })
        })
        .unzip();
    let places: Vec<DVec3> = points.iter().map(|p| p.at).collect();
    let tree = PointTree::new(&places)?;
    let around = |at: DVec3, side: DVec3, count: usize| {
        let mut near = tree.nearest(at, count);
        near.retain(|(_, i)| sides[*i as usize].dot(side) > MIN_COSINE);
        near
    };
    // For each foot its spacing, and the product of its residual with the mean of its neighbours'. In the
    // unit of the mesh, and in σ.
    let of_points: Vec<(f64, f64, f64)> = (points.par_iter().zip(&sides).enumerate())
        .map(|(i, (point, side))| {
            let mut near = around(point.at, *side, PRODUCT_NEIGHBOURS + 1);
            near.retain(|(_, j)| *j as usize != i);
            let spacing = near.get(SPACING_RANK - 1).map_or(f64::INFINITY, |(distance, _)| *distance);
            near.retain(|(_, j)| points[*j as usize].follows);
            let per = 1.0 / near.len().max(1) as f64;
            let mean_of = |value: &dyn Fn(&PointFoot) -> f64| {
                per * near.iter().map(|(_, j)| value(&points[*j as usize])).sum::<f64>()
            };
            let normalized = |p: &PointFoot| p.residual / p.sigma;
            (spacing, point.residual * mean_of(&|p| p.residual), normalized(point) * mean_of(&normalized))
        })
        .collect();
    let mut spacings: Vec<f64> = of_points.iter().map(|(spacing, ..)| *spacing).collect();
    spacings.sort_unstable_by(f64::total_cmp);
    let longest = MAX_SPACING * spacings.get(spacings.len() / 2).copied().unwrap_or(0.0);
    let of_vertices: Vec<(VertexSupport, f64, f64)> = (mesh.positions.par_iter())
        .zip(mesh.vertex_normals())
        .map(|(at, normal)| {
            let near = around(*at, normal, WINDOW);
            let supports =
                |(distance, i): &&(f64, u32)| *distance <= REACH * of_points[*i as usize].0.min(longest);
            let follows = |i: u32| points[i as usize].follows;
            let nearest = &near[..near.len().min(NEAREST_FEET)];
            let support = match near.iter().filter(supports).count() >= MIN_NEAR {
                false => VertexSupport::None,
                true if 2 * nearest.iter().filter(|(_, i)| follows(*i)).count() < nearest.len() => {
                    VertexSupport::NotFollowed
                }
                true => VertexSupport::Points,
            };
            let per = 1.0 / near.len().max(1) as f64;
            let products = near.iter().filter(|(_, i)| follows(*i)).map(|(_, i)| of_points[*i as usize].1);
            let squares =
                near.iter().filter(|(_, i)| !follows(*i)).map(|(_, i)| points[*i as usize].residual.powi(2));
            (support, (per * products.sum::<f64>()).max(0.0), per * squares.sum::<f64>())
        })
        .collect();
    let (sum, count) = (of_vertices.iter().filter(|(support, ..)| *support != VertexSupport::None))
        .fold((0.0, 0_usize), |(sum, n), (_, followed, _)| (sum + followed, n + 1));
    let scale = if sum > 0.0 { shape * shape * count as f64 / sum } else { 0.0 };
    let sigma = |(support, followed, unfollowed): &(VertexSupport, f64, f64)| match support {
        // Away from points, the shape is as uncertain as elsewhere.
        VertexSupport::None => shape,
        _ => (scale * followed + unfollowed).sqrt(),
    };
    let mut residuals = vec![VertexResiduals::default(); mesh.positions.len()];
    for ((point, vertex), (.., product)) in points.iter().zip(corners).zip(&of_points) {
        let (own, square) = (&mut residuals[vertex as usize], (point.residual / point.sigma).powi(2));
        if point.follows {
            own.points += 1;
            own.squares += square;
            own.products += product;
        } else {
            own.unfollowed += 1;
            own.unfollowed_squares += square;
        }
    }
    Ok(Support {
        residuals,
        shape: of_vertices.iter().map(sigma).collect(),
        of_vertices: of_vertices.into_iter().map(|(support, ..)| support).collect(),
        unfollowed: points.iter().filter(|p| !p.follows).count(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_mesh::icosphere;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Points on the upper half of a ball, at a height above it.
    fn upper_half(height: impl Fn(DVec3) -> f64, random: &mut ChaCha8Rng) -> Vec<DVec3> {
        let mut points = Vec::new();
        while points.len() < 3000 {
            let mut number = || StandardNormal.sample(random);
            let d = DVec3::new(number(), number(), number()).normalize();
            if d[2] > 0.0 {
                points.push((1.0 + height(d)) * d);
            }
        }
        points
    }

    fn feet(points: &[DVec3], unfollowed: &[u32]) -> Vec<PointFoot> {
        (points.iter().enumerate())
            .map(|(i, p)| PointFoot {
                at: p.normalize(),
                residual: p.length() - 1.0,
                sigma: 0.004,
                follows: !unfollowed.contains(&(i as u32)),
            })
            .collect()
    }

    /// Only vertices near points are supported, and unresolved shape is large where residuals agree.
    #[test]
    fn support_ends_where_points_end() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let ball = icosphere(1.0, 4);
        let sigma = 0.004;
        // A swelling on one side, beside noise.
        let swelling = |d: DVec3| if d[0] > 0.5 { 0.01 } else { 0.0 };
        let noise: Vec<f64> = (0..3000).map(|_| StandardNormal.sample(&mut random)).collect();
        let mut points = upper_half(swelling, &mut random);
        points.iter_mut().zip(noise).for_each(|(p, n): (_, f64)| *p += sigma * n * p.normalize());
        let found = support(&ball, &feet(&points, &[]), 0.005).unwrap();
        for (v, at) in ball.positions.iter().enumerate() {
            let expected = if at[2] > 0.0 { VertexSupport::Points } else { VertexSupport::None };
            assert!(at[2].abs() < 0.2 || found.of_vertices[v] == expected, "{at:?}");
        }
        let mean = |part: &dyn Fn(DVec3) -> bool| {
            let chosen: Vec<f64> = (ball.positions.iter().zip(&found.shape))
                .filter(|(at, _)| at[2] > 0.2 && part(**at))
                .map(|(_, s)| *s)
                .collect();
            chosen.iter().sum::<f64>() / chosen.len() as f64
        };
        let (swollen, rest) = (mean(&|at| at[0] > 0.7), mean(&|at| at[0] < 0.2));
        assert!(swollen > 0.007 && rest < 0.003, "{swollen} {rest}");
    }

    /// A bump that the fit rejected is found among gross errors, and the vertices under it do not follow.
    #[test]
    fn rejected_bumps_are_no_gross_errors() {
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let ball = icosphere(1.0, 4);
        let is_bump = |d: DVec3| d[0] > 0.8;
        let mut points = upper_half(|d| if is_bump(d) { 0.1 } else { 0.0 }, &mut random);
        let wrong: Vec<bool> = (0..points.len()).map(|_| random.random::<f64>() < 0.1).collect();
        for (p, _) in points.iter_mut().zip(&wrong).filter(|(_, wrong)| **wrong) {
            *p *= random.random_range(0.3..1.6);
        }
        let bump: Vec<bool> =
            points.iter().zip(&wrong).map(|(p, wrong)| !wrong && is_bump(p.normalize())).collect();
        let rejected: Vec<bool> = bump.iter().zip(&wrong).map(|(a, b)| *a || *b).collect();
        let sigmas = vec![0.003; points.len()];
        let found = unfollowed(&points, &sigmas, &rejected).unwrap();
        let right = found.iter().filter(|i| bump[**i as usize]).count();
        let all = bump.iter().filter(|is| **is).count();
        assert!(10 * right > 8 * all, "{right} of {all}");
        // Some gross errors are on the surface by chance.
        assert!(found.len() - right < points.len() / 50, "{} of {}", found.len() - right, points.len());
        let made = support(&ball, &feet(&points, &found), 0.0).unwrap();
        for (v, at) in ball.positions.iter().enumerate().filter(|(_, at)| at[2] > 0.2) {
            let expected = if at[0] > 0.9 { VertexSupport::NotFollowed } else { VertexSupport::Points };
            assert!((at[0] > 0.7 && at[0] < 0.9) || made.of_vertices[v] == expected, "{at:?}");
            assert!(at[0] < 0.9 || made.shape[v] > 0.05, "{}", made.shape[v]);
        }
    }
}
