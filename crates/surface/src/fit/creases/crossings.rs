//! Where edges of a mesh cross from one side of a crease to the other.
//!
//! Input: a mesh near the readings, and patches of the readings. Output: the side of each vertex, and for
//! each edge that crosses a crease the point of the crease, from the readings of both sides.
//!
//! Each vertex takes the patch nearest to it, such that neighbours agree where possible. Where the patches at
//! both ends of an edge meet at an angle, both are fitted again to the readings around that point. A crossing
//! is certain if the angle is larger than [`CERTAIN_ANGLE`] by twice its σ, and the readings next to the line
//! are on one of both patches. Others count only in a chain with certain ones.

use super::patch::{FittedPatch, Patch, Weighted, meeting};
use super::sides::{Cloud, Near, Side};
use planish_core::{DVec3, DisjointSets};
use planish_mesh::{Neighbours, TriangleMesh};
use rayon::prelude::*;
use std::collections::HashMap;
use std::num::NonZero;

/// No patch.
pub(super) const NONE: u32 = u32::MAX;
/// Readings of which patches are tried at a vertex, and how far they may be, in spacings.
const TRIED: NonZero<usize> = NonZero::new(24).unwrap();
const MAX_AWAY: f64 = 3.5;
/// What a patch costs at a vertex for each spacing to its reading, and if it has few readings, beside its
/// distance in spacings; the number of readings that are enough.
const AWAY_COST: f64 = 0.08;
const FEW_COST: f64 = 0.6;
const ENOUGH: f64 = 8.0;
/// Angles between the patches of neighbours from which they disagree, and disagree fully.
const JUMP_ANGLES: [f64; 2] = [0.14, 0.45];
/// Cosine of an angle below the first of these. It is found without an arc tangent.
const AGREEING_COSINE: f64 = 0.9904;
/// What full disagreement with a neighbour costs.
const JUMP_COST: f64 = 0.12;
const ROUNDS: usize = 4;
/// Readings to which both patches are fitted at a point of a crease, and number of fits.
const REFITTED: NonZero<usize> = NonZero::new(60).unwrap();
const NARROW: NonZero<usize> = NonZero::new(26).unwrap();
const REFITS: usize = 3;
/// How far the point of a crease may be from the edge that crosses it, in spacings.
const MAX_MOVE: f64 = 2.0;
/// Gate of readings at a crossing, as in the fits of sides, and the largest turn `1 − cos` of their normals.
const GATE_SIGMAS: f64 = 3.5;
const MIN_GATE: f64 = 0.12;
const MAX_TURN: f64 = 0.15;

/// Readings next to the line: closer than this many spacings to the point. At least so many are needed.
const BESIDE: f64 = 1.7;
const MIN_BESIDE: usize = 3;
/// A reading is on a patch within so many σ, or so many spacings.
const ON_SIGMAS: f64 = 3.0;
const ON_SPACINGS: f64 = 0.08;
/// What a certain crossing needs: the smallest angle (18°), the sum of weights of each side, the shares of
/// readings on the patches, their root mean square in σ, and how much of the angle the nearest readings have.
///
/// Of the crossings at edges of machine parts, 78 % to 91 % are certain. Of those on sculptures with details
/// as small as the spacing, 5 % to 18 % are (decision 0120).
const CERTAIN_ANGLE: f64 = 0.31;
const MIN_SUPPORT: f64 = 3.0;
const CERTAIN_BESIDE: f64 = 0.75;
const CERTAIN_SHARE: f64 = 0.78;
const CERTAIN_RMS: f64 = 1.7;
const NARROW_ANGLE_SHARE: f64 = 0.6;
/// What a crossing between certain ones needs; the smallest angle is 11°.
const POSSIBLE_ANGLE: f64 = 0.19;
const POSSIBLE_SIGMA: f64 = 0.5;
const POSSIBLE_SUPPORT: f64 = 1.0;
const POSSIBLE_SHARE: f64 = 0.5;
/// Rounds in which shares of certain crossings spread along chains, and the smallest share there.
const SPREADING_ROUNDS: usize = 32;
const MIN_NEAR_CERTAIN: f64 = 0.25;
/// Certain crossings of a connected set, as a share and in number.
const MIN_CERTAIN_SHARE: f64 = 0.4;
const MIN_CERTAIN: usize = 8;
/// Share of certain crossings in all. Below it, the surface is rough at the scale of the readings.
const MIN_SHARE_OF_ALL: f64 = 0.2;

/// A point of a crease on an edge of the mesh.
#[derive(Debug, Clone)]
pub(super) struct Crossing {
    pub(super) point: DVec3,
    /// The patches of the sides of the first and second end.
    pub(super) patches: [Patch; 2],
    is_certain: bool,
    is_possible: bool,
}

/// Crossings by the ends of their edges, in ascending order.
pub(super) type Crossings = HashMap<[u32; 2], Crossing>;

/// For each vertex of the mesh the reading whose patch it lies on, or [`NONE`].
pub(super) fn sides_of_vertices(cloud: &Cloud, sides: &[Option<Side>], mesh: &TriangleMesh) -> Vec<u32> {
    let normals = mesh.vertex_normals();
    let at = &mesh.positions;
    // Candidates with their costs.
    let tried: Vec<Vec<(u32, f64)>> = (0..at.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|v| {
            let near = cloud.near(at[v], TRIED);
            let spacing = near.spacing();
            let cost = |&i: &u32| {
                let side = sides[i as usize].as_ref()?;
                let away = cloud.points[i as usize].distance(at[v]) / spacing;
                let (off, normal) = side.patch.distance(at[v]);
                let few = (1.0 - side.support / ENOUGH).max(0.0);
                (away < MAX_AWAY && normal.dot(normals[v]) > 0.0)
                    .then_some((i, off.abs() / spacing + AWAY_COST * away + FEW_COST * few))
            };
            near.indices.iter().filter_map(cost).collect()
        })
        .collect();
    let least = |costs: &mut dyn Iterator<Item = (u32, f64)>| {
        costs.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(NONE, |(i, _)| i)
    };
    let mut own: Vec<u32> = tried.iter().map(|all| least(&mut all.iter().copied())).collect();
    let around = Neighbours::from_mesh(mesh);
    let jump = |i: u32, j: u32, middle: DVec3| jump_between(sides, i, j, middle);
    for _ in 0..ROUNDS {
        let disagreement = |v: usize, i: u32| -> f64 {
            // Neighbours occur twice, so each counts half.
            let others = around.of_vertex(v as u32).iter();
            others.map(|&w| 0.5 * jump(i, own[w as usize], 0.5 * (at[v] + at[w as usize]))).sum()
        };
        let next: Vec<u32> = (0..at.len())
            .into_par_iter()
            .with_min_len(64)
            .map(|v| {
                if disagreement(v, own[v]) == 0.0 {
                    return own[v];
                }
                least(&mut tried[v].iter().map(|&(i, cost)| (i, cost + JUMP_COST * disagreement(v, i))))
            })
            .collect();
        if next == own {
            break;
        }
        own = next;
    }
    own
}

/// From zero for patches that agree at a point to one.
fn jump_between(sides: &[Option<Side>], i: u32, j: u32, at: DVec3) -> f64 {
    if i == j || i == NONE || j == NONE {
        return 0.0;
    }
    let (Some(a), Some(b)) = (&sides[i as usize], &sides[j as usize]) else { return 0.0 };
    let [m, n] = [a, b].map(|side| side.patch.distance(at).1);
    if m.dot(n) > AGREEING_COSINE {
        return 0.0;
    }
    let angle = m.cross(n).length().atan2(m.dot(n));
    ((angle - JUMP_ANGLES[0]) / (JUMP_ANGLES[1] - JUMP_ANGLES[0])).clamp(0.0, 1.0)
}

/// The crossings of creases by edges of the mesh.
pub(super) fn crossings(
    cloud: &Cloud,
    sides: &[Option<Side>],
    mesh: &TriangleMesh,
    own: &[u32],
) -> Crossings {
    let mut edges: Vec<[u32; 2]> = mesh
        .triangles
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .filter(|[a, b]| a < b && own[*a as usize] != own[*b as usize])
        .collect();
    edges.sort_unstable();
    let all: Crossings = edges
        .into_par_iter()
        .with_min_len(16)
        .filter_map(|edge| {
            let middle = 0.5 * (mesh.positions[edge[0] as usize] + mesh.positions[edge[1] as usize]);
            let [i, j] = edge.map(|v| own[v as usize]);
            if jump_between(sides, i, j, middle) == 0.0 {
                return None;
            }
            let [a, b] = [i, j].map(|i| sides[i as usize].map(|side| side.patch));
            crossing(cloud, [a?, b?], middle).map(|crossing| (edge, crossing))
        })
        .collect();
    chained(all, mesh)
}

/// Both sides at a point of a crease.
struct TwoSides {
    point: DVec3,
    patches: [Patch; 2],
    /// Sum of the weights of the readings of each side.
    supports: [f64; 2],
    /// Angle between the normals, and its σ.
    angle: f64,
    sigma: f64,
    near: Near,
}

impl TwoSides {
    /// Fits two patches to the `count` nearest readings, each to those of its side, and finds the point where
    /// they meet.
    fn fit(cloud: &Cloud, start: [Patch; 2], middle: DVec3, count: NonZero<usize>) -> Option<Self> {
        let mut patches = start;
        let mut point = meeting(&patches, middle)?;
        let near = cloud.near(middle, count);
        let (spacing, mut supports) = (near.spacing(), [0.0; 2]);
        let mut fitted: Option<[FittedPatch; 2]> = None;
        for _ in 0..REFITS {
            if point.distance(middle) > MAX_MOVE * cloud.spacing.max(spacing) {
                return None;
            }
            let groups = groups(cloud, &patches, &near, point);
            supports = [0, 1].map(|k| groups[k].iter().map(|reading| reading.weight).sum());
            let fit = |k: usize| {
                let normal = patches[k].distance(point).1;
                Patch::fit(point, normal, near.radius, &groups[k], cloud.scales)
            };
            let now = [fit(0)?, fit(1)?];
            patches = [now[0].patch, now[1].patch];
            point = meeting(&patches, point)?;
            fitted = Some(now);
        }
        let [m, n] = patches.map(|patch| patch.distance(point).1);
        let along = m.cross(n).try_normalize()?;
        let [a, b] = fitted?;
        let sigma = a.slope_sigma(point, along.cross(m)).hypot(b.slope_sigma(point, along.cross(n)));
        let angle = m.cross(n).length().atan2(m.dot(n));
        Some(Self { point, patches, supports, angle, sigma, near })
    }
}

/// Readings of both sides with their weights.
fn groups(cloud: &Cloud, patches: &[Patch; 2], near: &Near, point: DVec3) -> [Vec<Weighted>; 2] {
    let gate = (GATE_SIGMAS * cloud.scales.height).max(MIN_GATE * near.spacing());
    let mut groups: [Vec<Weighted>; 2] = [Vec::new(), Vec::new()];
    for &i in &near.indices {
        let (p, n) = (cloud.points[i as usize], cloud.normals[i as usize]);
        let misfits = [0, 1].map(|k| {
            let (off, normal) = patches[k].distance(p);
            (off / gate).powi(2) + ((1.0 - normal.dot(n)) / MAX_TURN).powi(2)
        });
        let nearer = usize::from(misfits[1] < misfits[0]);
        if misfits[nearer] < 1.0 {
            let weight = cloud.window(i, point, near.radius) * (1.0 - misfits[nearer]);
            groups[nearer].push(cloud.weighted(i, weight));
        }
    }
    groups
}

/// How well two sides explain the readings around a point of their crease.
struct Agreement {
    /// Number of readings next to the line, and the share of them on one of both patches.
    beside: usize,
    share_beside: f64,
    /// The share of all readings on one of both patches.
    share: f64,
    /// Root mean square of distances from the nearer patch, in σ. Large ones count as three gates.
    rms: f64,
}

impl Agreement {
    fn new(cloud: &Cloud, sides: &TwoSides) -> Self {
        let TwoSides { point, patches, near, .. } = sides;
        let spacing = near.spacing();
        let on = (ON_SIGMAS * cloud.scales.height).max(ON_SPACINGS * spacing);
        let outward = patches.iter().map(|patch| patch.distance(*point).1).sum::<DVec3>();
        let (mut beside, mut on_beside, mut all, mut on_all) = (0, 0, 0, 0);
        let (mut weights, mut squares) = (0.0, 0.0);
        for &i in &near.indices {
            let (p, own) = (cloud.points[i as usize], cloud.normals[i as usize]);
            if own.dot(outward) < 0.0 {
                continue;
            }
            let [a, b] = patches.map(|patch| patch.distance(p).0.abs());
            let off = a.min(b);
            let is_on = usize::from(off < on);
            all += 1;
            on_all += is_on;
            if p.distance(*point) < BESIDE * spacing {
                beside += 1;
                on_beside += is_on;
            }
            let weight = cloud.window(i, *point, near.radius);
            weights += weight;
            squares += weight * off.min(3.0 * on).powi(2);
        }
        let share = |part: usize, all: usize| part as f64 / all.max(1) as f64;
        let rms = (squares / f64::max(weights, f64::MIN_POSITIVE)).sqrt() / cloud.scales.height;
        Self { beside, share_beside: share(on_beside, beside), share: share(on_all, all), rms }
    }
}

/// The point near `middle` where two patches meet, after both were fitted to the readings of their sides.
fn crossing(cloud: &Cloud, patches: [Patch; 2], middle: DVec3) -> Option<Crossing> {
    let wide = TwoSides::fit(cloud, patches, middle, REFITTED)?;
    let agreement = Agreement::new(cloud, &wide);
    let narrow = TwoSides::fit(cloud, wide.patches, wide.point, NARROW);
    let is_sharp = narrow.as_ref().is_some_and(|narrow| narrow.angle > NARROW_ANGLE_SHARE * wide.angle);
    let least = |sides: &TwoSides| sides.supports[0].min(sides.supports[1]);
    let is_certain = least(&wide) > MIN_SUPPORT
        && agreement.beside >= MIN_BESIDE
        && wide.angle - 2.0 * wide.sigma > CERTAIN_ANGLE
        && agreement.share_beside >= CERTAIN_BESIDE
        && agreement.share >= CERTAIN_SHARE
        && agreement.rms <= CERTAIN_RMS
        && is_sharp;
    let is_possible = least(&wide) > POSSIBLE_SUPPORT
        && wide.sigma < POSSIBLE_SIGMA
        && wide.angle > POSSIBLE_ANGLE
        && agreement.share_beside >= POSSIBLE_SHARE;
    Some(Crossing { point: wide.point, patches: wide.patches, is_certain, is_possible })
}

/// The crossings of chains that have enough certain ones.
///
/// A crossing that is neither certain nor possible stays if it fills a gap between two others.
fn chained(all: Crossings, mesh: &TriangleMesh) -> Crossings {
    let mut keys: Vec<[u32; 2]> = all.keys().copied().collect();
    keys.sort_unstable();
    let number: HashMap<[u32; 2], u32> = keys.iter().copied().zip(0..).collect();
    let crossed = |&[a, b, c]: &[u32; 3]| -> Vec<u32> {
        let edges = [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]);
        edges.iter().filter_map(|edge| number.get(edge).copied()).collect()
    };
    let triangles: Vec<Vec<u32>> = mesh.triangles.iter().map(crossed).filter(|t| t.len() > 1).collect();
    let certain: Vec<f64> = keys.iter().map(|key| f64::from(u8::from(all[key].is_certain))).collect();
    if certain.iter().sum::<f64>() < MIN_SHARE_OF_ALL * certain.len() as f64 {
        return Crossings::new();
    }
    let near_certain = spread(certain, &triangles);
    let counts = |k: u32| {
        let crossing = &all[&keys[k as usize]];
        near_certain[k as usize] >= MIN_NEAR_CERTAIN && (crossing.is_certain || crossing.is_possible)
    };
    // Number of triangles beside each crossing in which another one counts.
    let mut beside = vec![0; keys.len()];
    for triangle in &triangles {
        for &k in triangle {
            beside[k as usize] += usize::from(triangle.iter().any(|&other| other != k && counts(other)));
        }
    }
    let stays: Vec<bool> = (0..keys.len()).map(|k| counts(k as u32) || beside[k] == 2).collect();
    let mut sets = DisjointSets::new(keys.len());
    for triangle in &triangles {
        let staying: Vec<u32> = triangle.iter().copied().filter(|&k| stays[k as usize]).collect();
        staying.windows(2).for_each(|pair| {
            sets.join(pair[0], pair[1]);
        });
    }
    let roots = sets.into_roots();
    let mut sizes = vec![[0_usize; 2]; keys.len()];
    for (k, key) in keys.iter().enumerate().filter(|(k, _)| stays[*k]) {
        let size = &mut sizes[roots[k] as usize];
        size[0] += 1;
        size[1] += usize::from(all[key].is_certain);
    }
    let mut kept = all;
    for (k, key) in keys.iter().enumerate() {
        let [size, certain] = sizes[roots[k] as usize];
        if !stays[k] || certain < MIN_CERTAIN || (certain as f64) < MIN_CERTAIN_SHARE * size as f64 {
            kept.remove(key);
        }
    }
    kept
}

/// Means of values over crossings near each along chains.
fn spread(mut values: Vec<f64>, triangles: &[Vec<u32>]) -> Vec<f64> {
    for _ in 0..SPREADING_ROUNDS {
        let (mut sums, mut counts) = (values.clone(), vec![1.0; values.len()]);
        for triangle in triangles {
            for (&a, &b) in triangle.iter().flat_map(|a| triangle.iter().map(move |b| (a, b))) {
                if a != b {
                    sums[a as usize] += values[b as usize];
                    counts[a as usize] += 1.0;
                }
            }
        }
        values = sums.iter().zip(&counts).map(|(sum, count)| sum / count).collect();
    }
    values
}
