//! Delaunay tetrahedralisation of points in space.
//!
//! In: a box, and points strictly inside it, one at a time. Out: tetrahedra whose circumspheres contain no
//! other point, and for a query point the tetrahedra whose circumspheres contain it.
//!
//! The method is incremental insertion (A. Bowyer 1981; D. F. Watson 1981) with exact predicates (J. R.
//! Shewchuk 1997). It replaces the tetrahedra whose circumsphere contains the new point *strictly*. No
//! tetrahedron is ever flat, also on grids and among cospherical points, so nothing is perturbed. The reason:
//! if the new point were in the plane of a boundary face of the cavity, it would be strictly inside the
//! circumcircle of the face. It would then be inside the sphere on the other side too, and the face would not
//! be on the boundary. Points are inside the box, so no convex hull is needed.
//!
//! Not guaranteed: if five points lie on an empty sphere, the choice among the valid triangulations is
//! arbitrary.

use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::BoundingBox;
use robust::{Coord3D, insphere, orient3d};
use std::collections::HashMap;

/// No neighbour: a face of the box. No corner: no tetrahedron.
const OUTSIDE: u32 = u32::MAX;
/// Faces of a tetrahedron: the one opposite each corner, counter-clockwise seen from outside, so that
/// `orient3d(face, corner)` is positive.
pub(crate) const FACES: [[usize; 3]; 4] = [[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]];

/// Four points, and the tetrahedra across the faces opposite to them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tetrahedron {
    pub corners: [u32; 4],
    pub neighbours: [u32; 4],
}

/// A face at the border of a cavity.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BorderFace {
    /// Its corners, so that the cavity is on the positive side.
    pub corners: [u32; 3],
    /// The tetrahedron of the cavity that it belongs to.
    pub inside: u32,
    outside: u32,
}

/// A cavity, with buffers that are reused by the next search.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cavity {
    /// Tetrahedra whose circumsphere contains the point strictly.
    pub tetrahedra: Vec<u32>,
    pub border: Vec<BorderFace>,
    /// Number of searches, and for each tetrahedron the last search that tested it and its result.
    search: u32,
    tested: Vec<(u32, bool)>,
}

/// A Delaunay tetrahedralisation of points in a box. The first eight points are the corners of the box.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::BoundingBox;
/// use planish_shell::Delaunay;
/// let mut delaunay = Delaunay::new(&BoundingBox { min: DVec3::ZERO, max: DVec3::splat(1.0) })?;
/// assert_eq!(delaunay.tetrahedra().len(), 6);
/// assert_eq!(delaunay.insert(DVec3::new(0.4, 0.5, 0.6))?, 8);
/// assert_eq!(delaunay.points().len(), 9);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Delaunay {
    points: Vec<DVec3>,
    tetrahedra: Vec<Tetrahedron>,
    /// Unused entries of `tetrahedra`: a cavity may have had more tetrahedra than replaced them.
    free: Vec<u32>,
    /// A tetrahedron of the last inserted point, from which the next search starts.
    last: u32,
    scratch: Cavity,
}

impl Delaunay {
    /// The box alone, as six tetrahedra.
    ///
    /// # Errors
    /// `Input` for a box without volume or with corners that are not finite.
    pub fn new(bounds: &BoundingBox) -> Result<Self> {
        let [low, high] = [bounds.min, bounds.max];
        if (0..3).any(|k| !(low[k].is_finite() && high[k].is_finite() && low[k] < high[k])) {
            return Err(Error::input("expected a box with a volume for a triangulation"));
        }
        let points = bounds.corners().to_vec();
        // Six tetrahedra about the diagonal from corner 0 to corner 7, one for each order of the axes: H. W.
        // Kuhn 1960.
        const AXES: [[usize; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
        let tetrahedra: Vec<Tetrahedron> = (AXES.iter())
            .map(|&[a, b, _]| {
                // Corners are numbered by bits, one per axis, so walking along an axis sets its bit.
                let (second, third) = (1 << a, 1 << a | 1 << b);
                let mut corners = [0, second, third, 7];
                if orientation(&points, corners) < 0.0 {
                    corners.swap(1, 2);
                }
                Tetrahedron { corners, neighbours: [OUTSIDE; 4] }
            })
            .collect();
        let mut made = Self { points, tetrahedra, free: Vec::new(), last: 0, scratch: Cavity::default() };
        made.link_all();
        Ok(made)
    }

    /// The corners of the box, then the inserted points in order.
    #[must_use]
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// The corners of every tetrahedron, positively oriented.
    #[must_use]
    pub fn tetrahedra(&self) -> Vec<[u32; 4]> {
        self.tetrahedra_in_use().map(|(_, t)| t.corners).collect()
    }

    fn tetrahedra_in_use(&self) -> impl Iterator<Item = (usize, &Tetrahedron)> {
        (self.tetrahedra.iter().enumerate()).filter(|(_, t)| t.corners[0] != OUTSIDE)
    }

    pub(crate) fn corners(&self, tetrahedron: u32) -> [u32; 4] {
        self.tetrahedra[tetrahedron as usize].corners
    }

    pub(crate) fn neighbours(&self, tetrahedron: u32) -> [u32; 4] {
        self.tetrahedra[tetrahedron as usize].neighbours
    }

    /// True if a point is strictly inside the box.
    #[must_use]
    pub fn holds(&self, at: DVec3) -> bool {
        (0..3).all(|k| self.points[0][k] < at[k] && at[k] < self.points[7][k])
    }

    /// Inserts a point and returns its index. A point that exists already keeps its index.
    ///
    /// # Errors
    /// `Input` for a point that is not strictly inside the box.
    pub fn insert(&mut self, at: DVec3) -> Result<u32> {
        if !self.holds(at) {
            return Err(Error::input(format!(
                "expected points inside the box of the triangulation, found {:?} outside of {:?} to {:?}",
                at.to_array(),
                self.points[0].to_array(),
                self.points[7].to_array()
            )));
        }
        // Successive points are often neighbours, so the walk from the last one is short.
        let start = self.locate(at, self.last);
        let same = (self.corners(start).into_iter()).find(|&c| self.points[c as usize] == at);
        if let Some(same) = same {
            return Ok(same);
        }
        let mut cavity = std::mem::take(&mut self.scratch);
        self.cavity(at, start, &mut cavity);
        let new = self.points.len() as u32;
        self.points.push(at);
        self.fill(new, &cavity);
        self.scratch = cavity;
        Ok(new)
    }

    /// The tetrahedron that contains a point, by a walk from another one. The walk ends because the
    /// tetrahedralisation is Delaunay (H. Edelsbrunner 1990).
    pub(crate) fn locate(&self, at: DVec3, start: u32) -> u32 {
        let mut current = start;
        loop {
            let t = &self.tetrahedra[current as usize];
            // Exact predicates: with rounded ones the walk could cycle.
            let away = (0..4)
                .find(|&k| t.neighbours[k] != OUTSIDE && self.side(FACES[k].map(|c| t.corners[c]), at) < 0.0);
            match away {
                Some(k) => current = t.neighbours[k],
                None => return current,
            }
        }
    }

    /// Tetrahedra whose circumsphere contains the point strictly, and the faces around them. The point is in
    /// `start`, and not one of its corners.
    pub(crate) fn cavity(&self, at: DVec3, start: u32, cavity: &mut Cavity) {
        cavity.search += 1;
        // Marks carry the number of the search and need no clearing. A tetrahedron is tested once, although
        // up to four faces lead to it.
        cavity.tested.resize(self.tetrahedra.len(), (0, false));
        let search = cavity.search;
        cavity.tetrahedra.clear();
        cavity.border.clear();
        cavity.tetrahedra.push(start);
        cavity.tested[start as usize] = (search, true);
        let mut next = 0;
        while let Some(&inside) = cavity.tetrahedra.get(next) {
            next += 1;
            let t = self.tetrahedra[inside as usize];
            for k in 0..4 {
                let outside = t.neighbours[k];
                let in_conflict = outside != OUTSIDE && {
                    let (when, answer) = cavity.tested[outside as usize];
                    if when == search {
                        answer
                    } else {
                        let answer = self.in_conflict(outside, at);
                        cavity.tested[outside as usize] = (search, answer);
                        if answer {
                            cavity.tetrahedra.push(outside);
                        }
                        answer
                    }
                };
                if !in_conflict {
                    cavity.border.push(BorderFace {
                        corners: FACES[k].map(|c| t.corners[c]),
                        inside,
                        outside,
                    });
                }
            }
        }
    }

    fn in_conflict(&self, tetrahedron: u32, at: DVec3) -> bool {
        let [a, b, c, d] = self.corners(tetrahedron).map(|c| coordinates(self.points[c as usize]));
        // Strictly, so that no new tetrahedron is flat (see the module's description).
        insphere(a, b, c, d, coordinates(at)) > 0.0
    }

    fn side(&self, face: [u32; 3], at: DVec3) -> f64 {
        let [a, b, c] = face.map(|c| coordinates(self.points[c as usize]));
        orient3d(a, b, c, coordinates(at))
    }

    /// Replaces a cavity by the tetrahedra of its border and a new point.
    fn fill(&mut self, new: u32, cavity: &Cavity) {
        for &t in &cavity.tetrahedra {
            self.tetrahedra[t as usize].corners = [OUTSIDE; 4];
        }
        self.free.extend(&cavity.tetrahedra);
        // Each face with the new point belongs to two new tetrahedra. The edge of its other corners is the
        // key.
        let mut open: HashMap<[u32; 2], (u32, usize)> = HashMap::with_capacity(2 * cavity.border.len());
        for face in &cavity.border {
            let [a, b, c] = face.corners;
            let made = Tetrahedron {
                corners: [a, b, c, new],
                neighbours: [OUTSIDE, OUTSIDE, OUTSIDE, face.outside],
            };
            let at = match self.free.pop() {
                Some(at) => {
                    self.tetrahedra[at as usize] = made;
                    at
                }
                None => {
                    self.tetrahedra.push(made);
                    (self.tetrahedra.len() - 1) as u32
                }
            };
            self.last = at;
            if face.outside != OUTSIDE {
                let across = &mut self.tetrahedra[face.outside as usize];
                let side = (0..4).find(|&k| !face.corners.contains(&across.corners[k]));
                if let Some(side) = side {
                    across.neighbours[side] = at;
                }
            }
            for (k, edge) in [[b, c], [a, c], [a, b]].into_iter().enumerate() {
                let key = [edge[0].min(edge[1]), edge[0].max(edge[1])];
                match open.remove(&key) {
                    Some((other, side)) => {
                        self.tetrahedra[at as usize].neighbours[k] = other;
                        self.tetrahedra[other as usize].neighbours[side] = at;
                    }
                    None => {
                        open.insert(key, (at, k));
                    }
                }
            }
        }
        debug_assert!(open.is_empty(), "a cavity is a ball");
    }

    fn link_all(&mut self) {
        let mut open: HashMap<[u32; 3], (usize, usize)> = HashMap::new();
        for t in 0..self.tetrahedra.len() {
            for (k, face) in FACES.iter().enumerate() {
                let mut key = face.map(|c| self.tetrahedra[t].corners[c]);
                key.sort_unstable();
                if let Some((other, side)) = open.remove(&key) {
                    self.tetrahedra[t].neighbours[k] = other as u32;
                    self.tetrahedra[other].neighbours[side] = t as u32;
                } else {
                    open.insert(key, (t, k));
                }
            }
        }
    }
}

fn coordinates(DVec3 { x, y, z }: DVec3) -> Coord3D<f64> {
    Coord3D { x, y, z }
}

fn orientation(points: &[DVec3], corners: [u32; 4]) -> f64 {
    let [a, b, c, d] = corners.map(|c| coordinates(points[c as usize]));
    orient3d(a, b, c, d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn unit_box() -> BoundingBox {
        BoundingBox { min: DVec3::splat(-1.0), max: DVec3::splat(2.0) }
    }

    /// Every tetrahedron has positive volume, they fill the box, neighbours are mutual, and no circumsphere
    /// contains a point.
    fn judge(made: &Delaunay) {
        let mut volume = 0.0;
        for (t, tetrahedron) in made.tetrahedra_in_use() {
            let [a, b, c, d] = tetrahedron.corners.map(|c| coordinates(made.points[c as usize]));
            let six = orient3d(a, b, c, d);
            assert!(six > 0.0, "{tetrahedron:?} is flat or turned");
            volume += six / 6.0;
            for point in &made.points {
                assert!(insphere(a, b, c, d, coordinates(*point)) <= 0.0);
            }
            for k in (0..4).filter(|&k| tetrahedron.neighbours[k] != OUTSIDE) {
                let across = &made.tetrahedra[tetrahedron.neighbours[k] as usize];
                assert!(across.neighbours.contains(&(t as u32)));
                let face = FACES[k].map(|c| tetrahedron.corners[c]);
                assert!(face.iter().all(|c| across.corners.contains(c)));
            }
        }
        assert!((volume - 27.0).abs() < 1e-9, "{volume}");
    }

    #[test]
    fn random_points_grids_and_duplicates_are_triangulated() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut made = Delaunay::new(&unit_box()).unwrap();
        for _ in 0..300 {
            made.insert(DVec3::from_array(std::array::from_fn(|_| random.random_range(0.0..1.0)))).unwrap();
        }
        judge(&made);
        let mut grid = Delaunay::new(&unit_box()).unwrap();
        for k in 0..216 {
            let at = DVec3::from_array([k % 6, k / 6 % 6, k / 36].map(|i| f64::from(i) / 5.0));
            assert_eq!(grid.insert(at).unwrap(), k as u32 + 8);
            assert_eq!(grid.insert(at).unwrap(), k as u32 + 8);
        }
        judge(&grid);
        // Points on faces, edges and diagonals of the triangulation.
        let mut halves = Delaunay::new(&unit_box()).unwrap();
        for at in [[0.5; 3], [0.5, 0.5, 0.0], [0.5, 0.0, 0.0], [-0.25; 3], [0.5, 0.5, 1.25], [1.25, 0.5, 0.5]]
        {
            halves.insert(DVec3::from_array(at)).unwrap();
            judge(&halves);
        }
    }

    #[test]
    fn points_outside_of_the_box_are_rejected() {
        let mut made = Delaunay::new(&unit_box()).unwrap();
        for at in [[2.0, 0.0, 0.0], [f64::NAN, 0.0, 0.0], [0.0, 0.0, 7.0]] {
            assert!(made.insert(DVec3::from_array(at)).unwrap_err().to_string().contains("box"));
        }
        let flat = BoundingBox { min: DVec3::ZERO, max: DVec3::new(1.0, 0.0, 1.0) };
        assert!(Delaunay::new(&flat).is_err());
    }
}
