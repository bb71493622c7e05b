//! A drawing: points, bars between them, circles and arcs, over one vector of parameters.
//!
//! Comes in: coordinates and radii. Goes out: names, values and the parameters of each part. Lengths are in
//! the drawing's unit. Not guaranteed: that bars do not cross, or that an arc's ends lie on its circle; that
//! is a constraint.

use crate::constraint::Constraint;
use nalgebra::DVector;
use planish_core::BoundingBox;
use planish_estimate::{Error, Result};
use serde::{Deserialize, Serialize};

/// A point of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct PointId(pub u32);

/// A bar of a drawing: a straight line between two of its points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct BarId(pub u32);

/// A circle of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct CircleId(pub u32);

/// An arc of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct ArcId(pub u32);

/// Numbers of points, bars and circles: of a drawing, or before one that was put behind others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Offset {
    /// Points.
    pub points: u32,
    /// Bars.
    pub bars: u32,
    /// Circles.
    pub circles: u32,
}

impl Offset {
    /// A point's number in the whole.
    #[must_use]
    pub fn point(self, point: PointId) -> PointId {
        PointId(point.0 + self.points)
    }

    /// A bar's number in the whole.
    #[must_use]
    pub fn bar(self, bar: BarId) -> BarId {
        BarId(bar.0 + self.bars)
    }

    /// A circle's number in the whole.
    #[must_use]
    pub fn circle(self, circle: CircleId) -> CircleId {
        CircleId(circle.0 + self.circles)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Bar {
    start: PointId,
    end: PointId,
    axis: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Circle {
    centre: PointId,
    radius: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Arc {
    circle: CircleId,
    start: PointId,
    end: PointId,
}

/// Points, bars, circles and arcs over one vector of parameters.
///
/// Parameters stand in the order in which they were added: two for a point (`x1 y1`, counted from 1 as in the
/// paper), one for a radius (`r1`). A covariance of the drawing is in that order.
///
/// # Examples
/// ```
/// use planish_contour::constraint::Drawing;
///
/// let mut drawing = Drawing::polygon(&[[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]])?;
/// let centre = drawing.point([20.0, 15.0]);
/// drawing.circle(centre, 6.0)?;
/// assert_eq!(drawing.values().len(), 11);
/// assert_eq!(drawing.parameter_name(10), "r1");
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Drawing {
    values: Vec<f64>,
    names: Vec<String>,
    points: Vec<usize>,
    point_names: Vec<String>,
    bars: Vec<Bar>,
    circles: Vec<Circle>,
    circle_names: Vec<String>,
    arcs: Vec<Arc>,
}

impl Drawing {
    /// A closed polygon: a point for each vertex, a bar from each to the next.
    ///
    /// Its parameters are those of an estimated polygon, `x0 y0 x1 y1 …`, in the same order.
    ///
    /// # Errors
    /// `Input` when there are fewer than three vertices, a coordinate is not finite, or two neighbours
    /// coincide.
    pub fn polygon(vertices: &[[f64; 2]]) -> Result<Self> {
        let mut drawing = Self::default();
        drawing.add_polygon(vertices)?;
        Ok(drawing)
    }

    /// Adds a closed polygon, such as another part or a hole; its bars come back.
    ///
    /// # Errors
    /// As [`Self::polygon`]; nothing is added then.
    pub fn add_polygon(&mut self, vertices: &[[f64; 2]]) -> Result<Vec<BarId>> {
        if vertices.len() < 3 {
            return Err(Error::input(format!("a polygon needs three vertices, not {}", vertices.len())));
        }
        let mut larger = self.clone();
        let points: Vec<PointId> = vertices.iter().map(|&vertex| larger.point(vertex)).collect();
        let next = points.iter().cycle().skip(1);
        let bars =
            points.iter().zip(next).map(|(&start, &end)| larger.bar(start, end)).collect::<Result<_>>()?;
        *self = larger;
        Ok(bars)
    }

    /// Adds a point.
    pub fn point(&mut self, position: [f64; 2]) -> PointId {
        let number = self.points.len() + 1;
        self.points.push(self.values.len());
        self.point_names.push(format!("P{number}"));
        self.values.extend(position);
        self.names.extend([format!("x{number}"), format!("y{number}")]);
        PointId(number as u32 - 1)
    }

    /// Adds a bar.
    ///
    /// # Errors
    /// `Input` when its ends are one point, coincide, or are not finite: it would have no direction.
    pub fn bar(&mut self, start: PointId, end: PointId) -> Result<BarId> {
        let (a, b) = (self.position(start), self.position(end));
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        if !(length > 0.0 && length.is_finite()) {
            return Err(Error::input(format!(
                "a bar from {} {a:?} to {} {b:?} has no direction: give it two different, finite ends",
                self.point_name(start),
                self.point_name(end)
            )));
        }
        self.bars.push(Bar { start, end, axis: false });
        Ok(BarId(self.bars.len() as u32 - 1))
    }

    /// Adds a bar about which points may be symmetric: [`candidates`](crate::constraint::candidates) are made
    /// for these alone.
    ///
    /// # Errors
    /// As [`Self::bar`].
    pub fn axis(&mut self, start: PointId, end: PointId) -> Result<BarId> {
        let id = self.bar(start, end)?;
        self.bars[id.0 as usize].axis = true;
        Ok(id)
    }

    /// Adds a circle about a point.
    ///
    /// # Errors
    /// `Input` when the radius is not positive and finite.
    pub fn circle(&mut self, centre: PointId, radius: f64) -> Result<CircleId> {
        if !(radius > 0.0 && radius.is_finite()) {
            return Err(Error::input(format!("the radius of a circle must be positive, not {radius}")));
        }
        let number = self.circles.len() + 1;
        self.circles.push(Circle { centre, radius: self.values.len() });
        self.circle_names.push(format!("circle {number}"));
        self.values.push(radius);
        self.names.push(format!("r{number}"));
        Ok(CircleId(number as u32 - 1))
    }

    /// Adds an arc of a circle, counter-clockwise between two points, which [`Self::arc_constraints`] hold on
    /// it.
    pub fn arc(&mut self, circle: CircleId, start: PointId, end: PointId) -> ArcId {
        self.arcs.push(Arc { circle, start, end });
        ArcId(self.arcs.len() as u32 - 1)
    }

    /// Adds all of another drawing behind what is there, such as another contour or another view.
    ///
    /// Parameters keep their order, so that the covariance of both is made of the two blocks. Names get the
    /// prefix, or go on counting where there is none. By how much numbers of parts grow comes back.
    pub fn append(&mut self, other: &Self, prefix: Option<&str>) -> Offset {
        let offset = self.counts();
        let first = self.values.len();
        self.values.extend(&other.values);
        self.points.extend(other.points.iter().map(|x| first + x));
        let (mut names, mut point_names, mut circle_names) =
            (other.names.clone(), other.point_names.clone(), other.circle_names.clone());
        if let Some(prefix) = prefix {
            for name in names.iter_mut().chain(&mut point_names).chain(&mut circle_names) {
                name.insert_str(0, prefix);
            }
        } else {
            for (i, &x) in other.points.iter().enumerate() {
                let number = offset.points as usize + i + 1;
                point_names[i] = format!("P{number}");
                names[x] = format!("x{number}");
                names[x + 1] = format!("y{number}");
            }
            for (i, circle) in other.circles.iter().enumerate() {
                let number = offset.circles as usize + i + 1;
                circle_names[i] = format!("circle {number}");
                names[circle.radius] = format!("r{number}");
            }
        }
        self.names.append(&mut names);
        self.point_names.append(&mut point_names);
        self.circle_names.append(&mut circle_names);
        self.bars.extend(other.bars.iter().map(|bar| Bar {
            start: offset.point(bar.start),
            end: offset.point(bar.end),
            axis: bar.axis,
        }));
        self.circles.extend(
            other
                .circles
                .iter()
                .map(|circle| Circle { centre: offset.point(circle.centre), radius: first + circle.radius }),
        );
        self.arcs.extend(other.arcs.iter().map(|arc| Arc {
            circle: offset.circle(arc.circle),
            start: offset.point(arc.start),
            end: offset.point(arc.end),
        }));
        offset
    }

    /// That both ends of an arc lie on its circle.
    #[must_use]
    pub fn arc_constraints(&self, arc: ArcId) -> [Constraint; 2] {
        let Arc { circle, start, end } = self.arcs[arc.0 as usize];
        [start, end].map(|point| Constraint::PointOnCircle { point, circle })
    }

    /// The parameters.
    #[must_use]
    pub fn values(&self) -> DVector<f64> {
        DVector::from_column_slice(&self.values)
    }

    /// The parameters in place.
    pub(crate) fn raw_values(&self) -> &[f64] {
        &self.values
    }

    /// The same drawing with other parameters.
    ///
    /// # Errors
    /// `Input` when there are not as many, or one is not finite.
    pub fn with_values(&self, values: &DVector<f64>) -> Result<Self> {
        if values.len() != self.values.len() || !values.iter().all(|value| value.is_finite()) {
            return Err(Error::input(format!(
                "the drawing has {} parameters, each finite; {} were given",
                self.values.len(),
                values.len()
            )));
        }
        let mut moved = self.clone();
        moved.values.copy_from_slice(values.as_slice());
        Ok(moved)
    }

    /// How many points, bars and circles there are.
    #[must_use]
    pub fn counts(&self) -> Offset {
        Offset {
            points: self.points.len() as u32,
            bars: self.bars.len() as u32,
            circles: self.circles.len() as u32,
        }
    }

    /// How many parameters there are.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.values.len()
    }

    /// The name of a parameter, such as `x1`.
    ///
    /// # Panics
    /// When there is no such parameter.
    #[must_use]
    pub fn parameter_name(&self, parameter: usize) -> &str {
        &self.names[parameter]
    }

    /// Every point.
    pub fn points(&self) -> impl Iterator<Item = PointId> + use<> {
        (0..self.points.len() as u32).map(PointId)
    }

    /// Every bar.
    pub fn bars(&self) -> impl Iterator<Item = BarId> + use<> {
        (0..self.bars.len() as u32).map(BarId)
    }

    /// Every circle.
    pub fn circles(&self) -> impl Iterator<Item = CircleId> + use<> {
        (0..self.circles.len() as u32).map(CircleId)
    }

    /// Every arc: its circle, the point where it starts, and the one where it ends, counter-clockwise.
    pub fn arcs(&self) -> impl Iterator<Item = (CircleId, PointId, PointId)> {
        self.arcs.iter().map(|arc| (arc.circle, arc.start, arc.end))
    }

    /// Where a point is.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn position(&self, point: PointId) -> [f64; 2] {
        let [x, y] = self.coordinates(point);
        [self.values[x], self.values[y]]
    }

    /// The parameters that are a point's coordinates.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn coordinates(&self, point: PointId) -> [usize; 2] {
        let x = self.points[point.0 as usize];
        [x, x + 1]
    }

    /// The ends of a bar.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn ends(&self, bar: BarId) -> [PointId; 2] {
        let bar = self.bars[bar.0 as usize];
        [bar.start, bar.end]
    }

    /// Whether points may be symmetric about a bar.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn is_axis(&self, bar: BarId) -> bool {
        self.bars[bar.0 as usize].axis
    }

    /// The length of a bar.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn length(&self, bar: BarId) -> f64 {
        let [a, b] = self.ends(bar).map(|end| self.position(end));
        (b[0] - a[0]).hypot(b[1] - a[1])
    }

    /// The centre of a circle.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn centre(&self, circle: CircleId) -> PointId {
        self.circles[circle.0 as usize].centre
    }

    /// The parameter that is a circle's radius.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn radius_parameter(&self, circle: CircleId) -> usize {
        self.circles[circle.0 as usize].radius
    }

    /// The radius of a circle.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn radius(&self, circle: CircleId) -> f64 {
        self.values[self.radius_parameter(circle)]
    }

    /// What a point is called, such as `P1`; `front P1` where views were put together.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn point_name(&self, point: PointId) -> &str {
        &self.point_names[point.0 as usize]
    }

    /// What a circle is called, such as `circle 1`.
    ///
    /// # Panics
    /// When it is of another drawing.
    #[must_use]
    pub fn circle_name(&self, circle: CircleId) -> &str {
        &self.circle_names[circle.0 as usize]
    }

    /// A bar as text, such as `P1P2`; `front P1P2` where views were put together.
    #[must_use]
    pub fn bar_name(&self, bar: BarId) -> String {
        let [a, b] = self.ends(bar);
        self.pair_name(a, b)
    }

    /// Two points as text, as [`Self::bar_name`].
    #[must_use]
    pub fn pair_name(&self, a: PointId, b: PointId) -> String {
        let [a, b] = [a, b].map(|point| self.point_name(point));
        // A prefix that both share is said once.
        let number = b.rfind('P').unwrap_or(0);
        if a.get(..number) == b.get(..number) { format!("{a}{}", &b[number..]) } else { format!("{a} {b}") }
    }

    /// The diagonal of the box around all points and circles; 1 for a drawing without extent.
    #[must_use]
    pub fn extent(&self) -> f64 {
        let mut bounds: BoundingBox<2> = self.points().map(|point| self.position(point)).collect();
        for circle in self.circles() {
            let center = self.position(self.centre(circle));
            bounds.include_box(&BoundingBox { min: center, max: center }.grown(self.radius(circle).abs()));
        }
        let [width, height] = bounds.extent();
        let diagonal = width.hypot(height);
        if diagonal > 0.0 && diagonal.is_finite() { diagonal } else { 1.0 }
    }
}
