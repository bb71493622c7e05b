//! Search for the solid cells that satisfy all sight tests.
//!
//! Each sight test becomes clauses of a satisfiability problem, guarded by a switch literal. The solver then
//! enumerates assignments of cells. If there is none, switches are turned off until there is one, those with
//! the fewest positions first. The lines of these tests are reported as unexplained.

use super::cells::{Cells, UnseenFaces};
use super::contradictions::{most_satisfiable, satisfiable, satisfiable_without_a_line};
use super::preference::{Preference, Preferences};
use super::sight::{EdgeSectors, Expected, SightTest, SightTestPlace, SightTests};
use crate::drawing::LineStyle;
use batsat::{BasicSolver, Lit, SolverInterface, Var, lbool};
use planish_core::DisjointSets;
use std::collections::{BTreeMap, HashMap, HashSet};

/// Number of contradictions that are resolved by dropping a single test or preference of their core. Later
/// ones drop all of it: fewer are kept, but drawings with many contradictions end sooner.
pub(super) const MAX_SINGLE_QUERIES: usize = 60;
/// Maximum number of propagated literals of a search. It bounds the run time without a clock, so that results
/// are the same on each machine. Drawings that are solved need some 10⁴; 2·10⁷ take some seconds.
const MAX_PROPAGATIONS: u64 = 20_000_000;
/// Maximum number of assignments for each line that is left out.
const MAX_WITHOUT_A_LINE: usize = 4;

/// State of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CellState {
    Empty,
    /// Solid. All bodies are of this state unless some touch along faces.
    First,
    /// Solid, and separated from cells of the first state by a face.
    Second,
}

/// State of each cell.
pub(crate) type Assignment = BTreeMap<u32, CellState>;

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

/// Whether bodies may touch along faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Bodies {
    /// Faces separate solid from empty cells only, so that cells that touch belong to one body.
    Apart,
    /// Solid cells have one of two states, and faces separate these as well. The bodies are the connected
    /// parts of each state.
    MayTouch,
}

/// How many sight tests a solid must meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Explained {
    /// All: a solid that leaves lines unexplained has other views than the drawing.
    All,
    /// As many as hold together, for drawings with errors. Cells that no test decides are solid.
    Most,
}

/// How a drawing is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Conventions {
    pub(crate) smooth_edges: SmoothEdges,
    pub(crate) bodies: Bodies,
    pub(crate) explained: Explained,
    /// Matters only for views without hidden lines.
    pub(crate) unseen_faces: UnseenFaces,
}

impl Conventions {
    /// Those of drafting, which are tried first.
    pub(crate) const USUAL: Self = Self {
        smooth_edges: SmoothEdges::NotDrawn,
        bodies: Bodies::Apart,
        explained: Explained::All,
        unseen_faces: UnseenFaces::Allowed,
    };
}

/// Whether the features of an assignment are equal where their circles are, as far as the drawing allows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Regularity {
    Equal,
    Any,
}

/// Translates sight tests into clauses.
pub(super) struct Encoder {
    pub(super) solver: BasicSolver,
    /// The cell around the part, which is empty.
    outside: u32,
    cells: BTreeMap<u32, Var>,
    /// Literals that are true if sectors form an edge. Many tests share sectors, and each set is encoded
    /// once.
    events: HashMap<(EdgeSectors, SmoothEdges), Lit>,
    /// A literal that is always true.
    truth: Lit,
    smooth_edges: SmoothEdges,
    /// The value of a cell that the solver tries first.
    first_value: lbool,
    /// For each cell, whether its state is [`CellState::Second`]; `None` if there is no such state.
    seconds: Option<BTreeMap<u32, Var>>,
    /// Literals that two cells have different states.
    differences: HashMap<[u32; 2], Lit>,
}

impl Encoder {
    fn new(outside: u32, conventions: Conventions) -> Self {
        let mut solver = BasicSolver::default();
        let truth = Lit::new(solver.new_var_default(), true);
        solver.add_clause_reuse(&mut vec![truth]);
        Self {
            solver,
            outside,
            cells: BTreeMap::new(),
            events: HashMap::new(),
            truth,
            smooth_edges: conventions.smooth_edges,
            // Empty cells first prefer small solids. If tests are dropped, the volume within the outlines is
            // the better guess.
            first_value: match conventions.explained {
                Explained::All => lbool::TRUE,
                Explained::Most => lbool::FALSE,
            },
            seconds: (conventions.bodies == Bodies::MayTouch).then(BTreeMap::new),
            differences: HashMap::new(),
        }
    }

    fn fresh(&mut self) -> Lit {
        Lit::new(self.solver.new_var_default(), true)
    }

    /// The literal that a cell is solid.
    fn solid(&mut self, cell: u32) -> Lit {
        if cell == self.outside {
            return !self.truth;
        }
        let (solver, first) = (&mut self.solver, self.first_value);
        Lit::new(*self.cells.entry(cell).or_insert_with(|| solver.new_var(first, true)), true)
    }

    /// The literal that the state of a cell is [`CellState::Second`].
    fn second(&mut self, cell: u32) -> Lit {
        let solid = self.solid(cell);
        let Some(seconds) = self.seconds.as_mut().filter(|_| cell != self.outside) else {
            return !self.truth;
        };
        if let Some(known) = seconds.get(&cell) {
            return Lit::new(*known, true);
        }
        let variable = self.solver.new_var(lbool::TRUE, true);
        seconds.insert(cell, variable);
        let second = Lit::new(variable, true);
        self.clause(vec![!second, solid]);
        second
    }

    /// The literal that two cells have different states.
    fn differ(&mut self, a: u32, b: u32) -> Lit {
        if a == b {
            return !self.truth;
        }
        let key = [a.min(b), a.max(b)];
        if let Some(known) = self.differences.get(&key) {
            return *known;
        }
        let differ = self.fresh();
        let [solids, seconds] = [[self.solid(a), self.solid(b)], [self.second(a), self.second(b)]];
        for [p, q] in [solids, seconds] {
            self.clause(vec![differ, !p, q]);
            self.clause(vec![differ, p, !q]);
        }
        for (solid, second) in [(true, true), (true, false), (false, false)] {
            let mut clause = vec![!differ];
            // Not all four literals may have these values.
            clause.extend(solids.map(|l| if solid { !l } else { l }));
            clause.extend(seconds.map(|l| if second { !l } else { l }));
            self.clause(clause);
        }
        self.differences.insert(key, differ);
        differ
    }

    /// Whether the search has reached its limit.
    pub(super) fn is_exhausted(&self) -> bool {
        self.solver.num_propagations() > MAX_PROPAGATIONS
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
        let event = self.fresh();
        match self.seconds.is_some() {
            true => self.define_by_faces(event, group, smooth_edges),
            false => self.define_by_cells(event, group, smooth_edges),
        }
        self.events.insert(key, event);
        event
    }

    /// Adds one clause for each state of the distinct cells: a truth table.
    ///
    /// Sectors around a line are few, so the table is small. States that drawing conventions treat
    /// differently get no clause, so the event is free there.
    fn define_by_cells(&mut self, event: Lit, group: &EdgeSectors, smooth_edges: SmoothEdges) {
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
            let n = group.sectors.len();
            let differ = |h: usize| state(group.sectors[h]) != state(group.sectors[(h + 1) % n]);
            match edge(group, smooth_edges, differ) {
                Some(true) => clause.push(event),
                Some(false) => clause.push(!event),
                None => continue,
            }
            self.clause(clause);
        }
    }

    /// Adds one clause for each set of half-surfaces that may belong to the boundary.
    ///
    /// With three states of a cell, this table is smaller than that of all states.
    fn define_by_faces(&mut self, event: Lit, group: &EdgeSectors, smooth_edges: SmoothEdges) {
        let n = group.sectors.len();
        let differ: Vec<Lit> =
            (0..n).map(|h| self.differ(group.sectors[h], group.sectors[(h + 1) % n])).collect();
        // Half-surfaces within one cell are never on the boundary.
        let open: Vec<usize> = (0..n).filter(|&h| differ[h] != !self.truth).collect();
        for states in 0..1_u32 << open.len().min(12) {
            let is_on = |h: usize| open.iter().position(|o| *o == h).is_some_and(|k| states >> k & 1 == 1);
            let mut clause: Vec<Lit> =
                open.iter().map(|&h| if is_on(h) { !differ[h] } else { differ[h] }).collect();
            match edge(group, smooth_edges, is_on) {
                Some(true) => clause.push(event),
                Some(false) => clause.push(!event),
                None => continue,
            }
            self.clause(clause);
        }
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

    /// Solves with all required literals and as many preferences as are compatible. Returns the assumptions;
    /// none if the literals contradict each other.
    ///
    /// Preferences that occur in the core of a contradiction are dropped one by one, later all of a core.
    /// This is not a maximum set.
    fn first_choice(&mut self, on: &[Lit], mut preferred: Vec<Lit>) -> Option<Vec<Lit>> {
        for query in 0.. {
            let assumed: Vec<Lit> = on.iter().chain(&preferred).copied().collect();
            if self.solver.solve_limited(&assumed) == lbool::TRUE {
                return Some(assumed);
            }
            if preferred.is_empty() || self.is_exhausted() {
                return None;
            }
            let core: Vec<Lit> = self.solver.unsat_core().to_vec();
            let in_core = |l: &Lit| core.contains(l) || core.contains(&!*l);
            match preferred.iter().position(in_core) {
                Some(at) if query < MAX_SINGLE_QUERIES => drop(preferred.remove(at)),
                Some(_) => preferred.retain(|l| !in_core(l)),
                None => preferred.clear(),
            }
        }
        None
    }

    /// Enumerates assignments under some switches, the preferred ones first, and passes each to `accept`.
    /// Returns true if there are no others.
    fn enumerate(
        &mut self,
        on: &[Lit],
        preferred: &[Lit],
        patterns: &[Lit],
        limit: usize,
        accept: &mut impl FnMut(&Assignment, Regularity) -> Vec<u32>,
    ) -> bool {
        let Some(mut assumed) = self.first_choice(on, preferred.to_vec()) else { return true };
        let mut undetermined: HashSet<u32> = HashSet::new();
        let mut regularity = match patterns.iter().any(|p| assumed.contains(p)) {
            true => Regularity::Equal,
            false => Regularity::Any,
        };
        let mut count = 0;
        loop {
            count += 1;
            let assignment = self.assignment();
            undetermined.extend(accept(&assignment, regularity));
            // Without the indifferent cells, all assignments that differ only in these are excluded as well.
            // Otherwise n slivers would give 2^n copies of one solid.
            let continues = self.exclude(&assignment, &undetermined) && count < limit;
            let mut is_found = continues && self.solver.solve_limited(&assumed) == lbool::TRUE;
            if continues && !is_found && assumed.len() > on.len() {
                // The preferred assignments are exhausted; continue without preferences.
                assumed = on.to_vec();
                regularity = Regularity::Any;
                is_found = self.solver.solve_limited(on) == lbool::TRUE;
            }
            if !is_found || self.is_exhausted() {
                return count < limit && !is_found;
            }
        }
    }

    fn assignment(&self) -> Assignment {
        let is_true = |var: &Var| self.solver.value_var(*var) == lbool::TRUE;
        let is_second = |cell: &u32| self.seconds.as_ref().and_then(|s| s.get(cell)).is_some_and(is_true);
        let state = |(cell, var): (&u32, &Var)| match (is_true(var), is_second(cell)) {
            (false, _) => (*cell, CellState::Empty),
            (true, false) => (*cell, CellState::First),
            (true, true) => (*cell, CellState::Second),
        };
        self.cells.iter().map(state).collect()
    }

    /// Excludes an assignment, except for the state of some cells. Returns false if no cell is left.
    fn exclude(&mut self, assignment: &Assignment, undetermined: &HashSet<u32>) -> bool {
        let cells: Vec<(u32, CellState)> =
            assignment.iter().filter(|(c, _)| !undetermined.contains(c)).map(|(c, s)| (*c, *s)).collect();
        let has_seconds = cells.iter().any(|c| c.1 == CellState::Second);
        // Exchanging both states of solid cells gives the same bodies.
        for exchanged in [false, true].into_iter().take(1 + usize::from(has_seconds)) {
            let mut clause = Vec::new();
            for &(cell, state) in &cells {
                let solid = self.solid(cell);
                if state == CellState::Empty {
                    clause.push(solid);
                    continue;
                }
                clause.push(!solid);
                if self.seconds.is_some() {
                    let second = self.second(cell);
                    let is_second = (state == CellState::Second) != exchanged;
                    clause.push(if is_second { !second } else { second });
                }
            }
            self.clause(clause);
        }
        !cells.is_empty()
    }
}

/// True if the sectors form an edge, by the half-surfaces that belong to the boundary because the sectors
/// before and behind them differ; `None` if drawing conventions differ.
fn edge(group: &EdgeSectors, smooth_edges: SmoothEdges, differ: impl Fn(usize) -> bool) -> Option<bool> {
    // Two half-surfaces that continue each other are no edge; all other pairs are one.
    let boundary: Vec<u8> = (0..group.sectors.len()).filter(|&h| differ(h)).map(|h| h as u8).collect();
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

/// True if each connected part of the second state shares a face with one of the first.
///
/// A part without such a face might as well have the first state. It is a body apart from all others, which
/// another assignment has, or it only touches one along a line.
pub(crate) fn seconds_share_faces(assignment: &Assignment, sight_tests: &SightTests) -> bool {
    let second: Vec<u32> =
        assignment.iter().filter(|(_, s)| **s == CellState::Second).map(|(cell, _)| *cell).collect();
    let mut parts = DisjointSets::new(second.len());
    let mut touched = Vec::new();
    // Neighbouring sectors of a ring share a face.
    for group in sight_tests.tests.iter().flat_map(|(test, _)| &test.groups) {
        for (k, a) in group.sectors.iter().enumerate() {
            let b = &group.sectors[(k + 1) % group.sectors.len()];
            match (second.binary_search(a), second.binary_search(b)) {
                (Ok(a), Ok(b)) => drop(parts.join(a as u32, b as u32)),
                (Ok(at), Err(_)) if assignment.get(b) == Some(&CellState::First) => touched.push(at as u32),
                (Err(_), Ok(at)) if assignment.get(a) == Some(&CellState::First) => touched.push(at as u32),
                _ => {}
            }
        }
    }
    let touched: HashSet<u32> = touched.into_iter().map(|at| parts.root(at)).collect();
    (0..second.len() as u32).all(|at| touched.contains(&parts.root(at)))
}

/// Enumerates assignments and passes each to `accept`, up to a maximum number.
///
/// `accept` returns cells whose state makes no difference; assignments that differ only in these are skipped.
/// Assignments that satisfy the compatible preferences come first; the regularity states which these are.
pub(crate) fn search(
    cells: &Cells,
    sight_tests: &SightTests,
    conventions: Conventions,
    preferences: &Preferences,
    limit: usize,
    mut accept: impl FnMut(&Assignment, Regularity) -> Vec<u32>,
) -> SearchResult {
    let outside = cells.outside();
    // Each test has a switch. Assumed switches keep its clauses active, and the core of a contradiction then
    // names the tests that contradict each other.
    let mut encoder = Encoder::new(outside, conventions);
    let mut switches: Vec<(Lit, usize)> = Vec::new();
    for (index, (sight_test, _)) in sight_tests.tests.iter().enumerate() {
        let switch = encoder.fresh();
        encoder.add(sight_test, switch);
        switches.push((switch, index));
    }
    let is_doubtful = cells.plan.views.iter().any(|view| view.is_doubtful);
    let (sets, unexplained) = match (conventions.explained, is_doubtful) {
        (Explained::Most, _) => most_satisfiable(sight_tests, &mut encoder, switches),
        (Explained::All, true) => satisfiable_without_a_line(cells, sight_tests, &mut encoder, &switches),
        (Explained::All, false) => satisfiable(sight_tests, &mut encoder, switches),
    };
    // Naming the lines that no solid explains is the answer.
    if conventions.explained == Explained::All && !unexplained.is_empty() || sets.is_empty() {
        return SearchResult { complete: !encoder.is_exhausted(), unexplained };
    }
    let mut preferred: Vec<Lit> = preferences.undrawn.iter().map(|p| encoder.prefer(p)).collect();
    let patterns: Vec<Lit> = preferences.patterns.iter().map(|p| encoder.prefer(p)).collect();
    preferred.extend(&patterns);
    preferred.extend(preferences.surfaces.iter().map(|p| encoder.prefer(p)));
    // As few cells as possible are separated from others.
    preferred.extend(encoder.seconds.iter().flatten().map(|(_, second)| Lit::new(*second, false)));
    if let [on] = &sets[..] {
        // Switches that stay on are clauses: each of the following queries would propagate them again.
        on.iter().for_each(|switch| encoder.clause(vec![*switch]));
        let complete = encoder.enumerate(&[], &preferred, &patterns, limit, &mut accept);
        let complete = complete && !is_doubtful && !encoder.is_exhausted();
        return SearchResult { complete, unexplained };
    }
    for on in &sets {
        encoder.enumerate(on, &preferred, &patterns, MAX_WITHOUT_A_LINE, &mut accept);
    }
    SearchResult { complete: false, unexplained }
}
