//! Derivatives of the smooth distance: the second by the point, and the first by the vertices of the mesh.
//!
//! In: the shares of facets from [`Shell::distance`]. Out: the Hessian, and the derivatives of the distance,
//! or of the height over one facet, by each vertex.

use super::{FacetHeight, FacetShare, Metaball, Shell, ShellDistance, away};
use nalgebra::{Matrix3, Vector3};
use planish_core::DVec3;
use planish_mesh::NearFacet;

impl Shell<'_> {
    /// The Hessian `∂²D/∂x²`, from the shares and the result of [`Self::distance`]. It is the derivative of
    /// `∇D = Σ p_i (n_i − k (s_i − D) u_i)`,
    /// with `s_i` the heights and `u_i` the directions away from the skeletons; symmetric.
    #[must_use]
    pub fn hessian(&self, at: DVec3, shares: &[FacetShare], found: &ShellDistance) -> Matrix3<f64> {
        let k = self.options.sharpness;
        let facing = self.facets[found.facet as usize].normal.into();
        let gradient = Vector3::from(found.gradient);
        let mean_away: Vector3<f64> = shares.iter().map(|one| one.share * away(at, &one.near)).sum();
        let mut sum = Matrix3::zeros();
        for one in shares {
            let u = away(at, &one.near);
            let (height, normal) = self.height(at, &one.near, facing);
            let part = normal - k * (height - found.distance) * u;
            // ∂p_i = −k p_i (u_i − ū); ∂s_i = n_i; ∂D = m.
            sum += one.share
                * (-k * part * (u - mean_away).transpose() - k * u * (normal - gradient).transpose());
            sum -= one.share * k * (height - found.distance) * self.bending(&one.near, u);
        }
        sum
    }

    /// The Hessian of the distance from a skeleton: 0 over a face, one curvature of `1/r` if the nearest
    /// point is on an edge, two if it is a corner or a point.
    fn bending(&self, near: &NearFacet, u: Vector3<f64>) -> Matrix3<f64> {
        if near.distance == 0.0 {
            return Matrix3::zeros();
        }
        let mut flat = Matrix3::identity() - u * u.transpose();
        if self.options.metaball == Metaball::Triangular {
            let corners = self.mesh.corners(near.facet as usize);
            // Positive barycentric coordinates show whether the nearest point is a corner, on a side or
            // inside.
            let within: Vec<usize> = (0..3).filter(|&k| near.barycentric[k] > 0.0).collect();
            match within[..] {
                [_] => {}
                [a, b] => {
                    let along = Vector3::from(corners[b] - corners[a]).normalize();
                    flat -= along * along.transpose();
                }
                _ => return Matrix3::zeros(),
            }
        }
        flat / near.distance
    }

    /// `∂D/∂V_j` for every vertex that the distance depends on; a vertex of several facets comes several
    /// times.
    pub fn by_vertices(
        &self,
        at: DVec3,
        shares: &[FacetShare],
        found: &ShellDistance,
        mut visit: impl FnMut(u32, DVec3),
    ) {
        let k = self.options.sharpness;
        let facing = self.facets[found.facet as usize].normal.into();
        for one in shares.iter().filter(|one| one.share > 0.0) {
            let facet = &self.facets[one.near.facet as usize];
            let vertices = self.mesh.triangles[one.near.facet as usize];
            let corners = self.mesh.corners(one.near.facet as usize);
            let away = away(at, &one.near);
            let (height, normal) = self.height(at, &one.near, facing);
            let above = height - found.distance;
            let (own, twice) = (Vector3::from(facet.normal), 2.0 * facet.area);
            let off = Vector3::from(at - one.near.point);
            // n = m / |m|: dn = (I − n nᵀ) dm / |m|; d ln A = n·dm / |m|. A facet without area has no normal
            // to rotate.
            let by_m = if twice > 0.0 {
                let growing = match self.options.metaball {
                    Metaball::Spherical => above,
                    Metaball::Triangular => 0.0,
                };
                (one.share / twice) * (own.dot(&normal) * (off - off.dot(&own) * own) + growing * own)
            } else {
                Vector3::zeros()
            };
            let by_skeleton = -one.share * (normal - k * above * away);
            for corner in 0..3 {
                // m changes by dV × (the side opposite, turned back).
                let side = Vector3::from(corners[(corner + 2) % 3] - corners[(corner + 1) % 3]);
                let by_corner = match self.skeletons.get(one.near.facet as usize) {
                    // The nearest point of the facet moves too, but in its plane and perpendicular to the
                    // direction, so it contributes nothing.
                    None => one.near.barycentric[corner] * by_skeleton,
                    Some(skeleton) => skeleton.by_corner[corner].tr_mul(&by_skeleton),
                };
                visit(vertices[corner], (by_corner + by_m.cross(&side)).into());
            }
        }
    }

    /// The height of a point over the plane of a facet, and the distance of its foot point from the facet.
    pub(crate) fn over(&self, at: DVec3, one: &FacetShare) -> FacetHeight {
        let facet = &self.facets[one.near.facet as usize];
        let off = at - one.near.point;
        let height = facet.normal.dot(off);
        FacetHeight {
            height,
            normal: facet.normal,
            across: (off.length_squared() - height * height).max(0.0).sqrt(),
            area: facet.area,
        }
    }

    /// The signed distances of the foot point of a point from the sides of a facet; positive inside.
    pub(crate) fn within(&self, at: DVec3, one: &FacetShare) -> [f64; 3] {
        let normal = self.facets[one.near.facet as usize].normal;
        let corners = self.mesh.corners(one.near.facet as usize);
        [0, 1, 2].map(|k| {
            let side = corners[(k + 1) % 3] - corners[k];
            normal.cross(side).dot(at - corners[k]) / side.length().max(f64::MIN_POSITIVE)
        })
    }

    /// `∂h/∂V_j` of the height over a facet's plane, times `share`.
    pub(crate) fn height_by_vertices(
        &self,
        at: DVec3,
        one: &FacetShare,
        share: f64,
        visit: &mut impl FnMut(u32, DVec3),
    ) {
        let facet = &self.facets[one.near.facet as usize];
        let vertices = self.mesh.triangles[one.near.facet as usize];
        let corners = self.mesh.corners(one.near.facet as usize);
        let (own, twice) = (Vector3::from(facet.normal), 2.0 * facet.area);
        let off = Vector3::from(at - one.near.point);
        if twice <= 0.0 {
            return;
        }
        let by_m = (share / twice) * (off - off.dot(&own) * own);
        let by_skeleton = -share * own;
        for corner in 0..3 {
            let side = Vector3::from(corners[(corner + 2) % 3] - corners[(corner + 1) % 3]);
            let by_corner = match self.skeletons.get(one.near.facet as usize) {
                None => one.near.barycentric[corner] * by_skeleton,
                Some(skeleton) => skeleton.by_corner[corner].tr_mul(&by_skeleton),
            };
            visit(vertices[corner], (by_corner + by_m.cross(&side)).into());
        }
    }
}
