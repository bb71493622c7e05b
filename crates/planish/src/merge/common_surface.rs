//! A common surface in the overlaps of patches.
//!
//! Input: patches and their overlaps. Output: new positions and σ of their vertices.
//!
//! Overlaps are covered with small pieces. Each piece is a height field over the plane of its mean normal,
//! refitted by a bicubic spline ([`HeightField`]). Overlapping pieces are blended: a vertex gets the mean of
//! its positions in all pieces, weighted by the distance from their centres. Pieces grow from neighbour to
//! neighbour and end where normals turn away, so that each of them is a height field.
//!
//! R. Mohr, C. Zhao and G. Koscielny (1994, eq. 2) use the direction from the origin to the region's centroid
//! as the axis of the height field. This requires the origin to be well inside the object; the mean normal
//! does not.
//!
//! Not guaranteed: shape finer than the cells of a piece is smoothed.

use planish_core::{DVec3, Progress};
use planish_estimate::{Dispersion, Result};
use planish_mesh::{FusedVertices, MergePatch, Neighbours, Overlap, noise_correlation};
use planish_spline::{HeightField, HeightReading};
use rayon::prelude::*;
use std::cmp::Ordering;

/// Radius of a piece, in edges. Larger pieces bend too far for a height field; smaller ones have too few
/// readings per spline.
const RADIUS_EDGES: f64 = 12.0;
/// Side of a spline cell, in edges. Smaller cells follow noise; larger ones smooth shape.
const CELL_EDGES: f64 = 1.75;
/// Total weight of pieces at which a vertex counts as covered. The centre of a piece has weight 1. A larger
/// value means more, closer pieces at proportional cost. 0.4 is as near to the points of ten bunny scans (rms
/// 0.1854 mm with both), and in three simulated scenes not nearer to the truth.
const MIN_COVERAGE: f64 = 0.2;
/// Maximum number of cells across a piece. Fine vertices among coarse ones would otherwise demand too many.
const MAX_CELLS_ACROSS: f64 = 60.0;
/// Minimum number of vertices for a refit.
const MIN_VERTICES: usize = 4;
/// Minimum cosine between the normals of a piece and of its centre (53°). Steeper vertices would have large
/// errors along the axis of the height field.
const MIN_COSINE: f64 = 0.6;
/// Width over which a refit is blended in, relative to the width over which a patch gains its weight in a
/// mean. At the border of its data, a spline is less accurate than its covariance states.
const BLEND_WIDTH: f64 = 2.0;
/// Number of pieces that are fitted in parallel.
const BATCH: usize = 64;

/// Selection of the refitted vertices, and weights of the readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Refit {
    /// Only vertices in overlaps, with equal weights (the method of the paper).
    Shared,
    /// Vertices in overlaps and around them, weighted by their information. The correction decreases to zero
    /// at the border of a patch.
    Information,
}

/// A vertex of a patch.
type Place = (u32, u32);

/// Vertices of one height field, each with its blending weight.
struct Piece {
    members: Vec<(Place, f64)>,
}

/// The position of a vertex according to one piece.
struct FittedVertex {
    place: Place,
    weight: f64,
    position: DVec3,
    sigma: f64,
}

/// Positions and σ of all vertices. `mean` holds the fused vertices without a refit, which are kept at the
/// borders of patches.
pub(super) fn refitted(
    patches: &[MergePatch],
    overlap: &Overlap,
    mean: Vec<FusedVertices>,
    how: Refit,
    progress: &dyn Progress,
) -> Result<Vec<FusedVertices>> {
    let links: Vec<Neighbours> = patches.iter().map(|p| Neighbours::from_mesh(&p.mesh)).collect();
    let shared =
        |(p, v): Place| overlap.patches[p as usize].feet(v as usize).iter().any(|f| !f.beyond_border);
    let mut weight: Vec<Vec<f64>> = patches.iter().map(|p| vec![0.0; p.mesh.positions.len()]).collect();
    let mut moved: Vec<Vec<DVec3>> =
        patches.iter().map(|p| vec![DVec3::ZERO; p.mesh.positions.len()]).collect();
    let mut sigma: Vec<Vec<f64>> = weight.clone();
    let mut walk = Walk::new(patches);
    let mut seeds: Vec<Place> = patches
        .iter()
        .enumerate()
        .flat_map(|(p, patch)| (0..patch.mesh.positions.len()).map(move |v| (p as u32, v as u32)))
        .filter(|place| shared(*place))
        .collect();
    // Sorted by position, so that the result does not depend on the order of the patches.
    seeds.par_sort_unstable_by_key(|place| walk.rank(*place));
    let mut next = 0;
    while next < seeds.len() {
        progress.check("refitting overlaps", next as f64 / seeds.len() as f64)?;
        progress.items(next, "vertices");
        // Pieces are chosen one after the other, because each starts where no earlier one covers. Their fits
        // run in parallel.
        let mut pieces = Vec::new();
        while next < seeds.len() && pieces.len() < BATCH {
            let (p, v) = seeds[next];
            next += 1;
            if weight[p as usize][v as usize] >= MIN_COVERAGE {
                continue;
            }
            let members = walk
                .around((p, v), patches, overlap, &links, |place| how == Refit::Information || shared(place));
            for ((p, v), w) in &members {
                weight[*p as usize][*v as usize] += w;
            }
            pieces.push(Piece { members });
        }
        let fits: Vec<Vec<FittedVertex>> = pieces
            .par_iter()
            // A piece that cannot be fitted (vertices on a line, an exact plane) keeps the mean.
            .map(|piece| fit(piece, patches, overlap, how).unwrap_or_default())
            .collect();
        for (piece, fit) in pieces.iter().zip(fits) {
            if fit.is_empty() {
                // Other pieces may still cover these vertices.
                for ((p, v), w) in &piece.members {
                    weight[*p as usize][*v as usize] -= w;
                }
            }
            for fitted in fit {
                let (p, v) = (fitted.place.0 as usize, fitted.place.1 as usize);
                moved[p][v] += fitted.weight * fitted.position;
                sigma[p][v] += fitted.weight * fitted.sigma;
            }
        }
    }
    let correlation = noise_correlation(patches, overlap);
    let out = mean.into_iter().enumerate().map(|(p, mut fused)| {
        for v in 0..fused.positions.len() {
            let place = (p as u32, v as u32);
            let w = weight[p][v];
            if !(w > 1e-9 && shared(place)) {
                continue;
            }
            let to = 1.0 / w * moved[p][v];
            let share = match how {
                Refit::Shared => 1.0,
                Refit::Information => blend_factor(patches, overlap, place),
            };
            let from = fused.positions[v];
            fused.positions[v] = from + share * (to - from);
            // The refit averages over neighbours. With correlated errors, the variance decreases less than
            // the number of neighbours suggests.
            let alone = fused.sigma[v];
            let neighbours = (alone * w / sigma[p][v]).powi(2);
            let refit = alone * correlation[p].share_of_mean(neighbours).sqrt();
            fused.sigma[v] += share * (refit - alone);
        }
        fused
    });
    Ok(out.collect())
}

/// Order of vertices in space, independent of their patch.
fn by_position(patches: &[MergePatch], a: Place, b: Place) -> Ordering {
    let [p, q] = [a, b].map(|(p, v)| patches[p as usize].mesh.positions[v as usize]);
    let by = |k: usize| p[k].total_cmp(&q[k]);
    by(0).then(by(1)).then(by(2)).then(a.cmp(&b))
}

/// Blending factor of a vertex: 0 at the borders of the other patches, 1 a few edges inside.
fn blend_factor(patches: &[MergePatch], overlap: &Overlap, (p, v): Place) -> f64 {
    overlap.patches[p as usize]
        .feet(v as usize)
        .iter()
        .filter(|f| !f.beyond_border)
        .map(|f| {
            let (mesh, other_overlap) = (&patches[f.patch as usize].mesh, &overlap.patches[f.patch as usize]);
            let read = |values: &[f64]| mesh.interpolate(values, f.triangle as usize, f.barycentric);
            planish_mesh::taper(read(&other_overlap.to_border), BLEND_WIDTH * read(&other_overlap.spacing))
        })
        .fold(0.0, f64::max)
}

fn fit(piece: &Piece, patches: &[MergePatch], overlap: &Overlap, how: Refit) -> Result<Vec<FittedVertex>> {
    if piece.members.len() < MIN_VERTICES {
        return Ok(Vec::new());
    }
    let at = |(p, v): Place| patches[p as usize].mesh.positions[v as usize];
    let overlap_of = |(p, v): Place| (&overlap.patches[p as usize], v as usize);
    let count = piece.members.len() as f64;
    let mut middle = DVec3::ZERO;
    let mut axis = DVec3::ZERO;
    let mut spacing = 0.0;
    for (place, _) in &piece.members {
        let (known, v) = overlap_of(*place);
        middle += at(*place);
        axis += known.normals[v];
        spacing += known.spacing[v];
    }
    let (middle, spacing) = (1.0 / count * middle, spacing / count);
    let Some(z) = axis.try_normalize() else {
        return Ok(Vec::new());
    };
    // The axis most perpendicular to `z` gives a cross product far from zero.
    let smallest = (0..3).min_by(|i, j| z[*i].abs().total_cmp(&z[*j].abs())).unwrap_or(0);
    let axis: DVec3 = DVec3::from_array(std::array::from_fn(|k| f64::from(u8::from(k == smallest))));
    let Some(x) = axis.cross(z).try_normalize() else {
        return Ok(Vec::new());
    };
    let y = z.cross(x);
    let frame = |place: Place| {
        let d = at(place) - middle;
        ([d.dot(x), d.dot(y)], d.dot(z))
    };
    let readings: Vec<HeightReading> = piece
        .members
        .iter()
        .map(|(member, _)| {
            let (place, height) = frame(*member);
            let (known, v) = overlap_of(*member);
            // σ along the normal, converted to the axis of the height field. The limit of 0.2 keeps steep
            // vertices from losing all weight.
            let along = known.sigma[v] / known.normals[v].dot(z).max(0.2);
            HeightReading {
                place,
                height,
                information: match how {
                    Refit::Shared => 1.0,
                    Refit::Information => 1.0 / (along * along),
                },
            }
        })
        .collect();
    let dispersion = match how {
        Refit::Shared => Dispersion::Estimated,
        Refit::Information => Dispersion::Known(1.0),
    };
    let extent =
        (readings.iter()).fold(0.0_f64, |largest, r| largest.max(r.place[0].abs()).max(r.place[1].abs()));
    let cell = (CELL_EDGES * spacing).max(2.0 * extent / MAX_CELLS_ACROSS);
    let field = HeightField::fit(&readings, cell, dispersion)?;
    let places: Vec<[f64; 2]> = readings.iter().map(|r| r.place).collect();
    Ok((piece.members.iter().zip(&readings))
        .zip(field.at_all(&places))
        .filter_map(|(((member, w), reading), found)| {
            let found = found?;
            let to = at(*member) + (found.height - reading.height) * z;
            // From the axis of the height field back to the normal.
            let slope = 1.0 + found.slope[0] * found.slope[0] + found.slope[1] * found.slope[1];
            Some(FittedVertex {
                place: *member,
                weight: *w,
                position: to,
                sigma: (found.variance / slope).sqrt(),
            })
        })
        .collect())
}

/// Visits connected vertices from neighbour to neighbour, also across patches.
struct Walk {
    /// The place of each vertex in the order of positions. Sorting by these numbers takes a tenth of the time
    /// of sorting by positions in each walk.
    ranks: Vec<Vec<u32>>,
    /// The number of the walk that visited a vertex last, so that nothing is cleared between walks.
    met: Vec<Vec<u32>>,
    walks: u32,
}

impl Walk {
    fn new(patches: &[MergePatch]) -> Self {
        let zeros: Vec<Vec<u32>> = patches.iter().map(|p| vec![0; p.mesh.positions.len()]).collect();
        let mut all: Vec<Place> = (zeros.iter().enumerate())
            .flat_map(|(p, of_patch)| (0..of_patch.len()).map(move |v| (p as u32, v as u32)))
            .collect();
        all.par_sort_unstable_by(|a, b| by_position(patches, *a, *b));
        let mut ranks = zeros.clone();
        for (rank, (p, v)) in all.into_iter().enumerate() {
            ranks[p as usize][v as usize] = rank as u32;
        }
        Self { ranks, met: zeros, walks: 0 }
    }

    fn rank(&self, (p, v): Place) -> u32 {
        self.ranks[p as usize][v as usize]
    }

    /// Connected vertices within the radius of `first` that face the same way, with weights that decrease to
    /// 0 at the radius.
    fn around(
        &mut self,
        first: Place,
        patches: &[MergePatch],
        overlap: &Overlap,
        links: &[Neighbours],
        belongs: impl Fn(Place) -> bool,
    ) -> Vec<(Place, f64)> {
        self.walks += 1;
        let at = |(p, v): Place| patches[p as usize].mesh.positions[v as usize];
        let known = |(p, v): Place| (&overlap.patches[p as usize], v as usize);
        let (overlap, v) = known(first);
        let (middle, normal, radius) = (at(first), overlap.normals[v], RADIUS_EDGES * overlap.spacing[v]);
        let mut members = Vec::new();
        let mut queue = vec![first];
        self.met[first.0 as usize][first.1 as usize] = self.walks;
        while let Some(place) = queue.pop() {
            let far = at(place).distance(middle) / radius;
            let (overlap, v) = known(place);
            if far >= 1.0 || overlap.normals[v].dot(normal) < MIN_COSINE || !belongs(place) {
                continue;
            }
            let w = 1.0 - far * far;
            members.push((place, w * w));
            let own_neighbours = links[place.0 as usize].of_vertex(place.1).iter().map(|end| (place.0, *end));
            let other_patches = overlap.feet(v).iter().filter(|f| !f.beyond_border).flat_map(|f| {
                patches[f.patch as usize].mesh.triangles[f.triangle as usize].map(|end| (f.patch, end))
            });
            for to in own_neighbours.chain(other_patches) {
                let met = &mut self.met[to.0 as usize][to.1 as usize];
                if *met != self.walks {
                    *met = self.walks;
                    queue.push(to);
                }
            }
        }
        // The walk depends on the order of the patches; floating-point sums must not.
        members.sort_unstable_by_key(|(place, _)| self.rank(*place));
        members
    }
}
