//! Photometric stereo: normals with σ from images under known lights.
//!
//! In: at least three images of one view, each under one distant light of equal strength, and the directions
//! towards the lights. Out: a [`NormalMap`].
//!
//! Not guaranteed: normals are biased by interreflections and broad gloss. The camera is assumed to respond
//! linearly.
//!
//! A matte surface (Lambert) of albedo ρ and normal n under light l has the brightness
//! `I = ρ (max(n·l, 0) + a)`, with an ambient share a common to all pixels. For each pixel, readings in
//! shadow and highlights are rejected by their residuals ([`pixel`]). The others give `b = ρ n` by
//! generalised least squares. Their covariance contains the noise, and the errors of the lights, of Lambert's
//! law and of a, with variances estimated from the residuals of the image ([`model_error`]).
//!
//! σ of the normal is that of one tangential component, the root mean square of both:
//! `σ_n² = tr(P Cov(b) P) / (2 |b|²)`, `P = 1 − n nᵀ`.
//!
//! # References
//! - Woodham, *Photometric method for determining surface orientation from multiple images*, Optical
//!   Engineering 1980.
//! - Barsky and Petrou, *The 4-source photometric stereo technique*, PAMI 2003: shadows and highlights left
//!   out by their residuals.

mod ball;
mod model_error;
mod pixel;

pub use ball::lights_from_ball;

use crate::{Image, RangeGrid, Scan, Viewing};
use model_error::ModelError;
use pixel::{Pixel, inverse};
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Number of pixels from which the variances are estimated. More hardly change them, but cost time.
const PILOT: usize = 150;
/// Rank of the reading that stands for the brightness of a pixel, as a share of its readings. Highlights are
/// above it, shadows below.
const TYPICAL_RANK: f64 = 0.75;
/// Without a mask, the brightness of this share of all pixels is below that of a bright pixel of the object.
/// It excludes the background, and highlights of single pixels.
const BRIGHT_RANK: f64 = 0.98;

/// Options of [`photometric_normals`].
#[derive(Debug, Clone, PartialEq)]
pub struct PhotometricOptions {
    /// σ of a pixel's brightness (default: estimated from the residuals, which needs four lights).
    pub sigma_brightness: Option<f64>,
    /// σ of the lights' directions, in degrees.
    pub sigma_light_deg: f64,
    /// Pixels darker than this share of the median pixel inside the mask are skipped (default 0.08). The
    /// brightness of a pixel is the upper quartile of its readings.
    pub darkest: f64,
    /// Share of ambient light (default: estimated if there are five lights, otherwise 0). A negative share
    /// describes a camera whose response is not linear.
    pub ambient: Option<f64>,
}

impl Default for PhotometricOptions {
    fn default() -> Self {
        Self { sigma_brightness: None, sigma_light_deg: 0.0, darkest: 0.08, ambient: None }
    }
}

/// Normals of the pixels of a view.
#[derive(Debug, Clone, PartialEq)]
pub struct NormalMap {
    /// Pixels in a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// The normal of each pixel towards the camera (x right, y down, z away from the camera, so z is
    /// negative), row by row; `None` if unknown.
    pub normals: Vec<Option<DVec3>>,
    /// σ of each of its tangential components, in degrees; NaN where there is none. It includes the model
    /// error, unless there are only three lights, which leave no residuals.
    pub sigma_deg: Vec<f64>,
    /// Share of ambient light.
    pub ambient: f64,
    /// σ of the brightness of a pixel due to noise, stated or estimated.
    pub sigma_brightness: f64,
    /// σ of the errors of lights and of Lambert's law, as a share of the brightness under a light along the
    /// normal; 0 for three lights.
    pub model_error: f64,
    /// σ of the brightness estimated from the residuals of the typical pixel, even if one was stated; `None`
    /// for three lights, which leave no residuals.
    pub sigma_of_residuals: Option<f64>,
    /// The brightest reading of all images.
    pub brightest: f64,
    /// Pixels of the object without a normal: too few lights reach them, or the normal would face away.
    pub undetermined: usize,
    /// Pixels of the object that are too dark.
    pub dark: usize,
    /// Pixels of the object that have fewer than three readings because the others are saturated.
    pub saturated: usize,
    /// Readings of the pixels of the object that are not too dark, by their use.
    pub readings: ReadingCounts,
    /// Share of each light's readings above the horizon that were rejected by their residuals.
    pub rejected_by_light: Vec<f64>,
}

/// Numbers of readings (one for each light and pixel).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ReadingCounts {
    /// Readings that determine a normal.
    pub used: usize,
    /// Readings that are saturated.
    pub saturated: usize,
    /// Readings of lights below the horizon of the pixel.
    pub shadowed: usize,
    /// Readings rejected by their residuals: highlights and cast shadows.
    pub outliers: usize,
}

/// Estimates normals by photometric stereo.
///
/// Readings that are NaN are missing: mark saturated ones so. `mask` is above half of its maximum where the
/// object is. Without a mask, every pixel that is not dark is used.
///
/// # Errors
/// `Input` for fewer than three images, images of different sizes, two that are the same, or a light too few;
/// `Undetermined` for lights that lie in one plane, three lights without a σ of the brightness, and where no
/// pixel has a normal.
pub fn photometric_normals(
    images: &[Image],
    lights: &[DVec3],
    mask: Option<&Image>,
    options: &PhotometricOptions,
) -> Result<NormalMap> {
    check(images, lights, mask, options)?;
    let (columns, rows) = (images[0].columns, images[0].rows);
    let brightest = images.iter().flat_map(|i| &i.values).copied().fold(0.0_f32, f32::max);
    let object = Object::new(images, mask, options.darkest);
    let pilot: Vec<Vec<f64>> = (object.pixels.iter())
        .step_by(object.pixels.len().div_ceil(PILOT).max(1))
        .map(|k| readings_of(images, *k))
        .collect();
    let stated = options.sigma_brightness.map(|s| s * s);
    // A perfect fit still has the rounding of eight bits: half a step is the minimum.
    let least = (f64::from(brightest) / 512.0).powi(2);
    let mut model = ModelError::new(lights, options.ambient.unwrap_or(0.0), stated.unwrap_or(least));
    let fits = |ambient: f64, sigma: f64| -> Vec<Pixel> {
        pilot.par_iter().filter_map(|readings| Pixel::fit(readings, lights, ambient, sigma)).collect()
    };
    let has_residuals = lights.len() > 3;
    if has_residuals {
        let ambient = if lights.len() < 5 { options.ambient.or(Some(0.0)) } else { options.ambient };
        model.estimate(lights, stated, ambient, fits);
    }
    let light_variance = options.sigma_light_deg.to_radians().powi(2);
    let found: Vec<Found> = (object.pixels.par_iter())
        .map(|&k| {
            let readings = readings_of(images, k);
            let missing = readings.iter().filter(|i| !i.is_finite()).count();
            let fit = Pixel::fit(&readings, lights, model.ambient, model.sigma_noise());
            let normal = fit.as_ref().and_then(|p| model.normal(lights, p, !has_residuals));
            Found {
                normal: normal.map(|(n, sigma)| (n, (sigma * sigma + light_variance).sqrt().to_degrees())),
                fit,
                missing,
            }
        })
        .collect();
    if found.iter().all(|f| f.normal.is_none()) {
        return Err(Error::undetermined(
            "expected pixels with a normal, found none: check that the mask is white at the object, and \
             that the lights are in the order of the images",
        ));
    }
    let mut map = NormalMap {
        columns,
        rows,
        normals: vec![None; columns * rows],
        sigma_deg: vec![f64::NAN; columns * rows],
        ambient: model.ambient,
        sigma_brightness: model.sigma_noise(),
        model_error: if has_residuals { model.share() } else { 0.0 },
        sigma_of_residuals: has_residuals.then(|| {
            let fits = fits(model.ambient, model.sigma_noise());
            typical(fits.iter().filter_map(Pixel::variance).collect(), lights.len()).sqrt()
        }),
        brightest: brightest.into(),
        undetermined: 0,
        dark: object.dark,
        saturated: 0,
        readings: ReadingCounts::default(),
        rejected_by_light: Vec::new(),
    };
    let mut of_light = vec![[0_usize; 2]; lights.len()];
    for (&k, found) in object.pixels.iter().zip(found) {
        map.readings.saturated += found.missing;
        if let Some(fit) = &found.fit {
            map.readings.used += fit.used.len();
            map.readings.shadowed += fit.shadowed;
            map.readings.outliers += fit.outliers.len();
            fit.used.iter().for_each(|k| of_light[*k][0] += 1);
            fit.outliers.iter().for_each(|k| of_light[*k][1] += 1);
        }
        match found.normal {
            Some((n, sigma)) => (map.normals[k], map.sigma_deg[k]) = (Some(n), sigma),
            None if lights.len() - found.missing < 3 => map.saturated += 1,
            None => map.undetermined += 1,
        }
    }
    map.rejected_by_light = (of_light.iter())
        .map(|[used, rejected]| *rejected as f64 / (used + rejected).max(1) as f64)
        .collect();
    Ok(map)
}

/// The result of one pixel: its normal with σ in degrees, the fit, and the number of missing readings.
struct Found {
    normal: Option<(DVec3, f64)>,
    fit: Option<Pixel>,
    missing: usize,
}

/// The readings of a pixel, one for each light.
fn readings_of(images: &[Image], k: usize) -> Vec<f64> {
    images.iter().map(|i| f64::from(i.values[k])).collect()
}

/// The pixels of the object.
struct Object {
    pixels: Vec<usize>,
    dark: usize,
}

impl Object {
    /// Selects the pixels inside the mask that are not dark.
    fn new(images: &[Image], mask: Option<&Image>, darkest: f64) -> Self {
        let half = mask.map(|m| 0.5 * m.values.iter().copied().fold(0.0_f32, f32::max));
        let inside = |k: &usize| mask.zip(half).is_none_or(|(m, half)| m.values[*k] > half);
        let inside: Vec<usize> = (0..images[0].values.len()).filter(inside).collect();
        let brightness: Vec<f64> = (inside.par_iter())
            .map(|&k| {
                // Saturated readings are bright. Their value does not matter for a rank below them.
                let readings = readings_of(images, k);
                rank(readings.into_iter().map(|i| if i.is_nan() { f64::INFINITY } else { i }), TYPICAL_RANK)
            })
            .collect();
        let reference = rank(brightness.iter().copied(), if mask.is_some() { 0.5 } else { BRIGHT_RANK });
        let brightest = brightness.iter().copied().filter(|b| b.is_finite()).fold(0.0, f64::max);
        // A reference that is saturated itself has no value; the brightest pixel with one is darker.
        let least = darkest * if reference.is_finite() { reference } else { brightest };
        let (bright, dark): (Vec<_>, Vec<_>) =
            inside.into_iter().zip(brightness).partition(|(_, b)| *b > least);
        // Without a mask, dark pixels are background.
        let dark = if mask.is_some() { dark.len() } else { 0 };
        Self { pixels: bright.into_iter().map(|(k, _)| k).collect(), dark }
    }
}

/// The value at a share of the sorted values; 0 for none.
fn rank(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let at = ((values.len() - 1) as f64 * share).round() as usize;
    *values.select_nth_unstable_by(at, f64::total_cmp).1
}

/// The variance from the median of estimates with `lights − 3` degrees of freedom each (Wilson and Hilferty
/// 1931).
fn typical(variances: Vec<f64>, lights: usize) -> f64 {
    let freedom = lights.saturating_sub(3).max(1) as f64;
    median(variances) / (1.0 - 2.0 / (9.0 * freedom)).powi(3)
}

/// Normals from the colours of a normal map: red, green and blue are x, y (up) and z (towards the camera)
/// from −1 to 1.
///
/// # Errors
/// `Input` for values that are not three for each pixel.
pub fn normals_from_colours(
    columns: usize,
    rows: usize,
    values: &[f32],
    white: f32,
    sigma_deg: f64,
) -> Result<NormalMap> {
    if values.len() != 3 * columns * rows {
        return Err(Error::input(format!(
            "expected the three colours of {columns} × {rows} pixels, found {} values",
            values.len()
        )));
    }
    let normal = |p: &[f32]| {
        let [x, y, z] = [p[0], p[1], p[2]].map(|c| 2.0 * f64::from(c / white) - 1.0);
        // Pixels outside of the object are black or have an arbitrary length.
        let length = DVec3::new(x, y, z).length();
        DVec3::new(x, -y, -z).try_normalize().filter(|n| n[2] < 0.0 && (0.8..1.2).contains(&length))
    };
    let normals: Vec<_> = values.chunks_exact(3).map(normal).collect();
    Ok(NormalMap {
        columns,
        rows,
        sigma_deg: normals.iter().map(|n| if n.is_some() { sigma_deg } else { f64::NAN }).collect(),
        undetermined: normals.iter().filter(|n| n.is_none()).count(),
        normals,
        ambient: 0.0,
        sigma_brightness: 0.0,
        model_error: 0.0,
        sigma_of_residuals: None,
        brightest: white.into(),
        dark: 0,
        saturated: 0,
        readings: ReadingCounts::default(),
        rejected_by_light: Vec::new(),
    })
}

impl NormalMap {
    /// The normals at their pixels as a scan, in parallel projection along z: x right and y down, in
    /// multiples of `pixel_size` from the first pixel.
    ///
    /// Depth is not measured, so z is 0 with a σ as large as the image.
    ///
    /// # Errors
    /// `Undetermined` where there is no normal at all.
    pub fn scan(&self, pixel_size: f64, name: &str) -> Result<Scan> {
        let known: Vec<usize> = (0..self.normals.len()).filter(|k| self.normals[*k].is_some()).collect();
        if known.is_empty() {
            return Err(Error::undetermined("expected pixels with a normal, found none"));
        }
        let across = pixel_size * pixel_size / 12.0;
        // Depth is unknown: a σ of the size of the image keeps the covariance finite, and positions have no
        // influence on heights.
        let deep = (pixel_size * self.columns.max(self.rows) as f64).powi(2);
        let mut cells = vec![RangeGrid::EMPTY; self.normals.len()];
        known.iter().enumerate().for_each(|(i, k)| cells[*k] = i as u32);
        let point =
            |k: &usize| pixel_size * DVec3::new((k % self.columns) as f64, (k / self.columns) as f64, 0.0);
        Ok(Scan {
            name: name.to_owned(),
            points: known.iter().map(point).collect(),
            covariance: Some(vec![
                SymmetricMatrix3 { zz: deep, ..SymmetricMatrix3::isotropic(across) };
                known.len()
            ]),
            normals: Some(known.iter().filter_map(|k| self.normals[*k]).collect()),
            sigma_normal_deg: Some(known.iter().map(|k| self.sigma_deg[*k]).collect()),
            grid: Some(RangeGrid { columns: self.columns, rows: self.rows, cells }),
            viewing: Viewing::Direction(DVec3::Z),
            ..Scan::default()
        })
    }
}

/// True if two images have the same bits, so that missing readings are equal, too.
fn same(a: &Image, b: &Image) -> bool {
    a.values.iter().zip(&b.values).all(|(a, b)| a.to_bits() == b.to_bits())
}

fn check(
    images: &[Image],
    lights: &[DVec3],
    mask: Option<&Image>,
    options: &PhotometricOptions,
) -> Result<()> {
    if images.len() < 3 {
        return Err(Error::input(format!("expected three images or more, found {}", images.len())));
    }
    if images.len() != lights.len() {
        return Err(Error::input(format!(
            "expected one image per light, found {} and {}",
            images.len(),
            lights.len()
        )));
    }
    let first = (images[0].columns, images[0].rows);
    if let Some(other) = images.iter().chain(mask).find(|i| (i.columns, i.rows) != first) {
        return Err(Error::input(format!(
            "expected images of one size, found {} × {} and {} × {} pixels",
            first.0, first.1, other.columns, other.rows
        )));
    }
    let repeated =
        (1..images.len()).find_map(|k| Some((images[..k].iter().position(|i| same(i, &images[k]))?, k)));
    if let Some((first, second)) = repeated {
        return Err(Error::input(format!(
            "images {} and {} are the same, pixel by pixel: expected a different image for each light",
            first + 1,
            second + 1
        )));
    }
    if lights.len() == 3 && options.sigma_brightness.is_none() {
        return Err(Error::undetermined(
            "expected sigma_brightness or more than three lights: with three, there are no residuals to \
             estimate σ from",
        ));
    }
    let mut m = SymmetricMatrix3::ZERO;
    lights.iter().for_each(|l| m.add_outer(1.0, *l));
    match inverse(&m).is_some() {
        true => Ok(()),
        false => {
            let text = "expected three lights that are not in one plane with the object, found all in one \
                plane";
            Err(Error::undetermined(text))
        }
    }
}

fn median(values: Vec<f64>) -> f64 {
    rank(values.into_iter(), 0.5)
}

#[cfg(test)]
mod tests;
