//! Constraints from text: the sentences that [`Constraint::describe`] writes.

use super::candidates::{is_inside, is_left};
use super::drawing::{BarId, CircleId, ParametricDrawing, PointId};
use super::relation::{Axis, Constraint};
use planish_estimate::{Error, Result};

/// Examples of all sentences, for the error message.
const SENTENCES: &str = "P1P2 horizontal; P1P2 vertical; P1P2 parallel to P3P4; P1P2 perpendicular to P2P3; \
    P1P2 as long as \
    P3P4; P1P2 is 40 long; P3 is 12 from P1P2; P1P2 to P2P3 is 60°; x1 = 0; P1 at (0, 0); P1 on P5; P1 on \
    circle 1; P1 and P2 \
    symmetric about P3P4; circle 1 has radius 5; circle 1 has the radius of circle 2; circle 1 concentric \
    with circle 2; circle 1 \
    tangent to circle 2; P1P2 tangent to circle 1; P1P2 tangent to circle 1 at P2";

impl Constraint {
    /// Parses a constraint, such as `P1P2 parallel to P3P4` or `circle 1 has radius 5`.
    ///
    /// Parts have their names in the drawing. The drawing also determines which side of a bar a circle
    /// touches, and whether circles touch from inside.
    ///
    /// # Errors
    /// `Input` if the sentence is not of a form that [`Self::describe`] writes, or refers to a part that the
    /// drawing does not have.
    ///
    /// # Examples
    /// ```
    /// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing};
    ///
    /// let triangle = ParametricDrawing::polygon(&[[0.0, 0.0], [40.0, 0.0], [0.0, 30.0]])?;
    /// let right_angle = Constraint::parse("P1P2 perpendicular to P3P1", &triangle)?;
    /// assert_eq!(right_angle, Constraint::Perpendicular { a: BarId(0), b: BarId(2) });
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn parse(sentence: &str, drawing: &ParametricDrawing) -> Result<Self> {
        Words { drawing }
            .constraint(sentence.trim())
            .map_err(|e| e.in_context(format!("constraint `{}`", sentence.trim())))
    }
}

/// Parser of sentences about a drawing.
struct Words<'a> {
    drawing: &'a ParametricDrawing,
}

impl Words<'_> {
    /// Tries the phrases in turn. The order matters if a phrase occurs in a sentence of another: `tangent to`
    /// has to precede `at`.
    fn constraint(&self, text: &str) -> Result<Constraint> {
        let split = |word: &str| text.split_once(word).map(|(a, b)| (a.trim(), b.trim()));
        if let Some(bar) = text.strip_suffix(" horizontal") {
            return Ok(Constraint::Horizontal { bar: self.bar(bar)? });
        }
        if let Some(bar) = text.strip_suffix(" vertical") {
            return Ok(Constraint::Vertical { bar: self.bar(bar)? });
        }
        if let Some((a, b)) = split(" parallel to ") {
            let (a, b) = (self.bar(a)?, self.bar(b)?);
            return Ok(Constraint::Parallel { a, b });
        }
        if let Some((a, b)) = split(" perpendicular to ") {
            let (a, b) = (self.bar(a)?, self.bar(b)?);
            return Ok(Constraint::Perpendicular { a, b });
        }
        if let Some((a, b)) = split(" as long as ") {
            let (a, b) = (self.bar(a)?, self.bar(b)?);
            return Ok(Constraint::EqualLength { a, b });
        }
        if let Some((pair, about)) = split(" symmetric about ") {
            let Some((a, b)) = pair.split_once(" and ") else {
                return Err(unknown());
            };
            let (a, b, about) = (self.point(a)?, self.point(b)?, self.bar(about)?);
            return Ok(Constraint::Symmetric { a, b, about });
        }
        if let Some((a, b)) = split(" has the radius of ") {
            let (a, b) = (self.circle(a)?, self.circle(b)?);
            return Ok(Constraint::EqualRadius { a, b });
        }
        if let Some((circle, value)) = split(" has radius ") {
            let (circle, value) = (self.circle(circle)?, number(value)?);
            return Ok(Constraint::Radius { circle, value });
        }
        if let Some((a, b)) = split(" concentric with ") {
            let (a, b) = (self.circle(a)?, self.circle(b)?);
            return Ok(Constraint::Concentric { a, b });
        }
        if let Some((a, b)) = split(" tangent to ") {
            return self.tangent(a, b);
        }
        // One phrase for lengths, distances and angles: the text after it decides.
        if let Some((parts, value)) = split(" is ") {
            return self.size(parts, value);
        }
        if let Some((point, at)) = split(" at ") {
            let inner = at.strip_prefix('(').and_then(|rest| rest.strip_suffix(')'));
            let Some((x, y)) = inner.and_then(|inner| inner.split_once(',')) else {
                return Err(unknown());
            };
            let (point, at) = (self.point(point)?, [number(x)?, number(y)?]);
            return Ok(Constraint::Anchor { point, at });
        }
        if let Some((point, on)) = split(" on ") {
            let a = self.point(point)?;
            // Names of circles and points differ in form, so that at most one of both lookups succeeds.
            return Ok(match self.circle(on) {
                Ok(circle) => Constraint::PointOnCircle { point: a, circle },
                Err(_) => Constraint::Coincident { a, b: self.point(on)? },
            });
        }
        match split("=") {
            Some((parameter, value)) => self.coordinate(parameter, number(value)?),
            None => Err(unknown()),
        }
    }

    /// `a tangent to b`.
    fn tangent(&self, a: &str, b: &str) -> Result<Constraint> {
        // The first part decides between two circles, and a bar with a circle.
        if let Ok(first) = self.circle(a) {
            let b = self.circle(b)?;
            let inside = is_inside(self.drawing, first, b);
            return Ok(Constraint::TangentCircles { a: first, b, inside });
        }
        let bar = self.bar(a)?;
        if let Some((circle, point)) = b.split_once(" at ") {
            let (circle, point) = (self.circle(circle)?, self.point(point)?);
            return Ok(Constraint::TangentAt { bar, circle, point });
        }
        // The text does not state the side; the drawn one is meant.
        let circle = self.circle(b)?;
        let left = is_left(self.drawing, circle, bar);
        Ok(Constraint::Tangent { bar, circle, left })
    }

    /// `parts is value`: a length, a distance from a bar, or an angle.
    fn size(&self, parts: &str, value: &str) -> Result<Constraint> {
        if let Some(value) = value.strip_suffix(" long") {
            let ([a, b], value) = (self.pair(parts)?, number(value)?);
            return Ok(Constraint::Distance { a, b, value });
        }
        if let Some((value, bar)) = value.split_once(" from ") {
            let (point, bar, value) = (self.point(parts)?, self.bar(bar)?, number(value)?);
            return Ok(Constraint::PointLineDistance { point, bar, value });
        }
        // `deg` for keyboards without a degree sign.
        let degrees = value.strip_suffix('°').or_else(|| value.strip_suffix("deg"));
        match (parts.split_once(" to "), degrees) {
            (Some((from, to)), Some(degrees)) => Ok(Constraint::Angle {
                from: self.bar(from)?,
                to: self.bar(to)?,
                radians: number(degrees)?.to_radians(),
            }),
            _ => Err(unknown()),
        }
    }

    /// `parameter = value`.
    fn coordinate(&self, parameter: &str, value: f64) -> Result<Constraint> {
        let drawing = self.drawing;
        let found = drawing.points().find_map(|point| {
            let [x, y] = drawing.coordinates(point);
            match parameter {
                name if name == drawing.parameter_name(x) => Some((point, Axis::X)),
                name if name == drawing.parameter_name(y) => Some((point, Axis::Y)),
                _ => None,
            }
        });
        let Some((point, axis)) = found else {
            return Err(missing("coordinate", parameter, "x1", 2 * drawing.points().count()));
        };
        Ok(Constraint::Coordinate { point, axis, value })
    }

    fn point(&self, name: &str) -> Result<PointId> {
        let mut points = self.drawing.points();
        points
            .find(|&point| self.drawing.point_name(point) == name.trim())
            .ok_or_else(|| missing("point", name, "P1", self.drawing.points().count()))
    }

    fn circle(&self, name: &str) -> Result<CircleId> {
        let mut circles = self.drawing.circles();
        circles
            .find(|&circle| self.drawing.circle_name(circle) == name.trim())
            .ok_or_else(|| missing("circle", name, "circle 1", self.drawing.circles().count()))
    }

    /// Two points, with or without a bar between them.
    fn pair(&self, name: &str) -> Result<[PointId; 2]> {
        let name = name.trim();
        // Split at the last P: the first name may have a prefix that contains the letter.
        let cut = name.rfind('P').filter(|&cut| cut > 0);
        let Some(cut) = cut else {
            return Err(missing("pair of points", name, "P1P2", self.drawing.points().count()));
        };
        Ok([self.point(&name[..cut])?, self.point(&name[cut..])?])
    }

    /// A bar by its end points in either order.
    fn bar(&self, name: &str) -> Result<BarId> {
        let ends = self.pair(name)?;
        let mut bars = self.drawing.bars();
        bars.find(|&bar| {
            let [a, b] = self.drawing.ends(bar);
            ends == [a, b] || ends == [b, a]
        })
        .ok_or_else(|| missing("bar", name, "P1P2", self.drawing.bars().count()))
    }
}

fn number(text: &str) -> Result<f64> {
    let found: Option<f64> = text.trim().parse().ok();
    // `parse` accepts `nan` and `inf`.
    found
        .filter(|value| value.is_finite())
        .ok_or_else(|| Error::input(format!("expected a number, found `{}`", text.trim())))
}

fn missing(what: &str, name: &str, such_as: &str, count: usize) -> Error {
    Error::input(format!(
        "the drawing has no {what} `{}`: it has {count}, with names such as `{such_as}`",
        name.trim()
    ))
}

fn unknown() -> Error {
    Error::input(format!("expected a sentence such as: {SENTENCES}"))
}
