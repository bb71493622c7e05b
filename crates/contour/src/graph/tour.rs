//! Tours that traverse every edge: Euler's, and the postman's.
//!
//! Comes in: edges with lengths. Goes out: a closed route through all of them. Not guaranteed: the shortest
//! one where more than sixteen vertices have odd degree; the result says so.

use petgraph::algo::dijkstra;
use petgraph::graph::{NodeIndex, UnGraph};
use planish_estimate::{Error, Result};
use serde::Serialize;

/// An edge to be traversed, either way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TourEdge {
    /// One end.
    pub a: usize,
    /// The other.
    pub b: usize,
    /// Its length, positive.
    pub length: f64,
}

/// A closed route that traverses every edge at least once.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tour {
    /// The vertices in order; the first is the last too.
    pub vertices: Vec<usize>,
    /// The edges in order, one fewer.
    pub edges: Vec<usize>,
    /// Edges that are traversed again, once for each time.
    pub repeated: Vec<usize>,
    /// The length of the whole route.
    pub length: f64,
    /// Whether no shorter route exists.
    pub is_shortest: bool,
}

/// The most odd vertices that are paired exactly; 2¹⁶ subsets take a few milliseconds.
const EXACT: usize = 16;

/// The Chinese postman's tour from a vertex: all edges, and as little again as possible.
///
/// Vertices of odd degree are joined in pairs by their shortest paths, by dynamic programming over subsets up
/// to sixteen of them and by exchanges between nearest pairs beyond; then [`euler_tour`]. Cost: a search from
/// each odd vertex, and `2^k k` for `k` of them.
///
/// # Errors
/// `Input` when there is no edge at the start, an edge is not of positive length, or the edges do not hang
/// together.
///
/// # Examples
/// ```
/// use planish_contour::graph::{TourEdge, postman_tour};
///
/// let edge = |a, b, length| TourEdge { a, b, length };
/// // A square with one diagonal: its two ends are odd, and going along it again is shorter than along two
/// // sides.
/// let edges = [edge(0, 1, 1.0), edge(1, 2, 1.0), edge(2, 3, 1.0), edge(3, 0, 1.0), edge(0, 2, 1.4)];
/// let tour = postman_tour(&edges, 0)?;
/// assert_eq!(tour.repeated, [4]);
/// assert!(tour.is_shortest && (tour.length - 6.8).abs() < 1e-12);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Kwan 1962, *Graphic programming using odd or even points*; Edmonds and Johnson 1973, *Matching, Euler
/// tours and the Chinese postman*.
pub fn postman_tour(edges: &[TourEdge], start: usize) -> Result<Tour> {
    let mut graph = UnGraph::<(), usize>::default();
    let count = edges.iter().map(|edge| edge.a.max(edge.b) + 1).max().unwrap_or(0);
    let nodes: Vec<NodeIndex> = (0..count).map(|_| graph.add_node(())).collect();
    for (i, edge) in edges.iter().enumerate() {
        if !(edge.length > 0.0 && edge.length.is_finite()) {
            return Err(Error::input(format!(
                "edge {i}, from {} to {}, has length {}: a tour needs positive lengths",
                edge.a, edge.b, edge.length
            )));
        }
        graph.add_edge(nodes[edge.a], nodes[edge.b], i);
    }
    let odd: Vec<usize> = (0..count).filter(|&vertex| degree(edges, vertex) % 2 == 1).collect();
    let from: Vec<Vec<f64>> = odd
        .iter()
        .map(|&vertex| {
            let found = dijkstra(&graph, nodes[vertex], None, |edge| edges[*edge.weight()].length);
            nodes.iter().map(|node| found.get(node).copied().unwrap_or(f64::INFINITY)).collect()
        })
        .collect();
    let distance = |i: usize, j: usize| from[i][odd[j]];
    let pairs = if odd.len() <= EXACT {
        shortest_pairs(odd.len(), distance)
    } else {
        near_pairs(odd.len(), distance)
    };
    let mut repeated = Vec::new();
    for (i, j) in pairs {
        repeated.extend(path_back(edges, &from[i], odd[i], odd[j])?);
    }
    let mut all = edges.to_vec();
    all.extend(repeated.iter().map(|&i| edges[i]));
    let mut tour = euler_tour(&all, start)?;
    for edge in &mut tour.edges {
        if let Some(again) = edge.checked_sub(edges.len()) {
            *edge = repeated[again];
        }
    }
    tour.repeated = repeated;
    tour.is_shortest = odd.len() <= EXACT;
    Ok(tour)
}

/// An Euler tour: every edge exactly once, from a vertex and back.
///
/// The paper's next-node construction: walk along unused edges until stuck, start again from a vertex on the
/// way with edges left, and note at each vertex reached from where it was; then follow the notes, last first.
/// As printed (step 2: `Lv(kv) = y`) the note is made at the vertex that is *left*; the tour in step 5 can
/// then end with edges left over. Noted where it arrives, the first note of every vertex leads back to the
/// start, and none is. Where the paper picks edges at random, the first is taken. Cost: linear.
///
/// # Errors
/// `Input` when a vertex has odd degree, there is no edge at the start, or the edges do not hang together.
///
/// # References
/// Edmonds and Johnson 1973, *Matching, Euler tours and the Chinese postman*, section 5; Weiss-Cohen,
/// Bondarenko and Halevi 2009, section 5.
pub fn euler_tour(edges: &[TourEdge], start: usize) -> Result<Tour> {
    let count = edges.iter().map(|edge| edge.a.max(edge.b) + 1).max().unwrap_or(0);
    let mut at = vec![Vec::new(); count];
    for (i, edge) in edges.iter().enumerate() {
        at[edge.a].push(i);
        at[edge.b].push(i);
    }
    if let Some(odd) = (0..count).find(|&vertex| degree(edges, vertex) % 2 == 1) {
        return Err(Error::input(format!(
            "vertex {odd} has odd degree: no tour traverses every edge once, a postman's may"
        )));
    }
    if at.get(start).is_none_or(Vec::is_empty) {
        return Err(Error::input(format!("no edge leads to vertex {start}, where the tour starts")));
    }
    let mut notes: Vec<Vec<(usize, usize)>> = vec![Vec::new(); count];
    let mut used = vec![false; edges.len()];
    let mut next = vec![0; count];
    let mut reached = vec![start];
    let mut waiting = 0;
    let mut here = start;
    loop {
        while at[here].get(next[here]).is_some_and(|&edge| used[edge]) {
            next[here] += 1;
        }
        match at[here].get(next[here]) {
            Some(&edge) => {
                used[edge] = true;
                let there = edges[edge].a + edges[edge].b - here;
                notes[there].push((here, edge));
                reached.push(there);
                here = there;
            }
            None if waiting < reached.len() => {
                here = reached[waiting];
                waiting += 1;
            }
            None => break,
        }
    }
    if let Some(left) = used.iter().position(|used| !used) {
        return Err(Error::input(format!(
            "edge {left}, from {} to {}, cannot be reached from vertex {start}: the graph has several parts",
            edges[left].a, edges[left].b
        )));
    }
    let mut tour = Tour {
        vertices: vec![start],
        edges: Vec::with_capacity(edges.len()),
        repeated: Vec::new(),
        length: edges.iter().map(|edge| edge.length).sum(),
        is_shortest: true,
    };
    let mut here = start;
    while let Some((there, edge)) = notes[here].pop() {
        tour.edges.push(edge);
        tour.vertices.push(there);
        here = there;
    }
    Ok(tour)
}

fn degree(edges: &[TourEdge], vertex: usize) -> usize {
    edges.iter().map(|edge| usize::from(edge.a == vertex) + usize::from(edge.b == vertex)).sum()
}

/// The perfect pairing of least total distance, by dynamic programming over the subsets that are paired.
fn shortest_pairs(count: usize, distance: impl Fn(usize, usize) -> f64) -> Vec<(usize, usize)> {
    let full = (1_usize << count) - 1;
    let mut best = vec![f64::INFINITY; full + 1];
    let mut last = vec![(0, 0); full + 1];
    best[0] = 0.0;
    for set in 0..full {
        if best[set].is_infinite() {
            continue;
        }
        // The first one that is left must be paired with some other.
        let i = (!set).trailing_zeros() as usize;
        for j in i + 1..count {
            let grown = set | 1 << i | 1 << j;
            let total = best[set] + distance(i, j);
            if set & (1 << j) == 0 && total < best[grown] {
                (best[grown], last[grown]) = (total, (i, j));
            }
        }
    }
    let mut pairs = Vec::new();
    let mut set = full;
    while set != 0 && best[full].is_finite() {
        let (i, j) = last[set];
        pairs.push((i, j));
        set &= !(1 << i | 1 << j);
    }
    pairs
}

/// Nearest pairs first, then exchanges between two pairs as long as one shortens the total.
fn near_pairs(count: usize, distance: impl Fn(usize, usize) -> f64) -> Vec<(usize, usize)> {
    let mut all: Vec<(usize, usize)> = (0..count).flat_map(|i| (i + 1..count).map(move |j| (i, j))).collect();
    all.sort_by(|&(a, b), &(c, d)| distance(a, b).total_cmp(&distance(c, d)));
    let mut free = vec![true; count];
    let mut pairs: Vec<(usize, usize)> = Vec::new();
    for (i, j) in all {
        if free[i] && free[j] {
            (free[i], free[j]) = (false, false);
            pairs.push((i, j));
        }
    }
    let mut changed = true;
    while changed {
        changed = false;
        for k in 0..pairs.len() {
            for l in k + 1..pairs.len() {
                let ((a, b), (c, d)) = (pairs[k], pairs[l]);
                let now = distance(a, b) + distance(c, d);
                for (first, second) in [((a, c), (b, d)), ((a, d), (b, c))] {
                    let then = distance(first.0, first.1) + distance(second.0, second.1);
                    if then < now * (1.0 - 1e-12) && !changed {
                        (pairs[k], pairs[l]) = (first, second);
                        changed = true;
                    }
                }
            }
        }
    }
    pairs
}

/// The edges of a shortest path, walked back from its end along the distances from its start.
fn path_back(edges: &[TourEdge], from_start: &[f64], start: usize, end: usize) -> Result<Vec<usize>> {
    let mut path = Vec::new();
    let mut here = end;
    while here != start {
        let step = edges
            .iter()
            .enumerate()
            .filter(|(_, edge)| (edge.a == here) != (edge.b == here))
            .map(|(i, edge)| (i, edge.a + edge.b - here, edge.length))
            .filter(|&(_, there, _)| from_start[there] < from_start[here])
            .min_by(|a, b| (from_start[a.1] + a.2).total_cmp(&(from_start[b.1] + b.2)));
        let Some((edge, there, _)) = step else {
            return Err(Error::input(format!(
                "no way leads from vertex {start} to vertex {end}: the graph has several parts"
            )));
        };
        path.push(edge);
        here = there;
    }
    Ok(path)
}
