//! One surface where patches share places.
//!
//! Input: patches and where they lie on one another. Output: where their vertices come to lie. Shared
//! places are covered with pieces, each a height field over the plane of its mean normal (R. Mohr, C. Zhao,
//! G. Koscielny 1994 take the direction from the origin to the region's centroid, their eq. 2, which serves
//! only where the origin lies well inside the object), refitted by a bicubic spline ([`HeightField`]), and
//! blended: a place is where the pieces about it say, each by how near its middle is. Pieces follow the
//! surface from neighbour to neighbour and end where normals turn away, so that what is no height field is
//! several.
//!
//! Not guaranteed: that a piece follows shape finer than its cells.

use planish_core::Progress;
use planish_estimate::vector3::{add, add_scaled, cross, distance, dot, scale, sub, unit};
use planish_estimate::{Dispersion, Result};
use planish_mesh::{FusedVertices, MergePatch, Neighbours, Overlap, noise_correlation};
use planish_spline::{HeightField, HeightReading};
use rayon::prelude::*;
use std::cmp::Ordering;

/// The radius of a piece, in edges.
const RADIUS: f64 = 12.0;
/// The side of a cell, in edges.
const CELL: f64 = 1.75;
/// A place is covered when pieces weigh so much there; the middle of a piece weighs one.
const COVERED: f64 = 0.4;
/// Cells across a piece, at most: where coarse and fine vertices lie together, the fine ones' would be too
/// many.
const MOST_ACROSS: f64 = 60.0;
/// A refit needs so many vertices.
const FEWEST: usize = 4;
/// Normals of a piece and of its middle: the least cosine.
const SAME_PIECE: f64 = 0.6;
/// A refit blends in over so many times the edges over which a patch gains its weight in a mean: at its ends
/// a spline knows less than its covariance says.
const BLENDED: f64 = 2.0;
/// Vertices of one piece are worked on together up to so many pieces.
const BATCH: usize = 64;

/// What is refitted, and how readings count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Refit {
    /// Shared places alone, all alike (the paper's).
    Shared,
    /// Shared places and those around them, by their information; what is moved goes to nothing where a patch
    /// ends.
    Information,
}

/// A vertex of a patch.
type Place = (u32, u32);

/// Vertices that belong together, each with its weight.
struct Piece {
    members: Vec<(Place, f64)>,
}

/// Where a piece says that a vertex is.
struct Said {
    place: Place,
    weight: f64,
    position: [f64; 3],
    sigma: f64,
}

/// Places and σ of all vertices. `mean` are those without a refit, which blend in where patches end.
pub(super) fn refitted(
    patches: &[MergePatch],
    overlap: &Overlap,
    mean: Vec<FusedVertices>,
    how: Refit,
    progress: &dyn Progress,
) -> Result<Vec<FusedVertices>> {
    let links: Vec<Neighbours> = patches.iter().map(|p| Neighbours::from_mesh(&p.mesh)).collect();
    let shared = |(p, v): Place| overlap.patches[p as usize].feet(v as usize).iter().any(|f| !f.beside);
    let mut weight: Vec<Vec<f64>> = patches.iter().map(|p| vec![0.0; p.mesh.positions.len()]).collect();
    let mut moved: Vec<Vec<[f64; 3]>> =
        patches.iter().map(|p| vec![[0.0; 3]; p.mesh.positions.len()]).collect();
    let mut sigma: Vec<Vec<f64>> = weight.clone();
    let mut walk = Walk::new(patches);
    let mut seeds: Vec<Place> = patches
        .iter()
        .enumerate()
        .flat_map(|(p, patch)| (0..patch.mesh.positions.len()).map(move |v| (p as u32, v as u32)))
        .filter(|place| shared(*place))
        .collect();
    // Where pieces begin must not hang on the order of the patches.
    seeds.par_sort_unstable_by(|a, b| by_position(patches, *a, *b));
    let mut next = 0;
    while next < seeds.len() {
        progress.check("refitting what patches share", next as f64 / seeds.len() as f64)?;
        progress.items(next, "vertices");
        // Pieces one after the other, as each begins where none was; their fits side by side.
        let mut pieces = Vec::new();
        while next < seeds.len() && pieces.len() < BATCH {
            let (p, v) = seeds[next];
            next += 1;
            if weight[p as usize][v as usize] >= COVERED {
                continue;
            }
            let members = walk
                .around((p, v), patches, overlap, &links, |place| how == Refit::Information || shared(place));
            for ((p, v), w) in &members {
                weight[*p as usize][*v as usize] += w;
            }
            pieces.push(Piece { members });
        }
        let fits: Vec<Vec<Said>> = pieces
            .par_iter()
            // What cannot be fitted (vertices on a line, an exact plane) says nothing: the mean stands there.
            .map(|piece| fit(piece, patches, overlap, how).unwrap_or_default())
            .collect();
        for (piece, fit) in pieces.iter().zip(fits) {
            if fit.is_empty() {
                // Nothing was said: others may.
                for ((p, v), w) in &piece.members {
                    weight[*p as usize][*v as usize] -= w;
                }
            }
            for said in fit {
                let (p, v) = (said.place.0 as usize, said.place.1 as usize);
                moved[p][v] = add_scaled(moved[p][v], said.weight, said.position);
                sigma[p][v] += said.weight * said.sigma;
            }
        }
    }
    let likeness = noise_correlation(patches, overlap);
    let out = mean.into_iter().enumerate().map(|(p, mut fused)| {
        for v in 0..fused.positions.len() {
            let place = (p as u32, v as u32);
            let w = weight[p][v];
            if !(w > 1e-9 && shared(place)) {
                continue;
            }
            let to = scale(1.0 / w, moved[p][v]);
            let share = match how {
                Refit::Shared => 1.0,
                Refit::Information => within_others(patches, overlap, place),
            };
            let from = fused.positions[v];
            fused.positions[v] = add_scaled(from, share, sub(to, from));
            // Of the variance of a mean of one place of each patch, the refit's is what is left by so many
            // neighbours if each is off on its own.
            let alone = fused.sigma[v];
            let neighbours = (alone * w / sigma[p][v]).powi(2);
            let refit = alone * likeness[p].share_of_mean(neighbours).sqrt();
            fused.sigma[v] += share * (refit - alone);
        }
        fused
    });
    Ok(out.collect())
}

/// The order of places in space, whichever patch they are of.
fn by_position(patches: &[MergePatch], a: Place, b: Place) -> Ordering {
    let [p, q] = [a, b].map(|(p, v)| patches[p as usize].mesh.positions[v as usize]);
    let by = |k: usize| p[k].total_cmp(&q[k]);
    by(0).then(by(1)).then(by(2)).then(a.cmp(&b))
}

/// How far within other patches a place lies: nothing at their borders, one some edges from it.
fn within_others(patches: &[MergePatch], overlap: &Overlap, (p, v): Place) -> f64 {
    overlap.patches[p as usize]
        .feet(v as usize)
        .iter()
        .filter(|f| !f.beside)
        .map(|f| {
            let (mesh, of) = (&patches[f.patch as usize].mesh, &overlap.patches[f.patch as usize]);
            let read = |values: &[f64]| mesh.interpolate(values, f.triangle as usize, f.barycentric);
            planish_mesh::taper(read(&of.to_border), BLENDED * read(&of.spacing))
        })
        .fold(0.0, f64::max)
}

fn fit(piece: &Piece, patches: &[MergePatch], overlap: &Overlap, how: Refit) -> Result<Vec<Said>> {
    if piece.members.len() < FEWEST {
        return Ok(Vec::new());
    }
    let at = |(p, v): Place| patches[p as usize].mesh.positions[v as usize];
    let of = |(p, v): Place| (&overlap.patches[p as usize], v as usize);
    let count = piece.members.len() as f64;
    let mut middle = [0.0; 3];
    let mut axis = [0.0; 3];
    let mut spacing = 0.0;
    for (place, _) in &piece.members {
        let (known, v) = of(*place);
        middle = add(middle, at(*place));
        axis = add(axis, known.normals[v]);
        spacing += known.spacing[v];
    }
    let (middle, spacing) = (scale(1.0 / count, middle), spacing / count);
    let Some(z) = unit(axis) else {
        return Ok(Vec::new());
    };
    let least = (0..3).min_by(|i, j| z[*i].abs().total_cmp(&z[*j].abs())).unwrap_or(0);
    let aside: [f64; 3] = std::array::from_fn(|k| f64::from(u8::from(k == least)));
    let Some(x) = unit(cross(aside, z)) else {
        return Ok(Vec::new());
    };
    let y = cross(z, x);
    let frame = |place: Place| {
        let d = sub(at(place), middle);
        ([dot(d, x), dot(d, y)], dot(d, z))
    };
    let readings: Vec<HeightReading> = piece
        .members
        .iter()
        .map(|(member, _)| {
            let (place, height) = frame(*member);
            let (known, v) = of(*member);
            // σ is along the normal; along the axis it is longer.
            let along = known.sigma[v] / dot(known.normals[v], z).max(0.2);
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
    let extent = (readings.iter()).fold(0.0_f64, |most, r| most.max(r.place[0].abs()).max(r.place[1].abs()));
    let cell = (CELL * spacing).max(2.0 * extent / MOST_ACROSS);
    let field = HeightField::fit(&readings, cell, dispersion)?;
    let places: Vec<[f64; 2]> = readings.iter().map(|r| r.place).collect();
    Ok((piece.members.iter().zip(&readings))
        .zip(field.at_all(&places))
        .filter_map(|(((member, w), reading), found)| {
            let found = found?;
            let to = add_scaled(at(*member), found.height - reading.height, z);
            let slope = 1.0 + found.slope[0] * found.slope[0] + found.slope[1] * found.slope[1];
            Some(Said { place: *member, weight: *w, position: to, sigma: (found.variance / slope).sqrt() })
        })
        .collect())
}

/// From neighbour to neighbour over all patches.
struct Walk {
    /// In which walk a vertex was come by.
    met: Vec<Vec<u32>>,
    walks: u32,
}

impl Walk {
    fn new(patches: &[MergePatch]) -> Self {
        Self { met: patches.iter().map(|p| vec![0; p.mesh.positions.len()]).collect(), walks: 0 }
    }

    /// All that is within the radius of a place and faces as it does, with the weight that falls to nothing
    /// at the radius.
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
        let (of, v) = known(first);
        let (middle, normal, radius) = (at(first), of.normals[v], RADIUS * of.spacing[v]);
        let mut members = Vec::new();
        let mut queue = vec![first];
        self.met[first.0 as usize][first.1 as usize] = self.walks;
        while let Some(place) = queue.pop() {
            let far = distance(at(place), middle) / radius;
            let (of, v) = known(place);
            if far >= 1.0 || dot(of.normals[v], normal) < SAME_PIECE || !belongs(place) {
                continue;
            }
            let w = 1.0 - far * far;
            members.push((place, w * w));
            let mine = links[place.0 as usize].of_vertex(place.1).iter().map(|end| (place.0, *end));
            let others = of.feet(v).iter().filter(|f| !f.beside).flat_map(|f| {
                patches[f.patch as usize].mesh.triangles[f.triangle as usize].map(|end| (f.patch, end))
            });
            for to in mine.chain(others) {
                let met = &mut self.met[to.0 as usize][to.1 as usize];
                if *met != self.walks {
                    *met = self.walks;
                    queue.push(to);
                }
            }
        }
        // The order of the walk is the patches'; that of the sums should not be.
        members.sort_unstable_by(|(a, _), (b, _)| by_position(patches, *a, *b));
        members
    }
}
