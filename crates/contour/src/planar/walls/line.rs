//! A straight line by its direction and offset.

/// The line `−sin α · x + cos α · y = offset`, as [`super::super::ContourKind::Line`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WallLine {
    sin: f64,
    cos: f64,
    offset: f64,
}

/// Rounds of reweighting; the weights depend on the direction only, which changes little after the first.
const ROUNDS: usize = 3;

impl WallLine {
    pub(super) fn new(angle_rad: f64, offset: f64) -> Self {
        let (sin, cos) = angle_rad.sin_cos();
        Self { sin, cos, offset }
    }

    pub(super) fn angle(&self) -> f64 {
        self.sin.atan2(self.cos)
    }

    pub(super) fn offset(&self) -> f64 {
        self.offset
    }

    pub(super) fn normal(&self) -> [f64; 2] {
        [-self.sin, self.cos]
    }

    /// Signed distance of a point.
    pub(super) fn distance(&self, p: [f64; 2]) -> f64 {
        self.cos * p[1] - self.sin * p[0] - self.offset
    }

    /// Coordinate of a point along the line.
    pub(super) fn along(&self, p: [f64; 2]) -> f64 {
        self.cos * p[0] + self.sin * p[1]
    }

    /// The point of the line at a coordinate along it.
    pub(super) fn at(&self, t: f64) -> [f64; 2] {
        [t * self.cos - self.offset * self.sin, t * self.sin + self.offset * self.cos]
    }

    /// σ of a reading across the line.
    ///
    /// At least a tenth of its largest σ: an exact heading would give a reading along a wall no error across
    /// it, and no wall is that straight.
    pub(super) fn sigma_across(&self, [xx, xy, yy]: [f64; 3]) -> f64 {
        let across = self.sin * self.sin * xx - 2.0 * self.sin * self.cos * xy + self.cos * self.cos * yy;
        across.max(0.01 * (xx + yy)).max(f64::MIN_POSITIVE).sqrt()
    }

    /// Intersection with another line; `None` if they differ in direction by less than 6°.
    pub(super) fn intersection(&self, other: &Self) -> Option<[f64; 2]> {
        let cross = self.cos * other.sin - self.sin * other.cos;
        (cross.abs() > 0.1).then(|| {
            [
                (self.offset * other.cos - other.offset * self.cos) / cross,
                (self.offset * other.sin - other.offset * self.sin) / cross,
            ]
        })
    }

    /// Line of weighted total least squares; weights are those of the errors across it.
    pub(super) fn weighted(points: impl Iterator<Item = ([f64; 2], [f64; 3])> + Clone) -> Self {
        let mut line: Option<Self> = None;
        for _ in 0..ROUNDS {
            let weight = |c: [f64; 3]| line.map_or(1.0, |line| line.sigma_across(c).powi(-2));
            let (mut sum, mut middle) = (0.0, [0.0; 2]);
            for (p, c) in points.clone() {
                let w = weight(c);
                sum += w;
                middle = [middle[0] + w * p[0], middle[1] + w * p[1]];
            }
            let middle = middle.map(|m: f64| m / sum);
            let [mut xx, mut xy, mut yy] = [0.0; 3];
            for (p, c) in points.clone() {
                let (w, d) = (weight(c), [p[0] - middle[0], p[1] - middle[1]]);
                xx += w * d[0] * d[0];
                xy += w * d[0] * d[1];
                yy += w * d[1] * d[1];
            }
            let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
            let (sin, cos) = angle.sin_cos();
            line = Some(Self { sin, cos, offset: cos * middle[1] - sin * middle[0] });
        }
        line.unwrap_or(Self { sin: 0.0, cos: 1.0, offset: 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::WallLine;

    #[test]
    fn intersections_lie_on_both_lines() {
        let lines =
            [(0.3, 2.0), (1.7, -1.5), (-2.5, 0.7)].map(|(angle, offset)| WallLine::new(angle, offset));
        for i in 0..3 {
            let (one, other) = (&lines[i], &lines[(i + 1) % 3]);
            let p = one.intersection(other).expect("lines of different directions");
            assert!(one.distance(p).abs() < 1e-12 && other.distance(p).abs() < 1e-12, "{p:?}");
        }
    }
}
