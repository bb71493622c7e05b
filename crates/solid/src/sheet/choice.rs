//! Chooses the groups of curves that are the views.

use super::groups::{CurveGroup, joined_box};
use super::{Projection, SheetBox};
use crate::drawing::ViewKind;

/// Maximum difference of aligned sides of two views, relative to the size of all views.
///
/// A larger value accepts views of different scales; a smaller one rejects inaccurate drawings.
pub(super) const MAX_MISALIGNMENT: f64 = 2e-3;
/// Maximum number of readings.
const MAX_CHOICES: usize = 6;

/// Groups as views.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Choice {
    /// Front, top, side.
    pub views: Vec<(ViewKind, CurveGroup)>,
    pub projection: Projection,
    /// Whether the places of the views were given.
    pub are_given: bool,
}

/// An error with the first curve of a group.
type NoChoice = (Option<usize>, String);

/// The choices of views, best first. `symbol` is the convention that the title block shows.
pub(super) fn choices(
    groups: &[CurveGroup],
    given: Option<Projection>,
    symbol: Option<Projection>,
) -> Result<Vec<Choice>, NoChoice> {
    if groups.len() < 2 {
        return Err((
            None,
            format!(
                "expected two or three separate views on one sheet, found {}: specify the files of all views \
                 if each view has its own",
                groups.len()
            ),
        ));
    }
    let chooser = Chooser::new(groups);
    let mut found: Vec<(f64, Choice)> = Vec::new();
    for projection in [Projection::FirstAngle, Projection::ThirdAngle] {
        for front in 0..groups.len() {
            chooser.add_choices(front, projection, &mut found);
        }
    }
    // A choice that leaves out a view of the sheet could give a part that the sheet does not show.
    let views = found.iter().map(|(_, choice)| choice.views.len()).max().unwrap_or(0);
    found.retain(|(_, choice)| choice.views.len() == views && given.is_none_or(|p| p == choice.projection));
    if found.is_empty() {
        return Err(chooser.explain(given));
    }
    // Two views leave the convention open: that of the symbol first, then the first angle.
    let is_usual = |choice: &Choice| choice.projection == symbol.unwrap_or(Projection::FirstAngle);
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(is_usual(&b.1).cmp(&is_usual(&a.1))));
    let best = found[0].0;
    let choices = found.into_iter().take_while(|(value, _)| *value >= best - 1e-9);
    let choices: Vec<Choice> = choices.map(|(_, choice)| choice).take(MAX_CHOICES).collect();
    Ok(choices.into_iter().map(|choice| chooser.with_sections(choice)).collect())
}

struct Chooser<'a> {
    groups: &'a [CurveGroup],
    near: f64,
}

impl<'a> Chooser<'a> {
    fn new(groups: &'a [CurveGroup]) -> Self {
        let bounds = joined_box(groups.iter().map(|g| g.bounds));
        let size = bounds.iter().map(|s| s[1] - s[0]).fold(0.0, f64::max);
        Self { groups, near: MAX_MISALIGNMENT * size }
    }

    /// Whether two groups share both sides along an axis: stacked views share left and right, neighbours
    /// beside each other bottom and top. A section may show less than the whole part.
    fn are_aligned(&self, a: usize, b: usize, axis: usize) -> bool {
        let [first, second]: [&SheetBox; 2] = [a, b].map(|k| &self.groups[k].bounds);
        let is_within = |inner: &SheetBox, outer: &SheetBox| {
            inner[axis][0] >= outer[axis][0] - self.near && inner[axis][1] <= outer[axis][1] + self.near
        };
        (0..2).all(|e| (first[axis][e] - second[axis][e]).abs() <= self.near)
            || self.groups[a].is_section && is_within(first, second)
            || self.groups[b].is_section && is_within(second, first)
    }

    /// Adds all choices with a front view, and their values.
    fn add_choices(&self, front: usize, projection: Projection, found: &mut Vec<(f64, Choice)>) {
        let others = || (0..self.groups.len()).filter(move |g| *g != front);
        let own = &self.groups[front].bounds;
        let is_top = |g: &usize| {
            let is_above = self.groups[*g].bounds[1][0] > own[1][0];
            self.are_aligned(front, *g, 0) && is_above == (projection == Projection::ThirdAngle)
        };
        let is_side = |g: &usize| self.are_aligned(front, *g, 1) && !self.are_aligned(front, *g, 0);
        let tops: Vec<Option<usize>> = others().filter(is_top).map(Some).chain([None]).collect();
        let sides: Vec<Option<usize>> = others().filter(is_side).map(Some).chain([None]).collect();
        for top in &tops {
            for side in &sides {
                let depths = [top.map(|g| self.groups[g].extent(1)), side.map(|g| self.groups[g].extent(0))];
                let agree = match depths {
                    [None, None] => false,
                    [Some(a), Some(b)] => {
                        let is_section = |g: &Option<usize>| g.is_some_and(|g| self.groups[g].is_section);
                        (a - b).abs() <= self.near || is_section(top) && a < b || is_section(side) && b < a
                    }
                    _ => true,
                };
                if agree {
                    found.push(self.choice(front, *top, *side, projection));
                }
            }
        }
    }

    fn choice(
        &self,
        front: usize,
        top: Option<usize>,
        side: Option<usize>,
        projection: Projection,
    ) -> (f64, Choice) {
        let mut views = vec![(ViewKind::Front, self.groups[front].clone())];
        views.extend(top.map(|g| (ViewKind::Top, self.groups[g].clone())));
        if let Some(g) = side {
            let is_right = self.groups[g].bounds[0][0] > self.groups[front].bounds[0][0];
            let kind = match is_right == (projection == Projection::ThirdAngle) {
                true => ViewKind::Side,
                false => ViewKind::Left,
            };
            views.push((kind, self.groups[g].clone()));
        }
        // Each view counts beside its curves, so that three plain views are better than a rich one and a
        // table.
        // A section lacks what is before its plane.
        let share = |group: &CurveGroup| if group.is_section { 0.5 } else { 1.0 };
        let value = |group: &CurveGroup| share(group) * ((1.0 + group.curves.len() as f64).ln() + 1.0);
        let total = views.iter().map(|(_, group)| value(group)).sum();
        (total, Choice { views, projection, are_given: false })
    }

    /// The choice with the sections beside its views, each seen as the view in its row or column.
    fn with_sections(&self, mut choice: Choice) -> Choice {
        let is_used = |g: usize| choice.views.iter().any(|(_, used)| *used == self.groups[g]);
        let sections: Vec<usize> =
            (0..self.groups.len()).filter(|g| self.groups[*g].is_section && !is_used(*g)).collect();
        let Some(front) = self.groups.iter().position(|g| *g == choice.views[0].1) else { return choice };
        for g in sections {
            let (own, group) = (&self.groups[front].bounds, &self.groups[g]);
            let is_third = choice.projection == Projection::ThirdAngle;
            let [is_right, is_above] = [0, 1].map(|k| group.bounds[k][0] > own[k][0]);
            if self.are_aligned(front, g, 1) {
                let kind = if is_right == is_third { ViewKind::Side } else { ViewKind::Left };
                choice.views.push((kind, group.clone()));
            } else if self.are_aligned(front, g, 0) && is_above == is_third {
                choice.views.push((ViewKind::Top, group.clone()));
            }
        }
        choice
    }

    /// Why there is no choice.
    fn explain(&self, given: Option<Projection>) -> NoChoice {
        // The group with the most curves is a view most likely.
        let (front, _) = (self.groups.iter().enumerate())
            .max_by_key(|(_, g)| g.curves.len())
            .unwrap_or((0, &self.groups[0]));
        let other = (0..self.groups.len())
            .filter(|g| *g != front)
            .max_by_key(|g| self.groups[*g].curves.len())
            .unwrap_or(front);
        let [[left, right], [bottom, top]] = self.groups[other].bounds;
        let convention = match given {
            Some(Projection::FirstAngle) => " in the first-angle convention",
            Some(Projection::ThirdAngle) => " in the third-angle convention",
            None => "",
        };
        let text = format!(
            "expected views of one scale, aligned with the front view, found a view ({left:.3} to \
             {right:.3}, {bottom:.3} to {top:.3}) that is neither at the position of the top view nor at \
             that of a side view{convention}"
        );
        (Some(self.groups[other].curves[0]), text)
    }
}
