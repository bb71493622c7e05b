//! The verdict on a first fit, from data that did not inflate their own σ.
//!
//! Input: a converged surface with its readings. Output: a [`FitVerdict`] with the places that the surface
//! does not follow, or a refusal. See decision 0101.

use super::enclosed::{EnclosedSolid, EnclosedTopology};
use super::folds::Folds;
use super::leaves::{leaf_areas, neighbourhood};
use super::noise::SensorNoise;
use super::surface_misfit::{SurfaceMisfit, UnresolvedPlace, surface_misfit};
use crate::observe::{Foot, Observations, ProjectedReadings, Quantity};
use planish_core::numbers::significant;
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::{Error, Result, median_magnitude_scale};
use planish_exchange::ScanSet;
use planish_sense::Neighbourhoods;
use planish_spline::{Hierarchy, Shape, Surface};
use serde::Serialize;

/// Largest share of the measured area that may be unresolved in a result; with a topology that the surface
/// cannot have, a tenth of it.
pub(super) const MAX_UNRESOLVED: f64 = 0.05;
const MAX_UNRESOLVED_OF_OTHER_TOPOLOGY: f64 = 0.005;
/// Largest share of the surface that may be far from the solid that the readings enclose, if that has
/// another topology.
const MAX_STRAY: f64 = 0.003;
/// Largest share of the area that may pass through itself. Fits of 40,000 readings with less were covered to
/// 0.88 to 0.95 of 95 % intervals, those with more to 0.80 to 0.87.
pub(super) const MAX_FOLDED: f64 = 0.005;
/// Median distance of the readings from the surface, in σ of their noise, from which a surface runs between
/// two layers. Readings of one layer have 0.67.
const LAYERS_APART: f64 = 2.0;
/// Readings nearer to the surface than this share of the median distance, and the largest share of them if
/// the surface runs between two layers. Of normal errors 13 % are so near, of uniform ones 12 %.
const NEAR_SHARE: f64 = 0.25;
const MAX_NEAR: f64 = 0.04;
/// Fewer readings do not show how their residuals are distributed.
const MIN_FOR_LAYERS: usize = 100;
/// Scatter of the readings over their stated σ above which the statement is no measure of their errors. Data
/// sheets are wrong by factors of two or three.
const MAX_UNDERSTATEMENT: f64 = 10.0;
/// The same limit beside gross errors, and the share of readings on no surface that shows those.
const MAX_UNDERSTATEMENT_BESIDE_GROSS_ERRORS: f64 = 4.0;
const OFF_SURFACE_BESIDE_GROSS_ERRORS: f64 = 0.05;
/// Scale of residuals by their median, over that by their squares, below which they are a peak on a base.
const PEAKED: f64 = 0.72;
/// Places that a report lists.
const MAX_PLACES: usize = 20;
/// Readings from which the enclosed solid is found.
const TOPOLOGY_SAMPLE: usize = 30_000;
/// More handles than this are those of a wall that is as thin as a cell of the indicator.
const MAX_COUNTED_HANDLES: usize = 20;
/// Fewer readings are judged all together, and the largest share of them that need not be followed.
const MIN_FOR_PLACES: usize = 1000;
const MAX_NOT_FOLLOWED: f64 = 0.15;
/// A surface runs between its readings if the heights of this many nearest neighbours have a larger
/// correlation than `MAX_ALIKE`, and their scale exceeds this share of the spacing. Simulated smooth
/// surfaces of 12 to 30,000 readings with gross or correlated errors reach both 0.5 and 0.3 or 0.45 and 0.55;
/// an angle bracket of 350 to 1000 readings that was fitted as a smooth sheet has 0.72 and 0.52 or more.
const NEAREST: usize = 3;
const MAX_ALIKE: f64 = 0.5;
const MAX_SCALE: f64 = 0.4;
/// Fewer readings show no correlation, and more resolve what they are of.
const MIN_BETWEEN: usize = 50;
const MAX_BETWEEN: usize = 20_000;
/// Heights count up to this many times their scale.
const HUBER_BOUND: f64 = 4.0;
/// A reading is missed from this share of the spacing on. Closer, shape is below what the readings resolve,
/// and part of σ, as with exact points of a body with many details. Those of a bent pipe are off by 0.6.
const MIN_SPACINGS: f64 = 0.3;
/// Share of readings on no surface that a refusal names.
const MANY_OFF_SURFACE: f64 = 0.1;
/// Fewer readings show no solid: between them the indicator has holes.
const MIN_FOR_TOPOLOGY: usize = 1000;

/// Whether a surface can be trusted where its readings are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FitVerdict {
    /// The surface follows its readings everywhere.
    #[default]
    Converged,
    /// A small share of the measured area is not followed; it is marked as such.
    Unresolved,
    /// Too much is not followed; the result exists only because it was asked for in spite of that.
    Refused,
}

/// The verdict with its reasons.
#[derive(Debug, Clone, Default)]
pub(super) struct Verdict {
    pub verdict: FitVerdict,
    pub misfit: SurfaceMisfit,
    pub finding: Option<Finding>,
}

impl Verdict {
    /// Adds what only residuals show: a surface that runs past most readings where more than a twentieth of
    /// them lie. Several scans may contradict each other, which is no matter of the shape. A surface that
    /// misses what its cells cannot resolve everywhere has no places of misfit, and σ contains it.
    ///
    /// # Errors
    /// `Undetermined` for such a surface, unless `force` keeps it.
    pub(super) fn with_missed_readings(
        mut self,
        space: &Hierarchy,
        readings: ProjectedReadings<'_>,
        noise: &SensorNoise,
        input: VerdictInput<'_>,
    ) -> Result<Self> {
        if input.several_scans {
            return Ok(self);
        }
        let least = MIN_SPACINGS * self.misfit.spacing;
        let share = missed_share(space, readings, noise, input.gate, least);
        if share <= MAX_UNRESOLVED {
            return Ok(self);
        }
        let text = format!(
            "the surface misses most readings where {} of them lie: {}{}",
            percent(share),
            reason(space.shape(), None, false),
            gross_errors(readings.observations)
        );
        if !input.force {
            let text = format!("{text}; a result can be forced, but is wrong there");
            return Err(Error::undetermined(text).with_setting(Setting::Force));
        }
        self.verdict = FitVerdict::Refused;
        self.finding = Some(Finding::new(FindingCode::SurfaceRefused, text));
        Ok(self)
    }

    /// The largest places, for reports.
    pub(super) fn listed_places(&self) -> Vec<UnresolvedPlace> {
        self.misfit.places.iter().take(MAX_PLACES).copied().collect()
    }
}

/// What the verdict depends on besides the readings.
#[derive(Clone, Copy)]
pub(super) struct VerdictInput<'a> {
    pub gate: f64,
    /// Weight of each reading; 0 if it was rejected.
    pub information: &'a [f64],
    /// Keep a surface that would be refused.
    pub force: bool,
    /// True if the readings are of more than one scan.
    pub several_scans: bool,
    /// World coordinates of the origin.
    pub origin: DVec3,
}

/// Judges a first fit.
///
/// # Errors
/// `Undetermined` if the surface does not follow more than 5 % of the measured area. If the readings enclose
/// a solid of another topology, 0.5 % is enough, or a part of the surface nowhere near that solid. With
/// `force` the surface is kept.
pub(super) fn judge_surface(
    surface: &Surface,
    readings: ProjectedReadings<'_>,
    input: VerdictInput<'_>,
) -> Result<Verdict> {
    let shape = surface.space().shape();
    if !input.force {
        let found =
            layers(readings, input.several_scans).or_else(|| few_not_followed(readings, input, shape));
        if let Some(text) = found.map_or_else(|| passed_between(readings), |text| Ok(Some(text)))? {
            return Err(Error::undetermined(text).with_setting(Setting::Force));
        }
    }
    let folds = Folds::of(surface, Some(readings.feet))?;
    let folded = folds.text(input.origin);
    let misfit = surface_misfit(readings, input.gate, input.origin)?.with_feet(folds.places);
    let solid = (shape == Some(Shape::Ball)).then(|| solid_of(readings.observations)).flatten();
    // Thin parts vanish at some levels of the indicator, and noise makes small handles at others. Where the
    // surface leaves the solid as well, a single level is evidence.
    let stray =
        solid.as_ref().filter(|solid| !solid.at_any_level.is_ball()).map_or(0.0, |s| stray_share(surface, s));
    let other = (solid.as_ref())
        .map(|solid| if stray > MAX_STRAY { solid.at_any_level } else { solid.topology })
        .filter(|topology| !topology.is_ball());
    let is_folded = folds.area_fraction > MAX_FOLDED;
    if misfit.places.is_empty() && stray <= MAX_STRAY && !is_folded {
        let verdict = if folded.is_some() { FitVerdict::Unresolved } else { FitVerdict::Converged };
        let finding = folded.map(|text| Finding::new(FindingCode::SurfaceFolded, text));
        return Ok(Verdict { verdict, misfit, finding });
    }
    let allowed = if other.is_some() { MAX_UNRESOLVED_OF_OTHER_TOPOLOGY } else { MAX_UNRESOLVED };
    let refused = misfit.area_fraction > allowed || stray > MAX_STRAY || is_folded;
    let place = folded.clone().filter(|_| is_folded).unwrap_or_else(|| {
        misfit.places.first().map_or_else(
            || format!("{} of the surface is far from the solid that the readings enclose", percent(stray)),
            |largest| {
                format!(
                    "the surface does not follow the readings on {} of the measured area, most of it around \
                     ({}) over a length of {}",
                    percent(misfit.area_fraction),
                    largest.centre.map(|c| significant(c, 4)).join(", "),
                    significant(largest.size, 2)
                )
            },
        )
    });
    let mut text = format!("{place}: {}", reason(shape, other, input.several_scans));
    if other.is_some() && solid.is_some_and(|solid| solid.topology.is_ball()) {
        text += "; that depends on where exactly the border of the solid is drawn, so the readings may also \
                 be too few to show its shape";
    }
    if let Some(folded) = folded.filter(|_| !is_folded) {
        text += &format!("; {folded}");
    }
    text += &gross_errors(readings.observations);
    if refused && !input.force {
        let text = format!("{text}; a result can be forced, but is wrong there");
        return Err(Error::undetermined(text).with_setting(Setting::Force));
    }
    let (verdict, code) = if refused {
        (FitVerdict::Refused, FindingCode::SurfaceRefused)
    } else {
        (FitVerdict::Unresolved, FindingCode::SurfaceMisfit)
    };
    Ok(Verdict { verdict, misfit, finding: Some(Finding::new(code, text)) })
}

/// Refuses readings that scatter many times as much as their sensor states: the statement then is no measure
/// of their errors, and an estimate would hide why.
///
/// Gross errors that the surface follows look like noise, too. Beside many readings on no surface, or if the
/// residuals are a narrow peak on a broad base, a smaller ratio is refused.
///
/// # Errors
/// `Undetermined` for the first such sensor.
pub(super) fn refuse_far_larger_noise(
    set: &ScanSet,
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
) -> Result<()> {
    let off = off_surface_share(readings.observations);
    for (c, channel) in readings.observations.channels.iter().enumerate() {
        let ratio = noise.variance_factors[c].sqrt();
        let is_suspect = noise.is_contradicted[c]
            && channel.quantity == Quantity::Position
            && ratio > MAX_UNDERSTATEMENT_BESIDE_GROSS_ERRORS;
        if !is_suspect {
            continue;
        }
        let gross = if off > OFF_SURFACE_BESIDE_GROSS_ERRORS {
            format!("{} of them agree with none of their neighbours, as gross errors do, ", percent(off))
        } else if is_peaked(readings, c)? {
            "many of them are gross errors, between others that scatter less, ".to_owned()
        } else if ratio > MAX_UNDERSTATEMENT {
            String::new()
        } else {
            continue;
        };
        return Err(Error::undetermined(format!(
            "the readings of sensor {:?} scatter {} times as much about each other as the σ that it states: \
             {gross}they lie in two layers, come from several objects, or σ is in another unit; omit σ or \
             state a larger one if they are so noisy",
            set.sensors[channel.sensor].name,
            significant(ratio, 2)
        ))
        .with_setting(Setting::Force));
    }
    Ok(())
}

/// True if the residuals of a channel are a narrow peak on a broad base: by their median they scatter far
/// less than by their squares. Normal errors have a ratio of 1, exponential ones on both sides 0.73.
fn is_peaked(readings: ProjectedReadings<'_>, channel: usize) -> Result<bool> {
    let own = measured_positions(readings).filter(|(k, _, _)| readings.channel(*k) == channel);
    let heights: Vec<f64> = own.map(|(_, _, foot)| foot.height() / foot.variance.sqrt()).collect();
    if heights.len() < MIN_FOR_LAYERS {
        return Ok(false);
    }
    let square = heights.iter().map(|h| h * h).sum::<f64>() / heights.len() as f64;
    Ok(median_magnitude_scale(&heights)? < PEAKED * square.sqrt())
}

/// Share of the readings on a surface that lie where the fitted one misses most of those around, by the σ of
/// their sensors and by the distance `least`.
fn missed_share(
    space: &Hierarchy,
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    gate: f64,
    least: f64,
) -> f64 {
    // Of each leaf, the readings that agree with their neighbours, and those of them that are missed.
    let mut counts = vec![[0_usize; 2]; space.leaves().len()];
    for (k, _, foot) in measured_positions(readings).filter(|(_, i, _)| is_on_surface(readings, *i)) {
        let variance = noise.variance_factors[readings.channel(k)] * foot.variance;
        let [all, missed] = &mut counts[foot.leaf as usize];
        *all += 1;
        *missed += usize::from(foot.height().abs() > (gate * variance.sqrt()).max(least));
    }
    let is_missed = |leaf: &usize| {
        let near = neighbourhood(space, *leaf);
        let [all, missed] = [0, 1].map(|k| near.iter().map(|&leaf| counts[leaf][k]).sum::<usize>());
        2 * missed > all
    };
    let lost: usize = (0..counts.len()).filter(is_missed).map(|leaf| counts[leaf][0]).sum();
    lost as f64 / counts.iter().map(|[all, _]| all).sum::<usize>().max(1) as f64
}

/// A sentence on a small cloud of which the surface does not follow many readings that agree with their
/// neighbours; none if it follows them. Large clouds are judged by place.
fn few_not_followed(
    readings: ProjectedReadings<'_>,
    input: VerdictInput<'_>,
    shape: Option<Shape>,
) -> Option<String> {
    let (mut all, mut not_followed) = (0_usize, 0_usize);
    for (k, _, foot) in measured_positions(readings).filter(|(_, i, _)| is_on_surface(readings, *i)) {
        all += 1;
        not_followed += usize::from(foot.rejection(input.information[k]).is_some());
    }
    let share = not_followed as f64 / all.max(1) as f64;
    (all < MIN_FOR_PLACES && share > MAX_NOT_FOLLOWED).then(|| {
        format!(
            "the surface does not follow {not_followed} of {all} readings that agree with their \
             neighbours: {}",
            reason(shape, None, input.several_scans)
        )
    })
}

/// A sentence on a surface that runs between readings instead of through them; none if it does not.
///
/// Residuals of a surface that follows its readings are nearly independent; those of one that runs between
/// the sides of a thin part, or past an edge, are alike at the nearest neighbours, and as large as their
/// spacing. Shared errors of a sensor are alike, too, but smaller than that.
///
/// # Errors
/// `Undetermined` if the readings cannot be searched.
fn passed_between(readings: ProjectedReadings<'_>) -> Result<Option<String>> {
    let (points, mut heights): (Vec<DVec3>, Vec<f64>) = measured_positions(readings)
        .filter(|(_, i, _)| is_on_surface(readings, *i))
        .map(|(_, i, foot)| (readings.observations.readings.points[i], foot.height()))
        .unzip();
    if !(MIN_BETWEEN..=MAX_BETWEEN).contains(&points.len()) {
        return Ok(None);
    }
    let near = Neighbourhoods::new(&points, NEAREST)?;
    let scale = median_magnitude_scale(&heights)?;
    let mut spacings: Vec<f64> = (0..points.len()).map(|i| near.spacing(i)).collect();
    let spacing = median(&mut spacings).unwrap_or(0.0);
    let bound = HUBER_BOUND * scale;
    heights.iter_mut().for_each(|h| *h = h.clamp(-bound, bound));
    let products: f64 = (0..points.len())
        .map(|i| heights[i] * near.neighbours(i).iter().map(|&j| heights[j as usize]).sum::<f64>())
        .sum();
    let squares: f64 = heights.iter().map(|h| h * h).sum();
    let correlation = products / (NEAREST as f64 * squares).max(f64::MIN_POSITIVE);
    Ok((correlation > MAX_ALIKE && scale > MAX_SCALE * spacing).then(|| {
        format!(
            "the surface runs between the readings: their distances from it are {} of their spacing, and \
             those of neighbours correlate by {}; there are two layers, edges or thin parts that readings \
             so far apart do not show, or too many outliers: add readings, or fit one side",
            percent(scale / spacing),
            significant(correlation, 2)
        )
    }))
}

/// A sentence on two layers of readings between which the surface runs; none if it follows one of them, or
/// both, as the sides of a thin plate.
fn layers(readings: ProjectedReadings<'_>, several_scans: bool) -> Option<String> {
    let distances = |counts: &dyn Fn(usize) -> bool| -> Vec<f64> {
        let counted = measured_positions(readings).filter(|(_, i, _)| counts(*i));
        counted.map(|(_, _, foot)| foot.height().abs()).collect()
    };
    let text = |median: f64, times: Option<f64>| {
        format!(
            "the readings lie in two layers about {} apart{}, and the surface runs between them: remove one \
             layer, or give each its own file and align them",
            significant(2.0 * median, 2),
            times.map_or_else(String::new, |t| format!(", {} times the noise of each", significant(t, 2)))
        )
    };
    if let Some(noise) = readings.observations.intake.layers
        && let Some(median) = median(&mut distances(&|i| is_on_surface(readings, i)))
        && median > LAYERS_APART * noise
    {
        return Some(text(median, Some(2.0 * median / noise)));
    }
    // Layers no farther apart than a few spacings show in no neighbourhood, but leave the surface between
    // them empty. Several scans may be displaced by errors that they share.
    if several_scans {
        return None;
    }
    let mut all = distances(&|_| true);
    // Exact readings of a plane differ by rounding.
    let rounding = readings.observations.min_variance.sqrt();
    let median = median(&mut all).filter(|median| all.len() >= MIN_FOR_LAYERS && *median > rounding)?;
    let near = all.iter().filter(|d| **d < NEAR_SHARE * median).count() as f64;
    (near < MAX_NEAR * all.len() as f64).then(|| text(median, None))
}

/// The positions that were measured and not inferred: number of the foot, number of the reading, and foot.
fn measured_positions(readings: ProjectedReadings<'_>) -> impl Iterator<Item = (usize, usize, &Foot)> {
    (readings.subset.iter().zip(readings.feet).enumerate())
        .map(|(k, (i, foot))| (k, *i as usize, foot))
        .filter(move |(_, i, foot)| {
            foot.quantity == Quantity::Position && readings.observations.inferred(*i).is_none()
        })
}

/// True if reading `i` lies on a surface with its neighbours.
fn is_on_surface(readings: ProjectedReadings<'_>, i: usize) -> bool {
    readings.observations.readings.on_surface[i]
}

/// The middle of some numbers; none of no numbers. Their order changes.
fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Share of the readings that lie on no surface with their neighbours.
fn off_surface_share(observations: &Observations) -> f64 {
    let marks = &observations.readings.on_surface;
    marks.iter().filter(|on| !**on).count() as f64 / marks.len().max(1) as f64
}

/// What a refusal adds if many readings lie on no surface.
fn gross_errors(observations: &Observations) -> String {
    let off = off_surface_share(observations);
    let text =
        "of the readings agree on no surface with their neighbours, as gross errors and second layers do";
    if off > MANY_OFF_SURFACE { format!("; {} {text}", percent(off)) } else { String::new() }
}

/// Share of the area whose leaves have their middle far from a solid.
fn stray_share(surface: &Surface, solid: &EnclosedSolid) -> f64 {
    let areas = leaf_areas(surface);
    let stray = |leaf: usize| solid.is_stray(surface.leaf_point(leaf, 0.5, 0.5));
    let of_stray: f64 = (0..areas.len()).filter(|&leaf| stray(leaf)).map(|leaf| areas[leaf]).sum();
    of_stray / areas.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

/// Why a surface does not follow its readings, as far as the readings show it.
fn reason(shape: Option<Shape>, enclosed: Option<EnclosedTopology>, several_scans: bool) -> String {
    let noun = shape.map_or("surface", Shape::name);
    match enclosed {
        Some(EnclosedTopology { bodies, .. }) if bodies > 1 => {
            format!("the readings show {bodies} separate bodies, and a {noun} is one: fit each body alone")
        }
        Some(EnclosedTopology { handles, .. }) if handles > 0 => {
            let holes = match handles {
                1 => "a hole through it or a handle".to_owned(),
                2..=MAX_COUNTED_HANDLES => format!("{handles} or more holes through it or handles"),
                _ => "holes through it or handles, or thin walls".to_owned(),
            };
            format!(
                "the object has {holes}, which a {noun} cannot have: only the global filter without a given \
                 shape fits surfaces of other topology"
            )
        }
        _ => format!(
            "there is an edge, a hole, a thin part, a narrow gap between bodies or another feature that a \
             smooth {noun} of this resolution does not have{}{}",
            shape.map_or_else(String::new, |_| format!(", or it is no {noun}")),
            if several_scans { ", or scans are displaced against each other (align them)" } else { "" }
        ),
    }
}

/// A share as a percentage with two digits.
fn percent(share: f64) -> String {
    format!("{} %", significant(100.0 * share, 2))
}

/// The solid that the readings on a surface enclose; none if they are too few to show one.
fn solid_of(observations: &Observations) -> Option<EnclosedSolid> {
    let readings = &observations.readings;
    let on: Vec<usize> = (0..readings.len())
        .filter(|&i| readings.on_surface[i] && readings.normal(i) != DVec3::ZERO)
        .collect();
    let step = on.len().div_ceil(TOPOLOGY_SAMPLE).max(1);
    let (points, normals): (Vec<_>, Vec<_>) =
        on.iter().step_by(step).map(|&i| (readings.points[i], readings.normal(i))).unzip();
    (points.len() >= MIN_FOR_TOPOLOGY).then(|| EnclosedSolid::new(&points, &normals))
}
