//! Reads curves and surfaces of STEP files.
//!
//! **Input.** Instances, a scale for lengths and the unit of angles of the file.
//!
//! **Output.** Curves and surfaces in the requested unit and in radians.
//!
//! # References
//! ISO 10303-42:2022, *Geometric and topological representation*, clause 4.

use super::attributes::{Entity, part};
use super::syntax::Index;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_solid::brep;
use planish_solid::parametric::{MAX_DEGREE, ParametricCurve, ParametricSurface, SplineCurve, SplineSurface};
use std::f64::consts::FRAC_PI_2;

/// Maximum nesting of geometry that refers to other geometry; finds cycles.
const MAX_DEPTH: usize = 12;

/// Upper limit of coordinates: their squares must not overflow.
const MAX_COORDINATE: f64 = 1e100;

/// A right-handed orthonormal frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub(super) origin: DVec3,
    pub(super) x: DVec3,
    pub(super) y: DVec3,
    pub(super) z: DVec3,
}

/// Reader of geometry in the units of a representation.
#[derive(Clone, Copy)]
pub(super) struct Geometry<'b, 'a> {
    pub(super) index: &'b Index<'a>,
    /// Factor of lengths.
    pub(super) length: f64,
    /// Unit of angles in radians.
    pub(super) angle: f64,
}

impl Geometry<'_, '_> {
    pub(super) fn point(&self, id: u64) -> Result<DVec3> {
        let entity = self.index.entity_of(id, "CARTESIAN_POINT")?;
        // Attribute 0 is the name in every representation item.
        match entity.numbers(1)?.as_slice() {
            [x, y, z] if [x, y, z].iter().all(|c| (**c * self.length).abs() < MAX_COORDINATE) => {
                Ok(DVec3::from_array([*x, *y, *z].map(|c| c * self.length)))
            }
            [_, _, _] => {
                Err(entity
                    .wrong(&format!("expected coordinates below {MAX_COORDINATE:e}, found larger ones")))
            }
            other => Err(entity.wrong(&format!("expected three coordinates, found {}", other.len()))),
        }
    }

    pub(super) fn direction(&self, id: u64) -> Result<DVec3> {
        let entity = self.index.entity_of(id, "DIRECTION")?;
        let found = match entity.numbers(1)?.as_slice() {
            // Only the ratios of a direction are significant (ISO 10303-42), so its length is arbitrary.
            [x, y, z] => DVec3::new(*x, *y, *z).try_normalize(),
            _ => None,
        };
        found.ok_or_else(|| entity.wrong("expected three numbers that are not all 0, found others"))
    }

    fn direction_or(&self, id: Option<u64>, default: DVec3) -> Result<DVec3> {
        id.map_or(Ok(default), |id| self.direction(id))
    }

    fn vector(&self, id: u64) -> Result<DVec3> {
        let entity = self.index.entity_of(id, "VECTOR")?;
        let size = entity.number(2)? * self.length;
        let found = size * self.direction(entity.reference(1)?)?;
        match found.length() > 0.0 {
            true => Ok(found),
            false => Err(entity.wrong("expected a length other than 0, found 0")),
        }
    }

    /// Reads an `AXIS2_PLACEMENT_3D`. The second direction need not be perpendicular to the first, so it is
    /// orthogonalised (ISO 10303-42, `build_axes`).
    pub(super) fn frame(&self, id: u64) -> Result<Frame> {
        let entity = self.index.entity_of(id, "AXIS2_PLACEMENT_3D")?;
        let origin = self.point(entity.reference(1)?)?;
        let z = self.direction_or(entity.optional(2)?, DVec3::Z)?;
        // Without a second direction, any one that is far from parallel to z will do.
        let fallback = if z[0].abs() < 0.9 { DVec3::X } else { DVec3::Y };
        let wanted = self.direction_or(entity.optional(3)?, fallback)?;
        let Some(x) = (wanted - wanted.dot(z) * z).try_normalize() else {
            return Err(entity.wrong("expected two directions that are not parallel, found parallel ones"));
        };
        let y = z.cross(x);
        Ok(Frame { origin, x, y, z })
    }

    fn size(&self, entity: &Entity, at: usize) -> Result<f64> {
        let size = entity.number(at)? * self.length;
        match size > 0.0 && size < MAX_COORDINATE {
            true => Ok(size),
            false => Err(entity.wrong(&format!("attribute {}: expected a length > 0, found {size}", at + 1))),
        }
    }

    pub(super) fn curve(&self, id: u64) -> Result<ParametricCurve> {
        self.curve_at(id, 0)
    }

    fn curve_at(&self, id: u64, depth: usize) -> Result<ParametricCurve> {
        if depth > MAX_DEPTH {
            return Err(Error::input(format!("#{id}: geometry refers to itself")));
        }
        let parts = self.index.parts(id)?;
        let [entity] = parts.as_slice() else {
            return self.spline_curve(&parts);
        };
        let frame = || self.frame(entity.reference(1)?);
        Ok(match entity.record.keyword {
            "LINE" => ParametricCurve::Line {
                origin: self.point(entity.reference(1)?)?,
                along: self.vector(entity.reference(2)?)?,
            },
            "CIRCLE" => {
                let (f, r) = (frame()?, self.size(entity, 2)?);
                ParametricCurve::Ellipse { center: f.origin, a: r * f.x, b: r * f.y }
            }
            "ELLIPSE" => {
                let f = frame()?;
                ParametricCurve::Ellipse {
                    center: f.origin,
                    a: self.size(entity, 2)? * f.x,
                    b: self.size(entity, 3)? * f.y,
                }
            }
            "HYPERBOLA" => {
                let f = frame()?;
                ParametricCurve::Hyperbola {
                    center: f.origin,
                    a: self.size(entity, 2)? * f.x,
                    b: self.size(entity, 3)? * f.y,
                }
            }
            "PARABOLA" => {
                let (f, focal) = (frame()?, self.size(entity, 2)?);
                ParametricCurve::Parabola { vertex: f.origin, a: focal * f.x, b: focal * f.y }
            }
            "POLYLINE" => {
                let points: Result<Vec<_>> =
                    entity.references(1)?.into_iter().map(|p| self.point(p)).collect();
                ParametricCurve::Spline(
                    SplineCurve::polyline(&points?).map_err(|e| entity.wrong(&e.to_string()))?,
                )
            }
            // Trimming is ignored: the vertices of the edge bound the curve.
            "TRIMMED_CURVE"
            | "SURFACE_CURVE"
            | "SEAM_CURVE"
            | "INTERSECTION_CURVE"
            | "BOUNDED_SURFACE_CURVE" => self.curve_at(entity.reference(1)?, depth + 1)?,
            "B_SPLINE_CURVE_WITH_KNOTS" | "BEZIER_CURVE" | "UNIFORM_CURVE" | "QUASI_UNIFORM_CURVE" => {
                self.spline_curve(&parts)?
            }
            _ => return Err(unsupported_kind(entity, "curve")),
        })
    }

    /// Reads a B-spline curve. A rational one is a complex instance of several keywords.
    fn spline_curve(&self, parts: &[Entity]) -> Result<ParametricCurve> {
        let Some(first) = parts.first() else {
            return Err(Error::input("an instance without keyword"));
        };
        let simple = parts.len() == 1;
        // A simple instance has the name as its first attribute; in a complex one, the name is in another
        // part.
        let Some((base, at)) = (match simple {
            true => Some((first, 1)),
            false => part(parts, "B_SPLINE_CURVE").map(|base| (base, 0)),
        }) else {
            return Err(unsupported_kind(first, "curve"));
        };
        let degree = base.count(at)?;
        let poles: Result<Vec<_>> = base.references(at + 1)?.into_iter().map(|p| self.point(p)).collect();
        let poles = poles?;
        let knots = match part(parts, "B_SPLINE_CURVE_WITH_KNOTS") {
            Some(own) => {
                // A simple instance lists the attributes of its supertypes first: name, degree, poles, form
                // and two flags.
                let at = if simple { 6 } else { 0 };
                repeated(own, &own.counts(at)?, &own.numbers(at + 1)?, poles.len() + degree + 1)?
            }
            None => implied_knots(parts, "CURVE", degree, poles.len())
                .ok_or_else(|| first.wrong("has no knots"))?,
        };
        let weights = part(parts, "RATIONAL_B_SPLINE_CURVE").map(|w| w.numbers(0)).transpose()?;
        // Validity of knots, poles and weights is checked by the constructor.
        let made = SplineCurve::try_new(degree, knots, &poles, weights.as_deref());
        Ok(ParametricCurve::Spline(made.map_err(|e| base.wrong(&e.to_string()))?))
    }

    pub(super) fn surface(&self, id: u64) -> Result<ParametricSurface> {
        self.surface_at(id, 0)
    }

    fn surface_at(&self, id: u64, depth: usize) -> Result<ParametricSurface> {
        if depth > MAX_DEPTH {
            return Err(Error::input(format!("#{id}: geometry refers to itself")));
        }
        let parts = self.index.parts(id)?;
        let [entity] = parts.as_slice() else {
            return self.spline_surface(&parts);
        };
        let frame = || self.frame(entity.reference(1)?);
        Ok(match entity.record.keyword {
            "PLANE" => {
                let Frame { origin, x, z, .. } = frame()?;
                ParametricSurface::Elementary(brep::FaceSurface::Plane { origin, normal: z, x })
            }
            "CYLINDRICAL_SURFACE" => {
                let Frame { origin, x, z, .. } = frame()?;
                let radius = self.size(entity, 2)?;
                ParametricSurface::Elementary(brep::FaceSurface::Cylinder { origin, axis: z, x, radius })
            }
            "CONICAL_SURFACE" => self.cone(entity, frame()?)?,
            "SPHERICAL_SURFACE" => {
                let Frame { origin, x, z, .. } = frame()?;
                ParametricSurface::Elementary(brep::FaceSurface::Sphere {
                    center: origin,
                    axis: z,
                    x,
                    radius: self.size(entity, 2)?,
                })
            }
            "TOROIDAL_SURFACE" | "DEGENERATE_TOROIDAL_SURFACE" => {
                let Frame { origin, x, z, .. } = frame()?;
                ParametricSurface::Elementary(brep::FaceSurface::Torus {
                    center: origin,
                    axis: z,
                    x,
                    major: self.size(entity, 2)?,
                    minor: self.size(entity, 3)?,
                })
            }
            "SURFACE_OF_LINEAR_EXTRUSION" => ParametricSurface::Extrusion {
                curve: self.curve_at(entity.reference(1)?, depth + 1)?,
                along: self.vector(entity.reference(2)?)?,
            },
            "SURFACE_OF_REVOLUTION" => {
                let axis = self.index.entity_of(entity.reference(2)?, "AXIS1_PLACEMENT")?;
                ParametricSurface::Revolution {
                    curve: self.curve_at(entity.reference(1)?, depth + 1)?,
                    origin: self.point(axis.reference(1)?)?,
                    axis: self.direction_or(axis.optional(2)?, DVec3::Z)?,
                }
            }
            "OFFSET_SURFACE" => ParametricSurface::Offset {
                base: Box::new(self.surface_at(entity.reference(1)?, depth + 1)?),
                // May be negative: the offset is then against the normal.
                distance: entity.number(2)? * self.length,
            },
            // Trimming is ignored: the loops of the face bound the surface.
            "RECTANGULAR_TRIMMED_SURFACE" | "CURVE_BOUNDED_SURFACE" => {
                self.surface_at(entity.reference(1)?, depth + 1)?
            }
            "B_SPLINE_SURFACE_WITH_KNOTS"
            | "BEZIER_SURFACE"
            | "UNIFORM_SURFACE"
            | "QUASI_UNIFORM_SURFACE" => self.spline_surface(&parts)?,
            _ => return Err(unsupported_kind(entity, "surface")),
        })
    }

    fn cone(&self, entity: &Entity, frame: Frame) -> Result<ParametricSurface> {
        let Frame { origin, x, z, .. } = frame;
        let radius = entity.number(2)? * self.length;
        let half_angle_rad = entity.number(3)? * self.angle;
        // A radius of 0 is valid: the frame is then at the tip.
        if !(radius >= 0.0 && half_angle_rad > 0.0 && half_angle_rad < FRAC_PI_2) {
            return Err(entity.wrong(&format!(
                "expected a radius of at least 0 and a half angle between 0 and π/2, found {radius} and \
                 {half_angle_rad} rad"
            )));
        }
        Ok(ParametricSurface::Elementary(brep::FaceSurface::Cone {
            origin,
            axis: z,
            x,
            radius,
            half_angle_rad,
        }))
    }

    /// Reads a B-spline surface. A rational one is a complex instance of several keywords.
    fn spline_surface(&self, parts: &[Entity]) -> Result<ParametricSurface> {
        let Some(first) = parts.first() else {
            return Err(Error::input("an instance without keyword"));
        };
        let simple = parts.len() == 1;
        let Some((base, at)) = (match simple {
            true => Some((first, 1)),
            false => part(parts, "B_SPLINE_SURFACE").map(|base| (base, 0)),
        }) else {
            return Err(unsupported_kind(first, "surface"));
        };
        let degrees = [base.count(at)?, base.count(at + 1)?];
        let (n_u, ids) = base.rows_of_references(at + 2)?;
        // The minimum avoids a division by zero for an empty net, which the constructor below rejects.
        let n_v = ids.len() / n_u.max(1);
        let poles: Result<Vec<_>> = ids.into_iter().map(|p| self.point(p)).collect();
        let knots = match part(parts, "B_SPLINE_SURFACE_WITH_KNOTS") {
            Some(own) => {
                // Attributes: multiplicities along u and v, then knots along u and v.
                let at = if simple { 8 } else { 0 };
                [
                    repeated(own, &own.counts(at)?, &own.numbers(at + 2)?, n_u + degrees[0] + 1)?,
                    repeated(own, &own.counts(at + 1)?, &own.numbers(at + 3)?, n_v + degrees[1] + 1)?,
                ]
            }
            None => {
                let default_knots = |degree: usize, n: usize| {
                    implied_knots(parts, "SURFACE", degree, n).ok_or_else(|| first.wrong("has no knots"))
                };
                [default_knots(degrees[0], n_u)?, default_knots(degrees[1], n_v)?]
            }
        };
        let weights = part(parts, "RATIONAL_B_SPLINE_SURFACE")
            .map(|w| w.rows_of_numbers(0))
            .transpose()?
            .map(|(_, w)| w);
        let made = SplineSurface::try_new(degrees, knots, &poles?, weights.as_deref());
        Ok(ParametricSurface::Spline(Box::new(made.map_err(|e| base.wrong(&e.to_string()))?)))
    }
}

fn unsupported_kind(entity: &Entity, what: &str) -> Error {
    Error::unsupported(format!(
        "#{} {}: this kind of {what} is not supported",
        entity.id, entity.record.keyword
    ))
}

/// Repeats knots by their multiplicities. The sum is checked first, because a file can state any
/// multiplicity.
fn repeated(entity: &Entity, counts: &[usize], knots: &[f64], wanted: usize) -> Result<Vec<f64>> {
    let sum = counts.iter().fold(0_usize, |sum, n| sum.saturating_add(*n));
    if counts.len() != knots.len() || sum != wanted {
        return Err(entity.wrong(&format!(
            "expected a multiplicity per knot, {wanted} in all, found {} knots and {} multiplicities that \
             sum to {sum}",
            knots.len(),
            counts.len()
        )));
    }
    let each = knots.iter().zip(counts);
    Ok(each.flat_map(|(k, n)| std::iter::repeat_n(*k, *n)).collect())
}

/// Knots that the keywords `UNIFORM_…`, `QUASI_UNIFORM_…` and `BEZIER_…` imply (ISO 10303-42,
/// `default_b_spline_knots`).
fn implied_knots(parts: &[Entity], kind: &str, degree: usize, n: usize) -> Option<Vec<f64>> {
    // Checked before knots are allocated, because the degree comes from the file.
    if !(1..=MAX_DEGREE).contains(&degree) || n <= degree {
        return None;
    }
    let is = |what: &str| part(parts, &format!("{what}_{kind}")).is_some();
    let clamped = |inner: &mut dyn Iterator<Item = f64>, last: f64| {
        let ends = |x: f64| std::iter::repeat_n(x, degree + 1);
        ends(0.0).chain(inner).chain(ends(last)).collect::<Vec<f64>>()
    };
    if is("UNIFORM") {
        Some((0..n + degree + 1).map(|k| k as f64 - degree as f64).collect())
    } else if is("QUASI_UNIFORM") {
        Some(clamped(&mut (1..n - degree).map(|k| k as f64), (n - degree) as f64))
    } else if is("BEZIER") {
        // Pieces share their end poles; a remainder means that the number of poles is wrong.
        let pieces = (n - 1) / degree;
        let inner = (1..pieces).flat_map(|k| std::iter::repeat_n(k as f64, degree));
        (pieces * degree + 1 == n).then(|| clamped(&mut inner.into_iter(), pieces as f64))
    } else {
        None
    }
}
