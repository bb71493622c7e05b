//! Sections: what of a solid lies behind the cutting plane, and whether its material in the plane is where
//! the view is hatched.

use super::outlines::Outline;
use super::scene::{Eye, Scene};
use super::{Difference, Disagreement};
use crate::drawing::View;

/// Number of sample places along each side of a section. More find smaller differences and take more time.
const SAMPLES: usize = 48;
/// Minimum number of samples of a reported difference. A single one may be at the border of a region.
const MIN_PLACES: usize = 2;

/// The parts of lines that are behind the cutting plane by more than a distance.
pub(super) fn behind(lines: Vec<Outline>, eye: Eye, near: f64) -> Vec<Outline> {
    let mut found = Vec::new();
    for line in lines {
        // A piece that crosses the plane is left out; lines at the plane are borders of the material.
        for points in line.points.chunk_by(|a, b| eye.is_behind_cut(*a, near) && eye.is_behind_cut(*b, near))
        {
            if points.len() > 1 {
                found.push(Outline { points: points.to_vec(), ..line });
            }
        }
    }
    found
}

/// Where a section is hatched and the solid is empty in the cutting plane, or the reverse.
pub(super) fn wrong_hatches(view: &View, scene: &Scene<'_>, eye: Eye) -> Vec<Disagreement> {
    let Some(section) = view.section() else { return Vec::new() };
    let bounds = view.curves.iter().map(|c| c.curve.bounds()).fold([[f64::MAX, f64::MIN]; 2], |all, own| {
        [0, 1].map(|k| [all[k][0].min(own[k][0]), all[k][1].max(own[k][1])])
    });
    let mut wrong: [Vec<[f64; 2]>; 2] = Default::default();
    for i in 0..SAMPLES {
        for j in 0..SAMPLES {
            // Unequal shares, so that samples avoid planes of symmetry.
            let shares = [(i as f64 + 0.37) / SAMPLES as f64, (j as f64 + 0.43) / SAMPLES as f64];
            let at = [0, 1].map(|k| bounds[k][0] + shares[k] * (bounds[k][1] - bounds[k][0]));
            if view.is_near_border(at, scene.size) {
                continue;
            }
            let Some(is_hatched) = section.hatch.contains(at, &view.curves) else { continue };
            if is_hatched != scene.cut_body(eye, at).is_some() {
                wrong[usize::from(is_hatched)].push(at);
            }
        }
    }
    let enough = |(_, places): &(usize, Vec<[f64; 2]>)| places.len() >= MIN_PLACES;
    let named = wrong.into_iter().enumerate().filter(enough);
    named
        .map(|(hatched, places)| Disagreement {
            view: view.kind,
            entity: None,
            places,
            difference: Difference::Hatching { is_hatched: hatched == 1 },
        })
        .collect()
}
