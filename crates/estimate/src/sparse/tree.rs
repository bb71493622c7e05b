//! Walks along the tree of supernodes, independent subtrees side by side.
//!
//! Input: a symbolic analysis, data that lie in the order of the supernodes, and what is to be done at each
//! of them. Output: the data, changed in place. Upwards each supernode takes what its children leave,
//! downwards what its parent leaves it.
//!
//! A supernode's result depends on its children or its parent only, never on who works beside it: the same
//! bytes at any number of threads. Subtrees with little work are walked by one thread in one loop. What
//! passes between supernodes lies on a stack there: in a postorder the children's parts are always the
//! topmost.

use rayon::prelude::*;

use super::SymbolicFactor;

/// Subtrees of less work than this share of the whole are walked by one thread, as are trees of less work
/// than [`LEAST_WORK`] operations.
const SERIAL_SHARE: f64 = 1.0 / 48.0;
/// Waking a second thread costs some 10 µs.
const LEAST_WORK: f64 = 2e5;

/// Memory of one walker: parts that were used up, to be used again.
#[derive(Default)]
pub(super) struct Spare(Vec<Vec<f64>>);

impl Spare {
    /// A part of at least `length` numbers, whatever they are.
    pub(super) fn take(&mut self, length: usize) -> Vec<f64> {
        let mut part = self.0.pop().unwrap_or_default();
        if part.len() < length {
            part.resize(length, 0.0);
        }
        part
    }

    pub(super) fn give_back(&mut self, part: Vec<f64>) {
        self.0.push(part);
    }
}

/// How a tree is walked: where the data of each supernode begin, and how much work a subtree is.
pub(super) struct Walk<'a> {
    symbolic: &'a SymbolicFactor,
    /// Start of each supernode's data, and the end.
    start: &'a [usize],
    /// Operations of the subtree that ends in a supernode.
    work: &'a (dyn Fn(usize) -> f64 + Sync),
    /// Subtrees of no more work than this are walked by one thread.
    grain: f64,
}

impl<'a> Walk<'a> {
    pub(super) fn new(
        symbolic: &'a SymbolicFactor,
        start: &'a [usize],
        work: &'a (dyn Fn(usize) -> f64 + Sync),
    ) -> Self {
        let total: f64 = symbolic.roots().iter().map(|&root| work(root as usize)).sum();
        Self { symbolic, start, work, grain: (SERIAL_SHARE * total).max(LEAST_WORK) }
    }

    /// From the leaves to the roots: `visit(supernode, own data, parts of its children, memory)` gives the
    /// part for its parent.
    ///
    /// # Errors
    /// That of the first supernode, in the order of elimination, of those that were visited.
    pub(super) fn ascend<E: Send>(
        &self,
        data: &mut [f64],
        visit: &(impl Fn(usize, &mut [f64], &[Vec<f64>], &mut Spare) -> Result<Vec<f64>, E> + Sync),
    ) -> Result<(), E> {
        self.ascend_each(self.symbolic.roots(), data, visit).map(|_| ())
    }

    /// Walks the subtrees of neighbouring siblings, which `data` belong to.
    fn ascend_each<E: Send>(
        &self,
        siblings: &[u32],
        data: &mut [f64],
        visit: &(impl Fn(usize, &mut [f64], &[Vec<f64>], &mut Spare) -> Result<Vec<f64>, E> + Sync),
    ) -> Result<Vec<Vec<f64>>, E> {
        let (&[first, ..], &[.., last]) = (siblings, siblings) else {
            return Ok(Vec::new());
        };
        let work: f64 = siblings.iter().map(|&s| (self.work)(s as usize)).sum();
        if work <= self.grain {
            return self.ascend_serially(
                self.symbolic.first_below(first as usize),
                last as usize,
                data,
                visit,
            );
        }
        if siblings.len() > 1 {
            let (left, right) = siblings.split_at(siblings.len() / 2);
            let (before, after) = data.split_at_mut(self.length_of(left));
            let (left, right) = rayon::join(
                || self.ascend_each(left, before, visit),
                || self.ascend_each(right, after, visit),
            );
            let mut parts = left?;
            parts.append(&mut right?);
            return Ok(parts);
        }
        // Alone: go down to where the tree branches, then up again.
        let chain = self.chain(first as usize);
        let branching = chain[chain.len() - 1];
        let below = self.start[branching] - self.start[self.symbolic.first_below(first as usize)];
        let (below, mut above) = data.split_at_mut(below);
        let mut parts = self.ascend_each(self.symbolic.children(branching), below, visit)?;
        let mut spare = Spare::default();
        for &s in chain.iter().rev() {
            let (own, rest) = above.split_at_mut(self.start[s + 1] - self.start[s]);
            above = rest;
            let part = visit(s, own, &parts, &mut spare)?;
            parts.drain(..).for_each(|part| spare.give_back(part));
            parts.push(part);
        }
        Ok(parts)
    }

    fn ascend_serially<E>(
        &self,
        first: usize,
        last: usize,
        data: &mut [f64],
        visit: &impl Fn(usize, &mut [f64], &[Vec<f64>], &mut Spare) -> Result<Vec<f64>, E>,
    ) -> Result<Vec<Vec<f64>>, E> {
        let (mut parts, mut spare) = (Vec::<Vec<f64>>::new(), Spare::default());
        for s in first..=last {
            let own = &mut data[self.start[s] - self.start[first]..self.start[s + 1] - self.start[first]];
            let taken = parts.len() - self.symbolic.children(s).len();
            let part = visit(s, own, &parts[taken..], &mut spare)?;
            parts.drain(taken..).for_each(|part| spare.give_back(part));
            parts.push(part);
        }
        Ok(parts)
    }

    /// From the roots to the leaves: `visit(supernode, own data, part from its parent, memory)` gives the
    /// parts for its children, in their order. Roots get an empty part.
    pub(super) fn descend(
        &self,
        data: &mut [f64],
        visit: &(impl Fn(usize, &mut [f64], &[f64], &mut Spare) -> Vec<Vec<f64>> + Sync),
    ) {
        let roots = self.symbolic.roots();
        self.descend_each(roots, vec![Vec::new(); roots.len()], data, visit);
    }

    fn descend_each(
        &self,
        siblings: &[u32],
        mut parts: Vec<Vec<f64>>,
        data: &mut [f64],
        visit: &(impl Fn(usize, &mut [f64], &[f64], &mut Spare) -> Vec<Vec<f64>> + Sync),
    ) {
        let (&[first, ..], &[.., last]) = (siblings, siblings) else {
            return;
        };
        let work: f64 = siblings.iter().map(|&s| (self.work)(s as usize)).sum();
        if work <= self.grain {
            self.descend_serially(
                self.symbolic.first_below(first as usize),
                last as usize,
                parts,
                data,
                visit,
            );
            return;
        }
        if siblings.len() > 1 {
            let (left, right) = siblings.split_at(siblings.len() / 2);
            let (before, after) = data.split_at_mut(self.length_of(left));
            let right_parts = parts.split_off(left.len());
            rayon::join(
                || self.descend_each(left, parts, before, visit),
                || self.descend_each(right, right_parts, after, visit),
            );
            return;
        }
        let chain = self.chain(first as usize);
        let (mut rest, mut spare) = (data, Spare::default());
        for &s in &chain {
            let own_length = self.start[s + 1] - self.start[s];
            let (below, own) = rest.split_at_mut(rest.len() - own_length);
            rest = below;
            let next = visit(s, own, &parts[0], &mut spare);
            parts.drain(..).for_each(|part| spare.give_back(part));
            parts = next;
        }
        let branching = chain[chain.len() - 1];
        self.descend_each(self.symbolic.children(branching), parts, rest, visit);
    }

    fn descend_serially(
        &self,
        first: usize,
        last: usize,
        mut parts: Vec<Vec<f64>>,
        data: &mut [f64],
        visit: &impl Fn(usize, &mut [f64], &[f64], &mut Spare) -> Vec<Vec<f64>>,
    ) {
        let mut spare = Spare::default();
        for s in (first..=last).rev() {
            let own = &mut data[self.start[s] - self.start[first]..self.start[s + 1] - self.start[first]];
            let Some(part) = parts.pop() else {
                unreachable!("every supernode gets its part before it is visited")
            };
            parts.append(&mut visit(s, own, &part, &mut spare));
            spare.give_back(part);
        }
    }

    /// A supernode and those below it, as long as each has one child only.
    fn chain(&self, top: usize) -> Vec<usize> {
        let mut chain = vec![top];
        while let &[child] = self.symbolic.children(chain[chain.len() - 1]) {
            chain.push(child as usize);
        }
        chain
    }

    /// Numbers of data of the subtrees of siblings.
    fn length_of(&self, siblings: &[u32]) -> usize {
        let (first, last) = (siblings[0] as usize, siblings[siblings.len() - 1] as usize);
        self.start[last + 1] - self.start[self.symbolic.first_below(first)]
    }
}

/// Calls `work(first, part)` for pieces of `piece` columns each of a column-major matrix with columns of
/// `stride` numbers, side by side where there are several.
pub(super) fn by_columns(
    values: &mut [f64],
    stride: usize,
    piece: usize,
    work: impl Fn(usize, &mut [f64]) + Sync,
) {
    if stride == 0 {
        return;
    }
    if values.len() <= piece * stride {
        work(0, values);
        return;
    }
    values.par_chunks_mut(piece * stride).enumerate().for_each(|(at, part)| work(at * piece, part));
}
