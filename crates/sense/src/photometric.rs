//! Photometric stereo: normals with σ from images under known lights.
//!
//! In: at least three images of one view, each under one distant light of equal strength, and the directions
//! towards the lights. Out: a [`NormalMap`].
//!
//! Not guaranteed: normals are biased by interreflections and broad gloss. The camera is assumed to respond
//! linearly.
//!
//! A matte surface (Lambert) of albedo ρ and normal n under light l has the brightness
//! `I = ρ (max(n·l, 0) + a)`, with an ambient share a common to all pixels. For each pixel `b = ρ n` is found
//! by least squares with weights that reject shadows and highlights: readings below a share of the pixel's
//! brightest have weight 0, and residuals r have the weight `(1 + (r/cs)²)⁻²` (Geman and McClure 1987). In
//! the last round, residuals within three scales have weight 1 and all others 0. The ambient share a
//! minimises the residuals over the image.
//!
//! `Cov(b) = s² (Σ w l lᵀ)⁻¹`, s² from the pixel's residuals and the image's. σ of the normal is that of one
//! tangential component, the root mean square of both: `σ_n² = tr(P Cov(b) P) / (2 |b|²)`, `P = 1 − n nᵀ`.
//!
//! # References
//! - Woodham, *Photometric method for determining surface orientation from multiple images*, Optical
//!   Engineering 1980.
//! - Barsky and Petrou, *The 4-source photometric stereo technique*, PAMI 2003: shadows and highlights left
//!   out by their residuals.

use planish_core::vector3::tangents;
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

use crate::{Image, RangeGrid, Scan, Viewing};

/// Residual, in scales, at which a reading has weight ¼. Smaller values reject highlights better and use
/// fewer readings.
const CUT: f64 = 2.5;
/// Rounds of reweighting; the weights of the last one are 0 or 1.
const ROUNDS: usize = 8;
/// Gate of the last round, in scales of the residuals: it keeps 99.7 % of normally distributed readings.
const GATE: f64 = 3.0;
/// Weight, in readings, with which a pixel's residual variance is shrunk towards that of the image. A pixel
/// alone has too few redundant readings.
const SHRINKAGE: f64 = 8.0;
/// Readings below this share of the pixel's brightest are in shadow.
const SHADOW: f64 = 0.06;
/// Upper limit of the search for the ambient share, and its step.
const MAX_AMBIENT: f64 = 0.3;
const AMBIENT_STEP: f64 = 0.02;
/// The ambient share is estimated from every `PILOT`-th pixel, to save time.
const PILOT: usize = 7;

/// Options of [`photometric_normals`].
#[derive(Debug, Clone, PartialEq)]
pub struct PhotometricOptions {
    /// σ of a pixel's brightness (default: estimated from the residuals, which needs four lights).
    pub sigma_brightness: Option<f64>,
    /// σ of the lights' directions, in degrees.
    pub sigma_light_deg: f64,
    /// Pixels whose brightest reading is below this share of the image's brightest are skipped.
    pub darkest: f64,
    /// Share of ambient light (default: estimated if there are five lights, otherwise 0).
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
    /// σ of each of its tangential components, in degrees; NaN where there is none.
    pub sigma_deg: Vec<f64>,
    /// Share of ambient light.
    pub ambient: f64,
    /// σ of the brightness.
    pub sigma_brightness: f64,
    /// σ of the brightness estimated from the residuals of the typical pixel, even if one was stated; `None`
    /// for three lights, which leave no residuals.
    pub sigma_of_residuals: Option<f64>,
    /// The brightest reading of all images.
    pub brightest: f64,
    /// Pixels of the object without a normal: too few lights reach them, or the normal would face away.
    pub undetermined: usize,
}

/// Estimates normals by photometric stereo.
///
/// `mask` is above half of its maximum where the object is. Without a mask, every pixel that is not dark is
/// used.
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
    let half = mask.map(|m| 0.5 * m.values.iter().copied().fold(0.0_f32, f32::max));
    let readings = |k: usize| -> Option<Vec<f64>> {
        let inside = mask.zip(half).is_none_or(|(m, half)| m.values[k] > half);
        let all: Vec<f64> = images.iter().map(|i| f64::from(i.values[k])).collect();
        let maximum = all.iter().copied().fold(0.0, f64::max);
        (inside && maximum > options.darkest * f64::from(brightest)).then_some(all)
    };
    let pilot: Vec<Vec<f64>> = (0..columns * rows).step_by(PILOT).filter_map(readings).collect();
    let ambient = match options.ambient {
        Some(ambient) => ambient,
        None if lights.len() < 5 => 0.0,
        None => find_ambient(&pilot, lights),
    };
    // Twice: without a σ of the image, the few residuals of each pixel decide, and too many are rejected.
    let sigma_of_residuals = (lights.len() > 3).then(|| {
        (0..2).fold(0.0, |sigma, _| {
            typical(residual_variances(&pilot, lights, ambient, sigma), lights.len()).sqrt()
        })
    });
    let sigma = options.sigma_brightness.or(sigma_of_residuals).unwrap_or(0.0);
    // A perfect fit still has the rounding of eight bits: half a step is the minimum.
    let sigma = if sigma > 0.0 { sigma } else { f64::from(brightest) / 512.0 };
    let light_variance = options.sigma_light_deg.to_radians().powi(2);
    let found: Vec<Option<Option<Found>>> = (0..columns * rows)
        .into_par_iter()
        .map(|k| {
            let readings = readings(k)?;
            Some(
                Pixel::fit(&readings, lights, ambient, sigma)
                    .and_then(|p| p.normal(lights, sigma, options, light_variance)),
            )
        })
        .collect();
    let undetermined = found.iter().filter(|f| matches!(f, Some(None))).count();
    let found: Vec<_> = found.into_iter().map(Option::flatten).collect();
    if found.iter().all(Option::is_none) {
        return Err(Error::undetermined(
            "expected pixels with a normal, found none: check that the mask is white at the object, and \
             that the lights are in the order of the images",
        ));
    }
    Ok(NormalMap {
        columns,
        rows,
        normals: found.iter().map(|f| f.map(|(n, _)| n)).collect(),
        sigma_deg: found.iter().map(|f| f.map_or(f64::NAN, |(_, sigma)| sigma)).collect(),
        ambient,
        sigma_brightness: sigma,
        sigma_of_residuals,
        brightest: brightest.into(),
        undetermined,
    })
}

/// A normal and its σ in degrees.
type Found = (DVec3, f64);

/// One pixel's fit.
struct Pixel {
    b: DVec3,
    weights: Vec<f64>,
    residuals: Vec<f64>,
}

impl Pixel {
    /// `sigma` is the image's σ of brightness: residuals of its size are never outliers.
    fn fit(readings: &[f64], lights: &[DVec3], ambient: f64, sigma: f64) -> Option<Self> {
        let strongest = readings.iter().copied().fold(0.0, f64::max);
        // Shadowed readings do not follow the cosine law.
        let lit: Vec<f64> =
            readings.iter().map(|i| if *i > SHADOW * strongest { 1.0 } else { 0.0 }).collect();
        let mut weights = lit.clone();
        let mut b = DVec3::ZERO;
        let mut residuals = vec![0.0; readings.len()];
        let count = lit.iter().sum::<f64>();
        for round in 1..=ROUNDS {
            let brightness = ambient * b.length();
            let (mut m, mut r) = (SymmetricMatrix3::ZERO, DVec3::ZERO);
            for ((l, i), w) in lights.iter().zip(readings).zip(&weights) {
                m.add_outer(*w, *l);
                (0..3).for_each(|k| r[k] += w * l[k] * (i - brightness));
            }
            b = inverse(&m)?.times(r);
            let brightness = ambient * b.length();
            for (k, l) in lights.iter().enumerate() {
                residuals[k] = readings[k] - b.dot(*l) - brightness;
            }
            let among: Vec<f64> =
                residuals.iter().zip(&lit).filter(|(_, w)| **w > 0.0).map(|(r, _)| r.abs()).collect();
            // With four readings or fewer there is a single residual direction, so no outlier can be found.
            // After the last fit the weights stay, because variance and normal belong to them.
            if count < 5.0 || round == ROUNDS {
                continue;
            }
            // The fit uses three degrees of freedom of the residuals.
            let spread = 1.4826 * median(among) * (count / (count - 3.0)).sqrt();
            // No surface is completely matte, so residuals of this size are never outliers.
            let scale = spread.max(sigma).max(0.005 * strongest);
            for ((w, lit), r) in weights.iter_mut().zip(&lit).zip(&residuals) {
                *w = match round + 1 == ROUNDS {
                    false => lit / (1.0 + (r / (CUT * scale)).powi(2)).powi(2),
                    // Smooth weights first, so that the selection does not depend on a bad first fit; at the
                    // end full or zero weight, so that the covariance is that of plain least squares.
                    true if r.abs() < GATE * scale => *lit,
                    true => 0.0,
                };
            }
        }
        Some(Self { b, weights, residuals })
    }

    /// Sum of the weighted squares, and the remaining degrees of freedom.
    fn squares(&self) -> (f64, f64) {
        let squares = self.residuals.iter().zip(&self.weights).map(|(r, w)| w * r * r).sum();
        (squares, self.weights.iter().sum::<f64>() - 3.0)
    }

    /// The normal and its σ in degrees.
    fn normal(
        &self,
        lights: &[DVec3],
        sigma: f64,
        options: &PhotometricOptions,
        light_variance: f64,
    ) -> Option<(DVec3, f64)> {
        let n = self.b.try_normalize().filter(|n| n[2] < 0.0)?;
        let (squares, freedom) = self.squares();
        let variance = match options.sigma_brightness {
            Some(sigma) => sigma * sigma,
            None => (squares + SHRINKAGE * sigma * sigma) / (freedom.max(0.0) + SHRINKAGE),
        };
        let mut m = SymmetricMatrix3::ZERO;
        for (l, w) in lights.iter().zip(&self.weights) {
            m.add_outer(*w, *l);
        }
        // The covariance of `b` with the final weights.
        let inverse = inverse(&m)?;
        let (e1, e2) = tangents(n);
        let tangential = 0.5 * variance * (inverse.along(e1) + inverse.along(e2)) / self.b.length_squared();
        let sigma = (tangential + light_variance).sqrt().to_degrees();
        sigma.is_finite().then_some((n, sigma))
    }
}

/// The residual variance of every pixel that has enough lights.
fn residual_variances(pixels: &[Vec<f64>], lights: &[DVec3], ambient: f64, sigma: f64) -> Vec<f64> {
    let fits = pixels.par_iter().filter_map(|readings| Pixel::fit(readings, lights, ambient, sigma));
    let variances = fits.filter_map(|p| {
        let (squares, freedom) = p.squares();
        (freedom > 0.5).then(|| squares / freedom)
    });
    variances.collect()
}

/// The variance from the median of estimates with `lights − 3` degrees of freedom each (Wilson and Hilferty
/// 1931).
fn typical(variances: Vec<f64>, lights: usize) -> f64 {
    let freedom = lights.saturating_sub(3).max(1) as f64;
    median(variances) / (1.0 - 2.0 / (9.0 * freedom)).powi(3)
}

/// The ambient share that minimises the residuals.
fn find_ambient(pixels: &[Vec<f64>], lights: &[DVec3]) -> f64 {
    let steps = (MAX_AMBIENT / AMBIENT_STEP).round() as usize;
    // A grid and a parabola: the cost is a median, whose derivative jumps.
    let cost: Vec<f64> = (0..=steps)
        .map(|k| {
            // The median includes rejected readings. Otherwise a share that rejects more would seem better.
            let fits = pixels
                .par_iter()
                .filter_map(|i| Pixel::fit(i, lights, AMBIENT_STEP * k as f64, 0.0).zip(Some(i)));
            let residuals = fits.flat_map_iter(|(fit, readings)| {
                let strongest = readings.iter().copied().fold(0.0, f64::max);
                let lit =
                    fit.residuals.into_iter().zip(readings).filter(move |(_, i)| **i > SHADOW * strongest);
                lit.map(|(r, _)| r.abs())
            });
            median(residuals.collect())
        })
        .collect();
    let best = (0..=steps).min_by(|a, b| cost[*a].total_cmp(&cost[*b])).unwrap_or(0);
    if best == 0 || best == steps {
        return AMBIENT_STEP * best as f64;
    }
    let curvature = cost[best - 1] - 2.0 * cost[best] + cost[best + 1];
    let offset = if curvature > 0.0 { 0.5 * (cost[best - 1] - cost[best + 1]) / curvature } else { 0.0 };
    AMBIENT_STEP * (best as f64 + offset)
}

/// Directions towards the lights from images of a mirror ball: `l = 2 (n·v) n − v`, with the ball's normal n
/// at the highlight and v towards the camera.
///
/// The ball is the disc with the area and the centroid of the mask, in parallel projection. A highlight is
/// the centroid of the pixels above 95 % of the maximum.
///
/// # Errors
/// `Input` for images whose size differs from the mask; `Undetermined` for a mask below 100 pixels, and an
/// image without a highlight on the ball.
pub fn lights_from_ball(images: &[Image], mask: &Image) -> Result<Vec<DVec3>> {
    let half = 0.5 * mask.values.iter().copied().fold(0.0_f32, f32::max);
    let inside: Vec<usize> = (0..mask.values.len()).filter(|k| mask.values[*k] > half).collect();
    if inside.len() < 100 {
        return Err(Error::undetermined(format!(
            "expected a ball of 100 pixels or more, found {}",
            inside.len()
        )));
    }
    let place = |k: usize| [(k % mask.columns) as f64, (k / mask.columns) as f64];
    let middle = |pixels: &mut dyn Iterator<Item = (usize, f64)>| {
        let mut sums = DVec3::ZERO;
        for (k, w) in pixels {
            let [x, y] = place(k);
            sums = DVec3::new(sums[0] + w * x, sums[1] + w * y, sums[2] + w);
        }
        [sums[0] / sums[2], sums[1] / sums[2]]
    };
    let centre = middle(&mut inside.iter().map(|k| (*k, 1.0)));
    // From the area: more accurate than from the extreme pixels of the mask.
    let radius = (inside.len() as f64 / std::f64::consts::PI).sqrt();
    let light = |(number, image): (usize, &Image)| {
        if (image.columns, image.rows) != (mask.columns, mask.rows) {
            return Err(Error::input(format!(
                "image {number} of the ball: expected {} × {} pixels like its mask, found {} × {}",
                mask.columns, mask.rows, image.columns, image.rows
            )));
        }
        let maximum = inside.iter().map(|k| image.values[*k]).fold(0.0_f32, f32::max);
        // The centroid of a saturated highlight; its brightest pixel is arbitrary.
        let bright = inside.iter().copied().filter(|k| image.values[*k] > 0.95 * maximum);
        let spot = middle(&mut bright.map(|k| (k, f64::from(image.values[k]))));
        let (x, y) = ((spot[0] - centre[0]) / radius, (spot[1] - centre[1]) / radius);
        let square = x * x + y * y;
        if !(maximum > 0.0 && square < 1.0) {
            return Err(Error::undetermined(format!(
                "image {number} of the ball: expected a highlight, found none"
            )));
        }
        let n = DVec3::new(x, y, -(1.0 - square).sqrt());
        // v = (0, 0, −1).
        let along = -2.0 * n.z;
        Ok(DVec3::new(along * n.x, along * n.y, along * n.z + 1.0))
    };
    images.iter().enumerate().map(light).collect()
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
        sigma_of_residuals: None,
        brightest: white.into(),
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
        (1..images.len()).find_map(|k| Some((images[..k].iter().position(|i| *i == images[k])?, k)));
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

/// The inverse, unless the matrix is nearly singular.
fn inverse(m: &SymmetricMatrix3) -> Option<SymmetricMatrix3> {
    let [a, b, c, d, e, f] = m.to_array();
    let cofactors =
        [d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b];
    let determinant = a * cofactors[0] + b * cofactors[1] + c * cofactors[2];
    // Relative to the trace, so that the unit of the lights does not matter.
    let trace = a + d + f;
    (determinant > 1e-7 * trace.powi(3))
        .then(|| SymmetricMatrix3::from_array(cofactors.map(|c| c / determinant)))
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests;
