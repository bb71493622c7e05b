//! Search for the solid cells that satisfy all sight tests.
//!
//! Each sight test becomes clauses of a satisfiability problem, guarded by a switch literal. The solver then
//! enumerates assignments of cells. If there is none, switches are turned off until there is one, those with
//! the fewest positions first. The lines of these tests are reported as unexplained.

use super::cells::Cells;
use super::preference::Preference;
use super::sight::{EdgeSectors, Expected, SightTest, SightTestPlace, SightTests};
use crate::drawing::LineStyle;
use batsat::{BasicSolver, Lit, SolverInterface, Var, lbool};
use std::collections::{BTreeMap, HashMap, HashSet};

/// State of each cell: true if solid.
pub(crate) type Assignment = BTreeMap<u32, bool>;

/// Result of the search.
pub(crate) struct SearchResult {
    /// True if all assignments were enumerated.
    pub(crate) complete: bool,
    /// Positions that no solid explains.
    pub(crate) unexplained: Vec<(Expected, SightTestPlace)>,
}

/// Kinds of edges that a drawn line may represent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum SmoothEdges {
    /// Drawn lines are edges at which faces meet at an angle, and outlines.
    NotDrawn,
    /// Drawn lines may be tangent edges as well; these need not be drawn.
    MayBeDrawn,
}

/// Translates sight tests into clauses.
struct Encoder {
    solver: BasicSolver,
    /// The cell around the part, which is empty.
    outside: u32,
    cells: BTreeMap<u32, Var>,
    /// Literals that are true if sectors form an edge. Many tests share sectors, and each set is encoded
    /// once.
    events: HashMap<(EdgeSectors, SmoothEdges), Lit>,
    /// A literal that is always true.
    truth: Lit,
    smooth_edges: SmoothEdges,
}

impl Encoder {
    fn new(outside: u32, smooth_edges: SmoothEdges) -> Self {
        let mut solver = BasicSolver::default();
        let truth = Lit::new(solver.new_var_default(), true);
        solver.add_clause_reuse(&mut vec![truth]);
        Self { solver, outside, cells: BTreeMap::new(), events: HashMap::new(), truth, smooth_edges }
    }

    fn fresh(&mut self) -> Lit {
        Lit::new(self.solver.new_var_default(), true)
    }

    /// The literal that a cell is solid.
    fn solid(&mut self, cell: u32) -> Lit {
        if cell == self.outside {
            return !self.truth;
        }
        let solver = &mut self.solver;
        // The initial phase makes the solver try cells as empty first, which prefers small solids.
        Lit::new(*self.cells.entry(cell).or_insert_with(|| solver.new_var(lbool::TRUE, true)), true)
    }

    fn clause(&mut self, mut literals: Vec<Lit>) {
        self.solver.add_clause_reuse(&mut literals);
    }

    /// Literal that is true if the sectors form an edge, optionally a tangent one.
    fn event(&mut self, group: &EdgeSectors, smooth_edges: SmoothEdges) -> Lit {
        // Without tangent pairs, both readings of the drawing give the same clauses, and one literal serves
        // both.
        let smooth_edges = match group.tangent.is_empty() {
            true => SmoothEdges::NotDrawn,
            false => smooth_edges,
        };
        let key = (group.clone(), smooth_edges);
        if let Some(event) = self.events.get(&key) {
            return *event;
        }
        // One clause for each state of the distinct cells: a truth table. Sectors around a line are few, so
        // the table is small. States that drawing conventions treat differently get no clause, so the event
        // is free there.
        let event = self.fresh();
        // Several sectors may belong to one cell, which has one state.
        let mut distinct: Vec<u32> = group.sectors.clone();
        distinct.sort_unstable();
        distinct.dedup();
        distinct.retain(|c| *c != self.outside);
        let literals: Vec<Lit> = distinct.iter().map(|c| self.solid(*c)).collect();
        for states in 0..1_u32 << distinct.len().min(12) {
            let state =
                |cell: u32| distinct.iter().position(|c| *c == cell).is_some_and(|k| states >> k & 1 == 1);
            let mut clause: Vec<Lit> = (0..distinct.len())
                .map(|k| if states >> k & 1 == 1 { !literals[k] } else { literals[k] })
                .collect();
            match edge(group, smooth_edges, state) {
                Some(true) => clause.push(event),
                Some(false) => clause.push(!event),
                None => continue,
            }
            self.clause(clause);
        }
        self.events.insert(key, event);
        event
    }

    /// Adds the clauses of a sight test, which hold while its switch is on.
    fn add(&mut self, sight_test: &SightTest, switch: Lit) {
        if let Expected::Material(is_solid) = sight_test.expected {
            let solid = self.solid(sight_test.start[0]);
            self.clause(vec![!switch, if is_solid { solid } else { !solid }]);
            return;
        }
        // Only sharp edges are forbidden where nothing is drawn; a drawn line may be a tangent edge.
        let (forbidden, drawn) = (SmoothEdges::NotDrawn, self.smooth_edges);
        let seen_as = match sight_test.expected {
            Expected::Line(LineStyle::Visible) => drawn,
            _ => forbidden,
        };
        let events: Vec<Lit> = sight_test.groups.iter().map(|g| self.event(g, seen_as)).collect();
        // Where nothing is drawn, neither a visible nor a hidden edge may be: no occlusion is needed.
        if sight_test.expected == Expected::NoEdge {
            for event in events {
                self.clause(vec![!switch, !event]);
            }
            return;
        }
        // `visible[k]` holds if group k is an edge and all cells before it on both rays are empty. `clear`
        // accumulates the latter from the eye inwards, so each group adds one literal instead of a clause
        // over all cells before it.
        let mut visible = Vec::new();
        let mut clear = self.truth;
        let mut passed: Vec<u32> = sight_test.start.to_vec();
        for (group, event) in sight_test.groups.iter().zip(&events) {
            clear = self.clear(clear, &mut passed);
            let seen = self.fresh();
            // seen ⇔ clear ∧ event.
            self.clause(vec![!seen, clear]);
            self.clause(vec![!seen, *event]);
            self.clause(vec![seen, !clear, !*event]);
            visible.push(seen);
            passed.extend(&group.sectors);
        }
        match sight_test.expected {
            Expected::Line(LineStyle::Visible) => {
                visible.push(!switch);
                self.clause(visible);
            }
            // A hidden line must not be visible anywhere along the ray, and it needs an edge. Only this edge
            // may be a tangent one: `visible` was built from sharp edges.
            expected => {
                for seen in visible {
                    self.clause(vec![!switch, !seen]);
                }
                if expected != Expected::Line(LineStyle::Hidden) {
                    return;
                }
                let mut any: Vec<Lit> = sight_test.groups.iter().map(|g| self.event(g, drawn)).collect();
                any.push(!switch);
                self.clause(any);
            }
        }
    }

    /// The literal that all cells passed so far are empty.
    fn clear(&mut self, so_far: Lit, passed: &mut Vec<u32>) -> Lit {
        passed.sort_unstable();
        passed.dedup();
        let mut all: Vec<Lit> = std::mem::take(passed).into_iter().map(|c| !self.solid(c)).collect();
        all.push(so_far);
        all.retain(|l| *l != self.truth);
        match all.len() {
            0 => self.truth,
            1 => all[0],
            _ => {
                let clear = self.fresh();
                for literal in &all {
                    self.clause(vec![!clear, *literal]);
                }
                let mut back: Vec<Lit> = all.into_iter().map(|l| !l).collect();
                back.push(clear);
                self.clause(back);
                clear
            }
        }
    }

    /// The literal under which cells that a preference pairs have one state.
    fn prefer(&mut self, preference: &Preference) -> Lit {
        let switch = self.fresh();
        for [a, b] in &preference.pairs {
            let (a, b) = (self.solid(*a), self.solid(*b));
            self.clause(vec![!switch, !a, b]);
            self.clause(vec![!switch, a, !b]);
        }
        switch
    }

    /// Solves with all required literals and as many preferences as are compatible. Returns the assumptions.
    ///
    /// Preferences that occur in the core of a contradiction are dropped one by one. This is not a maximum
    /// set, but needs at most one query for each preference.
    fn first_choice(&mut self, on: &[Lit], mut preferred: Vec<Lit>) -> Vec<Lit> {
        loop {
            let assumed: Vec<Lit> = on.iter().chain(&preferred).copied().collect();
            if self.solver.solve_limited(&assumed) == lbool::TRUE || preferred.is_empty() {
                return assumed;
            }
            let core: Vec<Lit> = self.solver.unsat_core().to_vec();
            let in_core = |l: &Lit| core.contains(l) || core.contains(&!*l);
            match preferred.iter().position(in_core) {
                Some(at) => drop(preferred.remove(at)),
                None => preferred.clear(),
            }
        }
    }

    fn assignment(&self) -> Assignment {
        self.cells.iter().map(|(cell, var)| (*cell, self.solver.value_var(*var) == lbool::TRUE)).collect()
    }
}

/// True if the sectors form an edge for given cell states; `None` if drawing conventions differ.
fn edge(group: &EdgeSectors, smooth_edges: SmoothEdges, state: impl Fn(u32) -> bool) -> Option<bool> {
    let n = group.sectors.len();
    // Half-surfaces between sectors of different states belong to the boundary. Two that continue each other
    // are no edge; all other pairs are one.
    let states: Vec<bool> = group.sectors.iter().map(|c| state(*c)).collect();
    let boundary: Vec<u8> = (0..n).filter(|&h| states[h] != states[(h + 1) % n]).map(|h| h as u8).collect();
    match boundary[..] {
        [] => Some(false),
        [a, b] if group.smooth.contains(&[a, b]) => {
            Some(smooth_edges == SmoothEdges::MayBeDrawn && group.tangent.contains(&[a, b]))
        }
        [_, _] => Some(true),
        // Parts of the boundary touch along a line. If all of them pass through smoothly, as for a hole that
        // is tangent to a face, the line is drawn by some conventions only.
        _ => (!pairs_up(&boundary, &group.smooth)).then_some(true),
    }
}

/// True if the half-surfaces can be paired so that each pair is smooth.
fn pairs_up(halves: &[u8], smooth: &[[u8; 2]]) -> bool {
    // The first one must have a partner, so only its choices are tried; there are at most a few
    // half-surfaces.
    let Some((first, rest)) = halves.split_first() else {
        return true;
    };
    rest.iter().enumerate().any(|(k, other)| {
        let pair = [*first.min(other), *first.max(other)];
        smooth.contains(&pair) && {
            let left: Vec<u8> = rest.iter().enumerate().filter(|r| r.0 != k).map(|r| *r.1).collect();
            pairs_up(&left, smooth)
        }
    })
}

/// Enumerates assignments and passes each to `accept`, up to a maximum number.
///
/// `accept` returns cells whose state makes no difference; assignments that differ only in these are skipped.
/// Assignments that satisfy the compatible preferences come first.
pub(crate) fn search(
    cells: &Cells,
    sight_tests: &SightTests,
    smooth_edges: SmoothEdges,
    preferences: &[Preference],
    limit: usize,
    mut accept: impl FnMut(&Assignment) -> Vec<u32>,
) -> SearchResult {
    let outside = cells.outside();
    // Each test has a switch. Assumed switches keep its clauses active, and the core of a contradiction then
    // names the tests that contradict each other.
    let mut encoder = Encoder::new(outside, smooth_edges);
    let mut switches: Vec<(Lit, usize)> = Vec::new();
    for (index, (sight_test, _)) in sight_tests.tests.iter().enumerate() {
        let switch = encoder.fresh();
        encoder.add(sight_test, switch);
        switches.push((switch, index));
    }
    let mut unexplained = Vec::new();
    loop {
        let on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
        if encoder.solver.solve_limited(&on) == lbool::TRUE {
            break;
        }
        let core: Vec<Lit> = encoder.solver.unsat_core().to_vec();
        // A test that many positions require is probably right; one that few require is more likely the error
        // in the drawing.
        let places = |index: usize| sight_tests.tests[index].1.len();
        let Some(at) = (0..switches.len())
            .filter(|&s| core.contains(&switches[s].0) || core.contains(&!switches[s].0))
            .min_by_key(|&s| places(switches[s].1))
        else {
            return SearchResult { complete: true, unexplained };
        };
        let (_, index) = switches.swap_remove(at);
        let (sight_test, places) = &sight_tests.tests[index];
        unexplained.push((sight_test.expected, places[0].clone()));
    }
    let on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
    // A solid that leaves lines unexplained has other views than the drawing: naming the lines is the answer.
    if !unexplained.is_empty() {
        return SearchResult { complete: true, unexplained };
    }
    let preferred: Vec<Lit> = preferences.iter().map(|p| encoder.prefer(p)).collect();
    let mut assumed = encoder.first_choice(&on, preferred);
    let mut undetermined: HashSet<u32> = HashSet::new();
    let mut count = 0;
    loop {
        count += 1;
        let assignment = encoder.assignment();
        undetermined.extend(accept(&assignment));
        // Blocks this assignment. Without the indifferent cells the clause also blocks all assignments that
        // differ only in these; otherwise n slivers would give 2^n copies of one solid.
        let block: Vec<Lit> = assignment
            .iter()
            .filter(|(cell, _)| !undetermined.contains(cell))
            .map(|(cell, solid)| {
                let literal = Lit::new(encoder.cells[cell], true);
                if *solid { !literal } else { literal }
            })
            .collect();
        let continues = count < limit && !block.is_empty();
        if !block.is_empty() {
            encoder.clause(block);
        }
        let mut is_found = continues && encoder.solver.solve_limited(&assumed) == lbool::TRUE;
        if continues && !is_found && assumed.len() > on.len() {
            // The preferred assignments are exhausted; continue without preferences.
            assumed.clone_from(&on);
            is_found = encoder.solver.solve_limited(&on) == lbool::TRUE;
        }
        if !is_found {
            return SearchResult { complete: count < limit, unexplained };
        }
    }
}
