//! Over-, well- and under-determined parts of a system of equations, by its structure alone.

use super::incidence::Incidence;
use petgraph::algo::tarjan_scc;
use petgraph::graph::{DiGraph, NodeIndex};
use serde::Serialize;

/// Equations with the parameters of the same part.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct EquationBlock {
    /// Indices of equations, ascending.
    pub equations: Vec<usize>,
    /// Indices of parameters, ascending.
    pub parameters: Vec<usize>,
}

/// The coarse and fine decomposition of Dulmage and Mendelsohn.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Decomposition {
    /// Size of a maximum matching: the structural rank.
    pub rank: usize,
    /// Part with more equations than parameters.
    pub over: EquationBlock,
    /// Part with as many equations as parameters.
    pub well: EquationBlock,
    /// Part with fewer equations than parameters.
    pub under: EquationBlock,
    /// Blocks of the well-determined part, in the order in which they can be solved, each for its own
    /// parameters.
    pub blocks: Vec<EquationBlock>,
}

impl Incidence {
    /// The Dulmage–Mendelsohn decomposition.
    ///
    /// The over-determined part is what alternating paths reach from unmatched equations, the
    /// under-determined part what they reach from unmatched parameters. The result does not depend on the
    /// matching. Blocks are the strong components of the rest. Cost: that of the matching.
    ///
    /// # References
    /// Dulmage and Mendelsohn 1958, *Coverings of bipartite graphs*; Pothen and Fan 1990, *Computing the
    /// block triangular form of a sparse matrix*.
    #[must_use]
    pub fn decomposition(&self) -> Decomposition {
        let parameters_of = self.parameters_of_equations();
        let pairs = self.matching();
        let mut equation_of = vec![None; self.parameters.len()];
        let mut parameter_of = vec![None; parameters_of.len()];
        for &(parameter, equation) in &pairs {
            equation_of[parameter] = Some(equation);
            parameter_of[equation] = Some(parameter);
        }
        // The same search serves both sides, so it needs the transposed lists as well.
        let mut users = vec![Vec::new(); self.parameters.len()];
        for (equation, list) in parameters_of.iter().enumerate() {
            list.iter().for_each(|&parameter| users[parameter].push(equation));
        }
        let over = reached(&parameters_of, &parameter_of, &equation_of);
        let under = reached(&users, &equation_of, &parameter_of);
        // No node is reached from both sides: such a path would augment the matching, which is maximum.
        let side = |count: usize, a: &[bool], b: &[bool]| -> [Vec<usize>; 3] {
            let pick = |wanted: (bool, bool)| (0..count).filter(|&i| (a[i], b[i]) == wanted).collect();
            [pick((true, false)), pick((false, false)), pick((false, true))]
        };
        let equations = side(parameters_of.len(), &over.0, &under.1);
        let parameters = side(self.parameters.len(), &over.1, &under.0);
        let [over, well, under] = std::array::from_fn(|i| EquationBlock {
            equations: equations[i].clone(),
            parameters: parameters[i].clone(),
        });
        Decomposition {
            rank: pairs.len(),
            blocks: blocks(&well, &parameters_of, &equation_of, &parameter_of),
            over,
            well,
            under,
        }
    }
}

/// Nodes that alternating paths reach from unmatched nodes of one side: flags of that side and of the other.
fn reached(
    neighbours: &[Vec<usize>],
    partner: &[Option<usize>],
    partner_of_other: &[Option<usize>],
) -> (Vec<bool>, Vec<bool>) {
    let mut seen: Vec<bool> = partner.iter().map(Option::is_none).collect();
    let mut seen_other = vec![false; partner_of_other.len()];
    let mut stack: Vec<usize> = (0..seen.len()).filter(|&node| seen[node]).collect();
    while let Some(node) = stack.pop() {
        for &other in &neighbours[node] {
            if !std::mem::replace(&mut seen_other[other], true)
                && let Some(next) = partner_of_other[other]
                && !std::mem::replace(&mut seen[next], true)
            {
                stack.push(next);
            }
        }
    }
    (seen, seen_other)
}

/// Strong components of the well-determined part, in the order of solving.
fn blocks(
    well: &EquationBlock,
    parameters_of: &[Vec<usize>],
    equation_of: &[Option<usize>],
    parameter_of: &[Option<usize>],
) -> Vec<EquationBlock> {
    let mut graph = DiGraph::<usize, ()>::new();
    let mut node_of = vec![None; parameters_of.len()];
    for &equation in &well.equations {
        node_of[equation] = Some(graph.add_node(equation));
    }
    for &equation in &well.equations {
        for &parameter in &parameters_of[equation] {
            // An equation needs the parameters of others to be solved first: an arc to the equation of each.
            let needed = equation_of[parameter].and_then(|other| node_of[other]);
            if let (Some(from), Some(to)) = (node_of[equation], needed) {
                graph.add_edge(from, to, ());
            }
        }
    }
    // Tarjan's algorithm returns components in reverse topological order: those that others need come first.
    tarjan_scc(&graph)
        .into_iter()
        .map(|component: Vec<NodeIndex>| {
            let mut equations: Vec<usize> = component.into_iter().map(|node| graph[node]).collect();
            equations.sort_unstable();
            let mut parameters: Vec<usize> =
                equations.iter().filter_map(|&equation| parameter_of[equation]).collect();
            parameters.sort_unstable();
            EquationBlock { equations, parameters }
        })
        .collect()
}
