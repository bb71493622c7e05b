//! Which sight tests hold together, and which contradict each other.

use super::cells::Cells;
use super::search::{Encoder, MAX_SINGLE_QUERIES};
use super::sight::{Expected, SightTestPlace, SightTests};
use batsat::{Lit, SolverInterface, lbool};
use std::collections::{BTreeSet, HashSet};

/// Maximum number of lines of a doubtful view that are left out, one after the other.
const MAX_LINES_LEFT_OUT: usize = 40;

/// Maximum number of tests that are dropped one by one: each takes a query.
const MAX_SINGLE_DROPS: usize = 400;

/// Sets of switches that hold together, and tests that contradict others.
pub(super) type Satisfiable = (Vec<Vec<Lit>>, Vec<(Expected, SightTestPlace)>);

/// The switches of tests that hold together, and the first place of each test that was turned off.
pub(super) fn satisfiable(
    sight_tests: &SightTests,
    encoder: &mut Encoder,
    mut switches: Vec<(Lit, usize)>,
) -> Satisfiable {
    let mut unexplained = Vec::new();
    loop {
        let on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
        if encoder.solver.solve_limited(&on) == lbool::TRUE {
            return (vec![on], unexplained);
        }
        let core: Vec<Lit> = encoder.solver.unsat_core().to_vec();
        // A test that many positions require is probably right; one that few require is more likely the error
        // in the drawing.
        let places = |index: usize| sight_tests.tests[index].1.len();
        let mut named: Vec<usize> = (0..switches.len())
            .filter(|&s| core.contains(&switches[s].0) || core.contains(&!switches[s].0))
            .collect();
        if named.is_empty() || encoder.is_exhausted() {
            return (Vec::new(), unexplained);
        }
        if unexplained.len() < MAX_SINGLE_QUERIES {
            named.sort_by_key(|&s| places(switches[s].1));
            named.truncate(1);
        }
        // From the last one on, because the last switch takes the place of a removed one.
        for at in named.into_iter().rev() {
            let (_, index) = switches.swap_remove(at);
            let (sight_test, places) = &sight_tests.tests[index];
            unexplained.push((sight_test.expected, places[0].clone()));
        }
    }
}

/// A large set of switches that hold together, and the first place of each other test.
///
/// Tests of a contradiction are dropped one by one, those with the fewest places first, and then taken back
/// where the others allow it. The set is maximal, but not always the largest one.
pub(super) fn most_satisfiable(
    sight_tests: &SightTests,
    encoder: &mut Encoder,
    mut switches: Vec<(Lit, usize)>,
) -> Satisfiable {
    let places = |index: usize| sight_tests.tests[index].1.len();
    switches.sort_by_key(|&(_, index)| std::cmp::Reverse(places(index)));
    let mut dropped = Vec::new();
    loop {
        let on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
        if encoder.solver.solve_limited(&on) == lbool::TRUE {
            break;
        }
        let core: HashSet<Lit> = encoder.solver.unsat_core().iter().flat_map(|l| [*l, !*l]).collect();
        let Some(last) = switches.iter().rposition(|s| core.contains(&s.0)) else {
            return (Vec::new(), Vec::new());
        };
        if encoder.is_exhausted() {
            return (Vec::new(), Vec::new());
        }
        match dropped.len() < MAX_SINGLE_DROPS {
            true => dropped.push(switches.remove(last)),
            false => switches.retain(|s| !core.contains(&s.0)),
        }
    }
    let mut on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
    let mut unexplained = Vec::new();
    dropped.sort_by_key(|&(_, index)| std::cmp::Reverse(places(index)));
    for (switch, index) in dropped {
        on.push(switch);
        if encoder.is_exhausted() || encoder.solver.solve_limited(&on) != lbool::TRUE {
            on.pop();
            let (test, places) = &sight_tests.tests[index];
            unexplained.push((test.expected, places[0].clone()));
        }
    }
    (vec![on], unexplained)
}

/// Sets of switches that hold together: all, or else all but those of one line of a doubtful view, for each
/// line that contradicts others. If there is none, a contradiction is returned as well.
pub(super) fn satisfiable_without_a_line(
    cells: &Cells,
    sight_tests: &SightTests,
    encoder: &mut Encoder,
    switches: &[(Lit, usize)],
) -> Satisfiable {
    let on: Vec<Lit> = switches.iter().map(|s| s.0).collect();
    if encoder.solver.solve_limited(&on) == lbool::TRUE {
        return (vec![on], Vec::new());
    }
    let core: Vec<Lit> = encoder.solver.unsat_core().to_vec();
    let in_core = |l: &Lit| core.contains(l) || core.contains(&!*l);
    // A test may hold for several lines; it is turned off with any of them.
    let lines_of = |index: usize| {
        let places = sight_tests.tests[index].1.iter();
        places.filter(|p| cells.plan.views[p.view].is_doubtful).filter_map(|p| Some((p.view, p.curve?)))
    };
    let named = switches.iter().filter(|(switch, _)| in_core(switch));
    let lines: BTreeSet<(usize, usize)> = named.clone().flat_map(|(_, index)| lines_of(*index)).collect();
    let mut sets = Vec::new();
    for line in lines.into_iter().take(MAX_LINES_LEFT_OUT) {
        if encoder.is_exhausted() {
            break;
        }
        let kept = switches.iter().filter(|(_, index)| !lines_of(*index).any(|l| l == line));
        let kept: Vec<Lit> = kept.map(|s| s.0).collect();
        if encoder.solver.solve_limited(&kept) == lbool::TRUE {
            sets.push(kept);
        }
    }
    let mut first = named.map(|(_, index)| &sight_tests.tests[*index]).filter(|_| sets.is_empty());
    let contradiction = first.next().map(|(test, at)| (test.expected, at[0].clone()));
    (sets, contradiction.into_iter().collect())
}
