//! A drawing: points, bars between them, circles and arcs, over one vector of parameters.
//!
//! In: coordinates and radii. Out: names, values and the parameters of each part. Lengths are in the unit of
//! the drawing. Not guaranteed: that bars do not cross. That the ends of an arc lie on its circle is a
//! constraint, not a property of the drawing: an estimate of both satisfies it only approximately.

use crate::constraint::Constraint;
use nalgebra::DVector;
use planish_core::BoundingBox;
use planish_estimate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Index of a point of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct PointId(pub u32);

/// Index of a bar of a drawing: a straight line between two of its points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct BarId(pub u32);

/// Index of a circle of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct CircleId(pub u32);

/// Index of an arc of a drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct ArcId(pub u32);

/// Numbers of points, bars and circles of a drawing; also the index offsets of a drawing appended to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Offset {
    /// Number of points.
    pub points: u32,
    /// Number of bars.
    pub bars: u32,
    /// Number of circles.
    pub circles: u32,
}

impl Offset {
    /// Index of a point of the appended drawing in the whole drawing.
    #[must_use]
    pub fn point(self, point: PointId) -> PointId {
        PointId(point.0 + self.points)
    }

    /// Index of a bar of the appended drawing in the whole drawing.
    #[must_use]
    pub fn bar(self, bar: BarId) -> BarId {
        BarId(bar.0 + self.bars)
    }

    /// Index of a circle of the appended drawing in the whole drawing.
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
/// Parameters are in the order of their addition: two per point (`x1 y1`, counted from 1 as in the paper),
/// one per radius (`r1`). A covariance of the drawing has the same order.
///
/// # Examples
/// ```
/// use planish_contour::constraint::ParametricDrawing;
///
/// let mut drawing = ParametricDrawing::polygon(&[[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]])?;
/// let centre = drawing.point([20.0, 15.0]);
/// drawing.circle(centre, 6.0)?;
/// assert_eq!(drawing.values().len(), 11);
/// assert_eq!(drawing.parameter_name(10), "r1");
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ParametricDrawing {
    values: Vec<f64>,
    names: Vec<String>,
    points: Vec<usize>,
    point_names: Vec<String>,
    bars: Vec<Bar>,
    circles: Vec<Circle>,
    circle_names: Vec<String>,
    arcs: Vec<Arc>,
}

impl ParametricDrawing {
    /// A closed polygon: a point for each vertex, and a bar from each to the next.
    ///
    /// The parameters are those of an estimated polygon, `x0 y0 x1 y1 …`, in the same order.
    ///
    /// # Errors
    /// `Input` with fewer than three vertices, a coordinate that is not finite, or coincident neighbours.
    pub fn polygon(vertices: &[[f64; 2]]) -> Result<Self> {
        let mut drawing = Self::default();
        drawing.add_polygon(vertices)?;
        Ok(drawing)
    }

    /// Adds a closed polygon, such as another part or a hole, and returns its bars.
    ///
    /// # Errors
    /// As [`Self::polygon`]; nothing is added in that case.
    pub fn add_polygon(&mut self, vertices: &[[f64; 2]]) -> Result<Vec<BarId>> {
        if vertices.len() < 3 {
            return Err(Error::input(format!(
                "expected at least three vertices of a polygon, found {}",
                vertices.len()
            )));
        }
        // Work on a copy: an error in a later bar must not leave half of the polygon behind.
        let mut extended = self.clone();
        let points: Vec<PointId> = vertices.iter().map(|&vertex| extended.point(vertex)).collect();
        // The last bar returns to the first point.
        let next = points.iter().cycle().skip(1);
        let bars =
            points.iter().zip(next).map(|(&start, &end)| extended.bar(start, end)).collect::<Result<_>>()?;
        *self = extended;
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
    /// `Input` if its ends are the same point, coincide, or are not finite: it would have no direction.
    pub fn bar(&mut self, start: PointId, end: PointId) -> Result<BarId> {
        let (a, b) = (self.position(start), self.position(end));
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        if !(length > 0.0 && length.is_finite()) {
            return Err(Error::input(format!(
                "expected a bar with two different, finite ends, found one from {} {a:?} to {} {b:?}",
                self.point_name(start),
                self.point_name(end)
            )));
        }
        // Bars have no parameters of their own: two bars that share a point move together.
        self.bars.push(Bar { start, end, axis: false });
        Ok(BarId(self.bars.len() as u32 - 1))
    }

    /// Adds a bar that is a possible axis of symmetry.
    ///
    /// [`candidates`](crate::constraint::candidates) proposes symmetries about axes only; about every bar,
    /// their number would grow with the third power of the size of the drawing.
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
    /// `Input` if the radius is not positive and finite.
    pub fn circle(&mut self, centre: PointId, radius: f64) -> Result<CircleId> {
        if !(radius > 0.0 && radius.is_finite()) {
            return Err(Error::input(format!("expected a radius > 0 of a circle, found {radius}")));
        }
        let number = self.circles.len() + 1;
        // The centre is a point of the drawing, which other parts may share; only the radius is a new
        // parameter.
        self.circles.push(Circle { centre, radius: self.values.len() });
        self.circle_names.push(format!("circle {number}"));
        self.values.push(radius);
        self.names.push(format!("r{number}"));
        Ok(CircleId(number as u32 - 1))
    }

    /// Adds an arc of a circle, counter-clockwise from `start` to `end`. [`Self::arc_constraints`] put these
    /// points on the circle.
    pub fn arc(&mut self, circle: CircleId, start: PointId, end: PointId) -> ArcId {
        // The end points are independent parameters. Angles on the circle instead would prevent sharing them
        // with bars.
        self.arcs.push(Arc { circle, start, end });
        ArcId(self.arcs.len() as u32 - 1)
    }

    /// Appends another drawing, such as another contour or view, and returns the offsets of its indices.
    ///
    /// Parameters keep their order, so that the joint covariance is block-diagonal with the covariances of
    /// both. Names get the prefix; without one, their numbers continue.
    ///
    /// # Examples
    /// ```
    /// use planish_contour::constraint::{ParametricDrawing, PointId};
    ///
    /// let mut both = ParametricDrawing::polygon(&[[0.0, 0.0], [4.0, 0.0], [0.0, 3.0]])?;
    /// let offset = both.append(&both.clone(), None);
    /// assert_eq!(both.point_name(offset.point(PointId(0))), "P4");
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn append(&mut self, other: &Self, prefix: Option<&str>) -> Offset {
        let offset = self.counts();
        let first = self.values.len();
        self.values.extend(&other.values);
        // Parts refer to parameters and to other parts by index; only these indices change.
        self.points.extend(other.points.iter().map(|x| first + x));
        let (mut names, mut point_names, mut circle_names) =
            (other.names.clone(), other.point_names.clone(), other.circle_names.clone());
        if let Some(prefix) = prefix {
            for name in names.iter_mut().chain(&mut point_names).chain(&mut circle_names) {
                name.insert_str(0, prefix);
            }
        } else {
            // Same names as if the parts had been added to this drawing one by one.
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

    /// The constraints that both ends of an arc lie on its circle.
    #[must_use]
    pub fn arc_constraints(&self, arc: ArcId) -> [Constraint; 2] {
        let Arc { circle, start, end } = self.arcs[arc.0 as usize];
        [start, end].map(|point| Constraint::PointOnCircle { point, circle })
    }

    /// Values of the parameters.
    #[must_use]
    pub fn values(&self) -> DVector<f64> {
        DVector::from_column_slice(&self.values)
    }

    /// Values of the parameters without a copy.
    pub(crate) fn raw_values(&self) -> &[f64] {
        &self.values
    }

    /// The same drawing with other values of the parameters.
    ///
    /// # Errors
    /// `Input` if their number differs, or one is not finite.
    pub fn with_values(&self, values: &DVector<f64>) -> Result<Self> {
        if values.len() != self.values.len() || !values.iter().all(|value| value.is_finite()) {
            return Err(Error::input(format!(
                "expected {} finite parameters of the drawing, found {} values",
                self.values.len(),
                values.len()
            )));
        }
        // Bars without length are allowed here, unlike in `bar`: a solver may pass through them.
        let mut moved = self.clone();
        moved.values.copy_from_slice(values.as_slice());
        Ok(moved)
    }

    /// Numbers of points, bars and circles.
    #[must_use]
    pub fn counts(&self) -> Offset {
        Offset {
            points: self.points.len() as u32,
            bars: self.bars.len() as u32,
            circles: self.circles.len() as u32,
        }
    }

    /// Number of parameters.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.values.len()
    }

    /// The name of a parameter, such as `x1`.
    ///
    /// # Panics
    /// If there is no such parameter.
    #[must_use]
    pub fn parameter_name(&self, parameter: usize) -> &str {
        &self.names[parameter]
    }

    /// All points.
    pub fn points(&self) -> impl Iterator<Item = PointId> + use<> {
        (0..self.points.len() as u32).map(PointId)
    }

    /// All bars.
    pub fn bars(&self) -> impl Iterator<Item = BarId> + use<> {
        (0..self.bars.len() as u32).map(BarId)
    }

    /// All circles.
    pub fn circles(&self) -> impl Iterator<Item = CircleId> + use<> {
        (0..self.circles.len() as u32).map(CircleId)
    }

    /// All arcs: circle, start and end point, counter-clockwise.
    pub fn arcs(&self) -> impl Iterator<Item = (CircleId, PointId, PointId)> {
        self.arcs.iter().map(|arc| (arc.circle, arc.start, arc.end))
    }

    /// Coordinates of a point.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn position(&self, point: PointId) -> [f64; 2] {
        let [x, y] = self.coordinates(point);
        [self.values[x], self.values[y]]
    }

    /// Indices of the two parameters of a point.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn coordinates(&self, point: PointId) -> [usize; 2] {
        let x = self.points[point.0 as usize];
        [x, x + 1]
    }

    /// End points of a bar.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn ends(&self, bar: BarId) -> [PointId; 2] {
        let bar = self.bars[bar.0 as usize];
        [bar.start, bar.end]
    }

    /// True if a bar is a possible axis of symmetry.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn is_axis(&self, bar: BarId) -> bool {
        self.bars[bar.0 as usize].axis
    }

    /// Length of a bar.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn length(&self, bar: BarId) -> f64 {
        let [a, b] = self.ends(bar).map(|end| self.position(end));
        (b[0] - a[0]).hypot(b[1] - a[1])
    }

    /// Centre of a circle.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn centre(&self, circle: CircleId) -> PointId {
        self.circles[circle.0 as usize].centre
    }

    /// Index of the parameter of a circle's radius.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn radius_parameter(&self, circle: CircleId) -> usize {
        self.circles[circle.0 as usize].radius
    }

    /// Radius of a circle.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn radius(&self, circle: CircleId) -> f64 {
        self.values[self.radius_parameter(circle)]
    }

    /// Name of a point, such as `P1`, or `front P1` with a prefix.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn point_name(&self, point: PointId) -> &str {
        &self.point_names[point.0 as usize]
    }

    /// Name of a circle, such as `circle 1`.
    ///
    /// # Panics
    /// If the drawing has no such part.
    #[must_use]
    pub fn circle_name(&self, circle: CircleId) -> &str {
        &self.circle_names[circle.0 as usize]
    }

    /// Name of a bar, such as `P1P2`, or `front P1P2` with a prefix.
    #[must_use]
    pub fn bar_name(&self, bar: BarId) -> String {
        let [a, b] = self.ends(bar);
        self.pair_name(a, b)
    }

    /// Name of a pair of points, in the form of [`Self::bar_name`].
    #[must_use]
    pub fn pair_name(&self, a: PointId, b: PointId) -> String {
        let [a, b] = [a, b].map(|point| self.point_name(point));
        // Write a common prefix only once.
        // The number follows the last P: a prefix may contain that letter, too.
        let number = b.rfind('P').unwrap_or(0);
        if a.get(..number) == b.get(..number) { format!("{a}{}", &b[number..]) } else { format!("{a} {b}") }
    }

    /// Diagonal of the bounding box of all points and circles; 1 for a drawing without extent.
    ///
    /// Tolerances are relative to it; 1 avoids a division by zero.
    #[must_use]
    pub fn extent(&self) -> f64 {
        let mut bounds: BoundingBox<[f64; 2]> = self.points().map(|point| self.position(point)).collect();
        // The absolute value of a radius, as it may become negative while a solver runs.
        for circle in self.circles() {
            let center = self.position(self.centre(circle));
            bounds.include_box(&BoundingBox { min: center, max: center }.grown(self.radius(circle).abs()));
        }
        let [width, height] = bounds.extent();
        let diagonal = width.hypot(height);
        if diagonal > 0.0 && diagonal.is_finite() { diagonal } else { 1.0 }
    }
}
