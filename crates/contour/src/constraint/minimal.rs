//! Minimal conflicting sets.
//!
//! In: the number of demands, and an oracle that decides whether some of them can hold together. Out: a set
//! that cannot, while every proper subset can. Not guaranteed: that it is the only such set, or the smallest
//! one.

/// A minimal conflicting set by deletion: removes each member that the conflict does not need.
///
/// `holds` gets ascending indices, and must be true for every subset of a set for which it is true. The
/// result is empty if all demands hold together. Cost: `count` calls of `holds`, so it suits conflicts of
/// most members.
///
/// # Examples
/// ```
/// use planish_contour::constraint::deletion_filter;
///
/// // Weights that must stay below ten: 6 and 5 are too much together.
/// let weights = [1, 6, 1, 5];
/// let fits = |chosen: &[usize]| chosen.iter().map(|&i| weights[i]).sum::<i32>() < 10;
/// assert_eq!(deletion_filter(4, fits), [1, 3]);
/// ```
///
/// # References
/// Chinneck and Dravnieks 1991, *Locating minimal infeasible constraint sets in linear programs*.
pub fn deletion_filter(count: usize, mut holds: impl FnMut(&[usize]) -> bool) -> Vec<usize> {
    let mut kept: Vec<usize> = (0..count).collect();
    if holds(&kept) {
        return Vec::new();
    }
    // From the end, so that earlier, preferred demands stay in the set if there is a choice.
    for candidate in (0..count).rev() {
        let without: Vec<usize> = kept.iter().copied().filter(|&i| i != candidate).collect();
        if !holds(&without) {
            kept = without;
        }
    }
    kept
}

/// A minimal conflicting set by divide and conquer, with early members if there is a choice.
///
/// Demands are in order of preference. The last member of the result is the first demand that cannot hold
/// after all before it. The result is empty if all demands hold together. Cost: about `2 k log₂(count/k) + 2
/// k` calls of `holds` for a set of `k` members, so it suits small conflicts among many demands.
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

/// The members of `among` that conflict together with `background`, which conflicts with all of them.
///
/// `grown` is true if the background has changed since it was last known to hold; it then needs a new call.
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
    // The second half is explained with the whole first half in the background, and the first half then only
    // with the members found: this prefers early members.
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
