//! The search: which cells are solid, so that every look finds what is drawn.
//!
//! Every look becomes clauses of a satisfiability problem under a switch of its own; the solver then gives
//! one assignment of cells after the other. Where there is none, switches are turned off, those of the fewest
//! places first, until there is: what they stand for is unexplained.

use super::cells::Cells;
use super::preference::Preference;
use super::sight::{EdgeSectors, SightTest, SightTestPlace, SightTests};
use crate::drawing::LineStyle;
use batsat::{BasicSolver, Lit, SolverInterface, Var, lbool};
use std::collections::{BTreeMap, HashMap, HashSet};

/// Which cells are solid.
pub(crate) type Assignment = BTreeMap<u32, bool>;

/// What the search found.
pub(crate) struct SearchResult {
    /// Whether there are no others.
    pub(crate) complete: bool,
    /// Places that no solid explains.
    pub(crate) unexplained: Vec<(Option<LineStyle>, SightTestPlace)>,
}

/// Which edges lines may stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum SmoothEdges {
    /// Drawn lines are edges at which faces meet at an angle, and outlines.
    NotDrawn,
    /// Drawn lines may be tangent edges as well; these need not be drawn.
    MayBeDrawn,
}

struct Encoder {
    solver: BasicSolver,
    outside: u32,
    cells: BTreeMap<u32, Var>,
    events: HashMap<(EdgeSectors, SmoothEdges), Lit>,
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
        // Solids first try to be small.
        Lit::new(*self.cells.entry(cell).or_insert_with(|| solver.new_var(lbool::TRUE, true)), true)
    }

    fn clause(&mut self, mut literals: Vec<Lit>) {
        self.solver.add_clause_reuse(&mut literals);
    }

    /// The literal that there is an edge at a group, a tangent one or not.
    fn event(&mut self, group: &EdgeSectors, smooth_edges: SmoothEdges) -> Lit {
        let smooth_edges = match group.tangent.is_empty() {
            true => SmoothEdges::NotDrawn,
            false => smooth_edges,
        };
        let key = (group.clone(), smooth_edges);
        if let Some(event) = self.events.get(&key) {
            return *event;
        }
        let event = self.fresh();
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

    /// Adds a look, in force while its switch is on.
    fn add(&mut self, sight_test: &SightTest, switch: Lit) {
        // What must not be seen is an edge at an angle; what is drawn may be a tangent one.
        let (forbidden, drawn) = (SmoothEdges::NotDrawn, self.smooth_edges);
        let seen_as = match sight_test.style {
            Some(LineStyle::Visible) => drawn,
            _ => forbidden,
        };
        let events: Vec<Lit> = sight_test.groups.iter().map(|g| self.event(g, seen_as)).collect();
        let Some(style) = sight_test.style else {
            for event in events {
                self.clause(vec![!switch, !event]);
            }
            return;
        };
        let mut visible = Vec::new();
        let mut clear = self.truth;
        let mut passed: Vec<u32> = sight_test.start.to_vec();
        for (group, event) in sight_test.groups.iter().zip(&events) {
            clear = self.clear(clear, &mut passed);
            let seen = self.fresh();
            self.clause(vec![!seen, clear]);
            self.clause(vec![!seen, *event]);
            self.clause(vec![seen, !clear, !*event]);
            visible.push(seen);
            passed.extend(&group.sectors);
        }
        match style {
            LineStyle::Visible => {
                visible.push(!switch);
                self.clause(visible);
            }
            LineStyle::Hidden => {
                for seen in visible {
                    self.clause(vec![!switch, !seen]);
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

    /// Solves with what must be on and as many preferences as go together; gives back all that was assumed.
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

/// Whether there is an edge at a group for states of its cells; none where drawings differ in whether they
/// show one.
fn edge(group: &EdgeSectors, smooth_edges: SmoothEdges, state: impl Fn(u32) -> bool) -> Option<bool> {
    let n = group.sectors.len();
    let states: Vec<bool> = group.sectors.iter().map(|c| state(*c)).collect();
    let boundary: Vec<u8> = (0..n).filter(|&h| states[h] != states[(h + 1) % n]).map(|h| h as u8).collect();
    match boundary[..] {
        [] => Some(false),
        [a, b] if group.smooth.contains(&[a, b]) => {
            Some(smooth_edges == SmoothEdges::MayBeDrawn && group.tangent.contains(&[a, b]))
        }
        [_, _] => Some(true),
        // Parts of the boundary touch along a line. Where all of them run smoothly through, as where a hole
        // touches a wall, some draw it and some not.
        _ => (!pairs_up(&boundary, &group.smooth)).then_some(true),
    }
}

/// Whether half-surfaces can be put in pairs that continue each other.
fn pairs_up(halves: &[u8], smooth: &[[u8; 2]]) -> bool {
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

/// Searches for assignments, at most so many, and hands each to `accept`, which gives back cells whose states
/// make no difference: assignments that differ from a later one in these only are not searched for.
/// Assignments that meet all preferences that can be met together come first.
pub(crate) fn search(
    cells: &Cells,
    sight_tests: &SightTests,
    smooth_edges: SmoothEdges,
    preferences: &[Preference],
    most: usize,
    mut accept: impl FnMut(&Assignment) -> Vec<u32>,
) -> SearchResult {
    let outside = cells.at_in([0, 0, 0], [0, 1, 2].map(|a| cells.plan.grid[a][0] + 1e-3 * cells.plan.size));
    let mut encoder = Encoder::new(outside, smooth_edges);
    let mut switches: Vec<(Lit, usize)> = Vec::new();
    for (index, (sight_test, _)) in sight_tests.sight_tests.iter().enumerate() {
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
        let places = |index: usize| sight_tests.sight_tests[index].1.len();
        let Some(at) = (0..switches.len())
            .filter(|&s| core.contains(&switches[s].0) || core.contains(&!switches[s].0))
            .min_by_key(|&s| places(switches[s].1))
        else {
            return SearchResult { complete: true, unexplained };
        };
        let (_, index) = switches.swap_remove(at);
        let (sight_test, places) = &sight_tests.sight_tests[index];
        unexplained.push((sight_test.style, places[0].clone()));
    }
    let on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
    // A solid that leaves lines unexplained has other views than the drawing: naming the lines is the answer.
    if !unexplained.is_empty() {
        return SearchResult { complete: true, unexplained };
    }
    let preferred: Vec<Lit> = preferences.iter().map(|p| encoder.prefer(p)).collect();
    let mut assumed = encoder.first_choice(&on, preferred);
    let mut indifferent: HashSet<u32> = HashSet::new();
    let mut count = 0;
    loop {
        count += 1;
        let assignment = encoder.assignment();
        indifferent.extend(accept(&assignment));
        let block: Vec<Lit> = assignment
            .iter()
            .filter(|(cell, _)| !indifferent.contains(cell))
            .map(|(cell, solid)| {
                let literal = Lit::new(encoder.cells[cell], true);
                if *solid { !literal } else { literal }
            })
            .collect();
        let goes_on = count < most && !block.is_empty();
        if !block.is_empty() {
            encoder.clause(block);
        }
        let mut is_found = goes_on && encoder.solver.solve_limited(&assumed) == lbool::TRUE;
        if goes_on && !is_found && assumed.len() > on.len() {
            // Nothing more that meets the preferences: the others.
            assumed.clone_from(&on);
            is_found = encoder.solver.solve_limited(&on) == lbool::TRUE;
        }
        if !is_found {
            return SearchResult { complete: count < most, unexplained };
        }
    }
}
