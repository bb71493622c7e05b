//! Triangle meshes with exact sharp edges, built from curves and the faces between them.
//!
//! In: corners, curves between them, and faces that are bounded by the curves. Out: a mesh whose vertices lie
//! exactly on the faces, about one spacing apart, and the sharp edges.
//!
//! Faces refer to the vertices of their curves. Two faces at a curve therefore share its vertices, and a mesh
//! whose curves all have two faces is watertight.
//!
//! Not guaranteed: that faces do not intersect each other; the caller has to choose the sizes.

use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::TriangleMesh;
use planish_solid::tessellation::triangulate_region;
use serde::Serialize;
use std::f64::consts::TAU;

/// Distance of inner points of a plane from its boundary, in spacings.
///
/// With less, triangles at the boundary are slivers; with more, they are larger than the others.
const CLEARANCE: f64 = 0.6;

/// A sharp edge of an object.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum TrueEdge {
    /// A straight edge.
    Line {
        /// One end.
        start: DVec3,
        /// The other end.
        end: DVec3,
    },
    /// A circle, or an arc of it.
    Arc {
        /// Centre.
        center: DVec3,
        /// Unit normal of the plane of the circle.
        axis: DVec3,
        /// Radius.
        radius: f64,
        /// Start of the arc; equal to `end` for a circle.
        start: DVec3,
        /// End of the arc, counter-clockwise about the axis.
        end: DVec3,
    },
}

/// A mesh under construction.
#[derive(Debug, Clone)]
pub(super) struct FaceMesh {
    /// Distance of neighbouring vertices.
    spacing: f64,
    mesh: TriangleMesh,
    edges: Vec<TrueEdge>,
}

impl FaceMesh {
    /// A mesh without faces.
    pub(super) fn new(spacing: f64) -> Self {
        Self { spacing, mesh: TriangleMesh::default(), edges: Vec::new() }
    }

    /// The mesh and its sharp edges.
    pub(super) fn finish(self) -> (TriangleMesh, Vec<TrueEdge>) {
        (self.mesh, self.edges)
    }

    /// Adds a vertex.
    pub(super) fn vertex(&mut self, at: DVec3) -> u32 {
        self.mesh.positions.push(at);
        self.mesh.positions.len() as u32 - 1
    }

    fn position(&self, vertex: u32) -> DVec3 {
        self.mesh.positions[vertex as usize]
    }

    /// A straight curve between two vertices across which the surface is smooth, both included.
    pub(super) fn smooth_line(&mut self, start: u32, end: u32) -> Vec<u32> {
        let [a, b] = [start, end].map(|v| self.position(v));
        let count = (a.distance(b) / self.spacing).ceil().max(1.0) as usize;
        let mut line = vec![start];
        line.extend((1..count).map(|k| self.vertex(a + (k as f64 / count as f64) * (b - a))));
        line.push(end);
        line
    }

    /// A straight sharp edge between two vertices, both included.
    pub(super) fn line(&mut self, start: u32, end: u32) -> Vec<u32> {
        self.edges.push(TrueEdge::Line { start: self.position(start), end: self.position(end) });
        self.smooth_line(start, end)
    }

    /// A sharp arc, counter-clockwise about `axis` from one vertex to another, both included.
    pub(super) fn arc(&mut self, center: DVec3, axis: DVec3, [start, end]: [u32; 2]) -> Vec<u32> {
        let [a, b] = [start, end].map(|v| self.position(v));
        let x = a - center;
        let radius = x.length();
        let y = axis.cross(x);
        let angle_rad = (b - center).dot(y).atan2((b - center).dot(x)).rem_euclid(TAU);
        self.edges.push(TrueEdge::Arc { center, axis, radius, start: a, end: b });
        let count = self.chords(angle_rad, radius);
        let mut arc = vec![start];
        arc.extend((1..count).map(|k| {
            let (sin, cos) = (angle_rad * k as f64 / count as f64).sin_cos();
            self.vertex(center + cos * x + sin * y)
        }));
        arc.push(end);
        arc
    }

    /// A sharp circle, counter-clockwise about the unit vector `axis`, from `center + radius · x`.
    pub(super) fn circle(&mut self, center: DVec3, axis: DVec3, x: DVec3, radius: f64) -> Vec<u32> {
        let start = center + radius * x;
        self.edges.push(TrueEdge::Arc { center, axis, radius, start, end: start });
        let (count, y) = (self.chords(TAU, radius), axis.cross(x));
        (0..count)
            .map(|k| {
                let (sin, cos) = (TAU * k as f64 / count as f64).sin_cos();
                self.vertex(center + radius * (cos * x + sin * y))
            })
            .collect()
    }

    /// Number of chords of an arc: at most a spacing long, and at most 5.6° wide.
    ///
    /// The chord error is then at most 0.12 % of the radius, also of arcs that are small against the spacing.
    fn chords(&self, angle_rad: f64, radius: f64) -> usize {
        (angle_rad * radius / self.spacing).max(64.0 * angle_rad / TAU).ceil() as usize
    }

    /// Fills the plane between closed curves with triangles that face along `normal`.
    ///
    /// `curves` are lists of vertices without repetition; the first one surrounds the others. Curves may have
    /// either direction.
    ///
    /// # Errors
    /// `Unsupported` if curves cross.
    pub(super) fn plane(&mut self, normal: DVec3, curves: &[Vec<u32>]) -> Result<()> {
        let (x, y) = planish_core::vector3::tangents(normal);
        let flat = |p: DVec3| [p.dot(x), p.dot(y)];
        let mut vertices: Vec<u32> = curves.iter().flatten().copied().collect();
        let mut points: Vec<[f64; 2]> = vertices.iter().map(|&v| flat(self.position(v))).collect();
        let sizes: Vec<usize> = curves.iter().map(Vec::len).collect();
        let height = vertices.first().map_or(0.0, |&v| self.position(v).dot(normal));
        let inner = inner_points(&points, &sizes, self.spacing);
        vertices.extend(inner.iter().map(|p| self.vertex(p[0] * x + p[1] * y + height * normal)));
        let count = inner.len();
        points.extend(inner);
        let (z, made) = (x.cross(y).dot(normal), triangulate_region(&points, &sizes, count)?);
        self.mesh.triangles.extend(made.into_iter().map(|t| {
            let [a, b, c] = t.map(|k| vertices[k as usize]);
            if z > 0.0 { [a, b, c] } else { [a, c, b] }
        }));
        Ok(())
    }

    /// Fills the surface of straight lines between two curves with equally many vertices.
    ///
    /// `sides` are the first and the last of these lines; without them, the curves are closed. The surface
    /// faces along (direction of `from`) × (direction to `to`).
    pub(super) fn ruled(&mut self, from: &[u32], to: &[u32], sides: Option<[&[u32]; 2]>) {
        let rows = match sides {
            Some([first, _]) => first.len() - 1,
            None => {
                let length = from.first().zip(to.first());
                let length = length.map_or(0.0, |(&a, &b)| self.position(a).distance(self.position(b)));
                (length / self.spacing).ceil().max(1.0) as usize
            }
        };
        let mut grid = vec![from.to_vec()];
        for row in 1..rows {
            let share = row as f64 / rows as f64;
            let line: Vec<u32> = (from.iter().zip(to))
                .enumerate()
                .map(|(k, (&a, &b))| match sides {
                    Some([first, _]) if k == 0 => first[row],
                    Some([_, last]) if k + 1 == from.len() => last[row],
                    _ => {
                        let [a, b] = [a, b].map(|v| self.position(v));
                        self.vertex(a + share * (b - a))
                    }
                })
                .collect();
            grid.push(line);
        }
        grid.push(to.to_vec());
        let columns = from.len() - usize::from(sides.is_some());
        for pair in grid.windows(2) {
            for k in 0..columns {
                let next = (k + 1) % from.len();
                let [a, b, c, d] = [pair[0][k], pair[0][next], pair[1][next], pair[1][k]];
                self.mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
}

/// The closed curve of curves that follow each other; each is reversed if necessary.
///
/// Curves include both ends. The result has no repeated vertex.
pub(super) fn boundary(curves: &[impl AsRef<[u32]>]) -> Vec<u32> {
    let mut joined: Vec<u32> = Vec::new();
    for curve in curves.iter().map(AsRef::as_ref) {
        let is_reversed = joined.last().is_some_and(|end| curve.first() != Some(end));
        // The first vertex of a curve is the last one of its predecessor.
        joined.pop();
        if is_reversed {
            joined.extend(curve.iter().rev());
        } else {
            joined.extend(curve);
        }
    }
    joined.pop();
    joined
}

/// A triangular grid of points inside polygons, away from their sides.
///
/// `points` holds the corners of all polygons, of which `sizes` gives the numbers.
fn inner_points(points: &[[f64; 2]], sizes: &[usize], spacing: f64) -> Vec<[f64; 2]> {
    let mut sides = Vec::with_capacity(points.len());
    let mut first = 0;
    for &size in sizes {
        sides.extend((0..size).map(|k| [points[first + k], points[first + (k + 1) % size]]));
        first += size;
    }
    let bounds: planish_core::BoundingBox<[f64; 2]> = points.iter().copied().collect();
    // Points of the boundary by cells, so that the clearance is tested against a few of them only.
    let cell = |p: [f64; 2]| p.map(|c| (c / spacing).floor() as i64);
    let mut cells = std::collections::HashMap::<[i64; 2], Vec<[f64; 2]>>::new();
    for &p in points {
        cells.entry(cell(p)).or_default().push(p);
    }
    let is_clear = |p: [f64; 2]| {
        let [i, j] = cell(p);
        (i - 1..=i + 1).flat_map(|i| (j - 1..=j + 1).map(move |j| [i, j])).all(|near| {
            cells.get(&near).is_none_or(|points| {
                points.iter().all(|q| (p[0] - q[0]).hypot(p[1] - q[1]) > CLEARANCE * spacing)
            })
        })
    };
    let row_height = 0.75_f64.sqrt() * spacing;
    let rows = (bounds.extent()[1] / row_height).ceil() as usize;
    let columns = (bounds.extent()[0] / spacing).ceil() as usize + 1;
    let mut found = Vec::new();
    for row in 0..rows {
        let y = bounds.min[1] + (row as f64 + 0.5) * row_height;
        // Crossings of this row with the polygons; a point between an odd and an even one is inside.
        let mut crossings: Vec<f64> = (sides.iter())
            .filter(|[a, b]| (a[1] > y) != (b[1] > y))
            .map(|[a, b]| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
            .collect();
        crossings.sort_by(f64::total_cmp);
        let shift = if row.is_multiple_of(2) { 0.25 } else { 0.75 };
        for column in 0..columns {
            let p = [bounds.min[0] + (column as f64 + shift - 0.25) * spacing, y];
            if crossings.partition_point(|&x| x <= p[0]) % 2 == 1 && is_clear(p) {
                found.push(p);
            }
        }
    }
    found
}
