//! How each place of the fitted surface is known: by its readings, by inferred readings, by the earlier
//! model, or by the prior alone.

use super::Finishing;
use crate::fit::leaves::with_neighbours;
use crate::fit::support::{OCCUPANCY_DEPTH, Occupancy, Supporters, collapsed, occupancy_at, supported_cells};
use crate::model::{Observed, Support, SupportCell, SurfaceModel, is_closed, middles};
use crate::observe::Quantity;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_spline::Surface;

/// Half side of the square around the foot of a reading that is not followed, as a share of the leaf: about
/// the side of a cell of marks.
const NOT_FOLLOWED_AROUND: f64 = 0.125;

impl Finishing<'_> {
    /// Adds to a model how each of its places is known, and the errors of those without readings. At the
    /// given places of leaves, and on the given regions of leaves, the surface does not follow its readings.
    ///
    /// # Errors
    /// See [`Finishing::predictive_sigma`].
    pub(super) fn add_support(
        &self,
        model: &mut SurfaceModel,
        not_followed: &[(usize, [f64; 2])],
        regions: &[Vec<usize>],
    ) -> Result<()> {
        let (mut support, measured) = self.support(model)?;
        for &(leaf, local) in not_followed {
            let box_around = [-1.0, 1.0].map(|side| local.map(|x| x + side * NOT_FOLLOWED_AROUND));
            support.set_not_followed(leaf, box_around);
        }
        for &leaf in regions.iter().flatten() {
            support.set_not_followed(leaf, [[0.0; 2], [1.0; 2]]);
        }
        model.observed =
            (0..model.surface.space().leaves().len()).map(|leaf| support.of_leaf(leaf)).collect();
        model.support = support;
        if let Some(measured) = measured {
            model.predictive = self.predictive_sigma(model, &measured)?;
        }
        Ok(())
    }

    /// The support of every place of the model's surface, and the readings that give it.
    ///
    /// # Errors
    /// `Undetermined` if the readings cannot be searched.
    pub(super) fn support(&self, model: &SurfaceModel) -> Result<(Support, Option<Supporters>)> {
        let surface = &model.surface;
        let mut occupied: Vec<Occupancy> = match self.added {
            Some(added) => added.occupied.clone(),
            None => vec![0; surface.space().leaves().len()],
        };
        let (mut points, mut normals) = self.feet_points(surface, |k| self.is_measured_foot(k));
        self.places_of_batches(surface, &mut points, &mut normals);
        for (k, foot) in self.feet.iter().enumerate() {
            if self.supports(k) && self.is_measured_foot(k) {
                occupied[foot.leaf as usize] |= occupancy_at(foot.local);
            }
        }
        let Some(measured) = Supporters::new(points, normals)? else {
            return Ok((Support::default(), None));
        };
        let measured = if is_closed(surface.space()) { measured.on_closed_surface() } else { measured };
        let inferred = {
            let (points, normals) = self.feet_points(surface, |k| !self.is_measured_foot(k));
            Supporters::new(points, normals)?
        };
        let cells = supported_cells(surface, &occupied, &measured, inferred.as_ref());
        let support = Support::new(match self.earlier {
            None => cells,
            Some(earlier) => with_earlier(surface, cells, earlier),
        })?;
        Ok((support, Some(measured)))
    }

    /// True if foot `k` belongs to a position that takes part, on a surface with its neighbours: gross errors
    /// support no surface that follows them.
    pub(super) fn supports(&self, k: usize) -> bool {
        self.information[k] > 0.0
            && self.feet[k].quantity == Quantity::Position
            && self.observations.readings.on_surface[self.subset[k] as usize]
    }

    /// Feet of positions that take part and count, and the surface's normals there.
    fn feet_points(&self, surface: &Surface, counts: impl Fn(usize) -> bool) -> (Vec<DVec3>, Vec<DVec3>) {
        let point = |k: usize| {
            let foot = &self.feet[k];
            (surface.leaf_point(foot.leaf as usize, foot.local[0], foot.local[1]), foot.normal)
        };
        (0..self.feet.len()).filter(|&k| self.supports(k) && counts(k)).map(point).unzip()
    }

    /// Adds the middles of bins that readings of further batches occupy, in leaves with empty bins and around
    /// them. Full leaves are recognised without.
    fn places_of_batches(&self, surface: &Surface, points: &mut Vec<DVec3>, normals: &mut Vec<DVec3>) {
        let Some(added) = self.added else { return };
        let open: Vec<bool> = added.occupied.iter().map(|bins| *bins != Occupancy::MAX).collect();
        let near = with_neighbours(surface.space(), &open);
        for (leaf, bins) in added.occupied.iter().enumerate().filter(|(leaf, _)| near[*leaf]) {
            for local in middles(OCCUPANCY_DEPTH).filter(|local| bins & occupancy_at(*local) != 0) {
                let jet = surface.leaf_jet(leaf, local[0], local[1]);
                if let Some(normal) = jet.normal() {
                    points.push(jet.point);
                    normals.push(normal);
                }
            }
        }
    }
}

/// What the earlier model knew stays known.
///
/// Cells may have been divided since, so places are looked up by their parameters.
fn with_earlier(
    surface: &Surface,
    cells: Vec<(u8, Vec<SupportCell>)>,
    earlier: &SurfaceModel,
) -> Vec<(u8, Vec<SupportCell>)> {
    let before = |leaf: usize, local: [f64; 2]| {
        let [u, v] = surface.space().parameters(leaf, local);
        let (old, at) = earlier.surface.space().locate(u, v);
        let distance = match earlier.support.is_empty() {
            true => f64::INFINITY,
            false => earlier.support.at(old, at).distance,
        };
        (old, SupportCell { observed: earlier.observed_at(old, at), distance })
    };
    (cells.into_iter().enumerate())
        .map(|(leaf, (depth, cells))| {
            if cells.iter().all(|cell| cell.observed.is_measured()) {
                return (depth, cells);
            }
            let old = before(leaf, [0.5; 2]).0;
            let finest = earlier.support.depth(old).max(depth);
            let merged = middles(finest).map(|local| {
                let now = Support::cell_of(depth, &cells, local);
                let was = before(leaf, local).1;
                match (now.observed, was.observed) {
                    (Observed::Measured, _) | (_, Observed::Measured) => {
                        SupportCell { observed: Observed::Measured, distance: 0.0 }
                    }
                    (Observed::PriorOnly, was_observed) => {
                        SupportCell { observed: was_observed, distance: now.distance.min(was.distance) }
                    }
                    (observed, _) => SupportCell { observed, distance: now.distance.min(was.distance) },
                }
            });
            collapsed(finest, merged.collect())
        })
        .collect()
}
