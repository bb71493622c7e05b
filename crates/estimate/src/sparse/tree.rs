//! Parallel traversal of the tree of supernodes.
//!
//! Input: a symbolic analysis, data in the order of the supernodes, and a function to apply to each
//! supernode. Output: the data, changed in place. Upwards, a supernode receives results of its children;
//! downwards, of its parent.
//!
//! A result depends only on the children or the parent, so it has the same bytes for any number of threads.
//! One thread processes a subtree with little work in a single loop, with a stack of intermediate results: in
//! postorder the results of the children are always on top.

use rayon::prelude::*;

use super::SymbolicFactor;

/// Subtrees with less than this fraction of the total work are processed by one thread, as are trees below
/// [`MIN_PARALLEL_WORK`] operations.
const SERIAL_SHARE: f64 = 1.0 / 48.0;
/// Minimum number of operations for parallel work: waking a second thread costs about 10 µs.
const MIN_PARALLEL_WORK: f64 = 2e5;

/// Buffers of one thread for reuse.
#[derive(Default)]
pub(super) struct Spare(Vec<Vec<f64>>);

impl Spare {
    /// A buffer of at least `length` values with unspecified contents.
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

/// A traversal: the start of the data of each supernode, and the work of each subtree.
pub(super) struct Walk<'a> {
    symbolic: &'a SymbolicFactor,
    /// Start of the data of each supernode, and the end.
    start: &'a [usize],
    /// Operations of the subtree that ends in a supernode.
    work: &'a (dyn Fn(usize) -> f64 + Sync),
    /// Subtrees of at most this work are processed by one thread.
    grain: f64,
}

impl<'a> Walk<'a> {
    pub(super) fn new(
        symbolic: &'a SymbolicFactor,
        start: &'a [usize],
        work: &'a (dyn Fn(usize) -> f64 + Sync),
    ) -> Self {
        let total: f64 = symbolic.roots().iter().map(|&root| work(root as usize)).sum();
        // The share of the total work, not the number of threads, decides about tasks: the split is the same
        // on every machine.
        Self { symbolic, start, work, grain: (SERIAL_SHARE * total).max(MIN_PARALLEL_WORK) }
    }

    /// Traverses from the leaves to the roots: `visit(supernode, own data, parts of its children, buffers)`
    /// returns the part for its parent.
    ///
    /// # Errors
    /// The error of the first failing supernode, in elimination order, among those that were visited.
    pub(super) fn ascend<E: Send>(
        &self,
        data: &mut [f64],
        visit: &(impl Fn(usize, &mut [f64], &[Vec<f64>], &mut Spare) -> Result<Vec<f64>, E> + Sync),
    ) -> Result<(), E> {
        self.ascend_each(self.symbolic.roots(), data, visit).map(|_| ())
    }

    /// Traverses the subtrees of adjacent siblings; `data` are theirs.
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
            // The left error comes first although both sides have run, so that the message does not depend on
            // timing.
            let mut parts = left?;
            parts.append(&mut right?);
            return Ok(parts);
        }
        // A single subtree: process what is below its first branching in parallel, then its chain upwards.
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
            // In postorder, the results of the children are the last ones on the stack.
            let first_part = parts.len() - self.symbolic.children(s).len();
            let part = visit(s, own, &parts[first_part..], &mut spare)?;
            parts.drain(first_part..).for_each(|part| spare.give_back(part));
            parts.push(part);
        }
        Ok(parts)
    }

    /// Traverses from the roots to the leaves: `visit(supernode, own data, part from its parent, buffers)`
    /// returns the parts for its children, in their order. Roots receive an empty part.
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
            // In postorder, the data of a supernode follow those of its subtree.
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
        // Backwards through the postorder, the part of the next supernode is always the last one on the
        // stack.
        for s in (first..=last).rev() {
            let own = &mut data[self.start[s] - self.start[first]..self.start[s + 1] - self.start[first]];
            let Some(part) = parts.pop() else {
                unreachable!("a supernode is visited after its parent pushed its part")
            };
            parts.append(&mut visit(s, own, &part, &mut spare));
            spare.give_back(part);
        }
    }

    /// A supernode and its descendants, as long as each has exactly one child.
    fn chain(&self, top: usize) -> Vec<usize> {
        let mut chain = vec![top];
        while let &[child] = self.symbolic.children(chain[chain.len() - 1]) {
            chain.push(child as usize);
        }
        chain
    }

    /// Length of the data of the subtrees of siblings.
    fn length_of(&self, siblings: &[u32]) -> usize {
        let (first, last) = (siblings[0] as usize, siblings[siblings.len() - 1] as usize);
        self.start[last + 1] - self.start[self.symbolic.first_below(first)]
    }
}

/// Calls `work(first, part)` in parallel for blocks of `piece` columns of a column-major matrix with columns
/// of length `stride`.
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
