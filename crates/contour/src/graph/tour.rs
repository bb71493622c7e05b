//! Tours that traverse every edge: Euler tours and Chinese postman tours.
//!
//! In: edges with lengths. Out: a closed tour of all of them. Not guaranteed: the shortest tour if more than
//! sixteen vertices have odd degree; the result states this.

use petgraph::algo::dijkstra;
use petgraph::graph::{NodeIndex, UnGraph};
use planish_estimate::{Error, Result};
use serde::Serialize;

/// An undirected edge to be traversed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TourEdge {
    /// Index of one end.
    pub a: usize,
    /// Index of the other end.
    pub b: usize,
    /// Positive length.
    pub length: f64,
}

/// A closed tour that traverses every edge at least once.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tour {
    /// Vertices in order; the first one is also the last.
    pub vertices: Vec<usize>,
    /// Edges in order, one fewer than vertices.
    pub edges: Vec<usize>,
    /// Edges that are traversed again, once per repetition.
    pub repeated: Vec<usize>,
    /// Total length.
    pub length: f64,
    /// True if no shorter tour exists.
    pub is_shortest: bool,
}

/// Maximum number of odd vertices that are paired exactly. Time and memory grow with 2 to this power.
const MAX_EXACT: usize = 16;

/// The Chinese postman tour from a vertex: all edges, with the least repetition.
///
/// Vertices of odd degree are paired and joined by their shortest paths, which makes all degrees even;
/// [`euler_tour`] does the rest. Up to sixteen of them are paired by dynamic programming over subsets, more
/// by exchanges between nearest pairs. Cost: a shortest-path search from each odd vertex, and `2^k k` for `k`
/// of them.
///
/// # Errors
/// `Input` if there is no edge at the start, a length is not positive, or the graph is not connected.
///
/// # Examples
/// ```
/// use planish_contour::graph::{TourEdge, postman_tour};
///
/// let edge = |a, b, length| TourEdge { a, b, length };
/// // A square with one diagonal: its ends are odd_vertices, and repeating it is shorter than two sides.
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
    let odd_vertices: Vec<usize> = (0..count).filter(|&vertex| degree(edges, vertex) % 2 == 1).collect();
    let from: Vec<Vec<f64>> = odd_vertices
        .iter()
        .map(|&vertex| {
            let found = dijkstra(&graph, nodes[vertex], None, |edge| edges[*edge.weight()].length);
            nodes.iter().map(|node| found.get(node).copied().unwrap_or(f64::INFINITY)).collect()
        })
        .collect();
    let distance = |i: usize, j: usize| from[i][odd_vertices[j]];
    let pairs = if odd_vertices.len() <= MAX_EXACT {
        shortest_pairs(odd_vertices.len(), distance)
    } else {
        near_pairs(odd_vertices.len(), distance)
    };
    let mut repeated = Vec::new();
    for (i, j) in pairs {
        repeated.extend(path_back(edges, &from[i], odd_vertices[i], odd_vertices[j])?);
    }
    // With the repeated edges as copies, all degrees are even; their indices are mapped back afterwards.
    let mut all = edges.to_vec();
    all.extend(repeated.iter().map(|&i| edges[i]));
    let mut tour = euler_tour(&all, start)?;
    for edge in &mut tour.edges {
        if let Some(again) = edge.checked_sub(edges.len()) {
            *edge = repeated[again];
        }
    }
    tour.repeated = repeated;
    tour.is_shortest = odd_vertices.len() <= MAX_EXACT;
    Ok(tour)
}

/// An Euler tour from a vertex: every edge exactly once.
///
/// Uses the next-node construction of the paper: walk along unused edges until none is left, and continue
/// from a visited vertex with unused edges. Each vertex keeps a list of notes: the vertex from which it was
/// reached. The tour then follows the notes, last one first.
///
/// As printed (step 2: `Lv(kv) = y`), the note belongs to the vertex that is *left*, and the tour of step 5
/// can omit edges. With notes at the vertex of arrival, the first note of every vertex leads back to the
/// start, and no edge is omitted. The paper selects edges at random; here the first one is selected, so that
/// results are reproducible. Cost: linear.
///
/// # Errors
/// `Input` if a vertex has odd degree, there is no edge at the start, or the graph is not connected.
///
/// # Examples
/// ```
/// use planish_contour::graph::{TourEdge, euler_tour};
///
/// let edge = |a, b| TourEdge { a, b, length: 1.0 };
/// let triangle = [edge(0, 1), edge(1, 2), edge(2, 0)];
/// assert_eq!(euler_tour(&triangle, 0)?.edges.len(), 3);
/// assert!(euler_tour(&triangle[..2], 0).is_err()); // vertices 0 and 2 have odd_vertices degree
/// # Ok::<(), planish_estimate::Error>(())
/// ```
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
    if let Some(odd_vertex) = (0..count).find(|&vertex| degree(edges, vertex) % 2 == 1) {
        return Err(Error::input(format!(
            "vertex {odd_vertex} has odd degree, so no tour traverses every edge exactly once"
        )));
    }
    if at.get(start).is_none_or(Vec::is_empty) {
        return Err(Error::input(format!("the tour starts at vertex {start}, which has no edge")));
    }
    // `next` skips used edges of a vertex for good, which makes the walk linear.
    let mut notes: Vec<Vec<(usize, usize)>> = vec![Vec::new(); count];
    let mut used = vec![false; edges.len()];
    let mut next = vec![0; count];
    let mut reached = vec![start];
    let mut waiting = 0;
    let mut current = start;
    loop {
        while at[current].get(next[current]).is_some_and(|&edge| used[edge]) {
            next[current] += 1;
        }
        match at[current].get(next[current]) {
            Some(&edge) => {
                used[edge] = true;
                let neighbour = edges[edge].a + edges[edge].b - current;
                notes[neighbour].push((current, edge));
                reached.push(neighbour);
                current = neighbour;
            }
            // Stuck at the start of this walk, as all degrees are even: continue from the next visited
            // vertex.
            None if waiting < reached.len() => {
                current = reached[waiting];
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
    let mut current = start;
    while let Some((neighbour, edge)) = notes[current].pop() {
        tour.edges.push(edge);
        tour.vertices.push(neighbour);
        current = neighbour;
    }
    Ok(tour)
}

/// Degree of a vertex; a loop counts twice.
fn degree(edges: &[TourEdge], vertex: usize) -> usize {
    edges.iter().map(|edge| usize::from(edge.a == vertex) + usize::from(edge.b == vertex)).sum()
}

/// The perfect pairing of smallest total distance, by dynamic programming over subsets of paired vertices.
fn shortest_pairs(count: usize, distance: impl Fn(usize, usize) -> f64) -> Vec<(usize, usize)> {
    let full = (1_usize << count) - 1;
    let mut best = vec![f64::INFINITY; full + 1];
    let mut last = vec![(0, 0); full + 1];
    best[0] = 0.0;
    // Subsets in increasing order: a pair only adds bits, so every predecessor is final.
    for set in 0..full {
        if best[set].is_infinite() {
            continue;
        }
        // The first unpaired vertex must be paired with some other one: trying only its partners avoids
        // counting each pairing in every order.
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

/// Greedy pairing of nearest vertices, improved by exchanges between two pairs while they shorten the total.
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
                    // The margin prevents endless exchanges of equal totals that differ by rounding.
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

/// Edges of a shortest path, traced back from its end by the distances from its start.
fn path_back(edges: &[TourEdge], from_start: &[f64], start: usize, end: usize) -> Result<Vec<usize>> {
    let mut path = Vec::new();
    let mut current = end;
    while current != start {
        // Only edges to a vertex nearer to the start: rounding cannot lead into a cycle then.
        let step = edges
            .iter()
            .enumerate()
            .filter(|(_, edge)| (edge.a == current) != (edge.b == current))
            .map(|(i, edge)| (i, edge.a + edge.b - current, edge.length))
            .filter(|&(_, neighbour, _)| from_start[neighbour] < from_start[current])
            .min_by(|a, b| (from_start[a.1] + a.2).total_cmp(&(from_start[b.1] + b.2)));
        let Some((edge, neighbour, _)) = step else {
            return Err(Error::input(format!(
                "no path leads from vertex {start} to vertex {end}: the graph has several parts"
            )));
        };
        path.push(edge);
        current = neighbour;
    }
    Ok(path)
}
