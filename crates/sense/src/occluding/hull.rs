//! The visual hull: the region inside all silhouettes.
//!
//! In: views with closed silhouettes. Out: the depth of a point in the hull, its surface as a mesh, and the
//! share of the surface that no contour touches.
//!
//! Contours carry no information about the inside of the hull. The hull fills a hollow if every line of sight
//! through it meets the object elsewhere (A. Laurentini, *The visual hull concept for silhouette-based image
//! understanding*, PAMI 1994). Parts of its surface without a contour point nearby are therefore unobserved:
//! there are too few views, or the object is hollow.
//!
//! Not guaranteed: parts thinner than a cell.

use super::{Contour, ContourView, OccludingPoint};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use planish_core::matrix3::{inverse, times};
use planish_core::vector3::as_arrays;
use planish_core::{DVec3, Pinhole};
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, TriangleMesh, isosurface};
use rayon::prelude::*;
use std::num::NonZeroUsize;

/// Number of nearest contour points that are tested for each facet.
const NEAREST_POINTS: usize = 16;
/// Number of cells along a side of the cube in which the object is sought.
const BOUNDS_CELLS: usize = 64;
/// Upper limit of stored distances from a border, in pixels.
const FAR_PX: f64 = 1e4;

/// Depth of points inside all silhouettes, without a mesh of the hull.
pub struct SilhouetteBound {
    views: Vec<Distances>,
    limits: Option<BoundingBox>,
}

/// The visual hull with its surface mesh.
pub struct VisualHull {
    bound: SilhouetteBound,
    /// Its surface, facing outwards.
    pub mesh: TriangleMesh,
    /// Side of its cells.
    pub cell: f64,
}

/// Signed distances to a silhouette's border in pixels, positive inside.
struct Distances {
    camera: Pinhole,
    first: [f64; 2],
    columns: usize,
    rows: usize,
    values: Vec<f32>,
}

impl SilhouetteBound {
    /// Uses all views whose silhouettes are closed.
    ///
    /// # Errors
    /// `Undetermined` if there are fewer than two.
    pub fn new(views: &[ContourView]) -> Result<Self> {
        let views: Vec<Distances> = (views.par_iter())
            .filter(|view| !view.silhouette.is_empty() && view.silhouette.iter().all(|c| c.closed))
            .map(Distances::new)
            .collect();
        if views.len() < 2 {
            return Err(Error::undetermined(format!(
                "expected at least two closed silhouettes for a visual hull, found {}",
                views.len()
            )));
        }
        Ok(Self { views, limits: None })
    }

    /// Limits the region to a box that contains the object.
    #[must_use]
    pub fn within(self, limits: Option<BoundingBox>) -> Self {
        Self { limits, ..self }
    }

    /// Distance of a point from the nearest side of the box, positive inside; infinite without a box.
    pub(super) fn depth_in_limits(&self, at: DVec3) -> f64 {
        self.limits.map_or(f64::INFINITY, |limits| {
            (at - limits.min).min_element().min((limits.max - at).min_element())
        })
    }

    /// The minimum signed distance from a border over all views, converted to the unit of space at the
    /// point's distance; positive inside all silhouettes.
    #[must_use]
    pub fn depth(&self, at: DVec3) -> f64 {
        (self.views.iter().map(|view| view.at(at))).fold(self.depth_in_limits(at), f64::min)
    }

    /// The depth of a point without the view of minimum depth. The difference to [`Self::depth`] shows how
    /// much one view alone carves away.
    #[must_use]
    pub fn depth_without_one(&self, at: DVec3) -> f64 {
        let depths = self.views.iter().map(|view| view.at(at));
        let [_, second] = depths.fold([f64::INFINITY; 2], |[first, second], depth| {
            [first.min(depth), second.min(depth.max(first))]
        });
        second
    }

    /// The depth of a point without some views.
    pub(super) fn depth_except(&self, at: DVec3, views: &[u16]) -> f64 {
        (self.views.iter().zip(0..))
            .filter(|(_, number)| !views.contains(number))
            .map(|(view, _)| view.at(at))
            .fold(self.depth_in_limits(at), f64::min)
    }

    /// A box around the places that at most a third of the views show as background; `None` if it cannot be
    /// found, for example for parallel lines of sight.
    #[must_use]
    pub fn bounds(&self) -> Option<BoundingBox> {
        // The place nearest to the central lines of sight of all silhouettes.
        let (mut sum, mut right) = ([[0.0; 3]; 3], DVec3::ZERO);
        for view in &self.views {
            let direction = view.camera.direction(view.middle())?.try_normalize()?;
            let center = view.camera.center();
            // The part of an offset across the line of sight.
            right += center - direction.dot(center) * direction;
            for i in 0..3 {
                for j in 0..3 {
                    sum[i][j] += if i == j { 1.0 } else { 0.0 } - direction[i] * direction[j];
                }
            }
        }
        let middle = times(&inverse(&sum)?, right);
        if !middle.is_finite() {
            return None;
        }
        let radius =
            |view: &Distances| 0.5 * (view.columns as f64).hypot(view.rows as f64) * view.pixel_width(middle);
        // An object that is not in the middle of its silhouettes may reach farther than one of them.
        let half = 1.5 * self.views.iter().map(radius).fold(0.0, f64::max);
        let step = 2.0 * half / BOUNDS_CELLS as f64;
        let allowed = self.views.len() / 3;
        let places: Vec<DVec3> = (0..(BOUNDS_CELLS + 1).pow(3))
            .into_par_iter()
            .map(|k| {
                let n = BOUNDS_CELLS + 1;
                middle + step * DVec3::from([k % n, k / n % n, k / (n * n)].map(|i| i as f64)) - half
            })
            // A cell counts if its ball may be inside, so that thin parts are not lost.
            .filter(|at| self.views.iter().filter(|view| view.at(*at) < -step).count() <= allowed)
            .collect();
        let found = BoundingBox::from_points(&places)?.grown(step);
        Some(match self.limits {
            Some(limits) => {
                BoundingBox { min: found.min.max(limits.min - step), max: found.max.min(limits.max + step) }
            }
            None => found,
        })
    }

    /// Number of views with closed silhouettes.
    #[must_use]
    pub fn count(&self) -> usize {
        self.views.len()
    }

    /// Signed distances from the border of a view's silhouette, row by row, and their number in a row.
    pub(super) fn signed_distances(&self, view: usize) -> (&[f32], usize) {
        (&self.views[view].values, self.views[view].columns)
    }

    /// The width of a pixel at a point.
    #[must_use]
    pub fn pixel_width(&self, view: usize, at: DVec3) -> f64 {
        self.views[view].pixel_width(at)
    }

    /// True if a view shows a point inside its silhouette.
    pub(super) fn is_inside(&self, view: usize, at: DVec3) -> bool {
        self.views[view].at(at) > 0.0
    }

    /// Column and row of a point in the raster of a view; `None` outside of it.
    pub(super) fn raster_pixel(&self, view: usize, at: DVec3) -> Option<[usize; 2]> {
        let view = &self.views[view];
        let pixel = view.camera.project(at)?;
        let place = [0, 1].map(|k| (pixel[k] - view.first[k]).round());
        let counts = [view.columns, view.rows];
        (0..2).all(|k| place[k] >= 0.0 && place[k] < counts[k] as f64).then(|| place.map(|x| x as usize))
    }

    /// True if the depth may be zero within `reach` of a point. It may return true too often, but never false
    /// wrongly.
    #[must_use]
    pub fn may_contain_boundary(&self, at: DVec3, reach: f64) -> bool {
        // Signed distances are 1-Lipschitz in the image, so the projection of the ball bounds their change.
        let in_limits = self.depth_in_limits(at);
        if in_limits < -reach {
            return false;
        }
        let mut on_border = in_limits < reach;
        for view in &self.views {
            let far = view.camera.center().distance(at);
            if far <= 1.5 * reach {
                return true;
            }
            let value = view.at(at);
            // `far/(far − reach)` is the magnification of the near side of the ball; the factor 2 is a
            // margin.
            let bound = 2.0 * reach * far / (far - reach);
            if value < -bound {
                return false;
            }
            on_border |= value < bound;
        }
        on_border
    }
}

impl VisualHull {
    /// Meshes the hull in a box with `cells` cells along its longest side, from all views whose silhouettes
    /// are closed.
    ///
    /// # Errors
    /// `Undetermined` if fewer than two views have closed silhouettes, or no part of the box is inside all of
    /// them; as [`isosurface`].
    pub fn new(views: &[ContourView], bounds: &BoundingBox, cells: usize) -> Result<Self> {
        Self::of(SilhouetteBound::new(views)?, bounds, cells)
    }

    /// As [`Self::new`], from prepared silhouettes.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of(bound: SilhouetteBound, bounds: &BoundingBox, cells: usize) -> Result<Self> {
        let longest = bounds.longest_side();
        let cell = longest / cells.max(1) as f64;
        let mesh = isosurface(
            bounds,
            cell,
            |at| -bound.depth(at),
            |at, reach| bound.may_contain_boundary(at, reach),
        )?;
        if mesh.triangles.is_empty() {
            return Err(Error::undetermined("expected points inside all silhouettes, found none"));
        }
        Ok(Self { bound, mesh, cell })
    }

    /// True if a point is inside all silhouettes.
    #[must_use]
    pub fn holds(&self, at: DVec3) -> bool {
        self.bound.depth(at) > 0.0
    }

    /// The share of the hull's area without a contour point nearby. Nearby means within that point's distance
    /// to its neighbours, or within two cells.
    #[must_use]
    pub fn unseen_share(&self, points: &[OccludingPoint]) -> f64 {
        let facets: Vec<[DVec3; 3]> = (0..self.mesh.triangles.len()).map(|t| self.mesh.corners(t)).collect();
        let middles: Vec<DVec3> = facets.iter().map(|[a, b, c]| (a + b + c) / 3.0).collect();
        let seen = near_contours(points, &middles, 2.0 * self.cell);
        let areas: Vec<(f64, bool)> = (facets.iter().zip(seen))
            .map(|([a, b, c], seen)| (0.5 * (b - a).cross(c - a).length(), seen))
            .collect();
        let all: f64 = areas.iter().map(|(a, _)| a).sum();
        let unseen: f64 = areas.iter().filter(|(_, seen)| !seen).map(|(a, _)| a).sum();
        unseen / all
    }
}

/// For each place, true if a contour point is nearby: within that point's distance to its neighbours, or
/// within `distance`.
#[must_use]
pub fn near_contours(points: &[OccludingPoint], places: &[DVec3], distance: f64) -> Vec<bool> {
    let positions: Vec<DVec3> = points.iter().map(|p| p.position).collect();
    let Ok(tree) = ImmutableKdTree::<f64, 3>::new_from_slice(as_arrays(&positions)) else {
        return vec![false; places.len()];
    };
    (places.par_iter())
        .map(|at| {
            // The nearest point may have a small reach although a farther one covers the place.
            let asked = NonZeroUsize::MIN.saturating_add(NEAREST_POINTS - 1);
            let near = tree.query(at.as_ref()).nearest_n::<SquaredEuclidean<f64>>(asked).execute();
            near.iter().any(|near| {
                let p = &points[near.item as usize];
                p.position.distance(*at) <= p.reach.max(distance)
            })
        })
        .collect()
}

impl Distances {
    fn new(view: &ContourView) -> Self {
        let places = view.silhouette.iter().flat_map(|c| c.places.iter().copied());
        let bounds: BoundingBox<[f64; 2]> = places.collect();
        let first = bounds.min.map(|x| x.floor() - 2.0);
        let [columns, rows] = [0, 1].map(|k| (bounds.max[k] - first[k]).ceil() as usize + 3);
        // envelope of parabolas (P. Felzenszwalb, D. Huttenlocher, *Distance transforms of sampled
        // functions*, 2012). Two one-dimensional passes give exact Euclidean distances in linear time.

        let mut squares = vec![FAR_PX * FAR_PX; columns * rows];
        for contour in &view.silhouette {
            for p in &contour.places {
                let at = [0, 1].map(|k| p[k] - first[k]);
                for dy in 0..2 {
                    for dx in 0..2 {
                        let (x, y) = (at[0].floor() + f64::from(dx), at[1].floor() + f64::from(dy));
                        let index = y as usize * columns + x as usize;
                        let d = (x - at[0]).powi(2) + (y - at[1]).powi(2);
                        squares[index] = squares[index].min(d);
                    }
                }
            }
        }
        for y in 0..rows {
            let row: Vec<f64> = squares[y * columns..][..columns].to_vec();
            squares[y * columns..][..columns].copy_from_slice(&spread(&row));
        }
        for x in 0..columns {
            let column: Vec<f64> = (0..rows).map(|y| squares[y * columns + x]).collect();
            for (y, v) in spread(&column).into_iter().enumerate() {
                squares[y * columns + x] = v;
            }
        }
        let mut values = Vec::with_capacity(squares.len());
        for (y, row) in squares.chunks(columns).enumerate() {
            let passed = crossings(&view.silhouette, first[1] + y as f64);
            values.extend(row.iter().enumerate().map(|(x, d)| {
                let before = passed.partition_point(|at| *at <= first[0] + x as f64);
                let sign = if before % 2 == 1 { 1.0 } else { -1.0 };
                (sign * d.sqrt()) as f32
            }));
        }
        Self { camera: view.camera, first, columns, rows, values }
    }

    /// The middle of the raster.
    fn middle(&self) -> [f64; 2] {
        [self.first[0] + 0.5 * self.columns as f64, self.first[1] + 0.5 * self.rows as f64]
    }

    fn pixel_width(&self, place: DVec3) -> f64 {
        self.camera.center().distance(place) / self.camera.focal_px()
    }

    /// Signed distance to the border, converted to the unit of space at the distance of the point.
    fn at(&self, place: DVec3) -> f64 {
        let width = self.pixel_width(place);
        let Some(pixel) = self.camera.project(place) else {
            return -FAR_PX * width;
        };
        let at = [0, 1].map(|k| pixel[k] - self.first[k]);
        let limits = [self.columns, self.rows].map(|n| (n - 2) as f64 + 0.999);
        // Beyond the raster: the distance at its border plus the way to it, a lower bound that keeps the
        // sign.
        let held = [0, 1].map(|k| at[k].clamp(0.0, limits[k]));
        let outside = (at[0] - held[0]).hypot(at[1] - held[1]);
        let (i, j) = (held[0] as usize, held[1] as usize);
        let (s, t) = (held[0] - i as f64, held[1] - j as f64);
        let v = |i: usize, j: usize| f64::from(self.values[j * self.columns + i]);
        let inside = (1.0 - t) * ((1.0 - s) * v(i, j) + s * v(i + 1, j))
            + t * ((1.0 - s) * v(i, j + 1) + s * v(i + 1, j + 1));
        (inside - outside) * width
    }
}

/// Positions where a row crosses closed contours, in order. A pixel after an odd number of them is inside.
fn crossings(contours: &[Contour], y: f64) -> Vec<f64> {
    let mut found: Vec<f64> = (contours.iter())
        .flat_map(|c| c.places.iter().zip(c.places.iter().cycle().skip(1)))
        .filter(|(p, q)| (p[1] > y) != (q[1] > y))
        .map(|(p, q)| p[0] + (y - p[1]) / (q[1] - p[1]) * (q[0] - p[0]))
        .collect();
    found.sort_by(f64::total_cmp);
    found
}

/// `min_q (f(q) + (p − q)²)` for every `p`.
fn spread(f: &[f64]) -> Vec<f64> {
    // The lower envelope of parabolas: exact squared distances in linear time (Felzenszwalb and Huttenlocher
    // 2012).
    let n = f.len();
    let mut hull: Vec<usize> = Vec::with_capacity(n);
    let mut from: Vec<f64> = Vec::with_capacity(n);
    for q in 0..n {
        loop {
            let Some(&last) = hull.last() else {
                hull.push(q);
                from.push(f64::NEG_INFINITY);
                break;
            };
            let at = |k: usize| f[k] + (k * k) as f64;
            let cross = (at(q) - at(last)) / (2 * (q - last)) as f64;
            if from.last().is_some_and(|start| cross <= *start) {
                hull.pop();
                from.pop();
            } else {
                hull.push(q);
                from.push(cross);
                break;
            }
        }
    }
    let mut k = 0;
    (0..n)
        .map(|p| {
            while k + 1 < hull.len() && from[k + 1] < p as f64 {
                k += 1;
            }
            let d = p as f64 - hull[k] as f64;
            d * d + f[hull[k]]
        })
        .collect()
}
