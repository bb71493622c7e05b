//! Images of a textured object under a lamp or projected stripes.
//!
//! Input: a surface that rays can meet, a camera and a light. Output: the brightness of the pixels from 0 to
//! 255, with noise.
//!
//! Surfaces are matt (Lambert). The texture is solid: albedo is a function of the position, so that all views
//! show the same texture. Each pixel is the mean of 3 × 3 rays. Points that the light does not reach are in
//! shadow.
//!
//! Not modelled: interreflections, gloss and lens blur.
//!
//! # References
//! - Perlin, *An image synthesizer*, 1985, for solid textures.

use planish_core::random::{GOLDEN_GAMMA, mix64, signed_unit_interval};
use planish_core::{DVec3, Pinhole};
use planish_estimate::Result;
use planish_mesh::MeshSearch;
use planish_sense::stripes::StripePattern;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

/// Rays per pixel along each axis.
const RAYS: usize = 3;
/// Brightness of a white surface that faces the lamp, of 255; the rest is headroom for noise.
const WHITE: f64 = 240.0;
/// Share of ambient light with a lamp.
const AMBIENT_OF_LAMP: f64 = 0.25;
/// Share of ambient light with a projector: small, so that stripes have contrast.
const AMBIENT_OF_STRIPES: f64 = 0.06;
/// Mean albedo, the share of light that a surface reflects.
const ALBEDO: f64 = 0.6;
/// A point is in shadow if another one is nearer to the light by more than this share of the distance.
///
/// It has to exceed the rounding errors of the two intersections, or surfaces would shade themselves. Objects
/// closer to the surface than this cast no shadow.
const SHADOW_TOLERANCE: f64 = 1e-4;

/// A surface that rays can meet: a mesh or a closure.
pub trait RaySurface: Sync {
    /// The point where a ray first meets the surface, and the unit normal there, with either sign.
    fn first_hit(&self, origin: DVec3, direction: DVec3) -> Option<(DVec3, DVec3)>;
}

impl RaySurface for MeshSearch {
    fn first_hit(&self, origin: DVec3, direction: DVec3) -> Option<(DVec3, DVec3)> {
        MeshSearch::first_hit(self, origin, direction).map(|hit| (hit.point, hit.normal))
    }
}

impl<F: Fn(DVec3, DVec3) -> Option<(DVec3, DVec3)> + Sync> RaySurface for F {
    fn first_hit(&self, origin: DVec3, direction: DVec3) -> Option<(DVec3, DVec3)> {
        self(origin, direction)
    }
}

/// A solid texture of random spots.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Texture {
    /// Half the range of the albedo relative to its mean, from 0 (plain) to below 1.
    pub contrast: f64,
    /// Size of the finest spots, as a length.
    pub grain: f64,
    /// Seed of the pattern.
    pub seed: u64,
}

impl Texture {
    /// The albedo at a position: three octaves of noise, from spots of size `grain` to four times that.
    fn albedo(&self, at: DVec3) -> f64 {
        let octave = |k: u32| {
            let size = self.grain * f64::from(1 << k);
            noise(at.map(|c| c / size), self.seed.wrapping_add(u64::from(k)))
        };
        // 1.6 instead of 3: octaves rarely have their extremes at the same point. The clamp limits the rest.
        let sum: f64 = (0..3).map(octave).sum::<f64>() / 1.6;
        ALBEDO * (1.0 + self.contrast * sum.clamp(-1.0, 1.0))
    }
}

/// Smooth noise from −1 to 1: random numbers at integer positions, interpolated by `3t² − 2t³`.
fn noise(at: DVec3, seed: u64) -> f64 {
    let base = at.map(f64::floor);
    let share: [f64; 3] = std::array::from_fn(|k| at[k] - base[k]);
    let blend = share.map(|t| t * t * (3.0 - 2.0 * t));
    (0..8)
        .map(|corner| {
            let side = |k: usize| (corner >> k) & 1;
            let weight: f64 = (0..3).map(|k| if side(k) == 1 { blend[k] } else { 1.0 - blend[k] }).product();
            // A hash instead of a table of random numbers: the noise has no period.
            let mut x = seed;
            for k in 0..3 {
                x = mix64((x ^ (base[k] as i64 + side(k) as i64) as u64).wrapping_add(GOLDEN_GAMMA));
            }
            weight * signed_unit_interval(x)
        })
        .sum()
}

/// The light source.
#[derive(Debug, Clone, Copy)]
#[allow(clippy::large_enum_variant, reason = "one light per image")]
pub enum Light {
    /// A lamp at a position, and ambient light.
    Lamp(DVec3),
    /// A projector of crossed stripes with a Gaussian profile, and weak ambient light.
    Stripes {
        /// Pose and intrinsics of the projector.
        projector: Pinhole,
        /// The projected pattern.
        pattern: StripePattern,
        /// σ of the profile of a stripe, in pixels of the projector.
        sigma_px: f64,
    },
}

impl Light {
    fn centre(&self) -> DVec3 {
        match self {
            Self::Lamp(at) => *at,
            Self::Stripes { projector, .. } => projector.center(),
        }
    }

    /// Brightness of the light towards a point, relative to its maximum.
    fn towards(&self, point: DVec3) -> f64 {
        let Self::Stripes { projector, pattern, sigma_px } = self else {
            return 1.0;
        };
        let Some(pixel) = projector.project(point) else {
            return 0.0;
        };
        // The stripes of both directions overlap as filters do: their shares of darkness multiply, so that
        // crossings are not brighter than stripes.
        let dark = pattern.indices(pixel).into_iter().zip(&pattern.range).map(|(at, [first, last])| {
            let nearest = at.round().clamp(f64::from(*first), f64::from(*last));
            1.0 - (-0.5 * ((at - nearest) * pattern.spacing / sigma_px).powi(2)).exp()
        });
        1.0 - dark.product::<f64>()
    }

    fn ambient(&self) -> f64 {
        match self {
            Self::Lamp(_) => AMBIENT_OF_LAMP,
            Self::Stripes { .. } => AMBIENT_OF_STRIPES,
        }
    }
}

/// Settings of one image.
#[derive(Debug, Clone, Copy)]
pub struct Exposure<'a> {
    /// The camera.
    pub camera: &'a Pinhole,
    /// Columns and rows.
    pub size: [usize; 2],
    /// The light.
    pub light: &'a Light,
    /// The texture of the object.
    pub texture: &'a Texture,
    /// σ of the brightness of a pixel, on the scale from 0 to 255.
    pub sigma_brightness: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl Exposure<'_> {
    /// Renders the image: grey values from 0 to 255, row by row, on a black background.
    ///
    /// Cost: nine rays per pixel, and as many to the light where they meet the object.
    ///
    /// # Errors
    /// The errors of `check`, which is called every 32 rows with the share of the work done.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_mesh::{MeshSearch, icosphere};
    /// use planish_sense::Pinhole;
    /// use planish_simulate::{Exposure, Light, Texture};
    /// # fn main() -> planish_estimate::Result<()> {
    /// let ball = MeshSearch::try_new(&icosphere(8.0, 3))?;
    /// // The camera is 50 in front of the ball and looks along +z.
    /// let camera = Pinhole {
    ///     k: [[100.0, 0.0, 20.0], [0.0, 100.0, 20.0], [0.0, 0.0, 1.0]],
    ///     r: planish_core::matrix3::IDENTITY,
    ///     t: DVec3::new(0.0, 0.0, 50.0),
    /// };
    /// let exposure = Exposure {
    ///     camera: &camera,
    ///     size: [41, 41],
    ///     light: &Light::Lamp(DVec3::new(0.0, 0.0, -500.0)),
    ///     texture: &Texture { contrast: 0.0, grain: 1.0, seed: 0 },
    ///     sigma_brightness: 0.0,
    ///     seed: 0,
    /// };
    /// let image = exposure.take(&ball, &mut |_| Ok(()))?;
    /// let (corner, middle) = (image[0], image[20 * 41 + 20]);
    /// assert!(corner == 0 && middle > 100);
    /// # Ok(())
    /// # }
    /// ```
    pub fn take(
        &self,
        target: &impl RaySurface,
        check: &mut dyn FnMut(f64) -> Result<()>,
    ) -> Result<Vec<u8>> {
        let [columns, rows] = self.size;
        let mut picture = vec![0; columns * rows];
        // Rows are rendered in bands of 32: `check` cannot be called from several threads.
        let band = 32 * columns;
        for (k, band) in picture.chunks_mut(band).enumerate() {
            check(k as f64 * 32.0 / rows as f64)?;
            band.par_chunks_mut(columns).enumerate().for_each(|(j, row)| {
                let y = 32 * k + j;
                // A stream of random numbers per row: the noise does not depend on the number of threads.
                let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
                rng.set_stream(y as u64);
                for (x, pixel) in row.iter_mut().enumerate() {
                    let error: f64 = self.sigma_brightness * rng.sample::<f64, _>(StandardNormal);
                    *pixel = (self.pixel(target, x, y) + error).round().clamp(0.0, 255.0) as u8;
                }
            });
        }
        Ok(picture)
    }

    /// Brightness of a pixel without noise.
    fn pixel(&self, target: &impl RaySurface, x: usize, y: usize) -> f64 {
        let offset = |k: usize| (k as f64 + 0.5) / RAYS as f64 - 0.5;
        let centre = self.camera.center();
        let mut sum = 0.0;
        for j in 0..RAYS {
            for i in 0..RAYS {
                let direction = self.camera.direction([x as f64 + offset(i), y as f64 + offset(j)]);
                if let Some((point, normal)) = direction.and_then(|d| target.first_hit(centre, d)) {
                    let facing = if normal.dot(centre - point) < 0.0 { -normal } else { normal };
                    sum += self.texture.albedo(point) * self.irradiance(target, point, facing);
                }
            }
        }
        WHITE * sum / (RAYS * RAYS) as f64
    }

    /// Light that a surface point with this normal receives, from 0 to 1.
    fn irradiance(&self, target: &impl RaySurface, point: DVec3, normal: DVec3) -> f64 {
        let from = self.light.centre();
        let ambient = self.light.ambient();
        let way = from - point;
        let facing = way.try_normalize().map_or(0.0, |d| d.dot(normal).max(0.0));
        let brightness = self.light.towards(point);
        if facing == 0.0 || brightness == 0.0 {
            return ambient;
        }
        // Cast from the light: from the point, a ray would first meet the facet that it starts on.
        let seen = target.first_hit(from, -way);
        let reached = seen.is_some_and(|(hit, _)| hit.distance(point) <= SHADOW_TOLERANCE * way.length());
        ambient + if reached { (1.0 - ambient) * facing * brightness } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_mesh::{grid_sheet, icosphere};

    const CAMERA: Pinhole = Pinhole {
        k: [[100.0, 0.0, 20.0], [0.0, 100.0, 20.0], [0.0, 0.0, 1.0]],
        r: planish_core::matrix3::IDENTITY,
        t: DVec3::new(0.0, 0.0, 50.0),
    };
    const PLAIN: Texture = Texture { contrast: 0.0, grain: 1.0, seed: 0 };

    fn take(target: &impl RaySurface, light: &Light, sigma: f64) -> Vec<u8> {
        let exposure = Exposure {
            camera: &CAMERA,
            size: [41, 41],
            light,
            texture: &PLAIN,
            sigma_brightness: sigma,
            seed: 3,
        };
        exposure.take(target, &mut |_| Ok(())).unwrap()
    }

    #[test]
    fn brightness_follows_lambert_and_the_background_is_black() {
        let ball = MeshSearch::try_new(&icosphere(8.0, 4)).unwrap();
        let seen = take(&ball, &Light::Lamp(DVec3::new(0.0, 0.0, -500.0)), 0.0);
        assert_eq!(seen[0], 0);
        let middle = f64::from(seen[20 * 41 + 20]);
        assert!((middle - WHITE * ALBEDO).abs() < 2.0, "{middle}");
        // Lambert: a surface inclined by 60° receives half the light of the lamp.
        let x = 20 + (100.0 * 8.0 * 60.0_f64.to_radians().sin() / 46.0) as usize;
        let turned = f64::from(seen[20 * 41 + x]);
        assert!((turned / middle - 0.625).abs() < 0.06, "{turned}");
    }

    #[test]
    fn stripes_lie_where_they_are_projected_and_shadows_are_ambient() {
        let wall = MeshSearch::try_new(&grid_sheet(40.0, 40.0, 4, 4)).unwrap();
        let pattern = StripePattern {
            directions_rad: [0.0, std::f64::consts::FRAC_PI_2],
            spacing: 10.0,
            origin: [20.0, 20.0],
            range: [[-1, 1]; 2],
        };
        let light = Light::Stripes { projector: CAMERA, pattern, sigma_px: 1.0 };
        let seen = take(&wall, &light, 0.0);
        assert!(seen[20 * 41 + 5] > 100 && seen[5 * 41 + 30] > 100);
        assert!(seen[15 * 41 + 15] < 20);
        let noisy = take(&wall, &light, 4.0);
        let squares: f64 = seen
            .iter()
            .zip(&noisy)
            .filter(|(a, _)| **a > 20)
            .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
            .sum();
        let n = seen.iter().filter(|a| **a > 20).count() as f64;
        assert!(((squares / n).sqrt() / 4.0 - 1.0).abs() < 0.1);
        // A post in front of the wall, lit from the side, casts a shadow.
        let post = |o: DVec3, d: DVec3| {
            let at = |z: f64| o + d * (z - o.z) / d.z;
            let near = at(-20.0);
            let z = if near[0].abs() < 1.0 { -20.0 } else { 0.0 };
            (d[2] != 0.0).then(|| (at(z), DVec3::new(0.0, 0.0, -1.0)))
        };
        let seen = take(&post, &Light::Lamp(DVec3::new(-9.0, 0.0, -50.0)), 0.0);
        let dark =
            seen.iter().filter(|v| (f64::from(**v) - WHITE * ALBEDO * AMBIENT_OF_LAMP).abs() < 2.0).count();
        assert!(dark > 20, "{dark}");
    }
}
