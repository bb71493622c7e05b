//! Measurements of a surface at known parameters, as scalar equations in sixteen control vertices.
//!
//! Input: a [`SurfaceReading`] and the current estimate of the surface. Output: up to three equations
//! `a · Σ_k c_k P_k = z` with independent noise.
//!
//! | reading | equations |
//! |---|---|
//! | position, isotropic noise | `S = z`, three coordinates at once |
//! | position with covariance `R` | `e_i · S = e_i · z`, variance `λ_i`, along the eigenvectors of `R` |
//! | along a direction | `a · S = z` |
//! | normal `n` | `n · t1 = 0`, `n · t2 = 0` |
//! | principal curvatures | `n · S_ab = II_ab` for ab = 11, 12, 22; `II = κ1 d1 d1ᵀ + κ2 d2 d2ᵀ` |
//!
//! Normals and curvatures use an orthonormal tangent frame `t1 ∥ S_u`, `t2` of the estimate. In this basis
//! the noise components of a normal or of a curvature matrix are independent. Equations are linearised at the
//! estimate with their full gradient. For a normal, `g = n · t` with the *unit* tangent t and
//! `∂g = (n · N) N · ∂S_t`, where N is the normal of the surface. If the length |S_u| were not
//! differentiated, a shrinking surface would reduce the residuals, because normal noise is multiplied by a
//! shorter tangent. A sphere with 12 % noise then became 1 % too small. For curvatures
//! `g = n · S_ab − S_aᵀ II S_b`, with gradients of the tangents. Errors of the estimate enter in second
//! order.
//!
//! Not guaranteed: a good linearisation far from the true surface. Observe positions before normals, and
//! normals before curvatures.
//!
//! # References
//! do Carmo, *Differential Geometry of Curves and Surfaces*, 1976, §3.3; Wang, Wang 1994, eq. 3–7 (which hold
//! at unit speed only).

use crate::basis::cubic;
use crate::surface::{Jet, leaf_weights};
use crate::tangent_rows::{TangentRows, tensor_of};
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};

/// A measurement of a surface at parameters `(u, v)`, in base-grid units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SurfaceReading {
    /// A position with isotropic noise.
    Position {
        /// Parameters `(u, v)`.
        parameters: [f64; 2],
        /// The measured value.
        point: DVec3,
        /// Variance of each coordinate.
        variance: f64,
    },
    /// A position with a full covariance.
    PositionWithCovariance {
        /// Parameters `(u, v)`.
        parameters: [f64; 2],
        /// The measured value.
        point: DVec3,
        /// Covariance of the value.
        covariance: SymmetricMatrix3,
    },
    /// The component of a position along a unit direction: a height, or a distance along a normal.
    Along {
        /// Parameters `(u, v)`.
        parameters: [f64; 2],
        /// Unit direction.
        direction: DVec3,
        /// `direction · S`.
        value: f64,
        /// Its variance.
        variance: f64,
    },
    /// A unit normal.
    Normal {
        /// Parameters `(u, v)`.
        parameters: [f64; 2],
        /// The measured value.
        normal: DVec3,
        /// Standard deviation of its tilt along each tangent, in radians.
        sigma_rad: f64,
    },
    /// Principal curvatures with their directions; positive if the surface bends towards the normal.
    Curvature {
        /// Parameters `(u, v)`.
        parameters: [f64; 2],
        /// The unit normal.
        normal: DVec3,
        /// κ1 and κ2.
        principal: [f64; 2],
        /// Their unit directions.
        directions: [DVec3; 2],
        /// Standard deviation of each normal curvature; the mixed one has half the variance.
        sigma: f64,
    },
}

/// A scalar equation, or three with equal rows, over the sixteen coefficients of a cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Equation {
    pub what: EquationKind,
    pub variance: f64,
    /// Fraction of the detail variance that affects the equation; 1 for positions.
    pub detail_fraction: f64,
}

#[derive(Debug, Clone, Copy)]
#[allow(
    clippy::large_enum_variant,
    reason = "it is on the stack for one reading; a box would allocate at every update"
)]
pub(super) enum EquationKind {
    /// `Σ c_k P_k = z`, for each coordinate.
    Point([f64; 16], DVec3),
    /// `Σ f_k · P_k = z`.
    Form([DVec3; 16], f64),
}

impl Equation {
    fn along(weights: [f64; 16], direction: DVec3, value: f64, variance: f64) -> Self {
        Self {
            what: EquationKind::Form(weights.map(|w| w * direction), value),
            variance,
            detail_fraction: direction.length_squared(),
        }
    }
}

impl SurfaceReading {
    /// Parameters `(u, v)`.
    #[must_use]
    pub fn parameters(&self) -> [f64; 2] {
        match *self {
            Self::Position { parameters, .. }
            | Self::PositionWithCovariance { parameters, .. }
            | Self::Along { parameters, .. }
            | Self::Normal { parameters, .. }
            | Self::Curvature { parameters, .. } => parameters,
        }
    }

    fn validate(&self) -> Result<()> {
        let finite = |x: &[f64]| x.iter().all(|x| x.is_finite());
        let (values, variance, directions): (bool, f64, &[DVec3]) = match self {
            Self::Position { point, variance, .. } => (point.is_finite(), *variance, &[]),
            Self::PositionWithCovariance { point, covariance, .. } => {
                // A covariance is valid if its smallest eigenvalue is not negative; it stands in for the
                // variance below.
                let (_, values) = covariance.eigen();
                (point.is_finite() && covariance.is_finite(), values[2], &[])
            }
            Self::Along { direction, value, variance, .. } => {
                (value.is_finite(), *variance, std::slice::from_ref(direction))
            }
            Self::Normal { normal, sigma_rad, .. } => (true, *sigma_rad, std::slice::from_ref(normal)),
            Self::Curvature { principal, directions, normal, sigma, .. } => {
                (finite(principal) && is_unit(normal), *sigma, directions)
            }
        };
        if !values || !finite(&self.parameters()) {
            return Err(Error::input("a reading contains a value that is not finite"));
        }
        if !(variance >= 0.0 && variance.is_finite()) {
            return Err(Error::input(format!(
                "the variance or σ of a reading must not be negative, found {variance}"
            )));
        }
        match directions.iter().find(|d| !is_unit(d)) {
            Some(d) => Err(Error::input(format!("{:?} is not a unit vector", d.to_array()))),
            None => Ok(()),
        }
    }

    /// Writes the equations at local coordinates of a cell to `out`, followed by `None`. `jet` returns the
    /// estimate of the surface there.
    pub(super) fn equations(
        &self,
        [s, t]: [f64; 2],
        side: f64,
        jet: impl Fn() -> Jet,
        out: &mut [Option<Equation>; 3],
    ) -> Result<()> {
        self.validate()?;
        *out = [None; 3];
        match *self {
            Self::Position { point, variance, .. } => {
                out[0] = Some(Equation {
                    what: EquationKind::Point(leaf_weights(s, t), point),
                    variance,
                    detail_fraction: 1.0,
                });
            }
            Self::PositionWithCovariance { point, covariance, .. } => {
                // Along the eigenvectors the three components are independent, so each is one scalar update.
                let (axes, values) = covariance.eigen();
                for ((to, axis), value) in out.iter_mut().zip(axes).zip(values) {
                    // Rounding can make the zero eigenvalue of a plane or line slightly negative.
                    *to = Some(Equation::along(leaf_weights(s, t), axis, axis.dot(point), value.max(0.0)));
                }
            }
            Self::Along { direction, value, variance, .. } => {
                out[0] = Some(Equation::along(leaf_weights(s, t), direction, value, variance));
            }
            Self::Normal { normal, sigma_rad, .. } => {
                let frame = TangentFrame::from_jet(&jet())?;
                let own = frame.tangents[0].cross(frame.tangents[1]);
                // The change of a tangent is projected to the surface's normal. Along the measured normal it
                // is smaller by the cosine between both.
                let facing = normal.dot(own);
                // At the estimate the row gives `N·t = 0`, so the value is the residual alone.
                for ((to, along), tangent) in out.iter_mut().zip(frame.from_parameters).zip(frame.tangents) {
                    let weights = first_derivative([s, t], side, along);
                    // Only the normal component of a change turns a tangent; its length does not matter.
                    *to = Some(Equation {
                        detail_fraction: 0.0,
                        ..Equation::along(
                            weights,
                            own.map(|x| facing * x),
                            -normal.dot(tangent),
                            sigma_rad * sigma_rad,
                        )
                    });
                }
            }
            Self::Curvature { normal, principal, directions, sigma, .. } => {
                let frame = TangentFrame::from_jet(&jet())?;
                let bend = |t: DVec3| -> DVec3 {
                    let along = [0, 1].map(|k| principal[k] * directions[k].dot(t));
                    along[0] * directions[0] + along[1] * directions[1]
                };
                // Equations are in an orthonormal frame of the surface, not along the measured directions:
                // these are not exactly tangential, and parameter lines may be skewed.
                let first = frame.from_parameters.map(|along| first_derivative([s, t], side, along));
                for (to, [a, b]) in out.iter_mut().zip([[0, 0], [0, 1], [1, 1]]) {
                    let second =
                        second_derivative([s, t], side, frame.from_parameters[a], frame.from_parameters[b]);
                    let [bent_a, bent_b] = [a, b].map(|k| bend(frame.tangents[k]));
                    // Both factors of `S_aᵀ II S_b` are differentiated, so the row contains this term twice.
                    // The value corrects that.
                    let form = std::array::from_fn(|k| {
                        second[k] * normal - first[a][k] * bent_b - first[b][k] * bent_a
                    });
                    *to = Some(Equation {
                        what: EquationKind::Form(form, -frame.tangents[a].dot(bent_b)),
                        // The mixed component of a tensor with isotropic noise has half the variance of a
                        // diagonal one.
                        variance: sigma * sigma * if a == b { 1.0 } else { 0.5 },
                        detail_fraction: 0.0,
                    });
                }
            }
        }
        Ok(())
    }
}

/// A reading along a direction, usually the normal: the residual moves `Σ_k c_k P_k` along it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    pub weights: [f64; 16],
    pub direction: DVec3,
    pub residual: f64,
    pub variance: f64,
    pub detail_fraction: f64,
}

impl SurfaceReading {
    /// Writes the equations of a reading for vertices that move along the normal to `out`, followed by
    /// `None`. They use the rows of [`TangentRows`]: tangential motion neither turns nor bends the surface.
    pub(super) fn offsets(
        &self,
        local: [f64; 2],
        side: f64,
        jet: impl Fn() -> Jet,
        out: &mut [Option<Offset>; 3],
    ) -> Result<()> {
        self.validate()?;
        *out = [None; 3];
        let rows = || TangentRows::new(&jet(), 1.0 / side, local).ok_or_else(no_tangent_plane);
        match *self {
            Self::Along { direction, value, variance, .. } => {
                out[0] = Some(Offset {
                    weights: leaf_weights(local[0], local[1]),
                    direction,
                    residual: value - direction.dot(jet().point),
                    variance,
                    detail_fraction: 1.0,
                });
            }
            Self::Normal { normal, sigma_rad, .. } => {
                let rows = rows()?;
                for ((to, weights), tilt) in out.iter_mut().zip(rows.slopes).zip(rows.tilt(normal)) {
                    *to = Some(Offset {
                        weights,
                        direction: rows.normal,
                        residual: -tilt,
                        variance: sigma_rad * sigma_rad,
                        detail_fraction: 0.0,
                    });
                }
            }
            Self::Curvature { principal, directions, sigma, .. } => {
                let rows = rows()?;
                let bend = rows.bend(&tensor_of(principal, directions));
                for (((to, weights), residual), share) in
                    out.iter_mut().zip(rows.bends).zip(bend).zip([1.0, 0.5, 1.0])
                {
                    *to = Some(Offset {
                        weights,
                        direction: rows.normal,
                        residual,
                        variance: sigma * sigma * share,
                        detail_fraction: 0.0,
                    });
                }
            }
            Self::Position { .. } | Self::PositionWithCovariance { .. } => {
                // A position would have to be projected first, and the foot point depends on the search that
                // the caller chose.
                return Err(Error::unsupported(
                    "a filter along normals needs positions as readings along the normal at their foot \
                     points",
                ));
            }
        }
        Ok(())
    }
}

fn no_tangent_plane() -> Error {
    Error::undetermined(
        "the surface has no tangent plane at the parameters of a normal or curvature: observe positions \
         first",
    )
}

fn is_unit(d: &DVec3) -> bool {
    // Wide enough for unit vectors from files in single precision.
    (d.length_squared() - 1.0).abs() < 1e-6
}

/// Orthonormal tangents and the parameter steps along them.
struct TangentFrame {
    tangents: [DVec3; 2],
    from_parameters: [[f64; 2]; 2],
}

impl TangentFrame {
    fn from_jet(jet: &Jet) -> Result<Self> {
        let t1 = jet.du.try_normalize().ok_or_else(no_tangent_plane)?;
        let (l, m) = (jet.du.length(), jet.dv.dot(t1));
        let across = jet.dv - m * t1;
        let q = across.length();
        // At poles both derivatives are parallel or zero. The threshold is relative, because parameters have
        // no unit.
        if q <= 1e-9 * (jet.dv.length() + l) {
            return Err(no_tangent_plane());
        }
        Ok(Self { tangents: [t1, across / q], from_parameters: [[1.0 / l, 0.0], [-m / (l * q), 1.0 / q]] })
    }
}

fn products([s, t]: [f64; 2], order: [usize; 2], scale: f64, to: &mut [f64; 16]) {
    let (bu, bv) = (cubic(s), cubic(t));
    for (k, w) in to.iter_mut().enumerate() {
        *w += scale * bu[order[0]][k % 4] * bv[order[1]][k / 4];
    }
}

fn first_derivative(local: [f64; 2], side: f64, [u, v]: [f64; 2]) -> [f64; 16] {
    let mut weights = [0.0; 16];
    products(local, [1, 0], u / side, &mut weights);
    products(local, [0, 1], v / side, &mut weights);
    weights
}

fn second_derivative(local: [f64; 2], side: f64, a: [f64; 2], b: [f64; 2]) -> [f64; 16] {
    let h = 1.0 / (side * side);
    let mut weights = [0.0; 16];
    products(local, [2, 0], h * a[0] * b[0], &mut weights);
    products(local, [1, 1], h * (a[0] * b[1] + a[1] * b[0]), &mut weights);
    products(local, [0, 2], h * a[1] * b[1], &mut weights);
    weights
}
