//! Points of a surface from its occluding contours in views of known cameras.
//!
//! Comes in: [`ContourView`]s in the order in which a camera took them. Goes out: [`OccludingContours`]:
//! places with covariance and normals, in strips that hang together, and what was left out for which reason.
//!
//! | module | what |
//! |---|---|
//! | outline | from masks to contours in order |
//! | curve | place, tangent and σ along a contour |
//! | circle | depth and radius from three lines of sight |
//! | matching | which place of the next view is on the same epipolar curve |
//! | joining | what contradicts itself between views, the circle's own error, strips |
//! | organised | a mesh of each strip, its depths regularised |
//! | hull | what every silhouette leaves of space, and which of its surface no contour saw |
//!
//! A contour that a smooth surface draws is no curve on it that stands still: it glides over the surface as
//! the camera moves. Its places in consecutive views are matched along epipolar planes; all three lines of
//! sight of a place and its matches touch the surface's section, and the circle that they touch tells the
//! depth (`circle`). The normal needs no depth: it stands on the line of sight and on the tangent of the
//! contour.
//!
//! Left out and counted are places at corners and where one part hides another (`corner`), views without a
//! neighbour on either side (`end_of_sequence`), lines of sight along the motion (`along_baseline`), frontier
//! points, where the epipolar plane touches the surface and every depth fits (`frontier`), places without a
//! match that an opaque surface allows (`no_match`), those that lie outside of another view's silhouette
//! (`outside_silhouette`), whose match comes back elsewhere (`not_mutual`), whose depth is hardly known
//! (`uncertain`), and strips of a few places (`speck`).
//!
//! Not guaranteed: what no contour saw. Where a surface is concave along every line of sight, no view has a
//! contour, however many there are; see [`VisualHull::unseen_share`]. Edges come out as places of radius
//! zero, whose normals turn freely.
//!
//! # References
//! As in `circle`, and P. Giblin, R. Weiss, *Epipolar fields on surfaces*, ECCV 1994, for what degenerates at
//! frontier points.

mod circle;
mod curve;
mod hull;
mod joining;
mod matching;
mod organised;
mod outline;

#[cfg(test)]
mod tests;

pub use hull::{SilhouetteBound, VisualHull};
pub use outline::{Contour, outlines};

use crate::Scan;
use crate::stripes::Pinhole;
use circle::Eye;
use curve::{Curve, Local};
use planish_estimate::vector3::{distance, upper_triangle};
use planish_estimate::{Error, Result};
use planish_mesh::TriangleMesh;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Two views are no neighbours where the camera's step is so many times its median step.
const LONG_STEP: f64 = 2.5;
/// Places along a contour lie so far apart, in half widths of the window: by then the parabolas of neighbours
/// share no more information than there is.
const SPACING: f64 = 0.9;

/// What one view saw.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourView {
    /// What messages call it.
    pub name: String,
    /// Its camera.
    pub camera: Pinhole,
    /// Where contours are measured.
    pub contours: Vec<Contour>,
    /// The whole outline, against which places of other views are checked; empty where it is not known.
    pub silhouette: Vec<Contour>,
    /// σ of a place across its contour, in pixels.
    pub sigma_px: f64,
    /// Places nearer than this along a contour err alike, in pixels; 0 where each errs for itself.
    pub apart_px: f64,
}

/// How contours are read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OccludingOptions {
    /// Half the width of the window along a contour in which place and tangent are told, in pixels.
    pub half_window_px: f64,
    /// A tangent of a contour nearer than this to the epipolar line is taken for a frontier point, in
    /// degrees.
    pub frontier_deg: f64,
    /// Lines of sight that turn by more than this from view to view tell nothing, in degrees.
    pub most_turn_deg: f64,
    /// Depths with a larger σ, as a share of themselves, are left out.
    pub most_sigma_share: f64,
    /// Strips of fewer places are left out.
    pub least_places: usize,
}

impl Default for OccludingOptions {
    fn default() -> Self {
        Self {
            half_window_px: 6.0,
            frontier_deg: 15.0,
            most_turn_deg: 50.0,
            most_sigma_share: 0.05,
            least_places: 24,
        }
    }
}

/// A place of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OccludingPoint {
    /// The view whose line of sight it lies on.
    pub view: usize,
    /// Its contour in that view, and its number along it.
    pub contour: usize,
    /// As above.
    pub place: usize,
    /// The pixel.
    pub pixel: [f64; 2],
    /// Where it is, in the unit of the cameras.
    pub position: [f64; 3],
    /// Covariance of the position, by the σ of the contours and what the circle leaves out.
    pub covariance: [[f64; 3]; 3],
    /// Unit normal, outwards.
    pub normal: [f64; 3],
    /// σ of the normal about each of two axes across it, in degrees: the root of the mean of the variances of
    /// the contour's tangent, and of where along the line of sight the surface is touched.
    pub sigma_normal_deg: f64,
    /// σ of the depth.
    pub sigma_depth: f64,
    /// The part of it that the circle leaves out.
    pub sigma_circle: f64,
    /// Radius of the section along the line of sight and the normal, and its σ.
    pub radius: f64,
    /// As above.
    pub sigma_radius: f64,
    /// The strip that it is of, the largest first.
    pub strip: usize,
    /// How far the places of neighbouring views and of the same contour are.
    pub reach: f64,
}

impl OccludingPoint {
    /// σ of the position along the normal.
    #[must_use]
    pub fn sigma_along_normal(&self) -> f64 {
        let (c, n) = (&self.covariance, &self.normal);
        let variance: f64 = (0..3).map(|i| (0..3).map(|j| n[i] * c[i][j] * n[j]).sum::<f64>()).sum();
        variance.max(0.0).sqrt()
    }
}

/// What contours told.
#[derive(Debug, Clone, Default)]
pub struct OccludingContours {
    /// Places, strip after strip, in each by view and along its contours.
    pub points: Vec<OccludingPoint>,
    /// Their positions with depths regularised along contours and between views, for meshes.
    pub relaxed: Vec<[f64; 3]>,
    /// Triangles between the contours of consecutive views, facing outwards, over `points`.
    pub triangles: Vec<[u32; 3]>,
    /// Places along contours that were asked.
    pub asked: usize,
    /// Those left out, by cause.
    pub left_out: BTreeMap<&'static str, usize>,
    /// Places that have a match in a neighbouring view.
    pub matched: usize,
    /// χ² of the contours' places about their parabolas over its degrees of freedom: 1 where σ in pixels is
    /// true and places err independently.
    pub reduced_chi_square: f64,
    /// Strips.
    pub strips: usize,
    /// Runs of views that follow one another.
    pub sequences: usize,
}

impl OccludingContours {
    /// The mesh of one strip: contours of consecutive views joined by their matches, with regularised depths;
    /// and σ along the normals of its vertices.
    ///
    /// # Errors
    /// `Undetermined` for a strip without triangles.
    pub fn patch(&self, strip: usize) -> Result<(TriangleMesh, Vec<f64>)> {
        let mut index = vec![u32::MAX; self.points.len()];
        let (mut positions, mut sigma) = (Vec::new(), Vec::new());
        let mut triangles = Vec::new();
        for t in &self.triangles {
            if self.points[t[0] as usize].strip != strip {
                continue;
            }
            triangles.push(t.map(|v| {
                let v = v as usize;
                if index[v] == u32::MAX {
                    index[v] = positions.len() as u32;
                    positions.push(self.relaxed[v]);
                    sigma.push(self.points[v].sigma_along_normal());
                }
                index[v]
            }));
        }
        if triangles.is_empty() {
            return Err(Error::undetermined(format!("strip {} has no triangles", strip + 1)));
        }
        Ok((TriangleMesh::try_new(positions, triangles)?, sigma))
    }

    /// The places of one strip, or of all, as a scan.
    #[must_use]
    pub fn scan(&self, strip: Option<usize>, name: &str) -> Scan {
        let chosen: Vec<&OccludingPoint> =
            (self.points.iter()).filter(|p| strip.is_none_or(|strip| p.strip == strip)).collect();
        Scan {
            name: name.to_owned(),
            points: chosen.iter().map(|p| p.position).collect(),
            covariance: Some(chosen.iter().map(|p| upper_triangle(|i, j| p.covariance[i][j])).collect()),
            normals: Some(chosen.iter().map(|p| p.normal).collect()),
            sigma_normal_deg: Some(chosen.iter().map(|p| p.sigma_normal_deg).collect()),
            ..Scan::default()
        }
    }
}

/// Places along one contour of a view.
struct Line<'a> {
    curve: Curve<'a>,
    step: f64,
    places: Vec<Option<Local>>,
}

/// A view made ready.
struct Ready<'a> {
    eye: Eye,
    lines: Vec<Line<'a>>,
}

/// A place along a contour.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spot {
    line: usize,
    length: f64,
}

/// Finds places of a surface from its occluding contours.
///
/// Views follow one another in the order given; where the camera jumps by more than 2.5 of its median steps a
/// new sequence begins, and where its last view is as near to the first as others are to each other the
/// sequence is a ring.
///
/// σ are of first order in the contours' σ, beside two terms that are stated with them: what the circle
/// leaves out (see `circle`; the change of radius is taken from the radii of neighbouring views), along the
/// line of sight; and along the normal what a depth that is off by `δ` makes of the place, `δ²/2R`. Errors of
/// the cameras are not in them.
///
/// Cost: for each place along a contour a pass over the contours of two views, and over the silhouettes of
/// all.
///
/// # Errors
/// `Input` for fewer than three views, options that make no sense, and a camera without an inverse;
/// `Undetermined` where no place is left, with what was left out; whatever `progress` returns.
pub fn occluding_contours(
    views: &[ContourView],
    options: &OccludingOptions,
    progress: &mut dyn FnMut(f64) -> Result<()>,
) -> Result<OccludingContours> {
    checked(views, options)?;
    let ready: Vec<Ready<'_>> = views.iter().map(|view| ready(view, options)).collect::<Result<_>>()?;
    let centres: Vec<[f64; 3]> = ready.iter().map(|r| r.eye.centre).collect();
    let (neighbours, sequences) = sequence(&centres);
    let mut left_out: BTreeMap<&'static str, usize> = BTreeMap::new();
    let mut found = Vec::with_capacity(views.len());
    for (k, here) in ready.iter().enumerate() {
        progress(k as f64 / views.len() as f64)?;
        let of_view: Vec<Vec<std::result::Result<matching::Found, &'static str>>> = here
            .lines
            .iter()
            .map(|line| {
                (line.places.par_iter())
                    .map(|place| {
                        let place = place.as_ref().filter(|p| !p.corner).ok_or("corner")?;
                        let [Some(before), Some(after)] = neighbours[k] else {
                            return Err("end_of_sequence");
                        };
                        let others = [&ready[before], &ready[after]];
                        let found = matching::matched(here, place, others, options)?;
                        match matching::in_all_silhouettes(views, k, &ready, &found) {
                            true => Ok(found),
                            false => Err("outside_silhouette"),
                        }
                    })
                    .collect()
            })
            .collect();
        found.push(of_view);
    }
    let asked = found.iter().flatten().map(Vec::len).sum();
    let matched = found.iter().flatten().flatten().filter(|f| f.is_ok()).count();
    let joined = joining::joined(&ready, &neighbours, &mut found, options);
    for cause in found.iter().flatten().flatten().filter_map(|f| f.as_ref().err()) {
        *left_out.entry(cause).or_default() += 1;
    }
    if joined.points.is_empty() {
        let causes: Vec<String> = (left_out.iter()).map(|(cause, n)| format!("{n} {cause}")).collect();
        return Err(Error::undetermined(format!(
            "no place of {} views' contours has a depth ({}): are the views in the order of the camera's motion, and does it move across the lines of sight?",
            views.len(),
            causes.join(", ")
        )));
    }
    let smooth = (ready.iter().flat_map(|r| &r.lines))
        .flat_map(|line| line.places.iter().flatten())
        .filter(|place| !place.corner);
    let (chi2, freedom) = smooth.fold((0.0, 0.0), |(a, b), p| (a + p.chi2, b + p.freedom));
    Ok(OccludingContours {
        points: joined.points,
        relaxed: joined.relaxed,
        triangles: joined.triangles,
        asked,
        left_out,
        matched,
        reduced_chi_square: chi2 / freedom,
        strips: joined.strips,
        sequences,
    })
}

fn checked(views: &[ContourView], options: &OccludingOptions) -> Result<()> {
    if views.len() < 3 {
        return Err(Error::input(format!(
            "occluding contours need three views or more, found {}",
            views.len()
        )));
    }
    for view in views {
        if !(view.sigma_px > 0.0 && view.sigma_px.is_finite()) {
            return Err(Error::input(format!(
                "view `{}`: needed a σ of its contours above 0 pixels, found {}",
                view.name, view.sigma_px
            )));
        }
    }
    let positive = [
        ("window", options.half_window_px),
        ("angle of frontier points", options.frontier_deg),
        ("largest turn", options.most_turn_deg),
        ("largest share of σ", options.most_sigma_share),
    ];
    match positive.into_iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)) {
        Some((name, value)) => {
            Err(Error::input(format!("the {name} of occluding contours is a number above 0, got {value}")))
        }
        None => Ok(()),
    }
}

fn ready<'a>(view: &'a ContourView, options: &OccludingOptions) -> Result<Ready<'a>> {
    let lines = (view.contours.iter())
        .filter_map(|contour| Curve::new(contour, options.half_window_px, view.sigma_px, view.apart_px))
        .map(|curve| {
            let count = (curve.total / (SPACING * options.half_window_px)).floor().max(1.0);
            let step = curve.total / count;
            let places = (0..count as usize + usize::from(!curve.closed()))
                .map(|k| curve.at(k as f64 * step))
                .collect();
            Line { curve, step, places }
        })
        .collect();
    let eye = Eye::new(view.camera).map_err(|e| e.in_context(format!("view `{}`", view.name)))?;
    Ok(Ready { eye, lines })
}

/// The views before and after each, and how many sequences there are.
fn sequence(centres: &[[f64; 3]]) -> (Vec<[Option<usize>; 2]>, usize) {
    let count = centres.len();
    let steps: Vec<f64> = centres.windows(2).map(|pair| distance(pair[0], pair[1])).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let longest = LONG_STEP * sorted[sorted.len() / 2];
    let mut neighbours = vec![[None; 2]; count];
    let mut sequences = 1;
    for (k, step) in steps.iter().enumerate() {
        if *step <= longest {
            neighbours[k][1] = Some(k + 1);
            neighbours[k + 1][0] = Some(k);
        } else {
            sequences += 1;
        }
    }
    if sequences == 1
        && count > 3
        && distance(centres[0], centres[count - 1]) <= longest.min(1.5 * sorted[count - 2])
    {
        neighbours[0][0] = Some(count - 1);
        neighbours[count - 1][1] = Some(0);
    }
    (neighbours, sequences)
}
