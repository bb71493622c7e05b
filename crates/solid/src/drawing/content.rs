//! What a view shows of the part: all edges, the visible ones, or a section.

/// Two neighbouring hatching lines belong to one region if they are at most this many spacings apart.
const MAX_SPACINGS: f64 = 1.5;

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
    /// Whether a point is hatched; none if the hatching lines around it leave this open.
    ///
    /// The result is uncertain near the borders of regions: outlines may be polygons of curves.
    ///
    /// ```
    /// use planish_solid::drawing::Hatch;
    ///
    /// let outlines = vec![vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]];
    /// let hatch = Hatch { outlines, lines: Vec::new() };
    /// assert_eq!(hatch.contains([1.0, 1.0]), Some(true));
    /// assert_eq!(hatch.contains([5.0, 1.0]), Some(false));
    /// ```
    #[must_use]
    pub fn contains(&self, p: [f64; 2]) -> Option<bool> {
        let crossed = self.outlines.iter().filter(|outline| is_inside(outline, p)).count();
        if crossed % 2 == 1 {
            return Some(true);
        }
        match self.between_lines(p) {
            _ if self.lines.is_empty() => Some(false),
            found => found,
        }
    }

    /// Whether a point lies between two hatching lines.
    fn between_lines(&self, p: [f64; 2]) -> Option<bool> {
        let [a, b] = *self.lines.iter().max_by(|a, b| length(a).total_cmp(&length(b)))?;
        let along = [b[0] - a[0], b[1] - a[1]].map(|c| c / length(&[a, b]).max(f64::MIN_POSITIVE));
        let place = |q: [f64; 2]| {
            let d = [q[0] - p[0], q[1] - p[1]];
            (d[0] * along[0] + d[1] * along[1], d[1] * along[0] - d[0] * along[1])
        };
        let mut levels: Vec<f64> = self.lines.iter().map(|line| place(line[0]).1).collect();
        levels.sort_by(f64::total_cmp);
        let spacing = spacing_of(&levels)?;
        // The nearest lines on both sides that pass beside the point.
        let beside = |sign: f64| {
            self.lines.iter().any(|line| {
                let ((s, level), (t, _)) = (place(line[0]), place(line[1]));
                let level = sign * level;
                s.min(t) <= 0.0 && s.max(t) >= 0.0 && (0.0..MAX_SPACINGS * spacing).contains(&level)
            })
        };
        match (beside(1.0), beside(-1.0)) {
            (true, true) => Some(true),
            (false, false) => Some(false),
            _ => None,
        }
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

    #[test]
    fn points_between_hatching_lines_are_hatched_and_those_in_a_hole_are_not() {
        // Horizontal lines at 0, 1 … 10 over a width of 10, with a gap from x = 4 to 6.
        let lines = (0..=10).flat_map(|k| {
            let y = f64::from(k);
            [[[0.0, y], [4.0, y]], [[6.0, y], [10.0, y]]]
        });
        let hatch = Hatch { outlines: Vec::new(), lines: lines.collect() };
        assert_eq!(hatch.contains([2.0, 4.4]), Some(true));
        assert_eq!(hatch.contains([5.0, 4.4]), Some(false));
        assert_eq!(hatch.contains([2.0, 12.0]), Some(false));
        // Outside of the last line, but within one spacing of it.
        assert_eq!(hatch.contains([2.0, 10.5]), None);
    }

    #[test]
    fn an_outline_within_another_is_a_hole() {
        let square = |r: f64| vec![[-r, -r], [r, -r], [r, r], [-r, r]];
        let hatch = Hatch { outlines: vec![square(2.0), square(1.0)], lines: Vec::new() };
        assert_eq!(hatch.contains([0.0, 0.0]), Some(false));
        assert_eq!(hatch.contains([1.5, 0.0]), Some(true));
    }
}
