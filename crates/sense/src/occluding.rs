//! Points of a surface from its occluding contours in views of known cameras.
//!
//! In: [`ContourView`]s in the order of the camera's motion. Out: [`OccludingContours`], which are points
//! with covariances and normals in connected strips, and the number of rejected points by cause.
//!
//! | module | content |
//! |---|---|
//! | outline | ordered contours of masks |
//! | curve | position, tangent and σ along a contour |
//! | circle | depth and radius from three lines of sight |
//! | matching | the point of an adjacent view on the same epipolar curve |
//! | joining | consistency between views, the model error of the circle, strips |
//! | organised | a mesh of each strip with regularised depths |
//! | hull | the visual hull, and the part of its surface that no contour saw |
//! | consistent | the region that agrees best with silhouettes, some of which are wrong |
//!
//! The occluding contour of a smooth surface slides over it as the camera moves. Its points in consecutive
//! views are matched along epipolar planes. The lines of sight of a point and of its two matches touch the
//! section of the surface, and the circle that touches all three gives the depth (`circle`). The normal needs
//! no depth: it is perpendicular to the line of sight and to the tangent of the contour.
//!
//! Rejected and counted are points at corners and T-junctions (`corner`), views without a neighbour on either
//! side (`end_of_sequence`), lines of sight along the motion (`along_baseline`), frontier points, where the
//! epipolar plane is tangent to the surface and every depth fits (`frontier`), points without an admissible
//! match (`no_match`) or outside of another silhouette (`outside_silhouette`), inconsistent matches
//! (`not_mutual`), uncertain depths (`uncertain`), and small strips (`speck`).
//!
//! Not guaranteed: parts that are concave along every line of sight have no contour in any view; see
//! [`VisualHull::unseen_share`]. Sharp edges give points of radius zero, whose normals are arbitrary.
//!
//! # References
//! As in `circle`, and P. Giblin, R. Weiss, *Epipolar fields on surfaces*, ECCV 1994, for what degenerates at
//! frontier points.

mod circle;
mod consistent;
mod curve;
mod hull;
mod joining;
mod matching;
mod organised;
mod outline;

#[cfg(test)]
mod tests;

pub use consistent::ConsistentRegion;
pub use hull::{SilhouetteBound, VisualHull, near_contours};
pub use outline::{Contour, outlines};

use crate::Scan;
use circle::Eye;
use curve::{Curve, Local};
use planish_core::SymmetricMatrix3;
use planish_core::{DVec3, Pinhole};
use planish_estimate::{Error, Result};
use planish_mesh::TriangleMesh;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A step of the camera longer than this multiple of the median step starts a new sequence.
const LONG_STEP: f64 = 2.5;
/// Spacing of points along a contour, in half widths of the window. The windows of neighbours overlap by
/// about half, so that all readings are used without counting them twice.
const SPACING: f64 = 0.9;

/// The contours of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourView {
    /// Name in messages.
    pub name: String,
    /// Its camera.
    pub camera: Pinhole,
    /// Measured contours.
    pub contours: Vec<Contour>,
    /// The complete outline, by which points of other views are checked; empty if unknown.
    pub silhouette: Vec<Contour>,
    /// σ of a point across its contour, in pixels.
    pub sigma_px: f64,
    /// Distance along a contour below which errors are correlated, in pixels; 0 for independent errors.
    pub apart_px: f64,
}

/// Options of [`occluding_contours`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OccludingOptions {
    /// Half width of the window along a contour that gives position and tangent, in pixels.
    pub half_window_px: f64,
    /// Angle between contour and epipolar line below which a point is a frontier point, in degrees.
    pub frontier_deg: f64,
    /// Maximum angle between the lines of sight of matched points in adjacent views, in degrees.
    pub max_turn_deg: f64,
    /// Maximum σ of a depth, as a share of the depth.
    pub max_sigma_share: f64,
    /// Minimum number of points of a strip.
    pub min_strip_points: usize,
}

impl Default for OccludingOptions {
    fn default() -> Self {
        Self {
            half_window_px: 6.0,
            frontier_deg: 15.0,
            max_turn_deg: 50.0,
            max_sigma_share: 0.05,
            min_strip_points: 24,
        }
    }
}

/// A point of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OccludingPoint {
    /// Index of its view.
    pub view: usize,
    /// Index of its contour in that view.
    pub contour: usize,
    /// Index of the point along the contour.
    pub place: usize,
    /// The pixel.
    pub pixel: [f64; 2],
    /// Position, in the unit of the cameras.
    pub position: DVec3,
    /// Covariance of the position, from the σ of the contours and the model error of the circle.
    pub covariance: [DVec3; 3],
    /// Unit normal, outwards.
    pub normal: DVec3,
    /// σ of the normal about each of two axes perpendicular to it, in degrees: the root mean square of the σ
    /// of the contour's tangent and of the depth of contact.
    pub sigma_normal_deg: f64,
    /// σ of the depth.
    pub sigma_depth: f64,
    /// The part of `sigma_depth` that comes from the model error of the circle.
    pub sigma_circle: f64,
    /// Radius of the section along the line of sight and the normal.
    pub radius: f64,
    /// σ of the radius.
    pub sigma_radius: f64,
    /// Index of its strip; the largest is 0.
    pub strip: usize,
    /// Distance of the adjacent points in neighbouring views and on the same contour.
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

/// Points, meshes and statistics from occluding contours.
#[derive(Debug, Clone, Default)]
pub struct OccludingContours {
    /// Points, ordered by strip, then by view, then along its contours.
    pub points: Vec<OccludingPoint>,
    /// Positions with depths regularised along contours and between views, for meshes.
    pub relaxed: Vec<DVec3>,
    /// Triangles between the contours of consecutive views, facing outwards, over `points`.
    pub triangles: Vec<[u32; 3]>,
    /// Number of points along contours that were tested.
    pub asked: usize,
    /// Number of rejected points by cause.
    pub rejected: BTreeMap<&'static str, usize>,
    /// Number of points with a match in an adjacent view.
    pub matched: usize,
    /// χ² of the contour points about their local parabolas, divided by the degrees of freedom. It is 1 if σ
    /// in pixels is correct and errors are independent.
    pub reduced_chi_square: f64,
    /// Number of strips.
    pub strips: usize,
    /// Number of sequences of adjacent views.
    pub sequences: usize,
}

impl OccludingContours {
    /// The mesh of one strip, and σ along the normals of its vertices. Contours of consecutive views are
    /// joined by their matches; depths are regularised.
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

    /// The points of one strip, or of all, as a scan.
    #[must_use]
    pub fn scan(&self, strip: Option<usize>, name: &str) -> Scan {
        let chosen: Vec<&OccludingPoint> =
            (self.points.iter()).filter(|p| strip.is_none_or(|strip| p.strip == strip)).collect();
        Scan {
            name: name.to_owned(),
            points: chosen.iter().map(|p| p.position).collect(),
            covariance: Some(
                chosen.iter().map(|p| SymmetricMatrix3::from_entries(|i, j| p.covariance[i][j])).collect(),
            ),
            normals: Some(chosen.iter().map(|p| p.normal).collect()),
            sigma_normal_deg: Some(chosen.iter().map(|p| p.sigma_normal_deg).collect()),
            ..Scan::default()
        }
    }
}

/// Points along one contour of a view.
struct Line<'a> {
    curve: Curve<'a>,
    step: f64,
    places: Vec<Option<Local>>,
}

/// A view with its contours sampled.
struct Ready<'a> {
    eye: Eye,
    lines: Vec<Line<'a>>,
}

/// A position along a contour.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spot {
    line: usize,
    length: f64,
}

/// Computes points of a surface from its occluding contours.
///
/// Views are in the order of the motion. A step longer than 2.5 median steps starts a new sequence. A
/// sequence is a ring if its last view is as close to the first as adjacent views are to each other.
///
/// σ is of first order in the σ of the contours, with two more terms. Along the line of sight it includes the
/// model error of the circle (see `circle`), from the radii of adjacent views. Along the normal it includes
/// the effect `δ²/2R` of an error `δ` of the depth. Errors of the cameras are not included.
///
/// Cost: for each point along a contour, one pass over the contours of two views and over the silhouettes of
/// all.
///
/// # Errors
/// `Input` for fewer than three views, invalid options, and a singular camera matrix; `Undetermined` if no
/// point is left, with the causes; the error of `progress`.
pub fn occluding_contours(
    views: &[ContourView],
    options: &OccludingOptions,
    progress: &mut dyn FnMut(f64) -> Result<()>,
) -> Result<OccludingContours> {
    checked(views, options)?;
    let ready: Vec<Ready<'_>> = views.iter().map(|view| ready(view, options)).collect::<Result<_>>()?;
    let centres: Vec<DVec3> = ready.iter().map(|r| r.eye.centre).collect();
    let (neighbours, sequences) = sequence(&centres);
    let mut rejected: BTreeMap<&'static str, usize> = BTreeMap::new();
    let mut found = Vec::with_capacity(views.len());
    for (k, view) in ready.iter().enumerate() {
        progress(k as f64 / views.len() as f64)?;
        let of_view: Vec<Vec<std::result::Result<matching::Found, &'static str>>> = view
            .lines
            .iter()
            .map(|line| {
                // Results are collected in the order of the points, so they do not depend on the number of
                // threads.
                (line.places.par_iter())
                    .map(|place| {
                        let place = place.as_ref().filter(|p| !p.corner).ok_or("corner")?;
                        let [Some(before), Some(after)] = neighbours[k] else {
                            return Err("end_of_sequence");
                        };
                        let others = [&ready[before], &ready[after]];
                        let found = matching::matched(view, place, others, options)?;
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
    // Joining rejects further points. Causes are counted afterwards, so that each point is counted once.
    let joined = joining::joined(&ready, &neighbours, &mut found, options);
    for cause in found.iter().flatten().flatten().filter_map(|f| f.as_ref().err()) {
        *rejected.entry(cause).or_default() += 1;
    }
    if joined.points.is_empty() {
        let causes: Vec<String> = (rejected.iter()).map(|(cause, n)| format!("{n} {cause}")).collect();
        return Err(Error::undetermined(format!(
            "expected points with a depth on the contours of {} views, found none ({}): check that the \
             views are in the order of the camera's motion, and that it moves across the lines of sight",
            views.len(),
            causes.join(", ")
        )));
    }
    // Corners do not follow a parabola; they would raise the χ² although σ is correct.
    let smooth = (ready.iter().flat_map(|r| &r.lines))
        .flat_map(|line| line.places.iter().flatten())
        .filter(|place| !place.corner);
    let (chi2, freedom) = smooth.fold((0.0, 0.0), |(a, b), p| (a + p.chi2, b + p.freedom));
    Ok(OccludingContours {
        points: joined.points,
        relaxed: joined.relaxed,
        triangles: joined.triangles,
        asked,
        rejected,
        matched,
        reduced_chi_square: chi2 / freedom,
        strips: joined.strips,
        sequences,
    })
}

fn checked(views: &[ContourView], options: &OccludingOptions) -> Result<()> {
    if views.len() < 3 {
        return Err(Error::input(format!(
            "expected at least three views for occluding contours, found {}",
            views.len()
        )));
    }
    for view in views {
        if !(view.sigma_px > 0.0 && view.sigma_px.is_finite()) {
            return Err(Error::input(format!(
                "view `{}`: expected σ of its contours above 0 pixels, found {}",
                view.name, view.sigma_px
            )));
        }
    }
    let positive = [
        ("window", options.half_window_px),
        ("angle of frontier points", options.frontier_deg),
        ("largest turn", options.max_turn_deg),
        ("largest share of σ", options.max_sigma_share),
    ];
    match positive.into_iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)) {
        Some((name, value)) => {
            Err(Error::input(format!("expected a {name} of occluding contours above 0, found {value}")))
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
fn sequence(centres: &[DVec3]) -> (Vec<[Option<usize>; 2]>, usize) {
    let count = centres.len();
    let steps: Vec<f64> = centres.windows(2).map(|pair| pair[0].distance(pair[1])).collect();
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
        && centres[0].distance(centres[count - 1]) <= longest.min(1.5 * sorted[count - 2])
    {
        neighbours[0][0] = Some(count - 1);
        neighbours[count - 1][1] = Some(0);
    }
    (neighbours, sequences)
}
