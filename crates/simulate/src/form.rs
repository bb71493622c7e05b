//! Smooth freeform surfaces in closed form.
//!
//! Input: a shape, a size and a seed. Output: a [`ClosedForm`] with points and exact derivatives at any
//! `(u, v)`. None of the forms is a spline, so no fit can represent one exactly. Sizes are in the unit of the
//! model; `size` is about the longest side. Amplitudes are bounded so that no surface folds or intersects
//! itself.

use super::second_order::SecondOrder;
use planish_core::{DVec3, vector3::tangents};
use planish_estimate::{Error, Result};
use planish_spline::{Jet, Shape};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::f64::consts::{PI, TAU};

/// A smooth surface given by a formula over `(u, v)` in `[0, 1]²`.
///
/// `S_u × S_v` points outwards; for a sheet, to +z.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum ClosedForm {
    /// A height field over a rectangle.
    Sheet(SheetForm),
    /// A bent tube of varying, non-circular section, open at both ends.
    Tube(TubeForm),
    /// An ellipsoid with bumps and dents.
    Ball(BallForm),
    /// A rectangle that is bent to a catenary without stretch.
    Bent(BentForm),
}

/// `z = q · (x², xy, y²) + Σ h exp(−|p − c|² / 2 w²)` over a rectangle around the origin.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SheetForm {
    /// Sides along x and y.
    pub sides: [f64; 2],
    /// Coefficients of `x²`, `xy` and `y²`.
    pub quadratic: [f64; 3],
    /// Bumps with centre `c`, width `w` and height `h`.
    pub bumps: Vec<SheetBump>,
}

/// A bump of a [`SheetForm`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SheetBump {
    /// Centre.
    pub centre: [f64; 2],
    /// Standard width `w` of the Gaussian.
    pub width: f64,
    /// Height `h`, negative for a dent.
    pub height: f64,
}

/// A rectangle bent to a catenary.
///
/// With the length `s` along the bend and `t` across it, measured from the middle of the bend,
///
/// ```text
/// P = x(s) e + t f + z(s) k,    x = asinh(κs)/κ,    z = (√(1 + κ²s²) − 1)/κ,
/// ```
///
/// where `e` and `f` are the material's x and y axes, rotated by the angle of the bend. `s` is the arc length
/// of the catenary, whose curvature is `κ/(1 + κ²s²)`. The first fundamental form `E, F, G` is therefore that
/// of the flat rectangle, for any κ and angle. A bulge along the normal changes it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BentForm {
    /// Sides of the rectangle along x and y.
    pub sides: [f64; 2],
    /// Curvature `κ` in the middle of the bend, in 1/unit; zero for a flat sheet.
    pub curvature: f64,
    /// Angle from the material's x axis to the direction `e` of the bend, in radians.
    pub angle_rad: f64,
    /// Distance of the middle of the bend from the middle of the rectangle, along `e`.
    pub offset: f64,
    /// A bulge along the normal, which stretches the sheet; `None` for pure bending.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bulge: Option<SheetBump>,
}

/// A tube around an arc of a circle, with a section that varies along it.
///
/// `P = (R + r cos θ) e(φ) − R e(0) + (r sin θ + s sin(πw)) y`, with `θ = 2πu`, `φ = turn (v − ½)`,
/// `w = 2v − 1` and `r = r0 (1 + Σ a cos(mθ + p) cos(kπv + q))`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TubeForm {
    /// Radius `R` of the arc.
    pub bend_radius: f64,
    /// Angle of the arc from end to end, in radians.
    pub turn_rad: f64,
    /// Mean radius `r0` of the section.
    pub radius: f64,
    /// Amplitude `s` of the deviation from the plane of the arc.
    pub out_of_plane: f64,
    /// Waves of the radius.
    pub waves: Vec<TubeWave>,
}

/// A wave of a [`TubeForm`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TubeWave {
    /// Amplitude `a`, relative to the radius.
    pub amplitude: f64,
    /// Number of periods `m` around the section.
    pub around: f64,
    /// Number of half periods `k` along the tube.
    pub along: f64,
    /// Phases `p` and `q`, in radians.
    pub phases_rad: [f64; 2],
}

/// A star-shaped surface: `P = (1 + Σ a exp(κ (d · c − 1))) E d` over unit vectors `d`, with the semi-axes
/// `E`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BallForm {
    /// Semi-axes along x, y and z.
    pub semi_axes: DVec3,
    /// Bumps and dents.
    pub bumps: Vec<BallBump>,
}

/// A bump of a [`BallForm`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BallBump {
    /// Unit direction `c` of the centre.
    pub direction: DVec3,
    /// Sharpness `κ`: the standard width is `1/√κ` radians.
    pub sharpness: f64,
    /// Amplitude `a`, relative to the radius; negative for a dent.
    pub amplitude: f64,
}

impl ClosedForm {
    /// A random surface of the given shape, about `size` long.
    ///
    /// # Errors
    /// `Unsupported` for a torus; `Input` for a size that is not positive.
    ///
    /// # Examples
    /// ```
    /// use planish_simulate::ClosedForm;
    /// use planish_spline::Shape;
    /// # fn main() -> planish_estimate::Result<()> {
    /// let form = ClosedForm::random(Shape::Tube, 100.0, 3)?;
    /// assert_eq!(form, ClosedForm::random(Shape::Tube, 100.0, 3)?);
    /// // The section is closed: u = 0 and u = 1 are the same point.
    /// let [a, b] = [0.0, 1.0].map(|u| form.jet(u, 0.5).point);
    /// assert!(a.distance(b) < 1e-9);
    /// # Ok(())
    /// # }
    /// ```
    pub fn random(shape: Shape, size: f64, seed: u64) -> Result<Self> {
        if !(size > 0.0 && size.is_finite()) {
            return Err(Error::input(format!("expected a size > 0, found {size}")));
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Every property draws from one sequence, so the order of the draws is part of the surface: a new
        // property must draw last.
        let mut between = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
        Ok(match shape {
            Shape::Sheet => {
                let sides = [size, 0.8 * size];
                // Radii of curvature of about one to three lengths. Bumps have widths from a quarter down to
                // a twelfth of the sheet, so that fits have to refine more in some places than in others.
                let mut quadratic = [0.0; 3].map(|_| between(-0.35, 0.35) / size);
                // At least a quarter along x, with the sign that was drawn, so that no sheet is nearly
                // flat.
                quadratic[0] += 0.25f64.copysign(quadratic[0]) / size;
                let bumps = (0..9)
                    .map(|k| {
                        let width = size * [0.25, 0.16, 0.11, 0.08][k % 4] * between(0.9, 1.2);
                        let sign = if between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
                        SheetBump {
                            centre: sides.map(|side| side * between(-0.42, 0.42)),
                            width,
                            height: sign * width * between(0.12, 0.28),
                        }
                    })
                    .collect();
                Self::Sheet(SheetForm { sides, quadratic, bumps })
            }
            Shape::Tube => {
                // A bend of 30° to 40° keeps the bend radius well above the section, so that the inside
                // does not fold.
                let turn_rad = between(0.5, 0.7);
                let waves = [
                    (2.0, 0.0, 0.14),
                    (3.0, 1.0, 0.07),
                    (0.0, 2.0, 0.12),
                    (1.0, 3.0, 0.06),
                    (4.0, 2.0, 0.03),
                ]
                .map(|(around, along, amplitude)| TubeWave {
                    amplitude: amplitude * between(0.8, 1.2),
                    around,
                    along,
                    phases_rad: [between(0.0, TAU), between(0.0, TAU)],
                })
                .to_vec();
                Self::Tube(TubeForm {
                    bend_radius: size / turn_rad,
                    turn_rad,
                    radius: 0.2 * size,
                    out_of_plane: 0.05 * size * between(0.6, 1.0),
                    waves,
                })
            }
            Shape::Ball => {
                let semi_axes =
                    DVec3::from_array([0.5, 0.42, 0.34].map(|share| size * share * between(0.95, 1.05)));
                let bumps = (0..10)
                    .map(|k| {
                        let sharpness = [4.0, 7.0, 12.0, 20.0][k % 4] * between(0.8, 1.2);
                        let (z, angle) = (between(-1.0, 1.0), between(0.0, TAU));
                        let ring = (1.0 - z * z).sqrt();
                        let sign = if between(0.0, 1.0) < 0.4 { -1.0 } else { 1.0 };
                        BallBump {
                            direction: DVec3::new(ring * angle.cos(), ring * angle.sin(), z),
                            sharpness,
                            // The curvature of a bump is a κ. Above about 1, a dent makes the surface
                            // concave.
                            amplitude: sign * between(0.5, 1.1) / sharpness,
                        }
                    })
                    .collect();
                Self::Ball(BallForm { semi_axes, bumps })
            }
            Shape::Torus => {
                return Err(Error::unsupported(
                    "simulated scenes support the shapes sheet, tube and ball, found torus",
                ));
            }
        })
    }

    /// The topology of the surface.
    #[must_use]
    pub fn shape(&self) -> Shape {
        match self {
            Self::Sheet(_) => Shape::Sheet,
            Self::Tube(_) => Shape::Tube,
            Self::Ball(_) => Shape::Ball,
            Self::Bent(_) => Shape::Sheet,
        }
    }

    /// The point at `(u, v)` with its first and second derivatives with respect to u and v.
    ///
    /// At the poles of a ball (v = 0 and 1), the derivative with respect to u vanishes.
    #[must_use]
    pub fn jet(&self, u: f64, v: f64) -> Jet {
        let [u, v] = SecondOrder::parameters(u, v);
        match self {
            Self::Sheet(form) => form.jet(u, v),
            Self::Tube(form) => form.jet(u, v),
            Self::Bent(form) => form.jet(u, v),
            Self::Ball(form) => {
                let (s, c) = ((v * PI).sin(), (v * PI).cos());
                form.jet([s * (u * TAU).cos(), s * (u * TAU).sin(), c * -1.0])
            }
        }
    }

    /// The point at `(u, v)` with its derivatives in a chart that is regular there, poles included.
    ///
    /// On a ball the derivatives are along two tangents of the unit sphere, elsewhere with respect to u and
    /// v.
    #[must_use]
    pub(super) fn regular_jet(&self, u: f64, v: f64) -> Jet {
        match self {
            Self::Ball(form) => {
                let d = direction(u, v);
                let (e1, e2) = tangents(d);
                // The exponential map of the sphere to the second order: d + s e1 + t e2 − (s² + t²)/2 d.
                form.jet([0, 1, 2].map(|k| SecondOrder {
                    f: d[k],
                    u: e1[k],
                    v: e2[k],
                    uu: -d[k],
                    uv: 0.0,
                    vv: -d[k],
                }))
            }
            _ => self.jet(u, v),
        }
    }

    /// Parameters after a step in the chart of [`ClosedForm::regular_jet`], clamped at open borders.
    #[must_use]
    pub(super) fn moved(&self, [u, v]: [f64; 2], [s, t]: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Sheet(_) | Self::Bent(_) => [(u + s).clamp(0.0, 1.0), (v + t).clamp(0.0, 1.0)],
            Self::Tube(_) => [(u + s).rem_euclid(1.0), (v + t).clamp(0.0, 1.0)],
            Self::Ball(_) => {
                let d = direction(u, v);
                let (e1, e2) = tangents(d);
                let angle = s.hypot(t);
                if angle == 0.0 {
                    return [u, v];
                }
                // The exact exponential map: a step over a pole continues on the other side.
                let along = s / angle * e1 + t / angle * e2;
                parameters(angle.cos() * d + angle.sin() * along)
            }
        }
    }
}

/// The unit vector at parameters `(u, v)` of a ball: longitude `2πu`, angle `πv` from −z.
fn direction(u: f64, v: f64) -> DVec3 {
    let ((s, c), (sin, cos)) = ((PI * v).sin_cos(), (TAU * u).sin_cos());
    DVec3::new(s * cos, s * sin, -c)
}

/// The parameters `(u, v)` of a ball in a direction, which need not be a unit vector.
pub(super) fn parameters(d: DVec3) -> [f64; 2] {
    [d[1].atan2(d[0]).rem_euclid(TAU) / TAU, d[0].hypot(d[1]).atan2(-d[2]) / PI]
}

impl SheetForm {
    fn jet(&self, u: SecondOrder, v: SecondOrder) -> Jet {
        let (x, y) = ((u - 0.5) * self.sides[0], (v - 0.5) * self.sides[1]);
        let [xx, xy, yy] = self.quadratic;
        let mut z = x * x * xx + x * y * xy + y * y * yy;
        for bump in &self.bumps {
            let (dx, dy) = (x - bump.centre[0], y - bump.centre[1]);
            z = z + ((dx * dx + dy * dy) * (-0.5 / (bump.width * bump.width))).exp() * bump.height;
        }
        SecondOrder::jet([x, y, z])
    }
}

impl BentForm {
    fn jet(&self, u: SecondOrder, v: SecondOrder) -> Jet {
        let (x, y) = ((u - 0.5) * self.sides[0], (v - 0.5) * self.sides[1]);
        let (sin, cos) = self.angle_rad.sin_cos();
        let (s, t) = (x * cos + y * sin - self.offset, y * cos + x * -sin);
        let (k, arc) = (self.curvature, s.f);
        let r = 1.0_f64.hypot(k * arc);
        // Both coordinates of the catenary with their first and second derivatives with respect to its arc
        // length. κs²/(r + 1) is (r − 1)/κ without cancellation for small κ, and without division by zero.
        let along = if k == 0.0 { arc } else { (k * arc).asinh() / k };
        let mut along = s.compose([along, 1.0 / r, -k * k * arc / r.powi(3)]);
        let mut up = s.compose([k * arc * arc / (r + 1.0), k * arc / r, k / r.powi(3)]);
        if let Some(bulge) = &self.bulge {
            // The bulge lies along the normal of the catenary, (−sin, cos) of its slope. Both factors
            // need derivatives.
            let (dx, dy) = (x - bulge.centre[0], y - bulge.centre[1]);
            let height = ((dx * dx + dy * dy) * (-0.5 / (bulge.width * bulge.width))).exp() * bulge.height;
            let sin_slope = s.compose([k * arc / r, k / r.powi(3), -3.0 * k.powi(3) * arc / r.powi(5)]);
            let bend = k * k * (2.0 * (k * arc).powi(2) - 1.0) / r.powi(5);
            let cos_slope = s.compose([1.0 / r, -k * k * arc / r.powi(3), bend]);
            along = along + sin_slope * height * -1.0;
            up = up + cos_slope * height;
        }
        SecondOrder::jet([along * cos + t * -sin, along * sin + t * cos, up])
    }
}

impl TubeForm {
    fn jet(&self, u: SecondOrder, v: SecondOrder) -> Jet {
        let theta = u * TAU;
        let mut r = SecondOrder::constant(1.0);
        for wave in &self.waves {
            let around = (theta * wave.around + wave.phases_rad[0]).cos();
            r = r + around * (v * (PI * wave.along) + wave.phases_rad[1]).cos() * wave.amplitude;
        }
        r = r * self.radius;
        let phi = (v - 0.5) * self.turn_rad;
        let from_middle = r * theta.cos() + self.bend_radius;
        let out_of_plane = ((v - 0.5) * TAU).sin() * self.out_of_plane;
        SecondOrder::jet([
            from_middle * phi.cos() - self.bend_radius,
            r * theta.sin() + out_of_plane,
            from_middle * phi.sin(),
        ])
    }
}

impl BallForm {
    fn jet(&self, d: [SecondOrder; 3]) -> Jet {
        let mut radius = SecondOrder::constant(1.0);
        for bump in &self.bumps {
            let [a, b, c] = [0, 1, 2].map(|k| d[k] * bump.direction[k]);
            radius = radius + (((a + b + c) - 1.0) * bump.sharpness).exp() * bump.amplitude;
        }
        SecondOrder::jet([0, 1, 2].map(|k| radius * d[k] * self.semi_axes[k]))
    }
}
