//! Checks of patches before they are merged: orientation, self-intersections and distances.
//!
//! Input: patches as they were read. Output: patches with consistent orientation, and
//! messages about problems.

use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::Result;
use planish_exchange::Unit;
use planish_mesh::{MergePatch, MeshSearch, Overlap, searches_of};
use planish_report::numbers::significant;
use planish_surface::model::SigmaSummary;
use std::cmp::Reverse;

/// Maximum number of vertices per patch that are compared with other patches. Orientation is a majority
/// decision, so a sample is enough.
const MAX_SAMPLES: usize = 2000;

/// Patches with stated σ overlap if their distance is at most this many σ of the difference. A larger value
/// would pair the two sides of a thin plate. Guarded by the test
/// `sides_of_a_thin_plate_keep_their_orientation`.
const MAX_SIGMAS: f64 = 5.0;
/// Lower limit of that distance, as a fraction of two edge lengths: chord errors of coarse meshes may exceed
/// σ.
const CHORD: f64 = 0.15;
/// Overlaps below this fraction of a patch's largest overlap are ignored: at corners and borders, a few
/// vertices of patches that only touch may face any way.
const MIN_OVERLAP_RATIO: f64 = 0.05;

/// Maximum σ estimated from differences, as a fraction of an edge length. Unrelated surfaces have differences
/// that are uniform over the search distance of two edges, whose σ is about one edge.
const MAX_SIGMA_PER_EDGE: f64 = 0.4;

/// Findings about patches that cross themselves; `numbers` are those of their triangles in their files.
pub(super) fn crossings(searches: &[MeshSearch], names: &[String], numbers: &[Vec<u32>]) -> Vec<Finding> {
    let found = searches.iter().map(MeshSearch::self_crossings);
    (found.zip(names).zip(numbers).filter(|((found, _), _)| found.pairs > 0))
        .map(|((found, name), numbers)| {
            let [a, b] = found.first.map(|t| numbers.get(t as usize).copied().unwrap_or(t));
            let DVec3 { x, y, z } = found.place;
            let text = format!(
                "{name} intersects itself: {} of its triangles, the first {a} and {b} (counted from 0) at \
                 ({x:.6}, {y:.6}, {z:.6})",
                match found.pairs {
                    1 => "one pair".to_owned(),
                    pairs => format!("{pairs} pairs"),
                }
            );
            Finding::new(FindingCode::SelfCrossing, text)
        })
        .collect()
}

/// Orients patches consistently: overlapping patches face the same way.
///
/// The largest patch of each connected group keeps its orientation. If the patches are to be aligned
/// (`misaligned`), they may be 2 % of their size apart. Otherwise, patches with stated σ overlap only within
/// a few σ, so that the two sides of a plate keep their orientations. Returns which patches were flipped, and
/// a search structure for each patch in its final orientation.
pub(super) fn orient_patches(
    patches: &mut [MergePatch],
    misaligned: bool,
) -> Result<(Vec<bool>, Vec<MeshSearch>)> {
    let mut searches = searches_of(patches)?;
    let count = patches.len();
    let stated = |patch: &MergePatch| {
        (!patch.sigma.is_empty()).then(|| SigmaSummary::from_values(patch.sigma.clone()).median)
    };
    let sigma: Vec<Option<f64>> = patches.iter().map(stated).collect();
    // Sums of cosines between the normals of nearby points, for each pair of patches: positive if they agree.
    let mut agree = vec![0.0; count * count];
    for i in 0..count {
        let mesh = &patches[i].mesh;
        // Every nth vertex: the sample needs no seed and covers the whole patch.
        let step = (mesh.positions.len() / MAX_SAMPLES).max(1);
        let edges = 2.0 * (mesh.area() / mesh.triangles.len() as f64).sqrt();
        let reach = match mesh.bounding_box() {
            Some(bounds) if misaligned => edges.max(0.02 * bounds.diagonal()),
            _ => edges,
        };
        for p in mesh.positions.iter().step_by(step) {
            let Some(own_foot) = searches[i].closest_within(*p, edges) else {
                continue;
            };
            for j in (0..count).filter(|j| *j != i) {
                let reach = match (misaligned, sigma[i], sigma[j]) {
                    (false, Some(own_sigma), Some(other_sigma)) => {
                        reach.min((MAX_SIGMAS * own_sigma.hypot(other_sigma)).max(CHORD * edges))
                    }
                    _ => reach,
                };
                if let Some(foot) = searches[j].closest_within(*p, reach)
                    // A foot on the boundary means that the other patch ends there: the vertex is beside it,
                    // not above it.
                    && !foot.on_boundary
                {
                    let cosine = own_foot.normal.dot(foot.normal);
                    agree[i * count + j] += cosine;
                    agree[j * count + i] += cosine;
                }
            }
        }
    }
    // Contacts of a few vertices must not outvote a real overlap.
    let strongest: Vec<f64> =
        (agree.chunks(count)).map(|row| row.iter().copied().map(f64::abs).fold(0.0, f64::max)).collect();
    for (at, sum) in agree.iter_mut().enumerate() {
        if sum.abs() < MIN_OVERLAP_RATIO * strongest[at / count].min(strongest[at % count]) {
            *sum = 0.0;
        }
    }
    // Greedy propagation: always orient the patch next whose overlap with oriented patches is clearest, so
    // that a doubtful pair cannot decide about patches behind it.
    let mut turned: Vec<Option<bool>> = vec![None; count];
    while let Some(first) = (0..count)
        .filter(|k| turned[*k].is_none())
        // Of equally large patches the first file counts, so that the choice is defined.
        .max_by_key(|k| (patches[*k].mesh.triangles.len(), Reverse(*k)))
    {
        turned[first] = Some(false);
        loop {
            let mut best: Option<(f64, usize, bool)> = None;
            for k in (0..count).filter(|k| turned[*k].is_none()) {
                let sum: f64 = (0..count)
                    .filter_map(|j| Some(agree[k * count + j] * if turned[j]? { -1.0 } else { 1.0 }))
                    .sum();
                if sum != 0.0 && best.is_none_or(|(largest, ..)| sum.abs() > largest) {
                    best = Some((sum.abs(), k, sum < 0.0));
                }
            }
            let Some((_, k, over)) = best else { break };
            turned[k] = Some(over);
        }
    }
    let turned: Vec<bool> = turned.into_iter().map(|t| t == Some(true)).collect();
    for (k, patch) in patches.iter_mut().enumerate().filter(|(k, _)| turned[*k]) {
        for t in &mut patch.mesh.triangles {
            t.swap(1, 2);
        }
        // The search returns normals, which follow from the order of the corners.
        searches[k] = MeshSearch::try_new(&patch.mesh)?;
    }
    Ok((turned, searches))
}

/// Findings about patches that probably belong to different objects. Only patches without a stated σ are
/// judged.
///
/// Heights between unrelated surfaces are uniform over the search distance of two edges, so their σ is about
/// one edge.
pub(super) fn mismatched_patches(
    patches: &[MergePatch],
    overlap: &Overlap,
    names: &[String],
    unit: Unit,
) -> Vec<Finding> {
    let estimated = patches.iter().zip(&overlap.patches).zip(names);
    estimated
        .filter(|((patch, _), _)| patch.sigma.is_empty())
        .filter_map(|((_, overlap), name)| {
            let sigma = *overlap.sigma.first()?;
            let mut spacing = overlap.spacing.clone();
            let middle = spacing.len() / 2;
            let (_, edge, _) = spacing.select_nth_unstable_by(middle, f64::total_cmp);
            (sigma > MAX_SIGMA_PER_EDGE * *edge).then(|| {
                let text = format!(
                    "{name}: patches near it differ by {} {unit} (σ), while its edges are {} {unit} long: \
                     if they show different objects, use a smaller overlap distance",
                    significant(sigma, 3),
                    significant(*edge, 3)
                );
                Finding::new(FindingCode::PatchesDiffer, text).with_setting(Setting::Epsilon)
            })
        })
        .collect()
}

/// Message about the smallest distance between patches that do not overlap.
pub(super) fn nearest(
    patches: &[MergePatch],
    searches: &[MeshSearch],
    names: &[String],
    unit: Unit,
) -> String {
    let mut best: Option<(f64, usize, usize)> = None;
    for (j, search) in searches.iter().enumerate() {
        for (i, patch) in patches.iter().enumerate().filter(|(i, _)| *i != j) {
            // Only a message depends on this distance, so samples are enough.
            let step = (patch.mesh.positions.len() / MAX_SAMPLES).max(1);
            for p in patch.mesh.positions.iter().step_by(step) {
                if let Some(foot) = search.closest(*p)
                    && best.is_none_or(|(d, ..)| foot.distance < d)
                {
                    best = Some((foot.distance, i, j));
                }
            }
        }
    }
    match best {
        Some((d, i, j)) => {
            let (first, second) = (&names[i], &names[j]);
            // Three decimals show nothing of an object that is a thousandth of a unit large.
            match d {
                0.0 => format!("{first} and {second} touch, but do not overlap"),
                d if d < 1e-3 => format!("{first} and {second} come within {d:.2e} {unit}"),
                d => format!("{first} and {second} come within {d:.3} {unit}"),
            }
        }
        None => "no patch has vertices".to_owned(),
    }
}
