//! Which equation depends on which parameter, and maximum matchings of the two.

use super::{Constraint, ConstraintEquations, ParametricDrawing};
use serde::Serialize;
use std::collections::VecDeque;

/// That an equation depends on a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Entry {
    /// The equation, by its index.
    pub equation: usize,
    /// The parameter, by its index.
    pub parameter: usize,
    /// Whether the derivative is zero where the drawing is.
    pub vanishes: bool,
}

/// The bipartite graph of equations and parameters.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Incidence {
    /// Names of the parameters.
    pub parameters: Vec<String>,
    /// Which constraint each equation belongs to; equation `k` is called `f(k+1)`.
    pub owners: Vec<usize>,
    /// The edges, by equation.
    pub entries: Vec<Entry>,
}

/// A derivative of less than this share of the largest of its equation vanishes.
const VANISHES: f64 = 1e-9;

impl Incidence {
    /// The incidence of constraints; whether an entry vanishes is judged where the drawing is.
    #[must_use]
    pub fn new(drawing: &ParametricDrawing, constraints: &[Constraint]) -> Self {
        let equations = ConstraintEquations::new(drawing, constraints);
        let mut entries = Vec::new();
        for (equation, at) in equations.at(drawing.values().as_slice()).iter().enumerate() {
            let largest = at.gradient.iter().map(|(_, slope)| slope.abs()).fold(0.0, f64::max);
            entries.extend(at.gradient.iter().map(|&(parameter, slope)| Entry {
                equation,
                parameter,
                vanishes: slope.abs() <= VANISHES * largest,
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

    /// How many equations there are.
    #[must_use]
    pub fn equations(&self) -> usize {
        self.owners.len()
    }

    /// The parameters of every equation.
    #[must_use]
    pub fn parameters_of_equations(&self) -> Vec<Vec<usize>> {
        self.select(|_| true)
    }

    /// A maximum matching, `(parameter, equation)` in ascending order, of entries that do not vanish where
    /// those suffice.
    ///
    /// First the entries that do not vanish are matched; others are let in only to match more. Cost:
    /// `entries · √(equations + parameters)`.
    ///
    /// # References
    /// Hopcroft and Karp 1973, *An n^{5/2} algorithm for maximum matchings in bipartite graphs*.
    #[must_use]
    pub fn matching(&self) -> Vec<(usize, usize)> {
        let mut matched = vec![None; self.equations()];
        let count = self.parameters.len();
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

    /// Whether pairs `(parameter, equation)` are a matching: entries of the graph, and no parameter or
    /// equation twice.
    #[must_use]
    pub fn is_matching(&self, pairs: &[(usize, usize)]) -> bool {
        let of = self.parameters_of_equations();
        let mut seen = (vec![false; self.parameters.len()], vec![false; of.len()]);
        pairs.iter().all(|&(parameter, equation)| {
            let is_entry = of.get(equation).is_some_and(|list| list.contains(&parameter));
            is_entry
                && !std::mem::replace(&mut seen.0[parameter], true)
                && !std::mem::replace(&mut seen.1[equation], true)
        })
    }

    /// The pairs whose derivative is zero where the drawing is.
    #[must_use]
    pub fn vanishing(&self, pairs: &[(usize, usize)]) -> Vec<(usize, usize)> {
        let vanishes = |&(parameter, equation): &(usize, usize)| {
            self.entries
                .iter()
                .any(|entry| entry.vanishes && (entry.parameter, entry.equation) == (parameter, equation))
        };
        pairs.iter().filter(|pair| vanishes(pair)).copied().collect()
    }

    fn select(&self, wanted: impl Fn(&Entry) -> bool) -> Vec<Vec<usize>> {
        let mut of = vec![Vec::new(); self.equations()];
        for entry in self.entries.iter().filter(|entry| wanted(entry)) {
            of[entry.equation].push(entry.parameter);
        }
        of
    }
}

/// Makes a matching maximum: phases of shortest augmenting paths. `matched` holds each left node's partner.
fn augment(neighbours: &[Vec<usize>], right: usize, matched: &mut [Option<usize>]) {
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

/// Distances from free left nodes along alternating paths; `None` when no path ends at a free right node.
fn layers(
    neighbours: &[Vec<usize>],
    matched: &[Option<usize>],
    partner: &[Option<usize>],
) -> Option<Vec<usize>> {
    let mut layers: Vec<usize> =
        matched.iter().map(|found| if found.is_none() { 0 } else { usize::MAX }).collect();
    let mut queue: VecDeque<usize> = (0..matched.len()).filter(|&left| matched[left].is_none()).collect();
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

/// One augmenting path along the layers from a free left node, without recursion.
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
            Some(deeper) if layers[deeper] == layers[left] + 1 => {
                path.push((left, right));
                left = deeper;
            }
            Some(_) => {}
        }
    }
}
