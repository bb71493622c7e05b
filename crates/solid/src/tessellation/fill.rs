//! Triangulates the region between the polygons of a face.

use super::Points;
use super::domain::Domain;
use super::polygon::Corner;
use crate::brep::{Face, FaceSurface};
use planish_core::{DVec3, Setting};
use planish_estimate::{Error, Result};
use spade::handles::FixedVertexHandle;
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, Triangulation};

/// Maximum number of points of a face. It bounds time and memory; faces that need more are rejected.
const MAX_POINTS: usize = 100_000;
/// Maximum number of refinements. Each halves the triangles that exceed the tolerance, which divides their
/// error by about four.
const ROUNDS: usize = 10;
/// Number of new points from which all points are triangulated anew. It exceeds what ordinary faces add.
const MANY_POINTS: usize = 2000;

/// A region to triangulate.
pub(crate) struct Filling<'a> {
    /// Polygons. A point in an odd number of them is inside.
    pub(crate) polygons: &'a [Vec<Corner>],
    /// Points inside that must be vertices.
    pub(crate) inner: &'a [Corner],
    /// The point of the surface for a point of the plane.
    pub(crate) on_surface: &'a dyn Fn([f64; 2]) -> DVec3,
    /// True for a plane, where all triangles are exact.
    pub(crate) is_flat: bool,
    /// Maximum distance of triangles from the surface.
    pub(crate) tolerance: f64,
    /// Maximum number of points.
    pub(crate) max_points: usize,
}

/// A point of the triangulation.
#[derive(Clone, Copy)]
struct Placed {
    at: [f64; 2],
    vertex: u32,
}

impl HasPosition for Placed {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        Point2::new(self.at[0], self.at[1])
    }
}

type Triangles = ConstrainedDelaunayTriangulation<Placed>;

/// The triangles of a face, oriented outwards.
pub(super) fn triangles(
    face: &Face,
    domain: &Domain,
    points: &mut Points,
    tolerance: f64,
) -> Result<Vec<[u32; 3]>> {
    let filling = Filling {
        polygons: &domain.polygons,
        inner: &domain.inner,
        on_surface: &|at| domain.chart.point(at),
        is_flat: matches!(face.surface, FaceSurface::Plane { .. }),
        tolerance,
        max_points: MAX_POINTS,
    };
    let mut made = filling.triangles(&mut points.positions)?;
    if face.outward == domain.chart.is_mirrored() {
        for t in &mut made {
            t.swap(1, 2);
        }
    }
    Ok(made)
}

impl Filling<'_> {
    /// Triangles that are counter-clockwise in the plane. Added points are appended to the positions.
    ///
    /// No point is added on a polygon side, because the neighbouring face has the same chords there.
    pub(crate) fn triangles(&self, positions: &mut Vec<DVec3>) -> Result<Vec<[u32; 3]>> {
        let mut made = bounded(self.polygons, self.inner)?;
        // After the last round, triangles may still exceed the tolerance; `tessellate` checks the volume.
        for _ in 0..if self.is_flat { 0 } else { ROUNDS } {
            let wanted = missing(&made, positions, self.on_surface, self.tolerance);
            if wanted.is_empty() {
                break;
            }
            if made.num_vertices() + wanted.len() > self.max_points {
                return Err(too_many_points(made.num_vertices() + wanted.len()));
            }
            let added = wanted.into_iter().map(|at| {
                positions.push((self.on_surface)(at));
                Placed { at, vertex: positions.len() as u32 - 1 }
            });
            made = with_points(made, added.collect())?;
        }
        let inside = inside(&made);
        Ok(made
            .inner_faces()
            .filter(|f| inside[f.fix().index()])
            .map(|f| f.vertices().map(|v| v.data().vertex))
            .collect())
    }
}

/// The error for a face that needs too many points. It names a setting, unlike errors of the shape, which
/// finer chords may avoid.
pub(crate) fn too_many_points(count: usize) -> Error {
    Error::unsupported(format!(
        "needs {count} points or more, which is more than a face may have: a coordinate may be damaged; \
         otherwise expected a larger chord error"
    ))
    .with_setting(Setting::MeshTolerance)
}

/// The error for a point that the triangulation rejects.
fn refused(e: spade::InsertionError) -> Error {
    Error::unsupported(format!("a point cannot be placed: {e}"))
}

/// Triangles of a polygon without holes, as indices of its corners, in O(n log n). They are
/// counter-clockwise.
///
/// Corners at the same position count as one.
///
/// # Errors
/// `Unsupported` if sides cross, or a coordinate is not finite.
///
/// # Examples
/// ```
/// use planish_solid::tessellation::triangulate_polygon;
/// // An arrow head, which a fan around its first corner would not fill.
/// let triangles = triangulate_polygon(&[[1.0, 2.0], [0.0, 0.0], [2.0, 1.0], [1.0, 1.0]])?;
/// assert_eq!(triangles.len(), 2);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn triangulate_polygon(corners: &[[f64; 2]]) -> Result<Vec<[u32; 3]>> {
    triangulate_region(corners, &[corners.len()], 0)
}

/// Triangles of the region between polygons, with further points inside. They are counter-clockwise.
///
/// `points` holds the corners of the polygons, one polygon after the other, then `inner` points.
/// `polygon_sizes` is the number of corners of each polygon. A point in an odd number of polygons is inside.
/// Triangles are indices of `points`. No point is added. Cost O(n log n) for typical input.
///
/// # Errors
/// `Input` if the number of points differs from the sum of the sizes; `Unsupported` if sides cross, or a
/// coordinate is not finite.
///
/// # Examples
/// ```
/// use planish_solid::tessellation::triangulate_region;
/// // A square with a square hole.
/// let square = |half: f64| [[-half, -half], [half, -half], [half, half], [-half, half]];
/// let points = [square(2.0), square(1.0)].concat();
/// assert_eq!(triangulate_region(&points, &[4, 4], 0)?.len(), 8);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn triangulate_region(
    points: &[[f64; 2]],
    polygon_sizes: &[usize],
    inner: usize,
) -> Result<Vec<[u32; 3]>> {
    let expected = polygon_sizes.iter().sum::<usize>() + inner;
    if points.len() != expected {
        return Err(Error::input(format!("expected {expected} points of a region, found {}", points.len())));
    }
    let mut corners = points.iter().zip(0..).map(|(at, vertex)| Corner { vertex, at: *at });
    let polygons: Vec<Vec<Corner>> =
        polygon_sizes.iter().map(|&size| corners.by_ref().take(size).collect()).collect();
    let made = bounded(&polygons, &corners.collect::<Vec<_>>())?;
    let inside = inside(&made);
    Ok((made.inner_faces().filter(|f| inside[f.fix().index()]))
        .map(|f| f.vertices().map(|v| v.data().vertex))
        .collect())
}

/// The triangulation of the corners of the polygons, with their sides as constraints.
fn bounded(polygons: &[Vec<Corner>], inner: &[Corner]) -> Result<Triangles> {
    let mut made = Triangles::new();
    for polygon in polygons {
        let mut handles = Vec::with_capacity(polygon.len());
        for corner in polygon {
            let placed = Placed { at: corner.at, vertex: corner.vertex };
            handles.push(made.insert(placed).map_err(refused)?);
        }
        for k in 0..handles.len() {
            let (a, b) = (handles[k], handles[(k + 1) % handles.len()]);
            if a == b {
                continue;
            }
            // Crossing sides are reported instead of split: a new vertex on a side would not be in the
            // neighbouring face.
            if !made.can_add_constraint(a, b) {
                return Err(crossing(&made, a));
            }
            made.add_constraint(a, b);
        }
    }
    with_points(made, inner.iter().map(|c| Placed { at: c.at, vertex: c.vertex }).collect())
}

/// The triangulation with more points.
///
/// Points that are inserted one by one beside a distant corner change most triangles of the corner, which
/// takes quadratic time for many. All points are then triangulated anew, in an order that avoids this. The
/// sides are added last: with them, `bulk_load_cdt` of spade 2.15 gave triangulations with gaps.
fn with_points(made: Triangles, added: Vec<Placed>) -> Result<Triangles> {
    if added.len() < MANY_POINTS {
        return one_by_one(made, added);
    }
    let sides = made.undirected_edges().filter(|edge| edge.is_constraint_edge());
    let sides: Vec<_> = sides.map(|edge| edge.vertices().map(|v| v.fix())).collect();
    let points: Vec<Placed> = made.vertices().map(|v| *v.data()).chain(added.iter().copied()).collect();
    let count = points.len();
    let mut again = Triangles::bulk_load_cdt(points, Vec::new()).map_err(refused)?;
    // Points keep their order, unless two were at one position.
    if again.num_vertices() != count {
        return one_by_one(made, added);
    }
    for [a, b] in sides {
        if !again.can_add_constraint(a, b) {
            return Err(crossing(&again, a));
        }
        again.add_constraint(a, b);
    }
    Ok(again)
}

fn one_by_one(mut made: Triangles, added: Vec<Placed>) -> Result<Triangles> {
    for placed in added {
        made.insert(placed).map_err(refused)?;
    }
    Ok(made)
}

/// The error for a side from this corner that crosses another one.
fn crossing(made: &Triangles, corner: FixedVertexHandle) -> Error {
    let p = made.vertex(corner).data().at;
    Error::unsupported(format!("sides of its loops cross near the parameters {p:?}"))
}

/// For each triangle, true if it is in the face: an odd number of polygon sides away from the outside.
fn inside(made: &Triangles) -> Vec<bool> {
    let mut found: Vec<Option<bool>> = vec![None; made.num_all_faces()];
    found[made.outer_face().fix().index()] = Some(false);
    let mut open = Vec::new();
    // Flood fill from the outer face: each polygon side changes the state. This needs no point location and
    // is exact. The neighbours are those of the triangulation, as lists of them would double its memory.
    for edge in made.directed_edges().filter(|edge| edge.face().is_outer()) {
        let next = edge.rev().face().fix();
        if found[next.index()].is_none() {
            found[next.index()] = Some(edge.is_constraint_edge());
            open.push(next);
        }
    }
    while let Some(at) = open.pop() {
        let is_inside = found[at.index()].unwrap_or(false);
        for edge in made.face(at).as_inner().into_iter().flat_map(|face| face.adjacent_edges()) {
            let next = edge.rev().face().fix();
            if found[next.index()].is_none() {
                found[next.index()] = Some(is_inside != edge.is_constraint_edge());
                open.push(next);
            }
        }
    }
    found.into_iter().map(|f| f.unwrap_or(false)).collect()
}

/// Points that are needed: the middles of inner sides that exceed the tolerance, or, if there are none, the
/// middles of such triangles.
///
/// Points in triangles alone would keep long sides; points on sides shorten these first.
fn missing(
    made: &Triangles,
    positions: &[DVec3],
    on_surface: &dyn Fn([f64; 2]) -> DVec3,
    tolerance: f64,
) -> Vec<[f64; 2]> {
    let inside = inside(made);
    let miss = |corners: &[Placed]| {
        let n = corners.len() as f64;
        let at = [0, 1].map(|k| corners.iter().map(|c| c.at[k]).sum::<f64>() / n);
        let mean = |k: usize| corners.iter().map(|c| positions[c.vertex as usize][k]).sum::<f64>() / n;
        let flat = DVec3::new(mean(0), mean(1), mean(2));
        (at, (on_surface(at) - flat).length())
    };
    let mut wanted = Vec::new();
    for edge in made.undirected_edges().filter(|e| !e.is_constraint_edge()) {
        let [a, b] = edge.as_directed().vertices().map(|v| *v.data());
        let within = inside[edge.as_directed().face().fix().index()];
        let (at, far) = miss(&[a, b]);
        if within && far > tolerance {
            wanted.push(at);
        }
    }
    if wanted.is_empty() {
        for face in made.inner_faces().filter(|f| inside[f.fix().index()]) {
            let (at, far) = miss(&face.vertices().map(|v| *v.data()));
            if far > tolerance {
                wanted.push(at);
            }
        }
    }
    wanted
}
