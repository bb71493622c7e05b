//! Affine maps of the plane, applied to the curves of drawings.

use planish_solid::views::Curve2;

/// The map `[x, y] ↦ x columns[0] + y columns[1] + origin`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Affine {
    pub(crate) columns: [[f64; 2]; 2],
    pub(crate) origin: [f64; 2],
}

impl Affine {
    pub(crate) const IDENTITY: Self = Self { columns: [[1.0, 0.0], [0.0, 1.0]], origin: [0.0; 2] };

    /// Image of a vector, without the origin.
    pub(crate) fn turned(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [a, b] = self.columns;
        [a[0] * x + b[0] * y, a[1] * x + b[1] * y]
    }

    pub(crate) fn point(&self, p: [f64; 2]) -> [f64; 2] {
        let q = self.turned(p);
        [q[0] + self.origin[0], q[1] + self.origin[1]]
    }

    /// Composition that applies `first` first.
    pub(crate) fn after(&self, first: &Self) -> Self {
        Self { columns: first.columns.map(|c| self.turned(c)), origin: self.point(first.origin) }
    }

    /// True if all entries are finite and so small that their products cannot overflow.
    pub(crate) fn is_finite(&self) -> bool {
        // At 1e15, doubles are an eighth of a unit apart: no drawing needs coordinates that large.
        self.columns.iter().flatten().chain(&self.origin).all(|x| x.is_finite() && x.abs() < 1e15)
    }

    /// Image of a curve. Arcs stay arcs if the map keeps circles; other curves become chains of points.
    pub(crate) fn curve(&self, curve: &Curve2) -> Curve2 {
        let [a, b] = self.columns;
        let (length, other) = (a[0].hypot(a[1]), b[0].hypot(b[1]));
        // Columns of equal length at right angles: a rotation or reflection with uniform scale.
        let keeps_circles = (length - other).abs() <= 1e-9 * length
            && (a[0] * b[0] + a[1] * b[1]).abs() <= 1e-9 * length * length;
        match curve {
            Curve2::Segment(p, q) => Curve2::Segment(self.point(*p), self.point(*q)),
            Curve2::Arc { center, radius, start, sweep } if keeps_circles => {
                // Arcs run counter-clockwise, so the image of an arc under a mirror starts at the image of
                // its end.
                let mirrors = a[0] * b[1] - a[1] * b[0] < 0.0;
                let first = if mirrors { start + sweep } else { *start };
                let [x, y] = self.turned([first.cos(), first.sin()]);
                Curve2::Arc {
                    center: self.point(*center),
                    radius: radius * length,
                    start: y.atan2(x),
                    sweep: *sweep,
                }
            }
            // A stretched arc is an arc of an ellipse, for which `Curve2` has no kind of its own.
            _ => Curve2::Chain(curve.points().into_iter().map(|p| self.point(p)).collect()),
        }
    }
}
