//! Finds the neighbours of crossings along stripes.
//!
//! In: [`Crossings`] and the [`Ridges`] between them. Out: pieces of the net, whose crossings have integer
//! coordinates.
//!
//! Both stripes of each crossing are followed in both directions to the next crossing. A link is accepted if
//! it is mutual and is a side of a closed mesh: two ways around lead to the same fourth crossing. A stripe
//! that jumps to a surface behind closes no mesh.
//!
//! Not guaranteed: the stripe indices of a piece are known only up to a shift and a quarter turn.

use std::collections::{BTreeMap, VecDeque};

use super::crossings::{Crossing, Crossings, apart};
use super::ridges::Ridges;

/// Maximum distance to which a stripe is followed, as a multiple of the median spacing of crossings.
const MAX_FOLLOWED: f64 = 3.5;
/// Distance at which a crossing is reached, as a share of the median spacing, and in pixels.
const ARRIVAL_SPACINGS: f64 = 0.2;
const ARRIVAL_PX: f64 = 2.5;
/// Maximum gap in a stripe, in scales; ridge points are missing near crossings.
const GAP_SCALES: f64 = 4.5;
/// Minimum cosine between successive steps, and between the last step and the stripe of the reached crossing:
/// 37°. Stripes on smooth surfaces turn much less per pixel; a jump to the other stripe turns more.
const MIN_STEP_COSINE: f64 = 0.8;

/// A crossing of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Knot {
    /// Index of the crossing.
    pub crossing: usize,
    /// Its coordinates in the piece.
    pub at: [i32; 2],
    /// Quarter turns from the piece's first axis to the crossing's first stripe.
    pub turn: usize,
}

/// The next crossing in one of four directions, and which of that one's directions goes on.
type Next = [Option<(usize, usize)>; 4];

/// The pieces of the net, each with its crossings in the order of their coordinates, without contradictory
/// crossings.
pub(super) fn pieces(crossings: &Crossings, ridges: &Ridges) -> Vec<Vec<Knot>> {
    let all = &crossings.found;
    let ways: Vec<Next> =
        (0..all.len()).map(|k| [0, 1, 2, 3].map(|way| follow(crossings, ridges, k, way))).collect();
    // Only mutual links: a stripe that was lost may reach a crossing that itself leads elsewhere.
    let both: Vec<Next> = (0..all.len())
        .map(|k| {
            [0, 1, 2, 3].map(|way| {
                let (other, on) = ways[k][way]?;
                let back = ways[other][(on + 2) % 4]?;
                (back == (k, (way + 2) % 4)).then_some((other, on))
            })
        })
        .collect();
    let closed: Vec<Next> = (0..all.len())
        .map(|k| {
            [0, 1, 2, 3]
                .map(|way| both[k][way].filter(|_| closes(&both, k, way, 1) || closes(&both, k, way, 3)))
        })
        .collect();
    // The test starts at one end of a side. If directions are inconsistent, the result may differ from that
    // of the other end.
    let closed: Vec<Next> = (0..all.len())
        .map(|k| {
            [0, 1, 2, 3]
                .map(|way| closed[k][way].filter(|(other, on)| closed[*other][(on + 2) % 4].is_some()))
        })
        .collect();
    let mut seen = vec![false; all.len()];
    let mut found = Vec::new();
    for start in 0..all.len() {
        if !seen[start] && closed[start].iter().any(Option::is_some) {
            found.push(piece(&closed, start, &mut seen));
        }
    }
    found
}

/// The direction of one of the four ways from a crossing: along stripe 0, along stripe 1, and back.
fn way_direction(crossing: &Crossing, way: usize) -> [f64; 2] {
    let d = crossing.direction(way % 2);
    if way < 2 { d } else { d.map(|c| -c) }
}

/// Follows a stripe to the next crossing.
fn follow(crossings: &Crossings, ridges: &Ridges, from: usize, way: usize) -> Option<(usize, usize)> {
    let all = &crossings.found;
    let mut place = all[from].image;
    let mut direction = way_direction(&all[from], way);
    let arrived = (ARRIVAL_SPACINGS * crossings.spacing).max(ARRIVAL_PX);
    // The candidates once per stripe, not once per step of a pixel.
    let near: Vec<usize> = (0..all.len())
        .filter(|&k| k != from && apart(all[k].image, place) <= MAX_FOLLOWED * crossings.spacing + arrived)
        .collect();
    let mut missing = 0.0;
    let mut walked = 0.0;
    while walked <= MAX_FOLLOWED * crossings.spacing && missing <= GAP_SCALES * ridges.scale {
        let next = [place[0] + direction[0], place[1] + direction[1]];
        let reached = (near.iter().copied())
            .filter(|&k| apart(all[k].image, next) <= arrived)
            .min_by(|&a, &b| apart(all[a].image, next).total_cmp(&apart(all[b].image, next)));
        if let Some(to) = reached {
            let along = |way: usize| {
                let d = way_direction(&all[to], way);
                d[0] * direction[0] + d[1] * direction[1]
            };
            let on = (0..4).max_by(|&a, &b| along(a).total_cmp(&along(b)))?;
            return (along(on) >= MIN_STEP_COSINE).then_some((to, on));
        }
        let turned = |d: [f64; 2]| d[0] * direction[0] + d[1] * direction[1];
        // The search radius covers the 1.3 pixels below plus the half pixel between a ridge and its pixel's
        // centre. Points behind the last one are excluded, because the walk would stop there.
        let on_line = (ridges.near(next, 1.6))
            .filter(|r| {
                let ahead = turned([r.place[0] - place[0], r.place[1] - place[1]]);
                turned(r.direction).abs() >= MIN_STEP_COSINE && ahead >= 0.4 && apart(r.place, next) <= 1.3
            })
            .min_by(|a, b| apart(a.place, next).total_cmp(&apart(b.place, next)));
        walked += 1.0;
        match on_line {
            Some(r) => {
                let sign = turned(r.direction).signum();
                place = r.place;
                direction = r.direction.map(|c| sign * c);
                missing = 0.0;
            }
            None => {
                // Straight on through a gap.
                place = next;
                missing += 1.0;
            }
        }
    }
    None
}

/// Whether the mesh on one side (`hand`: 1 or 3 quarter turns) of a link is closed.
fn closes(next: &[Next], from: usize, way: usize, hand: usize) -> bool {
    let round = || {
        let (b, on) = next[from][way]?;
        let (d, _) = next[b][(on + hand) % 4]?;
        let (c, up) = next[from][(way + hand) % 4]?;
        let (other, _) = next[c][(up + 4 - hand) % 4]?;
        Some(d == other && b != c)
    };
    round() == Some(true)
}

fn piece(next: &[Next], start: usize, seen: &mut [bool]) -> Vec<Knot> {
    let mut knots: BTreeMap<usize, Knot> = BTreeMap::new();
    let mut wrong = Vec::new();
    knots.insert(start, Knot { crossing: start, at: [0; 2], turn: 0 });
    let mut queue = VecDeque::from([start]);
    seen[start] = true;
    while let Some(from) = queue.pop_front() {
        let knot = knots[&from];
        for (way, to) in next[from].iter().enumerate() {
            let Some((to, on)) = *to else { continue };
            let absolute = (knot.turn + way) % 4;
            let step = [[1, 0], [0, 1], [-1, 0], [0, -1]][absolute];
            let arrived = Knot {
                crossing: to,
                at: [knot.at[0] + step[0], knot.at[1] + step[1]],
                turn: (absolute + 4 - on) % 4,
            };
            match knots.get(&to) {
                // The other way around leads to different coordinates. Both ends are removed.
                Some(known) if *known != arrived => wrong.extend([from, to]),
                Some(_) => {}
                None => {
                    knots.insert(to, arrived);
                    seen[to] = true;
                    queue.push_back(to);
                }
            }
        }
    }
    // Two crossings with the same coordinates: one of the links was wrong, and nothing shows which. An
    // ordered map keeps the result independent of hashing.
    let mut by_place: BTreeMap<[i32; 2], Vec<Knot>> = BTreeMap::new();
    for knot in knots.into_values().filter(|k| !wrong.contains(&k.crossing)) {
        by_place.entry(knot.at).or_default().push(knot);
    }
    let alone = by_place.into_values().filter(|at| at.len() == 1);
    alone.flatten().collect()
}
