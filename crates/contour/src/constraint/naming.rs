//! The parts that a constraint refers to, and its text.

use super::drawing::{BarId, CircleId, Offset, ParametricDrawing, PointId};
use super::place::Place;
use super::relation::Constraint;
use planish_estimate::{Error, Result};

impl Constraint {
    /// Checks that a drawing has the parts of the constraint, and that its value is finite.
    ///
    /// # Errors
    /// `Input` if not.
    pub fn require_parts(&self, drawing: &ParametricDrawing) -> Result<()> {
        // Lists of its own for `Aligned`, whose parts depend on its value; all other arms borrow from `self`.
        let aligned;
        let (points, bars, circles, value): (&[PointId], &[BarId], &[CircleId], f64) = match self {
            Self::Distance { a, b, value } => (&[*a, *b], &[], &[], *value),
            Self::PointLineDistance { point, bar, value } => (&[*point], &[*bar], &[], *value),
            Self::Angle { from, to, radians } => (&[], &[*from, *to], &[], *radians),
            Self::Parallel { a, b } | Self::Perpendicular { a, b } | Self::EqualLength { a, b } => {
                (&[], &[*a, *b], &[], 0.0)
            }
            Self::Tangent { bar, circle, .. } => (&[], &[*bar], &[*circle], 0.0),
            Self::TangentCircles { a, b, .. } | Self::Concentric { a, b } | Self::EqualRadius { a, b } => {
                (&[], &[], &[*a, *b], 0.0)
            }
            Self::Symmetric { a, b, about } => (&[*a, *b], &[*about], &[], 0.0),
            Self::TangentAt { bar, circle, point } => (&[*point], &[*bar], &[*circle], 0.0),
            Self::Aligned { a, b } => {
                let mut named = (Vec::new(), Vec::new());
                for place in [a, b] {
                    match place {
                        Place::Point { point, .. } => named.0.push(*point),
                        Place::Extreme { circle, .. } => named.1.push(*circle),
                    }
                }
                aligned = named;
                (&aligned.0, &[], &aligned.1, 0.0)
            }
            Self::Horizontal { bar } | Self::Vertical { bar } => (&[], &[*bar], &[], 0.0),
            Self::Coordinate { point, value, .. } => (&[*point], &[], &[], *value),
            // The sum is finite only if both coordinates are.
            Self::Anchor { point, at } => (&[*point], &[], &[], at[0] + at[1]),
            Self::Coincident { a, b } => (&[*a, *b], &[], &[], 0.0),
            Self::PointOnCircle { point, circle } => (&[*point], &[], &[*circle], 0.0),
            Self::Radius { circle, value } => (&[], &[], &[*circle], *value),
        };
        let count = [drawing.points().count(), drawing.bars().count(), drawing.circles().count()];
        // Counted from 1 in the message, as names of parts are.
        let missing = (points.iter().map(|p| ("point", p.0, count[0])))
            .chain(bars.iter().map(|b| ("bar", b.0, count[1])))
            .chain(circles.iter().map(|c| ("circle", c.0, count[2])))
            .find(|&(_, id, count)| id as usize >= count);
        match missing {
            Some((part, id, count)) => Err(Error::input(format!(
                "a constraint refers to {part} {}: expected a number of at most {count}",
                id + 1
            ))),
            None if !value.is_finite() => {
                Err(Error::input(format!("{} has no finite value", self.describe(drawing))))
            }
            None => Ok(()),
        }
    }

    /// The constraint as text, such as `P1P2 parallel to P4P3`, with values to eight digits.
    ///
    /// [`Self::parse`] reads this text.
    ///
    /// # Examples
    /// ```
    /// use planish_contour::constraint::{Constraint, ParametricDrawing, PointId};
    ///
    /// let triangle = ParametricDrawing::polygon(&[[0.0, 0.0], [40.0, 0.0], [0.0, 30.0]])?;
    /// let length = Constraint::Distance { a: PointId(0), b: PointId(1), value: 40.0 };
    /// assert_eq!(length.describe(&triangle), "P1P2 is 40 long");
    /// assert_eq!(Constraint::parse("P1P2 is 40 long", &triangle)?, length);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    #[must_use]
    pub fn describe(&self, drawing: &ParametricDrawing) -> String {
        let bar = |bar: &BarId| drawing.bar_name(*bar);
        let point = |point: &PointId| drawing.point_name(*point);
        let circle = |circle: &CircleId| drawing.circle_name(*circle);
        match self {
            Self::Distance { a, b, value } => {
                format!("{} is {} long", drawing.pair_name(*a, *b), rounded(*value))
            }
            Self::PointLineDistance { point: p, bar: b, value } => {
                format!("{} is {} from {}", point(p), rounded(*value), bar(b))
            }
            Self::Angle { from, to, radians } => {
                format!("{} to {} is {}°", bar(from), bar(to), rounded(radians.to_degrees()))
            }
            Self::Parallel { a, b } => format!("{} parallel to {}", bar(a), bar(b)),
            Self::Perpendicular { a, b } => format!("{} perpendicular to {}", bar(a), bar(b)),
            Self::Tangent { bar: b, circle: c, .. } => format!("{} tangent to {}", bar(b), circle(c)),
            Self::TangentCircles { a, b, .. } => format!("{} tangent to {}", circle(a), circle(b)),
            Self::Concentric { a, b } => format!("{} concentric with {}", circle(a), circle(b)),
            Self::EqualLength { a, b } => format!("{} as long as {}", bar(a), bar(b)),
            Self::EqualRadius { a, b } => format!("{} has the radius of {}", circle(a), circle(b)),
            Self::Symmetric { a, b, about } => {
                format!("{} and {} symmetric about {}", point(a), point(b), bar(about))
            }
            Self::Horizontal { bar: b } => format!("{} horizontal", bar(b)),
            Self::Vertical { bar: b } => format!("{} vertical", bar(b)),
            Self::Coordinate { point: p, axis, value } => {
                format!(
                    "{} = {}",
                    drawing.parameter_name(drawing.coordinates(*p)[*axis as usize]),
                    rounded(*value)
                )
            }
            Self::Anchor { point: p, at } => {
                format!("{} at ({}, {})", point(p), rounded(at[0]), rounded(at[1]))
            }
            Self::Coincident { a, b } => format!("{} on {}", point(a), point(b)),
            Self::PointOnCircle { point: p, circle: c } => format!("{} on {}", point(p), circle(c)),
            Self::TangentAt { bar: b, circle: c, point: p } => {
                format!("{} tangent to {} at {}", bar(b), circle(c), point(p))
            }
            Self::Aligned { a, b } => format!("{} = {}", a.describe(drawing), b.describe(drawing)),
            Self::Radius { circle: c, value } => format!("{} has radius {}", circle(c), rounded(*value)),
        }
    }

    /// Indices of the parameters that it depends on, in ascending order.
    pub(crate) fn parameters(&self, drawing: &ParametricDrawing) -> Vec<usize> {
        // Gradients list every parameter, even with a zero slope, so any values of the drawing serve.
        let equations = self.equations(drawing, drawing.raw_values());
        let mut found: Vec<usize> = equations
            .iter()
            .flat_map(|equation| equation.gradient.iter().map(|&(parameter, _)| parameter))
            .collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// The same constraint after its drawing was appended to another.
    #[must_use]
    pub fn shifted(&self, offset: Offset) -> Self {
        // Collect mutable references to all indices first, then shift them in one place.
        let mut moved = *self;
        let (mut points, mut bars, mut circles): (Vec<&mut PointId>, Vec<&mut BarId>, Vec<&mut CircleId>) =
            Default::default();
        match &mut moved {
            Self::Distance { a, b, .. } | Self::Coincident { a, b } => points.extend([a, b]),
            Self::PointLineDistance { point, bar, .. } => {
                points.push(point);
                bars.push(bar);
            }
            Self::Angle { from, to, .. } => bars.extend([from, to]),
            Self::Parallel { a, b } | Self::Perpendicular { a, b } | Self::EqualLength { a, b } => {
                bars.extend([a, b])
            }
            Self::Tangent { bar, circle, .. } => {
                bars.push(bar);
                circles.push(circle);
            }
            Self::TangentCircles { a, b, .. } | Self::Concentric { a, b } | Self::EqualRadius { a, b } => {
                circles.extend([a, b]);
            }
            Self::Symmetric { a, b, about } => {
                points.extend([a, b]);
                bars.push(about);
            }
            Self::Horizontal { bar } | Self::Vertical { bar } => bars.push(bar),
            Self::Coordinate { point, .. } | Self::Anchor { point, .. } => points.push(point),
            Self::PointOnCircle { point, circle } => {
                points.push(point);
                circles.push(circle);
            }
            Self::TangentAt { bar, circle, point } => {
                bars.push(bar);
                circles.push(circle);
                points.push(point);
            }
            Self::Radius { circle, .. } => circles.push(circle),
            Self::Aligned { a, b } => {
                *a = a.shifted(offset);
                *b = b.shifted(offset);
            }
        }
        points.into_iter().for_each(|point| *point = offset.point(*point));
        bars.into_iter().for_each(|bar| *bar = offset.bar(*bar));
        circles.into_iter().for_each(|circle| *circle = offset.circle(*circle));
        moved
    }
}

/// A value with eight significant digits, more than any estimate needs; very large and small ones with an
/// exponent.
fn rounded(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (1e-6..1e12).contains(&size) {
        // The shortest decimal text of the rounded value; fixed precision would print trailing zeros.
        let scale = 10_f64.powi(7 - size.max(f64::MIN_POSITIVE).log10().floor() as i32);
        return match value == 0.0 {
            true => "0".to_owned(),
            false => ((value * scale).round() / scale).to_string(),
        };
    }
    // Parsing and formatting again removes trailing zeros.
    let short = format!("{value:.7e}");
    short.parse::<f64>().map_or(short, |v| format!("{v:e}"))
}
