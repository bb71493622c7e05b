//! What a view shows of the part: all edges, the visible ones, or a section.

use super::DrawnCurve;

/// Factor by which the way across hatching lines may exceed their distance without meeting one.
const MISSED: f64 = 1.1;

/// What a view shows of the part.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum ViewContent {
    /// All edges; hidden ones are dashed. A missing line means that there is no edge.
    #[default]
    AllEdges,
    /// Only visible edges. A missing line means that there is no visible edge.
    VisibleEdges,
    /// Visible edges of the part behind a plane across the line of sight.
    Section(Section),
    /// All edges, but some lines may be missing, wrong, or in the wrong style. Nothing follows from a missing
    /// line.
    Doubtful,
    /// Nothing: the curves are candidates for what is round about an axis along which no view looks.
    Candidates,
}

/// A full section.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Section {
    /// Coordinate of the cutting plane along the line of sight.
    pub at: f64,
    /// The hatched material in the cutting plane.
    pub hatch: Hatch,
}

/// Hatched regions of a view.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hatch {
    /// Closed polygons; a point is hatched if it is inside of an odd number of them.
    pub outlines: Vec<Vec<[f64; 2]>>,
    /// Parallel hatching lines, if the file has these instead of regions.
    pub lines: Vec<[[f64; 2]; 2]>,
}

impl Hatch {
    /// Whether a point is hatched, in a view with some curves; none if hatching lines leave this open.
    ///
    /// A point is between hatching lines if one of them is met on the way across them, before any curve. It
    /// is not if the way to the curves on both sides is longer than the distance of the lines.
    ///
    /// The result is uncertain near the borders of regions: outlines may be polygons of curves.
    ///
    /// ```
    /// use planish_solid::drawing::Hatch;
    ///
    /// let outlines = vec![vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]];
    /// let hatch = Hatch { outlines, lines: Vec::new() };
    /// assert_eq!(hatch.contains([1.0, 1.0], &[]), Some(true));
    /// assert_eq!(hatch.contains([5.0, 1.0], &[]), Some(false));
    /// ```
    #[must_use]
    pub fn contains(&self, p: [f64; 2], curves: &[DrawnCurve]) -> Option<bool> {
        let crossed = self.outlines.iter().filter(|outline| is_inside(outline, p)).count();
        match self.lines.is_empty() {
            _ if crossed % 2 == 1 => Some(true),
            true => Some(false),
            false => self.between_lines(p, curves),
        }
    }

    /// Whether a point lies between two hatching lines.
    fn between_lines(&self, p: [f64; 2], curves: &[DrawnCurve]) -> Option<bool> {
        let longest = self.lines.iter().max_by(|a, b| length(a).total_cmp(&length(b)))?;
        let size = length(longest).max(f64::MIN_POSITIVE);
        let across = [longest[0][1] - longest[1][1], longest[1][0] - longest[0][0]].map(|c| c / size);
        let level = |q: [f64; 2]| q[0] * across[0] + q[1] * across[1];
        let mut levels: Vec<f64> = self.lines.iter().map(|line| level(line[0])).collect();
        levels.sort_by(f64::total_cmp);
        let spacing = spacing_of(&levels)?;
        let mut free = 0.0;
        for direction in [across, across.map(|c| -c)] {
            let pieces = curves.iter().map(|c| c.curve.points());
            let to_curve = pieces
                .flat_map(|points| {
                    points.windows(2).filter_map(|w| met(p, direction, [w[0], w[1]])).collect::<Vec<_>>()
                })
                .fold(MISSED * spacing, f64::min);
            if self.lines.iter().filter_map(|line| met(p, direction, *line)).any(|t| t < to_curve) {
                return Some(true);
            }
            free += to_curve;
        }
        (free > MISSED * spacing).then_some(false)
    }

    /// The hatch with all points mapped.
    pub(crate) fn mapped(&self, map: impl Fn([f64; 2]) -> [f64; 2]) -> Self {
        Self {
            outlines: self.outlines.iter().map(|o| o.iter().map(|p| map(*p)).collect()).collect(),
            lines: self.lines.iter().map(|line| line.map(&map)).collect(),
        }
    }
}

/// Distance of parallel lines with the given levels, ascending: the median of the distances of neighbours.
pub(crate) fn spacing_of(levels: &[f64]) -> Option<f64> {
    let extent = levels.last()? - levels.first()?;
    let gaps = levels.windows(2).map(|pair| pair[1] - pair[0]);
    // Several lines may have one level, where a hole interrupts them.
    let mut gaps: Vec<f64> = gaps.filter(|gap| *gap > 1e-4 * extent).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied()
}

fn length([a, b]: &[[f64; 2]; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

/// Distance from a point along a direction at which a straight piece is met.
fn met(p: [f64; 2], direction: [f64; 2], [a, b]: [[f64; 2]; 2]) -> Option<f64> {
    let d = [b[0] - a[0], b[1] - a[1]];
    let cross = direction[0] * d[1] - direction[1] * d[0];
    if cross == 0.0 {
        return None;
    }
    let off = [a[0] - p[0], a[1] - p[1]];
    let along = (off[0] * d[1] - off[1] * d[0]) / cross;
    let share = (off[0] * direction[1] - off[1] * direction[0]) / cross;
    (along >= 0.0 && (0.0..=1.0).contains(&share)).then_some(along)
}

/// Whether a point is inside of a polygon, by the crossings of a ray to the right.
fn is_inside(polygon: &[[f64; 2]], p: [f64; 2]) -> bool {
    let mut inside = false;
    for (k, a) in polygon.iter().enumerate() {
        let b = polygon[(k + 1) % polygon.len()];
        if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            inside = !inside;
        }
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::{Curve2, LineStyle};

    #[test]
    fn points_between_hatching_lines_are_hatched_and_those_in_a_hole_are_not() {
        // Horizontal lines at 0.5, 1.5 … 9.5 over a width of 10, with a slot from x = 4 to 6.
        let lines = (0..10).flat_map(|k| {
            let y = f64::from(k) + 0.5;
            [[[0.0, y], [4.0, y]], [[6.0, y], [10.0, y]]]
        });
        let hatch = Hatch { outlines: Vec::new(), lines: lines.collect() };
        let line = |a: [f64; 2], b: [f64; 2]| DrawnCurve {
            curve: Curve2::Segment(a, b),
            style: LineStyle::Visible,
            entity: String::new(),
        };
        let mut curves: Vec<DrawnCurve> = [0.0, 4.0, 6.0, 10.0].map(|x| line([x, 0.0], [x, 10.0])).to_vec();
        curves.extend([0.0, 10.0].map(|y| line([0.0, y], [10.0, y])));
        let contains = |p: [f64; 2]| hatch.contains(p, &curves);
        assert_eq!(contains([2.0, 4.4]), Some(true));
        assert_eq!(contains([5.0, 4.4]), Some(false));
        // In a corner: only one line is beside it. Outside, the border is between the point and the line.
        assert_eq!(contains([0.1, 9.9]), Some(true));
        assert_eq!(contains([2.0, 10.1]), Some(false));
        // Between two lines that are nearer to each other than hatching lines, there may be none.
        curves.extend([4.6, 4.9].map(|y| line([0.0, y], [4.0, y])));
        assert_eq!(hatch.contains([2.0, 4.7], &curves), None);
    }

    #[test]
    fn an_outline_within_another_is_a_hole() {
        let square = |r: f64| vec![[-r, -r], [r, -r], [r, r], [-r, r]];
        let hatch = Hatch { outlines: vec![square(2.0), square(1.0)], lines: Vec::new() };
        assert_eq!(hatch.contains([0.0, 0.0], &[]), Some(false));
        assert_eq!(hatch.contains([1.5, 0.0], &[]), Some(true));
    }
}
