//! A surface given by its distance as a manifold mesh with sharp features, by dual contouring.
//!
//! In: a signed distance with its gradient, a box, and the size of a cell. Out: triangles that face outwards.
//!
//! The surface crosses the edges of a grid of cubes. Each piece of the surface in a cube gets one vertex,
//! where the tangent planes of its crossings meet (T. Ju et al. 2002), so that an edge or a corner of the
//! surface gets a vertex on it. Each crossed edge joins the vertices of its four cubes to a quadrilateral,
//! which is cut into two triangles, or into four around the crossing if it is not flat.
//!
//! - A cube has one vertex for each piece, not one for all, as in dual marching cubes (G. M. Nielson 2004).
//!   Two pieces that meet twice across an ambiguous face would share an edge of four triangles; such a face
//!   is flipped ([`loops`]).
//! - Vertices stay in their cubes. The segment between the vertices of two neighbouring cubes then crosses
//!   their common face, because two cubes side by side are convex. With four triangles around each crossing,
//!   the surface in a cube is a cone over a loop on its boundary, which cannot intersect itself.
//! - Two triangles are used where they do not intersect others. Quadrilaterals of intersecting triangles are
//!   cut into four, and if this is not enough, their vertices move to the means of their crossings.
//!
//! Not guaranteed: features smaller than a cell; that pieces in the same cube do not intersect each other.
//!
//! # References
//! - T. Ju, F. Losasso, S. Schaefer, J. Warren, *Dual contouring of Hermite data*, SIGGRAPH 2002.
//! - T. Ju, T. Udeshi, *Intersection-free contouring on an octree grid*, Pacific Graphics 2006.

mod loops;
mod quadrilateral;
mod vertex;

use crate::isosurface::zero_between;
use crate::mesh::TriangleMesh;
use crate::search::MeshSearch;
use crate::surface_cells::{Grid, SurfaceCells, corner_numbers, corner_of, key};
use loops::{Loops, NONE, joins_itself, loops};
use planish_core::{BoundingBox, DVec3};
use planish_estimate::Result;
use quadrilateral::{Cut, Quadrilateral};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Smallest distance of a crossing from the ends of its edge, as a share of the edge. Crossings of several
/// edges at one corner would otherwise coincide, and triangles between them would have no area.
const MIN_SHARE: f64 = 1e-4;
/// Maximum number of times that faces are flipped, and that intersecting triangles are cut. Each time
/// concerns only what the last one left.
const MAX_ROUNDS: usize = 4;

/// A surface as the zero of a signed distance.
pub trait DistanceField: Sync {
    /// Signed distance of a point from the surface, negative inside, with a slope of at most 1.
    fn distance(&self, at: DVec3) -> f64;

    /// The signed distance and its gradient. Near edges of the surface, the gradient belongs to one side.
    fn distance_and_gradient(&self, at: DVec3) -> (f64, DVec3);

    /// Whether the surface may pass within `reach` of a point. It may return true too often, but never false
    /// wrongly.
    fn may_pass(&self, at: DVec3, reach: f64) -> bool {
        self.distance(at).abs() <= reach
    }
}

/// A point where the surface crosses an edge of the grid.
struct Crossing {
    /// Number of the edge: four times that of its lower corner, plus its axis.
    edge: u64,
    /// The lower corner of the edge.
    low: [u32; 3],
    at: DVec3,
    normal: DVec3,
    /// True if the lower end is inside.
    rises: bool,
}

/// A cube that the surface passes through.
struct Cube {
    key: u64,
    /// Numbers of the corners.
    corners: [u32; 8],
    inside: [bool; 8],
    /// Flipped faces, as bits.
    flipped: u8,
    loops: Loops,
    /// Index of the vertex of the first loop.
    first_vertex: u32,
}

/// The grid with everything that was found on it.
struct Contour {
    grid: Grid,
    /// In ascending order of `edge`.
    crossings: Vec<Crossing>,
    /// In ascending order of `key`.
    cubes: Vec<Cube>,
}

/// The zero surface of a distance within `bounds`, by cubes of side `cell`.
///
/// Cubes are excluded if the distance at their centre exceeds half of their diagonal. Cost: one distance for
/// each cube of every size near the surface and for each of its corners, about five for each crossed edge,
/// and three for each vertex.
///
/// # Errors
/// `Input` for a cell size that is not positive or an empty box; `Unsupported` for more than 40 million
/// cells, or a million along a side.
///
/// # Examples
/// A cube keeps its edges:
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::{BoundingBox, DistanceField, dual_contour};
/// struct UnitCube;
/// impl DistanceField for UnitCube {
///     fn distance(&self, at: DVec3) -> f64 {
///         at.abs().max_element() - 1.0
///     }
///     fn distance_and_gradient(&self, at: DVec3) -> (f64, DVec3) {
///         let axis = (0..3).max_by(|&i, &j| at[i].abs().total_cmp(&at[j].abs())).unwrap_or(0);
///         (self.distance(at), at[axis].signum() * DVec3::AXES[axis])
///     }
/// }
/// let bounds = BoundingBox { min: DVec3::splat(-1.21), max: DVec3::splat(1.21) };
/// let cube = dual_contour(&bounds, 0.23, &UnitCube)?;
/// assert!(cube.check().watertight && cube.check().manifold);
/// assert!((cube.signed_volume().expect("the cube is closed") - 8.0).abs() < 1e-6);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn dual_contour(bounds: &BoundingBox, cell: f64, field: &impl DistanceField) -> Result<TriangleMesh> {
    let cells = SurfaceCells::find(bounds, cell, |at, reach| field.may_pass(at, reach))?;
    let contour = Contour::new(cells, field);
    let vertices = contour.vertices(|crossings, low| vertex::on_surface(crossings, low, cell, field));
    contour.mesh(vertices)
}

impl Contour {
    /// Finds the crossings and the pieces of the surface in each cube.
    fn new(SurfaceCells { grid, cubes, corners }: SurfaceCells, field: &impl DistanceField) -> Self {
        let values: Vec<f64> =
            (corners.par_iter()).map(|c| field.distance(grid.place(corner_of(*c)))).collect();
        // The sign is decided once per corner. Zero and NaN count as outside for all cubes alike, so that the
        // mesh is closed.
        let inside: Vec<bool> = values.iter().map(|v| *v < 0.0).collect();
        let mut found: Vec<Cube> = (cubes.par_iter())
            .filter_map(|cube| {
                let numbers = corner_numbers(&corners, *cube);
                let inside = numbers.map(|c| inside[c as usize]);
                inside.contains(&!inside[0]).then(|| Cube {
                    key: key(*cube),
                    corners: numbers,
                    inside,
                    flipped: 0,
                    loops: loops(&inside, 0),
                    first_vertex: 0,
                })
            })
            .collect();
        found.par_sort_unstable_by_key(|cube| cube.key);
        let mut edges: Vec<u64> = (found.par_iter())
            .flat_map_iter(|cube| {
                (0..12).filter(|e| cube.loops.of_edge[*e] != NONE).map(|e| cube.grid_edge(e))
            })
            .collect();
        edges.par_sort_unstable();
        edges.dedup();
        let crossing = |edge: &u64| {
            let (low, axis) = ((edge / 4) as usize, (edge % 4) as usize);
            let corner = corner_of(corners[low]);
            let mut next = corner;
            next[axis] += 1;
            let high = corners.binary_search(&key(next)).unwrap_or(low);
            let rises = inside[low];
            let [inner, outer] = if rises { [low, high] } else { [high, low] };
            let end = |c: usize| (grid.place(corner_of(corners[c])), values[c]);
            let mut at = zero_between([end(inner), end(outer)], |at| field.distance(at));
            let start = grid.place(corner)[axis];
            at[axis] = at[axis].clamp(start + MIN_SHARE * grid.cell, start + (1.0 - MIN_SHARE) * grid.cell);
            Crossing { edge: *edge, low: corner, at, normal: field.distance_and_gradient(at).1, rises }
        };
        let crossings = edges.par_iter().map(crossing).collect();
        let mut contour = Self { grid, crossings, cubes: found };
        contour.flip_faces();
        let mut vertices = 0;
        for cube in &mut contour.cubes {
            cube.first_vertex = vertices;
            vertices += u32::from(cube.loops.count);
        }
        contour
    }

    fn cube(&self, corner: [u32; 3]) -> Option<usize> {
        self.cubes.binary_search_by_key(&key(corner), |cube| cube.key).ok()
    }

    /// Flips the ambiguous faces on both sides of which a piece meets itself.
    fn flip_faces(&mut self) {
        for _ in 0..MAX_ROUNDS {
            let mut changed = false;
            for at in 0..self.cubes.len() {
                for axis in 0..3 {
                    let cube = &self.cubes[at];
                    if !joins_itself(&cube.inside, cube.flipped, 2 * axis + 1) {
                        continue;
                    }
                    let mut next = corner_of(cube.key);
                    next[axis] += 1;
                    let Some(other) = self.cube(next) else { continue };
                    let beyond = &self.cubes[other];
                    if joins_itself(&beyond.inside, beyond.flipped, 2 * axis) {
                        self.cubes[at].flip(2 * axis + 1);
                        self.cubes[other].flip(2 * axis);
                        changed = true;
                    }
                }
            }
            if !changed {
                break;
            }
        }
    }

    /// The crossings of one loop of a cube.
    fn crossings_of(&self, cube: &Cube, of_loop: u8) -> Vec<(DVec3, DVec3)> {
        (0..12)
            .filter(|e| cube.loops.of_edge[*e] == of_loop)
            .filter_map(|e| self.crossings.binary_search_by_key(&cube.grid_edge(e), |c| c.edge).ok())
            .map(|at| (self.crossings[at].at, self.crossings[at].normal))
            .collect()
    }

    /// The vertices of all cubes. `place` gets the crossings of a piece and the lowest corner of its cube.
    fn vertices(&self, place: impl Fn(&[(DVec3, DVec3)], DVec3) -> DVec3 + Sync) -> Vec<DVec3> {
        let of_cube = |cube: &Cube| -> Vec<DVec3> {
            let low = self.grid.place(corner_of(cube.key));
            (0..cube.loops.count).map(|l| place(&self.crossings_of(cube, l), low)).collect()
        };
        self.cubes.par_iter().flat_map_iter(of_cube).collect()
    }

    /// The vertices around a crossed edge, counter-clockwise seen from outside. `None` if a cube is missing,
    /// which happens only at the end of the box.
    fn around(&self, crossing: &Crossing) -> Option<[u32; 4]> {
        let axis = (crossing.edge % 4) as usize;
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut found = [0; 4];
        for (found, [i, j]) in found.iter_mut().zip([[0, 0], [1, 0], [1, 1], [0, 1]]) {
            let mut at = crossing.low;
            at[a] = at[a].checked_sub(i)?;
            at[b] = at[b].checked_sub(j)?;
            let cube = &self.cubes[self.cube(at)?];
            let of_loop = cube.loops.of_edge[4 * axis + i as usize + 2 * j as usize];
            *found = cube.first_vertex + u32::from(of_loop);
        }
        if !crossing.rises {
            found.reverse();
        }
        Some(found)
    }

    /// Cuts all quadrilaterals into triangles that do not intersect.
    fn mesh(&self, mut vertices: Vec<DVec3>) -> Result<TriangleMesh> {
        let quadrilaterals: Vec<Quadrilateral> = (0..self.crossings.len())
            .into_par_iter()
            .filter_map(|n| {
                Some(Quadrilateral { around: self.around(&self.crossings[n])?, crossing: n as u32 })
            })
            .collect();
        let middle: Vec<DVec3> = self.crossings.iter().map(|crossing| crossing.at).collect();
        let mut cuts: Vec<Cut> = (quadrilaterals.par_iter())
            .map(|q| q.best_cut(&vertices, middle[q.crossing as usize], self.grid.cell))
            .collect();
        for round in 0..=MAX_ROUNDS {
            let (mesh, owner) = quadrilateral::triangles(&quadrilaterals, &cuts, &vertices, &middle);
            if mesh.triangles.is_empty() || round == MAX_ROUNDS {
                return Ok(mesh);
            }
            let crossing = MeshSearch::try_new(&mesh)?.crossing_pairs();
            let involved: BTreeSet<u32> = crossing.iter().flatten().map(|t| owner[*t as usize]).collect();
            if involved.is_empty() {
                return Ok(mesh);
            }
            // A second cut changes nothing, so vertices have to move.
            let all_cut = involved.iter().all(|q| cuts[*q as usize] == Cut::AroundCrossing);
            if all_cut {
                let means = self.vertices(|crossings, _| vertex::middle(crossings));
                for q in &involved {
                    for v in quadrilaterals[*q as usize].around {
                        vertices[v as usize] = means[v as usize];
                    }
                }
            }
            for q in involved {
                cuts[q as usize] = Cut::AroundCrossing;
            }
        }
        Ok(TriangleMesh::default())
    }
}

impl Cube {
    /// The number of an edge in the grid.
    fn grid_edge(&self, edge: usize) -> u64 {
        4 * u64::from(self.corners[loops::ends(edge)[0]]) + edge as u64 / 4
    }

    fn flip(&mut self, face: usize) {
        self.flipped |= 1 << face;
        self.loops = loops(&self.inside, self.flipped);
    }
}

#[cfg(test)]
mod tests;
