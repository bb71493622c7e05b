//! Kinds of contours: their parameters and the outlines that the parameters describe.
//!
//! In: a [`ContourKind`] and its parameter vector θ (lengths in the unit of the readings, angles in radians).
//! Out: vertices, pieces, names of the parameters, and derivatives of vertices by θ. Not guaranteed: that an
//! outline is free of self-intersections.

use std::fmt;

/// Bulge of a quarter circle, `tan(π/8) = √2 − 1`.
const QUARTER: f64 = 0.414_213_562_373_095_03;

/// The kind of a contour, with the order of its parameters.
///
/// # Examples
/// ```
/// use planish_contour::planar::ContourKind;
///
/// let kind = ContourKind::RegularPolygon(6);
/// assert_eq!(kind.to_string(), "regular-polygon-6");
/// assert_eq!(ContourKind::from_name("regular-polygon-6", 12), Some(kind.clone()));
/// assert_eq!((kind.parameters(), kind.pieces()), (4, 6));
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum ContourKind {
    /// An infinite straight line: `angle_rad offset`, the points with `−sin·x + cos·y = offset`.
    Line,
    /// `center_x center_y radius`.
    Circle,
    /// `center_x center_y semi_major semi_minor angle_rad`.
    Ellipse,
    /// `center_x center_y width height angle_rad`.
    Rectangle,
    /// `center_x center_y width height angle_rad corner_radius`.
    RoundedRectangle,
    /// A rectangle that ends in half circles: `center_x center_y length width angle_rad`, with the overall
    /// length.
    Slot,
    /// A regular polygon of this many sides: `center_x center_y circumradius angle_rad`, where the angle is
    /// the direction of the first vertex.
    RegularPolygon(usize),
    /// A closed polygon of this many vertices: `x0 y0 x1 y1 …`.
    Polygon(usize),
    /// Lines and arcs: the vertices as for a polygon, then the bulge `tan(α/4)` of each arc, α being its
    /// angle.
    Chain {
        /// Whether each piece is an arc.
        arcs: Vec<bool>,
        /// Whether the last piece ends at the first vertex.
        closed: bool,
    },
}

/// Vertices and the pieces between them. Piece `i` runs from vertex `i` to the next, counter-clockwise around
/// the interior.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    /// The vertices.
    pub vertices: Vec<[f64; 2]>,
    /// Bulge of each piece, `tan(α/4)` of an arc of angle α and 0 of a line, as in a DXF polyline. Positive
    /// values curve outwards.
    pub bulges: Vec<f64>,
    /// True if a piece joins the last vertex to the first.
    pub closed: bool,
}

impl fmt::Display for ContourKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line => out.write_str("line"),
            Self::Circle => out.write_str("circle"),
            Self::Ellipse => out.write_str("ellipse"),
            Self::Rectangle => out.write_str("rectangle"),
            Self::RoundedRectangle => out.write_str("rounded-rectangle"),
            Self::Slot => out.write_str("slot"),
            Self::RegularPolygon(sides) => write!(out, "regular-polygon-{sides}"),
            Self::Polygon(vertices) => write!(out, "polygon-{vertices}"),
            Self::Chain { .. } => out.write_str("chain"),
        }
    }
}

impl ContourKind {
    /// Parses the name that `Display` writes. Polygons may have 3 to `max_corners` corners.
    ///
    /// Returns `None` for unknown names and for `chain`, whose pattern of lines and arcs is not in its name.
    #[must_use]
    pub fn from_name(name: &str, max_corners: usize) -> Option<Self> {
        let counted = |prefix: &str| {
            name.strip_prefix(prefix)
                .and_then(|count| count.parse::<usize>().ok())
                .filter(|count| (3..=max_corners).contains(count))
        };
        Some(match name {
            "line" => Self::Line,
            "circle" => Self::Circle,
            "ellipse" => Self::Ellipse,
            "rectangle" => Self::Rectangle,
            "rounded-rectangle" => Self::RoundedRectangle,
            "slot" => Self::Slot,
            _ => {
                return (counted("regular-polygon-").map(Self::RegularPolygon))
                    .or_else(|| counted("polygon-").map(Self::Polygon));
            }
        })
    }

    /// Number of parameters, without those of a motion.
    #[must_use]
    pub fn parameters(&self) -> usize {
        match self {
            Self::Line => 2,
            Self::Circle => 3,
            Self::RegularPolygon(_) => 4,
            Self::Ellipse | Self::Rectangle | Self::Slot => 5,
            Self::RoundedRectangle => 6,
            Self::Polygon(vertices) => 2 * vertices,
            Self::Chain { arcs, closed } => {
                2 * (arcs.len() + usize::from(!closed)) + arcs.iter().filter(|&&arc| arc).count()
            }
        }
    }

    /// The name of the kind without its number of vertices: `regular-polygon`.
    #[must_use]
    pub fn family(&self) -> &'static str {
        match self {
            Self::Line => "line",
            Self::Circle => "circle",
            Self::Ellipse => "ellipse",
            Self::Rectangle => "rectangle",
            Self::RoundedRectangle => "rounded-rectangle",
            Self::Slot => "slot",
            Self::RegularPolygon(_) => "regular-polygon",
            Self::Polygon(_) => "polygon",
            Self::Chain { .. } => "chain",
        }
    }

    /// Names of the parameters in files, each with the factor from internal units to those of the file
    /// (degrees for angles, 1 otherwise).
    #[must_use]
    pub fn names(&self) -> Vec<(String, f64)> {
        let fixed = |names: &[&str]| {
            let with_unit = |name: &&str| {
                ((*name).to_owned(), if name.ends_with("_deg") { 1f64.to_degrees() } else { 1.0 })
            };
            names.iter().map(with_unit).collect::<Vec<_>>()
        };
        match self {
            Self::Line => fixed(&["angle_deg", "offset"]),
            Self::Circle => fixed(&["center_x", "center_y", "radius"]),
            Self::Ellipse => fixed(&["center_x", "center_y", "semi_major", "semi_minor", "angle_deg"]),
            Self::Rectangle => fixed(&["center_x", "center_y", "width", "height", "angle_deg"]),
            Self::RoundedRectangle => {
                fixed(&["center_x", "center_y", "width", "height", "angle_deg", "corner_radius"])
            }
            Self::Slot => fixed(&["center_x", "center_y", "length", "width", "angle_deg"]),
            Self::RegularPolygon(_) => fixed(&["center_x", "center_y", "circumradius", "angle_deg"]),
            Self::Polygon(count) => vertex_names(*count),
            Self::Chain { arcs, closed } => {
                let mut names = vertex_names(arcs.len() + usize::from(!closed));
                let bulges = arcs.iter().enumerate().filter(|(_, arc)| **arc);
                names.extend(bulges.map(|(i, _)| (format!("bulge{i}"), 1.0)));
                names
            }
        }
    }

    /// Number of pieces of the outline; 1 for lines, circles and ellipses.
    #[must_use]
    pub fn pieces(&self) -> usize {
        match self {
            Self::Line | Self::Circle | Self::Ellipse => 1,
            Self::Rectangle | Self::Slot => 4,
            Self::RoundedRectangle => 8,
            Self::RegularPolygon(count) | Self::Polygon(count) => *count,
            Self::Chain { arcs, .. } => arcs.len(),
        }
    }

    pub(crate) fn is_closed(&self) -> bool {
        !matches!(self, Self::Line | Self::Chain { closed: false, .. })
    }

    /// Vertex `i` of the outline. Lines, circles and ellipses have none.
    pub(crate) fn vertex(&self, theta: &[f64], i: usize) -> [f64; 2] {
        match self {
            Self::Polygon(_) | Self::Chain { .. } => [theta[2 * i], theta[2 * i + 1]],
            Self::RegularPolygon(sides) => {
                let angle = theta[3] + std::f64::consts::TAU * i as f64 / *sides as f64;
                [theta[0] + theta[2] * angle.cos(), theta[1] + theta[2] * angle.sin()]
            }
            _ => {
                let corner = self.corner(i);
                let local =
                    [0, 1].map(|axis| (0..3).map(|k| corner[axis][k] * self.size(theta, k)).sum::<f64>());
                let (sin, cos) = theta[4].sin_cos();
                [theta[0] + cos * local[0] - sin * local[1], theta[1] + sin * local[0] + cos * local[1]]
            }
        }
    }

    /// Fills `out` with the first vertices of the outline.
    ///
    /// Unlike [`Self::vertex`], it evaluates the sine and cosine once for all vertices: the search for the
    /// nearest piece calls it for every reading.
    pub(crate) fn vertices(&self, theta: &[f64], out: &mut [[f64; 2]]) {
        match self {
            Self::Polygon(_) | Self::Chain { .. } => {
                for (i, vertex) in out.iter_mut().enumerate() {
                    *vertex = [theta[2 * i], theta[2 * i + 1]];
                }
            }
            Self::RegularPolygon(sides) => {
                let (sin, cos) = (std::f64::consts::TAU / *sides as f64).sin_cos();
                // Each vertex is the previous one, rotated: one rotation instead of a sine and a cosine.
                let mut arm = [theta[2] * theta[3].cos(), theta[2] * theta[3].sin()];
                for vertex in out {
                    *vertex = [theta[0] + arm[0], theta[1] + arm[1]];
                    arm = [cos * arm[0] - sin * arm[1], sin * arm[0] + cos * arm[1]];
                }
            }
            _ => {
                let (sin, cos) = theta[4].sin_cos();
                for (i, vertex) in out.iter_mut().enumerate() {
                    let corner = self.corner(i);
                    let local =
                        [0, 1].map(|axis| (0..3).map(|k| corner[axis][k] * self.size(theta, k)).sum::<f64>());
                    *vertex = [
                        theta[0] + cos * local[0] - sin * local[1],
                        theta[1] + sin * local[0] + cos * local[1],
                    ];
                }
            }
        }
    }

    /// Adds `wᵀ ∂P_i/∂θ` to `out`.
    pub(crate) fn add_vertex_derivative(&self, theta: &[f64], i: usize, w: [f64; 2], out: &mut [f64]) {
        match self {
            Self::Polygon(_) | Self::Chain { .. } => {
                out[2 * i] += w[0];
                out[2 * i + 1] += w[1];
            }
            Self::RegularPolygon(sides) => {
                let angle = theta[3] + std::f64::consts::TAU * i as f64 / *sides as f64;
                let (sin, cos) = angle.sin_cos();
                out[0] += w[0];
                out[1] += w[1];
                out[2] += w[0] * cos + w[1] * sin;
                out[3] += theta[2] * (w[1] * cos - w[0] * sin);
            }
            _ => {
                let corner = self.corner(i);
                let (sin, cos) = theta[4].sin_cos();
                out[0] += w[0];
                out[1] += w[1];
                // The sizes act along the axes of the body: rotate w into them once.
                let body = [w[0] * cos + w[1] * sin, w[1] * cos - w[0] * sin];
                let sizes = if matches!(self, Self::RoundedRectangle) { 3 } else { 2 };
                let mut local = [0.0; 2];
                for k in 0..sizes {
                    let index = if k == 2 { 5 } else { 2 + k };
                    for axis in 0..2 {
                        out[index] += body[axis] * corner[axis][k];
                        local[axis] += corner[axis][k] * theta[index];
                    }
                }
                // Rotation: the derivative of R p is R J p.
                out[4] += body[1] * local[0] - body[0] * local[1];
            }
        }
    }

    /// Bulge of piece `i`, and the index of its parameter if it is one.
    pub(crate) fn bulge(&self, theta: &[f64], i: usize) -> (f64, Option<usize>) {
        match self {
            // Only chains have free bulges: those of slots and rounded rectangles follow from the kind.
            // The ends of a slot are half circles, of bulge tan(π/4) = 1.
            Self::Slot => (if i % 2 == 1 { 1.0 } else { 0.0 }, None),
            Self::RoundedRectangle => (if i % 2 == 1 { QUARTER } else { 0.0 }, None),
            Self::Chain { arcs, closed } if arcs[i] => {
                let first = 2 * (arcs.len() + usize::from(!closed));
                let index = first + arcs[..i].iter().filter(|&&arc| arc).count();
                (theta[index], Some(index))
            }
            _ => (0.0, None),
        }
    }

    /// Size `k` of a kind with sides: width, height, corner radius (0 if the kind has none).
    fn size(&self, theta: &[f64], k: usize) -> f64 {
        match k {
            2 if matches!(self, Self::RoundedRectangle) => theta[5],
            2 => 0.0,
            _ => theta[2 + k],
        }
    }

    /// Local coordinates of vertex `i` as multiples of width, height and corner radius.
    ///
    /// Vertices are linear in the sizes, so the same table gives positions and derivatives.
    fn corner(&self, i: usize) -> [[f64; 3]; 2] {
        let h = 0.5;
        match self {
            Self::RoundedRectangle => {
                // Ends of the straight part of each side, counter-clockwise from the left end of the bottom
                // side: even pieces are sides, odd ones are corner arcs.
                const ENDS: [[[f64; 3]; 2]; 8] = [
                    [[-0.5, 0.0, 1.0], [0.0, -0.5, 0.0]],
                    [[0.5, 0.0, -1.0], [0.0, -0.5, 0.0]],
                    [[0.5, 0.0, 0.0], [0.0, -0.5, 1.0]],
                    [[0.5, 0.0, 0.0], [0.0, 0.5, -1.0]],
                    [[0.5, 0.0, -1.0], [0.0, 0.5, 0.0]],
                    [[-0.5, 0.0, 1.0], [0.0, 0.5, 0.0]],
                    [[-0.5, 0.0, 0.0], [0.0, 0.5, -1.0]],
                    [[-0.5, 0.0, 0.0], [0.0, -0.5, 1.0]],
                ];
                ENDS[i % 8]
            }
            Self::Slot => {
                // The straight part: ±(L − W)/2 along the axis, ±W/2 across. The length includes both half
                // circles.
                let (x, y) = [(-h, -h), (h, -h), (h, h), (-h, h)][i % 4];
                [[x, -x, 0.0], [0.0, y, 0.0]]
            }
            _ => {
                let (x, y) = [(-h, -h), (h, -h), (h, h), (-h, h)][i % 4];
                [[x, 0.0, 0.0], [0.0, y, 0.0]]
            }
        }
    }

    /// The outline with these parameters.
    ///
    /// Circles and ellipses become a polygon of 256 vertices on the curve. A line has no outline (`None`).
    ///
    /// # Examples
    /// ```
    /// use planish_contour::planar::ContourKind;
    ///
    /// let slot = ContourKind::Slot.outline(&[0.0, 0.0, 30.0, 10.0, 0.0]).ok_or("a slot has an outline")?;
    /// assert_eq!(slot.bulges, [0.0, 1.0, 0.0, 1.0]); // two sides and two half circles
    /// assert_eq!(slot.vertices[0], [-10.0, -5.0]);
    /// assert!(ContourKind::Line.outline(&[0.0, 1.0]).is_none());
    /// # Ok::<(), &str>(())
    /// ```
    #[must_use]
    pub fn outline(&self, theta: &[f64]) -> Option<Outline> {
        let around = |point: &dyn Fn(f64) -> [f64; 2]| {
            // The chord error is 1 − cos(π/256), or 7.5e-5 of the radius.
            let count = 256;
            let vertices = (0..count).map(|k| point(std::f64::consts::TAU * f64::from(k) / f64::from(count)));
            Outline { vertices: vertices.collect(), bulges: vec![0.0; count as usize], closed: true }
        };
        match self {
            Self::Line => None,
            Self::Circle => Some(around(&|t| [theta[0] + theta[2] * t.cos(), theta[1] + theta[2] * t.sin()])),
            Self::Ellipse => {
                let (sin, cos) = theta[4].sin_cos();
                Some(around(&|t| {
                    let (a, b) = (theta[2] * t.cos(), theta[3] * t.sin());
                    [theta[0] + cos * a - sin * b, theta[1] + sin * a + cos * b]
                }))
            }
            _ => {
                let closed = self.is_closed();
                let count = self.pieces() + usize::from(!closed);
                Some(Outline {
                    vertices: (0..count).map(|i| self.vertex(theta, i)).collect(),
                    bulges: (0..self.pieces()).map(|i| self.bulge(theta, i).0).collect(),
                    closed,
                })
            }
        }
    }

    /// The same contour in the normal form that files use.
    ///
    /// The longer axis comes first, angles lie in one period of the kind, and a polygon starts at its lowest
    /// vertex (the leftmost of several). The second value gives, for each parameter, the index and the sign
    /// of its source, so that a covariance can be permuted in the same way.
    ///
    /// # Examples
    /// ```
    /// use planish_contour::planar::ContourKind;
    ///
    /// // An ellipse whose first axis is the shorter one.
    /// let (theta, source) = ContourKind::Ellipse.canonical(&[0.0, 0.0, 2.0, 5.0, 0.0]);
    /// assert_eq!(theta[2..], [5.0, 2.0, std::f64::consts::FRAC_PI_2]);
    /// assert_eq!(source[2], (3, 1.0));
    /// ```
    #[must_use]
    pub fn canonical(&self, theta: &[f64]) -> (Vec<f64>, Vec<(usize, f64)>) {
        let mut value = theta.to_vec();
        let mut from: Vec<(usize, f64)> = (0..theta.len()).map(|i| (i, 1.0)).collect();
        let turn = |angle: f64, period: f64| {
            let rest = angle.rem_euclid(period);
            // Rounding turns a tiny negative angle into almost a whole period: an angle of 0° would be
            // printed as 180°.
            if period - rest < 1e-12 { 0.0 } else { rest }
        };
        match self {
            Self::Line => {
                if value[0].rem_euclid(std::f64::consts::TAU) >= std::f64::consts::PI {
                    // A line turned by half a turn is the same line with its normal reversed.
                    value[1] = -value[1];
                    from[1].1 = -1.0;
                }
                value[0] = turn(value[0], std::f64::consts::PI);
            }
            Self::Circle => {}
            Self::Ellipse | Self::Rectangle | Self::RoundedRectangle | Self::Slot => {
                if value[2] < value[3] {
                    // Exchanging both axes is a quarter turn. All four kinds are symmetric under half a turn.
                    value.swap(2, 3);
                    from.swap(2, 3);
                    value[4] += std::f64::consts::FRAC_PI_2;
                }
                value[4] = turn(value[4], std::f64::consts::PI);
            }
            Self::RegularPolygon(sides) => {
                // Any vertex can be the first one.
                value[3] = turn(value[3], std::f64::consts::TAU / *sides as f64);
            }
            Self::Polygon(count) => {
                // The start of the list of vertices is arbitrary; the lowest vertex makes it comparable.
                let lowest = (0..*count).min_by(|&a, &b| {
                    let key = |i: usize| (theta[2 * i + 1], theta[2 * i]);
                    key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal)
                });
                let first = lowest.unwrap_or(0);
                for i in 0..*count {
                    for axis in 0..2 {
                        let source = 2 * ((first + i) % count) + axis;
                        value[2 * i + axis] = theta[source];
                        from[2 * i + axis] = (source, 1.0);
                    }
                }
            }
            Self::Chain { .. } => {}
        }
        (value, from)
    }

    /// True if the parameters describe a contour of this kind: finite, positive sizes, corner radii that fit.
    #[must_use]
    pub fn is_valid(&self, theta: &[f64]) -> bool {
        let finite = theta.iter().all(|value| value.is_finite());
        finite
            && match self {
                Self::Line | Self::Polygon(_) | Self::Chain { .. } => true,
                Self::Circle | Self::RegularPolygon(_) => theta[2] > 0.0,
                Self::Ellipse | Self::Rectangle => theta[2] > 0.0 && theta[3] > 0.0,
                Self::Slot => theta[3] > 0.0 && theta[2] > theta[3],
                Self::RoundedRectangle => {
                    theta[5] > 0.0 && theta[2] > 2.0 * theta[5] && theta[3] > 2.0 * theta[5]
                }
            }
    }
}

fn vertex_names(count: usize) -> Vec<(String, f64)> {
    (0..count).flat_map(|i| [(format!("x{i}"), 1.0), (format!("y{i}"), 1.0)]).collect()
}
