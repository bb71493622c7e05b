//! Data model of a drawing: curves with line styles in up to three views, in model coordinates.

pub mod conditions;
mod content;

pub(crate) use content::spacing_of;
pub use content::{Hatch, Section, ViewContent};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Distance from straight lines, relative to the size of the drawing, and from curves, relative to their
/// extent, from which on points are clear of the borders of hatched regions. These are often polygons of
/// curves: those with 24 sides to a turn are off by 0.009 radii.
const BORDER_CLEARANCE: [f64; 2] = [1e-4, 0.01];

/// Viewing direction of a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ViewKind {
    /// From −y: x to the right, z up.
    Front,
    /// From +z: x to the right, y up.
    Top,
    /// From +x: y to the right, z up.
    Side,
    /// From −x, mirrored: y to the right, z up.
    Left,
}

impl ViewKind {
    /// The three that files hold by default: front, top, side.
    pub const ALL: [Self; 3] = [Self::Front, Self::Top, Self::Side];

    /// The axes (0 = x, 1 = y, 2 = z) that run right, up, and along the line of sight.
    ///
    /// ```
    /// use planish_solid::views::ViewKind;
    ///
    /// // From above: x to the right, y up, z along the line of sight.
    /// assert_eq!(ViewKind::Top.axes(), [0, 1, 2]);
    /// ```
    #[must_use]
    pub fn axes(self) -> [usize; 3] {
        match self {
            Self::Front => [0, 2, 1],
            Self::Top => [0, 1, 2],
            Self::Side | Self::Left => [1, 2, 0],
        }
    }

    /// True if the coordinate along the line of sight increases away from the viewer.
    #[must_use]
    pub fn depth_increases_away(self) -> bool {
        matches!(self, Self::Front | Self::Left)
    }

    /// Its name in messages and JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Top => "top",
            Self::Side => "side",
            Self::Left => "left",
        }
    }
}

/// Line style.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum LineStyle {
    /// Visible line.
    Visible,
    /// Line behind solid material.
    Hidden,
}

/// A curve in a view.
#[derive(Debug, Clone, PartialEq)]
pub enum Curve2 {
    /// A straight line between two points.
    Segment([f64; 2], [f64; 2]),
    /// A part of a circle, counter-clockwise; angles in radians.
    Arc {
        /// Centre of the circle.
        center: [f64; 2],
        /// Radius, > 0.
        radius: f64,
        /// Angle of the start, from the axis that runs right.
        start: f64,
        /// Angle between start and end, in (0, 2π].
        sweep: f64,
    },
    /// Any other curve, for example the image of an edge between curved faces: a polygon through its points.
    Chain(Vec<[f64; 2]>),
}

impl Curve2 {
    /// Points along the curve, from its start to its end.
    ///
    /// A segment has two. Points of an arc are at most 3.75° apart, and there are at least five.
    ///
    /// ```
    /// use planish_solid::views::Curve2;
    ///
    /// let quarter = Curve2::Arc { center: [1.0, 0.0], radius: 2.0, start: 0.0, sweep: 1.5 };
    /// let points = quarter.points();
    /// assert_eq!(points.len(), 24);
    /// assert_eq!(points[0], [3.0, 0.0]);
    /// ```
    #[must_use]
    pub fn points(&self) -> Vec<[f64; 2]> {
        match self {
            Self::Segment(a, b) => vec![*a, *b],
            Self::Arc { center, radius, start, sweep } => {
                let n = ((sweep / TAU * 96.0).ceil() as usize).max(4);
                (0..=n)
                    .map(|k| {
                        let angle = start + sweep * k as f64 / n as f64;
                        [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()]
                    })
                    .collect()
            }
            Self::Chain(points) => points.clone(),
        }
    }

    /// Minimum and maximum of each coordinate along the curve.
    ///
    /// ```
    /// use planish_solid::views::Curve2;
    ///
    /// // From 1 to 2 radians, an arc passes its highest point.
    /// let arc = Curve2::Arc { center: [0.0, 0.0], radius: 2.0, start: 1.0, sweep: 1.0 };
    /// assert_eq!(arc.bounds()[1][1], 2.0);
    /// ```
    #[must_use]
    pub fn bounds(&self) -> [[f64; 2]; 2] {
        let points = self.points();
        let mut bounds =
            [0, 1].map(|k| points.iter().fold([f64::MAX, f64::MIN], |s, p| [s[0].min(p[k]), s[1].max(p[k])]));
        if let Self::Arc { center, radius, start, sweep } = self {
            // Left, right, lowest and highest point of the circle.
            for (quarter, (axis, side)) in [(0, 1), (1, 1), (0, 0), (1, 0)].into_iter().enumerate() {
                if (quarter as f64 * FRAC_PI_2 - start).rem_euclid(TAU) <= *sweep {
                    bounds[axis][side] = center[axis] + [-radius, *radius][side];
                }
            }
        }
        bounds
    }

    /// The curve after `to`, a translation or, with `mirrored`, a translation after the map x → −x.
    ///
    /// Angles of arcs are not rotated, so `to` must not contain a rotation.
    ///
    /// ```
    /// use planish_solid::views::Curve2;
    ///
    /// let line = Curve2::Segment([1.0, 0.0], [3.0, 2.0]);
    /// let moved = line.moved(|p| [10.0 - p[0], p[1]], true);
    /// assert_eq!(moved, Curve2::Segment([9.0, 0.0], [7.0, 2.0]));
    /// ```
    #[must_use]
    pub fn moved(&self, to: impl Fn([f64; 2]) -> [f64; 2], mirrored: bool) -> Self {
        match self {
            Self::Segment(a, b) => Self::Segment(to(*a), to(*b)),
            Self::Arc { center, radius, start, sweep } => Self::Arc {
                center: to(*center),
                radius: *radius,
                // A mirror takes the angle θ to π − θ and reverses the direction. Arcs stay
                // counter-clockwise, so the mirrored end becomes the start.
                start: if mirrored { PI - start - sweep } else { *start },
                sweep: *sweep,
            },
            Self::Chain(points) => Self::Chain(points.iter().map(|p| to(*p)).collect()),
        }
    }

    /// Length of the polygon through [`Curve2::points`].
    ///
    /// Chords make the length of an arc too small, by less than 0.02 % for chords of 3.75°.
    #[must_use]
    pub fn length(&self) -> f64 {
        let points = self.points();
        points.windows(2).map(|p| distance(p[0], p[1])).sum()
    }
}

/// The distance between two points of a view.
///
/// ```
/// assert_eq!(planish_solid::views::distance([0.0, 0.0], [3.0, 4.0]), 5.0);
/// ```
#[must_use]
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The distance of a point to the segment between two points.
///
/// ```
/// use planish_solid::views::distance_to_segment;
///
/// assert_eq!(distance_to_segment([4.0, 3.0], [0.0, 0.0], [10.0, 0.0]), 3.0);
/// // Beyond its end, the end is nearest.
/// assert_eq!(distance_to_segment([13.0, 4.0], [0.0, 0.0], [10.0, 0.0]), 5.0);
/// ```
#[must_use]
pub fn distance_to_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let d = [b[0] - a[0], b[1] - a[1]];
    let square = d[0] * d[0] + d[1] * d[1];
    // A segment without length is a point; the quotient would be NaN.
    let share = match square > 0.0 {
        true => (((p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1]) / square).clamp(0.0, 1.0),
        false => 0.0,
    };
    distance(p, [a[0] + share * d[0], a[1] + share * d[1]])
}

/// The point of a curve that is nearest to a point.
///
/// ```
/// use planish_solid::views::{Curve2, nearest_on_curve};
///
/// let curve = Curve2::Segment([0.0, 0.0], [10.0, 0.0]);
/// assert_eq!(nearest_on_curve(&curve, [4.0, 3.0]), [4.0, 0.0]);
/// ```
#[must_use]
pub fn nearest_on_curve(curve: &Curve2, p: [f64; 2]) -> [f64; 2] {
    if let Curve2::Arc { center, radius, start, sweep } = curve {
        let angle = (p[1] - center[1]).atan2(p[0] - center[0]);
        let along = (angle - start).rem_euclid(TAU);
        // Beyond the arc, the end nearer by angle is also nearer by distance. A clamp of `along` would always
        // give its end, because angles before the start wrap to values above the sweep.
        let along = match (along <= *sweep, along - sweep < TAU - along) {
            (true, _) => along,
            (false, true) => *sweep,
            (false, false) => 0.0,
        };
        let (sin, cos) = (start + along).sin_cos();
        return [center[0] + radius * cos, center[1] + radius * sin];
    }
    let points = curve.points();
    let on = |pair: &[[f64; 2]]| {
        let d = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
        let square = d[0] * d[0] + d[1] * d[1];
        let share = match square > 0.0 {
            true => (((p[0] - pair[0][0]) * d[0] + (p[1] - pair[0][1]) * d[1]) / square).clamp(0.0, 1.0),
            false => 0.0,
        };
        [0, 1].map(|k| pair[0][k] + share * d[k])
    };
    let all = points.windows(2).map(on);
    all.min_by(|a, b| distance(*a, p).total_cmp(&distance(*b, p))).unwrap_or(points[0])
}

/// A curve with its style and its name in the file.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnCurve {
    /// The curve.
    pub curve: Curve2,
    /// Line style.
    pub style: LineStyle,
    /// Name of the entity in messages: its kind, handle or number, and line of the file.
    pub entity: String,
}

/// One view.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Viewing direction.
    pub kind: ViewKind,
    /// Curves of the view.
    pub curves: Vec<DrawnCurve>,
    /// What it shows of the part.
    pub content: ViewContent,
}

impl View {
    /// A view that shows all edges.
    #[must_use]
    pub fn new(kind: ViewKind, curves: Vec<DrawnCurve>) -> Self {
        Self { kind, curves, content: ViewContent::AllEdges }
    }

    /// Whether a missing line means that there is no edge, not even a hidden one.
    #[must_use]
    pub fn shows_hidden_edges(&self) -> bool {
        self.content == ViewContent::AllEdges
    }

    /// Whether a line is drawn hidden.
    #[must_use]
    pub fn has_hidden_lines(&self) -> bool {
        self.curves.iter().any(|c| c.style == LineStyle::Hidden)
    }

    /// Whether a point may be on the wrong side of the border of a hatched region: it is near a line.
    pub(crate) fn is_near_border(&self, p: [f64; 2], size: f64) -> bool {
        self.curves.iter().any(|drawn| {
            let near = match &drawn.curve {
                Curve2::Segment(..) => BORDER_CLEARANCE[0] * size,
                curve => {
                    let bounds = curve.bounds();
                    BORDER_CLEARANCE[1] * bounds.iter().map(|b| b[1] - b[0]).fold(0.0, f64::max)
                }
            };
            distance(nearest_on_curve(&drawn.curve, p), p) <= near
        })
    }

    /// Whether solids are compared with it.
    pub(crate) fn is_compared(&self) -> bool {
        !matches!(self.content, ViewContent::Candidates | ViewContent::Doubtful)
    }

    /// The section that it shows, if it is one.
    #[must_use]
    pub fn section(&self) -> Option<&Section> {
        match &self.content {
            ViewContent::Section(section) => Some(section),
            _ => None,
        }
    }
}

/// Views of one part, in one frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Drawing {
    /// At most one of each kind, beside sections.
    pub views: Vec<View>,
}

impl Drawing {
    /// Minimum and maximum drawn coordinate along each axis.
    pub(crate) fn bounds(&self) -> [[f64; 2]; 3] {
        let mut bounds = [[f64::MAX, f64::MIN]; 3];
        // Each axis is shown by two views, and both contribute.
        for view in &self.views {
            let axes = view.kind.axes();
            for own in view.curves.iter().map(|c| c.curve.bounds()) {
                for k in 0..2 {
                    let [lo, hi] = bounds[axes[k]];
                    bounds[axes[k]] = [lo.min(own[k][0]), hi.max(own[k][1])];
                }
            }
        }
        bounds
    }

    /// The drawing without sections; none if it has none, or if fewer than two views are left.
    #[must_use]
    pub fn without_sections(&self) -> Option<Self> {
        let views: Vec<View> = self.views.iter().filter(|v| v.section().is_none()).cloned().collect();
        (views.len() < self.views.len() && whole_views(&views) > 1).then_some(Self { views })
    }

    /// Number of lines of sight along which the whole part is shown.
    #[must_use]
    pub fn whole_views(&self) -> usize {
        whole_views(&self.views)
    }

    /// The drawing with all lengths times a factor.
    ///
    /// ```
    /// use planish_solid::drawing::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind};
    ///
    /// let curve = Curve2::Segment([1.0, 0.0], [3.0, 4.0]);
    /// let line = DrawnCurve { curve, style: LineStyle::Visible, entity: "LINE 1".to_owned() };
    /// let drawing = Drawing { views: vec![View::new(ViewKind::Front, vec![line])] };
    /// assert_eq!(drawing.scaled(2.0).views[0].curves[0].curve, Curve2::Segment([2.0, 0.0], [6.0, 8.0]));
    /// ```
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let at = |p: &[f64; 2]| p.map(|c| factor * c);
        let curve = |curve: &Curve2| match curve {
            Curve2::Segment(a, b) => Curve2::Segment(at(a), at(b)),
            Curve2::Arc { center, radius, start, sweep } => {
                Curve2::Arc { center: at(center), radius: factor * radius, start: *start, sweep: *sweep }
            }
            Curve2::Chain(points) => Curve2::Chain(points.iter().map(at).collect()),
        };
        let mut scaled = self.clone();
        for drawn in scaled.views.iter_mut().flat_map(|v| &mut v.curves) {
            drawn.curve = curve(&drawn.curve);
        }
        for view in &mut scaled.views {
            if let ViewContent::Section(section) = &mut view.content {
                *section = Section { at: factor * section.at, hatch: section.hatch.mapped(|p| at(&p)) };
            }
        }
        scaled
    }

    /// The larger side of the box around all curves. Tolerances are relative to this size.
    ///
    /// ```
    /// use planish_solid::views::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind};
    ///
    /// let line = DrawnCurve {
    ///     curve: Curve2::Segment([5.0, 5.0], [25.0, 12.0]),
    ///     style: LineStyle::Visible,
    ///     entity: "LINE 1".to_owned(),
    /// };
    /// let drawing = Drawing { views: vec![View::new(ViewKind::Front, vec![line])] };
    /// assert_eq!(drawing.size(), 20.0);
    /// ```
    #[must_use]
    pub fn size(&self) -> f64 {
        let points = || self.views.iter().flat_map(|v| &v.curves).flat_map(|c| c.curve.points());
        (0..2)
            .map(|a| {
                let (lo, hi) =
                    points().fold((f64::MAX, f64::MIN), |(lo, hi), p| (lo.min(p[a]), hi.max(p[a])));
                hi - lo
            })
            .fold(0.0, f64::max)
    }
}

/// Number of lines of sight along which views show the whole part.
fn whole_views(views: &[View]) -> usize {
    let is_whole = |view: &&View| !matches!(view.content, ViewContent::Section(_) | ViewContent::Candidates);
    let mut sights: Vec<usize> = views.iter().filter(is_whole).map(|v| v.kind.axes()[2]).collect();
    sights.sort_unstable();
    sights.dedup();
    sights.len()
}
