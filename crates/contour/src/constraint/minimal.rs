//! Smallest sets that fail: which of many demands contradict each other.
//!
//! Comes in: how many demands there are and an oracle that says whether some of them can hold together. Goes
//! out: a set that cannot, of which every proper part can. Not guaranteed: that it is the only one, or the
//! one of fewest members.

/// A minimal failing set by deletion: each member is left out in turn, and stays out where the others still
/// fail.
///
/// `holds` is asked about ascending indices, and must hold for every part of a set for which it holds. Empty
/// when all hold together. Cost: one question for each of `count`, so best where most of them take part.
///
/// # References
/// Chinneck and Dravnieks 1991, *Locating minimal infeasible constraint sets in linear programs*.
pub fn deletion_filter(count: usize, mut holds: impl FnMut(&[usize]) -> bool) -> Vec<usize> {
    let mut kept: Vec<usize> = (0..count).collect();
    if holds(&kept) {
        return Vec::new();
    }
    for candidate in (0..count).rev() {
        let without: Vec<usize> = kept.iter().copied().filter(|&i| i != candidate).collect();
        if !holds(&without) {
            kept = without;
        }
    }
    kept
}

/// A minimal failing set by divide and conquer, made of early members where there is a choice.
///
/// Demands are in order of preference: an explanation is sought among the first ones, so that the last member
/// of what comes back is the first demand that cannot be granted after all before it. Empty when all hold
/// together. Cost: about `2 k log₂(count/k) + 2 k` questions for a set of `k` members.
///
/// # Examples
/// ```
/// use planish_contour::constraint::quick_xplain;
///
/// // Weights that must stay below ten; 6 and 5 are too much, and so is 9 with anything.
/// let weights = [1, 6, 1, 5, 9];
/// let fits = |chosen: &[usize]| chosen.iter().map(|&i| weights[i]).sum::<i32>() < 10;
/// assert_eq!(quick_xplain(5, fits), [1, 3]);
/// ```
///
/// # References
/// Junker 2004, *QuickXplain: preferred explanations and relaxations for over-constrained problems*.
pub fn quick_xplain(count: usize, mut holds: impl FnMut(&[usize]) -> bool) -> Vec<usize> {
    let all: Vec<usize> = (0..count).collect();
    if holds(&all) {
        return Vec::new();
    }
    let mut found = explain(&[], false, &all, &mut holds);
    found.sort_unstable();
    found
}

/// The members of `among` that fail together with `background`, which is known to fail with all of them.
fn explain(
    background: &[usize],
    grown: bool,
    among: &[usize],
    holds: &mut impl FnMut(&[usize]) -> bool,
) -> Vec<usize> {
    if grown && !holds(&sorted(background)) {
        return Vec::new();
    }
    if among.len() <= 1 {
        return among.to_vec();
    }
    let (first, second) = among.split_at(among.len() / 2);
    let of_second = explain(&joined(background, first), true, second, holds);
    let of_first = explain(&joined(background, &of_second), !of_second.is_empty(), first, holds);
    joined(&of_first, &of_second)
}

fn joined(a: &[usize], b: &[usize]) -> Vec<usize> {
    a.iter().chain(b).copied().collect()
}

fn sorted(set: &[usize]) -> Vec<usize> {
    let mut set = set.to_vec();
    set.sort_unstable();
    set
}
