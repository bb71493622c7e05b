//! The quadrilateral around a crossed edge, and how it is cut into triangles.

use crate::mesh::TriangleMesh;
use crate::triangle::closest_on_triangle;
use planish_core::DVec3;

/// Largest distance of a crossing from two triangles, in cells, for which it is left out. Crossings lie on
/// the surface, so this bounds the error that leaving them out adds.
const FLAT: f64 = 0.03;
/// Difference of this distance, in cells, below which the shorter diagonal is taken.
const SIMILAR: f64 = 0.003;
/// Smallest cosine between a triangle and its quadrilateral: beyond 78°, one triangle lies across the other.
const MIN_COSINE: f64 = 0.2;

/// How a quadrilateral is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cut {
    /// Along the diagonal from this vertex, 0 or 1.
    Diagonal(usize),
    /// Into four triangles around the crossing.
    AroundCrossing,
}

/// The vertices of the four cubes around a crossed edge.
pub(super) struct Quadrilateral {
    pub around: [u32; 4],
    pub crossing: u32,
}

impl Quadrilateral {
    /// Two triangles if they are nearly as near to the surface as four.
    pub fn best_cut(&self, vertices: &[DVec3], crossing: DVec3, cell: f64) -> Cut {
        let corners = self.around.map(|v| vertices[v as usize]);
        let normal = (corners[2] - corners[0]).cross(corners[3] - corners[1]);
        let distances = [0, 1].map(|first| {
            let triangles = halves(first).map(|t| t.map(|k| corners[k]));
            let valid = triangles.iter().all(|[a, b, c]| {
                let own = (*b - *a).cross(*c - *a);
                own.dot(normal) > MIN_COSINE * own.length() * normal.length()
            });
            let distance = |t: &[DVec3; 3]| {
                closest_on_triangle(crossing, t, f64::INFINITY).map_or(f64::INFINITY, |f| f.squared_distance)
            };
            let nearest = distance(&triangles[0]).min(distance(&triangles[1])).sqrt();
            if valid { nearest } else { f64::INFINITY }
        });
        let lengths = [0, 1].map(|first| corners[first].distance_squared(corners[first + 2]));
        let shorter = usize::from(lengths[1] < lengths[0]);
        let nearer = usize::from(distances[1] < distances[0]);
        let similar = (distances[0] - distances[1]).abs() < SIMILAR * cell;
        match if similar { shorter } else { nearer } {
            first if distances[first] <= FLAT * cell => Cut::Diagonal(first),
            _ => Cut::AroundCrossing,
        }
    }
}

/// The two triangles on either side of the diagonal from a vertex.
fn halves(first: usize) -> [[usize; 3]; 2] {
    [[0, 1, 2], [2, 3, 0]].map(|t| t.map(|k| (k + first) % 4))
}

/// The mesh of all triangles, and the quadrilateral of each. Crossings that are used follow the vertices.
pub(super) fn triangles(
    quadrilaterals: &[Quadrilateral],
    cuts: &[Cut],
    vertices: &[DVec3],
    crossings: &[DVec3],
) -> (TriangleMesh, Vec<u32>) {
    let mut positions = vertices.to_vec();
    let (mut triangles, mut owner) = (Vec::new(), Vec::new());
    for (number, (quadrilateral, cut)) in quadrilaterals.iter().zip(cuts).enumerate() {
        let around = quadrilateral.around;
        match cut {
            Cut::Diagonal(first) => triangles.extend(halves(*first).map(|t| t.map(|k| around[k]))),
            Cut::AroundCrossing => {
                let middle = positions.len() as u32;
                positions.push(crossings[quadrilateral.crossing as usize]);
                triangles.extend((0..4).map(|k| [middle, around[k], around[(k + 1) % 4]]));
            }
        }
        owner.resize(triangles.len(), number as u32);
    }
    (TriangleMesh { positions, triangles }, owner)
}
