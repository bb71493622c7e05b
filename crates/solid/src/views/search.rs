//! The search: which cells are solid, so that every look finds what is drawn.
//!
//! Every look becomes clauses of a satisfiability problem under a switch of its own; the solver then gives one assignment of cells after the other.
//! Where there is none, switches are turned off, those of the fewest places first, until there is: what they stand for is unexplained.

use super::cells::Cells;
use super::drawing::LineStyle;
use super::sight::{Group, Look, LookPlace, Looks};
use batsat::{BasicSolver, Lit, SolverInterface, Var, lbool};
use std::collections::{BTreeMap, HashMap, HashSet};

/// Which cells are solid.
pub(crate) type Assignment = BTreeMap<u32, bool>;

/// What the search found.
pub(crate) struct Found {
    /// Whether there are no others.
    pub(crate) complete: bool,
    /// Places that no solid explains.
    pub(crate) unexplained: Vec<(Option<LineStyle>, LookPlace)>,
}

struct Encoder {
    solver: BasicSolver,
    outside: u32,
    cells: BTreeMap<u32, Var>,
    events: HashMap<Group, Lit>,
    truth: Lit,
}

impl Encoder {
    fn new(outside: u32) -> Self {
        let mut solver = BasicSolver::default();
        let truth = Lit::new(solver.new_var_default(), true);
        solver.add_clause_reuse(&mut vec![truth]);
        Self {
            solver,
            outside,
            cells: BTreeMap::new(),
            events: HashMap::new(),
            truth,
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
        let solver = &mut self.solver;
        // Solids first try to be small.
        Lit::new(
            *self
                .cells
                .entry(cell)
                .or_insert_with(|| solver.new_var(lbool::TRUE, true)),
            true,
        )
    }

    fn clause(&mut self, mut literals: Vec<Lit>) {
        self.solver.add_clause_reuse(&mut literals);
    }

    /// The literal that there is an edge at a group.
    fn event(&mut self, group: &Group) -> Lit {
        if let Some(event) = self.events.get(group) {
            return *event;
        }
        let event = self.fresh();
        let mut distinct: Vec<u32> = group.sectors.clone();
        distinct.sort_unstable();
        distinct.dedup();
        distinct.retain(|c| *c != self.outside);
        let literals: Vec<Lit> = distinct.iter().map(|c| self.solid(*c)).collect();
        for states in 0..1_u32 << distinct.len().min(12) {
            let state = |cell: u32| {
                distinct
                    .iter()
                    .position(|c| *c == cell)
                    .is_some_and(|k| states >> k & 1 == 1)
            };
            let mut clause: Vec<Lit> = (0..distinct.len())
                .map(|k| {
                    if states >> k & 1 == 1 {
                        !literals[k]
                    } else {
                        literals[k]
                    }
                })
                .collect();
            match edge(group, state) {
                Some(true) => clause.push(event),
                Some(false) => clause.push(!event),
                None => continue,
            }
            self.clause(clause);
        }
        self.events.insert(group.clone(), event);
        event
    }

    /// Adds a look, in force while its switch is on.
    fn add(&mut self, look: &Look, switch: Lit) {
        let events: Vec<Lit> = look.groups.iter().map(|g| self.event(g)).collect();
        let Some(style) = look.style else {
            for event in events {
                self.clause(vec![!switch, !event]);
            }
            return;
        };
        let mut visible = Vec::new();
        let mut clear = self.truth;
        let mut passed: Vec<u32> = look.start.to_vec();
        for (group, event) in look.groups.iter().zip(&events) {
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
                let mut any = events;
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

    fn assignment(&self) -> Assignment {
        self.cells
            .iter()
            .map(|(cell, var)| (*cell, self.solver.value_var(*var) == lbool::TRUE))
            .collect()
    }
}

/// Whether there is an edge at a group for states of its cells; none where drawings differ in whether they show one.
fn edge(group: &Group, state: impl Fn(u32) -> bool) -> Option<bool> {
    let n = group.sectors.len();
    let states: Vec<bool> = group.sectors.iter().map(|c| state(*c)).collect();
    let boundary: Vec<u8> = (0..n)
        .filter(|&h| states[h] != states[(h + 1) % n])
        .map(|h| h as u8)
        .collect();
    match boundary[..] {
        [] => Some(false),
        [a, b] => Some(!group.smooth.contains(&[a, b])),
        // Parts of the boundary touch along a line. Where all of them run smoothly through, as where a hole touches a wall, some draw it and some not.
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

/// Searches for assignments, at most so many, and hands each to `accept`, which gives back cells whose states make no difference: assignments that differ
/// from a later one in these only are not searched for.
pub(crate) fn search(
    cells: &Cells,
    looks: &Looks,
    most: usize,
    mut accept: impl FnMut(&Assignment) -> Vec<u32>,
) -> Found {
    let outside = cells.at_in(
        [0, 0, 0],
        [0, 1, 2].map(|a| cells.plan.grid[a][0] + 1e-3 * cells.plan.size),
    );
    let mut encoder = Encoder::new(outside);
    let mut switches: Vec<(Lit, usize)> = Vec::new();
    for (index, (look, _)) in looks.looks.iter().enumerate() {
        let switch = encoder.fresh();
        encoder.add(look, switch);
        switches.push((switch, index));
    }
    let mut unexplained = Vec::new();
    loop {
        let on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
        if encoder.solver.solve_limited(&on) == lbool::TRUE {
            break;
        }
        let core: Vec<Lit> = encoder.solver.unsat_core().to_vec();
        let places = |index: usize| looks.looks[index].1.len();
        let Some(at) = (0..switches.len())
            .filter(|&s| core.contains(&switches[s].0) || core.contains(&!switches[s].0))
            .min_by_key(|&s| places(switches[s].1))
        else {
            return Found {
                complete: true,
                unexplained,
            };
        };
        let (_, index) = switches.swap_remove(at);
        let (look, places) = &looks.looks[index];
        unexplained.push((look.style, places[0].clone()));
    }
    let on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
    // A solid that leaves lines unexplained has other views than the drawing: naming the lines is the answer.
    if !unexplained.is_empty() {
        return Found {
            complete: true,
            unexplained,
        };
    }
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
        if !goes_on || encoder.solver.solve_limited(&on) != lbool::TRUE {
            return Found {
                complete: count < most,
                unexplained,
            };
        }
    }
}
