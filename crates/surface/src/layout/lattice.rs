//! Square lattices in the tangent planes of a surface, and how those of two places fit each other.

use planish_core::DVec3;

/// A tangent plane with a square lattice of the positions `p + h (i d + j n × d)`, with the same `h` all over
/// a surface.
///
/// The direction `d` stands for four directions at right angles, so lattices of two places are compared up to
/// quarter turns and whole steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lattice {
    /// A point of the surface.
    pub(super) at: DVec3,
    /// The unit normal.
    pub(super) normal: DVec3,
    /// A unit vector across the normal.
    pub(super) direction: DVec3,
    /// A position of the lattice.
    pub(super) position: DVec3,
    /// The side `h` of its squares.
    pub(super) side: f64,
}

/// How the lattice of one place continues that of another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Step {
    /// Quarter turns that bring coordinates along the directions of the second place to those of the first.
    pub(super) turn: u8,
    /// From the position of the first to that of the second, along the directions of the first.
    pub(super) by: [i32; 2],
}

impl Step {
    /// From the second place to the first.
    pub(super) fn reversed(self) -> Self {
        let turn = (4 - self.turn) % 4;
        let by = turned(self.by, turn);
        Self { turn, by: [-by[0], -by[1]] }
    }

    /// This step and another one from where it ends.
    pub(super) fn then(self, next: Self) -> Self {
        let by = turned(next.by, self.turn);
        Self { turn: (self.turn + next.turn) % 4, by: [self.by[0] + by[0], self.by[1] + by[1]] }
    }

    pub(super) fn is_zero(self) -> bool {
        self.by == [0, 0]
    }

    pub(super) fn length_squared(self) -> i32 {
        self.by[0] * self.by[0] + self.by[1] * self.by[1]
    }
}

/// Coordinates after quarter turns.
pub(super) fn turned<T: Copy + std::ops::Neg<Output = T>>([x, y]: [T; 2], quarters: u8) -> [T; 2] {
    match quarters % 4 {
        0 => [x, y],
        1 => [-y, x],
        2 => [-x, -y],
        _ => [y, -x],
    }
}

impl Lattice {
    pub(super) fn across(&self) -> DVec3 {
        self.normal.cross(self.direction)
    }

    /// The point of the tangent plane below or above another one.
    pub(super) fn on_plane(&self, p: DVec3) -> DVec3 {
        p - (p - self.at).dot(self.normal) * self.normal
    }

    /// The vector with coordinates along both directions.
    pub(super) fn vector(&self, [x, y]: [f64; 2]) -> DVec3 {
        x * self.direction + y * self.across()
    }

    /// Sets the direction to that of a vector in the tangent plane, if it has one.
    pub(super) fn point_along(&mut self, v: DVec3) {
        self.direction = (v - v.dot(self.normal) * self.normal).try_normalize().unwrap_or(self.direction);
    }

    fn steps_to(&self, p: DVec3) -> [f64; 2] {
        let d = (p - self.position) / self.side;
        [d.dot(self.direction), d.dot(self.across())]
    }

    /// The same lattice, with the position that is nearest to the point of the surface.
    pub(super) fn nearest(mut self) -> Self {
        let steps = self.steps_to(self.at).map(|x| floor(x + 0.5));
        self.position += self.side * self.vector(steps);
        self
    }

    /// Directions that agree best, one of this lattice and one of the other.
    pub(super) fn agreeing_directions(&self, other: &Self) -> [DVec3; 2] {
        let (first, second) = ([self.direction, self.across()], [other.direction, other.across()]);
        let mut best = (0.0, [first[0], second[0]]);
        for x in first {
            for y in second {
                let cosine = x.dot(y);
                if cosine.abs() > best.0 {
                    best = (cosine.abs(), [x, cosine.signum() * y]);
                }
            }
        }
        best.1
    }

    /// Quarter turns that bring coordinates along the directions of the other lattice to those of this one.
    pub(super) fn turn_to(&self, other: &Self) -> u8 {
        let [first, second] = self.agreeing_directions(other);
        // The direction of the other lattice that continues the first one of this lattice.
        let same = if first == self.direction { second } else { -other.normal.cross(second) };
        let [x, y] = [other.direction, other.across()].map(|d| same.dot(d));
        let quarters = match (x.abs() > y.abs(), x > 0.0, y > 0.0) {
            (true, true, _) => 0,
            (false, _, true) => 1,
            (true, false, _) => 2,
            (false, _, false) => 3,
        };
        (4 - quarters) % 4
    }

    /// Whole steps on both lattices to positions that coincide well between their places: the position of
    /// one lattice nearest to the middle and that of the other nearest to it, or the reverse.
    pub(super) fn coinciding(&self, other: &Self) -> [[f64; 2]; 2] {
        let middle = self.between(other);
        let near = |lattice: &Self, p: DVec3| lattice.steps_to(p).map(|x| floor(x + 0.5));
        let own = near(self, middle);
        let from_own = self.position_at(own);
        let others = near(other, middle);
        let from_others = other.position_at(others);
        let (to_others, to_own) = (near(other, from_own), near(self, from_others));
        let first = from_own.distance_squared(other.position_at(to_others));
        let second = from_others.distance_squared(self.position_at(to_own));
        if first <= second { [own, to_others] } else { [to_own, others] }
    }

    /// The position at steps along both directions.
    pub(super) fn position_at(&self, steps: [f64; 2]) -> DVec3 {
        self.position + self.side * self.vector(steps)
    }

    /// The step to another lattice, and what is left: true steps less whole ones.
    pub(super) fn step_to(&self, other: &Self) -> (Step, [f64; 2]) {
        let (turn, side) = (self.turn_to(other), self.side);
        let [own, others] = self.coinciding(other);
        let same = turned(others, turn);
        let by = [0, 1].map(|k| (own[k] - same[k]).round() as i32);
        let gap = other.position_at(others) - self.position_at(own);
        let left = [gap.dot(self.direction), gap.dot(self.across())].map(|x| (x / side).clamp(-0.5, 0.5));
        (Step { turn, by }, left)
    }

    /// The point that lies in both tangent planes, nearest to the middle of both places.
    fn between(&self, other: &Self) -> DVec3 {
        let middle = 0.5 * (self.at + other.at);
        let cosine = self.normal.dot(other.normal);
        let own = (self.at - middle).dot(self.normal);
        let others = (other.at - middle).dot(other.normal);
        // The middle plus multiples of both normals; nearly parallel planes have no line in common.
        let scale = 1.0 / (1.0 - cosine * cosine + 1e-4);
        middle + scale * ((own - cosine * others) * self.normal + (others - cosine * own) * other.normal)
    }
}

/// `f64::floor` is a call on processors without SSE 4.1, and takes most of the time of a field of lattices.
fn floor(x: f64) -> f64 {
    let cut = x as i64 as f64;
    if cut > x { cut - 1.0 } else { cut }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_follow_lattices_over_a_plane_in_any_turn() {
        let [d, n] = [DVec3::X, DVec3::Z];
        let (side, shift) = (0.5, DVec3::new(0.1, 0.2, 0.0));
        let first = Lattice { at: DVec3::ZERO, normal: n, direction: d, position: shift, side };
        for quarters in 0..4 {
            let [x, y] = turned([1.0, 0.0], quarters);
            let direction = DVec3::new(x, y, 0.0);
            let at = DVec3::new(1.0, 0.5, 0.0);
            let position = shift + side * DVec3::new(2.0, 1.0, 0.0);
            let second = Lattice { at, normal: n, direction, position, side };
            let (step, left) = first.step_to(&second);
            assert_eq!((step.by, left.map(|x| (x * 1e9).round())), ([2, 1], [0.0, 0.0]));
            // Coordinates along the second direction, as the first sees them.
            assert_eq!(turned([1, 0], step.turn), [x as i32, y as i32]);
            assert_eq!(step.then(step.reversed()), Step { turn: 0, by: [0, 0] });
            assert_eq!(second.step_to(&first).0, step.reversed());
        }
    }
}
