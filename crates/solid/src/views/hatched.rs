//! What the hatches of a section state: which cells in the cutting plane are solid.

use super::cells::{Cells, is_plain};
use super::column::SurfaceId;
use super::sight::{Expected, SightTest, SightTestPlace, SightTests};
use crate::drawing::Drawing;

/// Positions of samples within a box of the grid, as shares. Unequal, so that they avoid planes of symmetry.
const SHARES: [f64; 6] = [0.04, 0.19, 0.37, 0.58, 0.79, 0.95];

impl SightTests {
    /// Adds the states of cells in the cutting plane of a section.
    pub(super) fn at_hatches(&mut self, cells: &Cells, drawing: &Drawing, view: usize) {
        let plan = cells.plan;
        let Some((_, hatch)) = &plan.views[view].cut else { return };
        let [right, up, along] = plan.views[view].kind.axes();
        for i in 0..plan.intervals(right) {
            for j in 0..plan.intervals(up) {
                let divided = (0..plan.intervals(along)).any(|k| {
                    let mut cell = [0; 3];
                    (cell[right], cell[up], cell[along]) = (i, j, k);
                    !is_plain(plan, cell)
                });
                let shares = if divided { &SHARES[..] } else { &[0.47][..] };
                let at = |axis: usize, k: usize, share: f64| {
                    plan.grid[axis][k] + share * (plan.grid[axis][k + 1] - plan.grid[axis][k])
                };
                for s in shares {
                    for t in shares {
                        let at = [at(right, i, *s), at(up, j, *t)];
                        if drawing.views[view].is_near_border(at, plan.size) {
                            continue;
                        }
                        let Some(is_hatched) = hatch.contains(at, &drawing.views[view].curves) else {
                            continue;
                        };
                        let column = cells.column(view, at);
                        let behind = column.breaks.first().filter(|b| b.surface == SurfaceId::Cut);
                        let cell = behind.map_or(column.start, |b| b.cell);
                        let expected = Expected::Material(is_hatched);
                        let test = SightTest { expected, start: [cell; 2], groups: Vec::new() };
                        self.add_test(test, SightTestPlace { view, at, curve: None });
                    }
                }
            }
        }
    }
}
