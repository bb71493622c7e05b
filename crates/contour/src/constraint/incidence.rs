//! Incidence of equations and parameters, and maximum matchings between them.

use super::{Constraint, ConstraintEquations, ParametricDrawing};
use serde::Serialize;
use std::collections::VecDeque;

/// An entry of the incidence matrix: an equation depends on a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Entry {
    /// Index of the equation.
    pub equation: usize,
    /// Index of the parameter.
    pub parameter: usize,
    /// True if the derivative is zero at the drawing.
    pub vanishes: bool,
}

/// The bipartite graph of equations and parameters.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Incidence {
    /// Names of the parameters.
    pub parameters: Vec<String>,
    /// For each equation, the index of its constraint. Equation `k` is called `f(k+1)`.
    pub owners: Vec<usize>,
    /// Edges of the graph, ordered by equation.
    pub entries: Vec<Entry>,
}

/// A derivative below this fraction of the largest one of its equation counts as zero.
const VANISHING_SLOPE: f64 = 1e-9;

impl Incidence {
    /// Incidence of constraints. Whether an entry vanishes is judged at the drawing.
    #[must_use]
    pub fn new(drawing: &ParametricDrawing, constraints: &[Constraint]) -> Self {
        let equations = ConstraintEquations::new(drawing, constraints);
        let mut entries = Vec::new();
        for (equation, at) in equations.at(drawing.values().as_slice()).iter().enumerate() {
            // Relative to the equation, because slopes of lengths and of angles have different units.
            let largest = at.gradient.iter().map(|(_, slope)| slope.abs()).fold(0.0, f64::max);
            entries.extend(at.gradient.iter().map(|&(parameter, slope)| Entry {
                equation,
                parameter,
                vanishes: slope.abs() <= VANISHING_SLOPE * largest,
            }));
        }
        Self {
            parameters: (0..drawing.parameters())
                .map(|parameter| drawing.parameter_name(parameter).to_owned())
                .collect(),
            owners: equations.owners(),
            entries,
        }
    }

    /// Number of equations.
    #[must_use]
    pub fn equations(&self) -> usize {
        self.owners.len()
    }

    /// Indices of the parameters of each equation.
    #[must_use]
    pub fn parameters_of_equations(&self) -> Vec<Vec<usize>> {
        self.select(|_| true)
    }

    /// A maximum matching as pairs `(parameter, equation)` in ascending order, preferring entries that do not
    /// vanish.
    ///
    /// Entries that do not vanish are matched first; the others are added only to match more. Such a matching
    /// has a non-zero term of the determinant if one exists. Cost: `entries · √(equations + parameters)`.
    ///
    /// # References
    /// Hopcroft and Karp 1973, *An n^{5/2} algorithm for maximum matchings in bipartite graphs*.
    #[must_use]
    pub fn matching(&self) -> Vec<(usize, usize)> {
        let mut matched = vec![None; self.equations()];
        let count = self.parameters.len();
        // An augmenting path keeps every matched node matched, so matched nodes stay matched, although the
        // second phase may change their partners.
        augment(&self.select(|entry| !entry.vanishes), count, &mut matched);
        augment(&self.parameters_of_equations(), count, &mut matched);
        let mut pairs: Vec<(usize, usize)> = matched
            .iter()
            .enumerate()
            .filter_map(|(equation, parameter)| Some(((*parameter)?, equation)))
            .collect();
        pairs.sort_unstable();
        pairs
    }

    /// True if pairs `(parameter, equation)` are a matching: entries of the graph, with no parameter or
    /// equation twice.
    #[must_use]
    pub fn is_matching(&self, pairs: &[(usize, usize)]) -> bool {
        let parameters_of = self.parameters_of_equations();
        // Both sides need a check: a list of pairs can repeat either.
        let mut seen = (vec![false; self.parameters.len()], vec![false; parameters_of.len()]);
        pairs.iter().all(|&(parameter, equation)| {
            let is_entry = parameters_of.get(equation).is_some_and(|list| list.contains(&parameter));
            is_entry
                && !std::mem::replace(&mut seen.0[parameter], true)
                && !std::mem::replace(&mut seen.1[equation], true)
        })
    }

    /// The pairs whose derivative is zero at the drawing.
    #[must_use]
    pub fn vanishing(&self, pairs: &[(usize, usize)]) -> Vec<(usize, usize)> {
        let vanishes = |&(parameter, equation): &(usize, usize)| {
            self.entries
                .iter()
                .any(|entry| entry.vanishes && (entry.parameter, entry.equation) == (parameter, equation))
        };
        pairs.iter().filter(|pair| vanishes(pair)).copied().collect()
    }

    /// Parameters of each equation, from the wanted entries.
    fn select(&self, wanted: impl Fn(&Entry) -> bool) -> Vec<Vec<usize>> {
        let mut parameters_of = vec![Vec::new(); self.equations()];
        for entry in self.entries.iter().filter(|entry| wanted(entry)) {
            parameters_of[entry.equation].push(entry.parameter);
        }
        parameters_of
    }
}

/// Extends a matching to a maximum one by phases of shortest augmenting paths (Hopcroft and Karp).
///
/// `matched` holds the partner of each left node.
fn augment(neighbours: &[Vec<usize>], right: usize, matched: &mut [Option<usize>]) {
    // Start from the given matching instead of an empty one: it is kept as far as possible.
    let mut partner = vec![None; right];
    for (left, found) in matched.iter().enumerate() {
        if let Some(found) = found {
            partner[*found] = Some(left);
        }
    }
    while let Some(layers) = layers(neighbours, matched, &partner) {
        let mut next = vec![0; neighbours.len()];
        for root in 0..neighbours.len() {
            if matched[root].is_none() {
                extend(root, neighbours, &layers, &mut next, matched, &mut partner);
            }
        }
    }
}

/// Distances from free left nodes along alternating paths; `None` if no path ends at a free right node.
fn layers(
    neighbours: &[Vec<usize>],
    matched: &[Option<usize>],
    partner: &[Option<usize>],
) -> Option<Vec<usize>> {
    let mut layers: Vec<usize> =
        matched.iter().map(|found| if found.is_none() { 0 } else { usize::MAX }).collect();
    let mut queue: VecDeque<usize> = (0..matched.len()).filter(|&left| matched[left].is_none()).collect();
    // The search does not stop at the first free right node: the whole layer is needed for disjoint paths.
    let mut ends = false;
    while let Some(left) = queue.pop_front() {
        for &right in &neighbours[left] {
            match partner[right] {
                None => ends = true,
                Some(next) if layers[next] == usize::MAX => {
                    layers[next] = layers[left] + 1;
                    queue.push_back(next);
                }
                Some(_) => {}
            }
        }
    }
    ends.then_some(layers)
}

/// Applies one augmenting path along the layers from a free left node.
///
/// It is iterative, because recursion could overflow the stack: a path may contain every node. `next`
/// remembers the edges tried in this phase, which bounds its cost by the number of edges.
fn extend(
    root: usize,
    neighbours: &[Vec<usize>],
    layers: &[usize],
    next: &mut [usize],
    matched: &mut [Option<usize>],
    partner: &mut [Option<usize>],
) {
    let mut path: Vec<(usize, usize)> = Vec::new();
    let mut left = root;
    loop {
        let Some(&right) = neighbours[left].get(next[left]) else {
            match path.pop() {
                Some((back, _)) => left = back,
                None => return,
            }
            continue;
        };
        // The edge is used up for this phase, whether it leads on or not.
        next[left] += 1;
        match partner[right] {
            None => {
                path.push((left, right));
                for &(left, right) in &path {
                    matched[left] = Some(right);
                    partner[right] = Some(left);
                }
                return;
            }
            // Only along the layers: this makes all paths of a phase shortest ones.
            Some(deeper) if layers[deeper] == layers[left] + 1 => {
                path.push((left, right));
                left = deeper;
            }
            Some(_) => {}
        }
    }
}
