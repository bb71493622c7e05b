//! Whether a point of a solid is seen.

use crate::brep::TrimmedFace;
use crate::drawing::ViewKind;
use planish_estimate::vector3::dot;

/// Rays pass a line on both sides at this share of the size: more than edges and their faces are apart.
const ASIDE: f64 = 3e-5;

/// From where a view is seen.
#[derive(Clone, Copy)]
pub(super) struct Eye {
    axes: [usize; 3],
    /// +1 where what is near to the eye has the larger coordinate along the line of sight.
    sign: f64,
}

impl Eye {
    pub(super) fn new(kind: ViewKind) -> Self {
        Self { axes: kind.axes(), sign: if kind.depth_increases_away() { -1.0 } else { 1.0 } }
    }

    /// The unit vector to the eye.
    pub(super) fn towards(self) -> [f64; 3] {
        let mut e = [0.0; 3];
        e[self.axes[2]] = self.sign;
        e
    }

    /// Where a point stands in the view.
    pub(super) fn seen(self, p: [f64; 3]) -> [f64; 2] {
        [p[self.axes[0]], p[self.axes[1]]]
    }

    /// How near to the eye a point is; larger is nearer.
    fn nearness(self, p: [f64; 3]) -> f64 {
        self.sign * p[self.axes[2]]
    }
}

/// The faces of a solid, and how large all of it is.
pub(super) struct Scene<'a> {
    pub(super) faces: Vec<TrimmedFace<'a>>,
    pub(super) size: f64,
    /// A box around everything.
    pub(super) reach: [[f64; 3]; 2],
}

impl Scene<'_> {
    /// Whether a point of a line is seen: on one side of the line, `across` in the view, nothing stands
    /// before it.
    pub(super) fn is_visible(&self, eye: Eye, p: [f64; 3], across: [f64; 2]) -> bool {
        [-1.0, 1.0].into_iter().any(|side| !self.is_covered(eye, p, across, side * ASIDE * self.size))
    }

    fn is_covered(&self, eye: Eye, p: [f64; 3], across: [f64; 2], aside: f64) -> bool {
        let mut from = p;
        from[eye.axes[0]] += aside * across[0];
        from[eye.axes[1]] += aside * across[1];
        let direction = eye.towards();
        let [lo, hi] = self.reach;
        let along = eye.axes[2];
        // Distances along the ray within the box.
        let range = [lo[along] - p[along], hi[along] - p[along]].map(|d| d * eye.sign);
        let range = [range[0].min(range[1]), range[0].max(range[1])];
        self.faces.iter().any(|face| {
            let [least, most] = face.bounds;
            let beside = eye.axes[..2].iter().any(|&a| from[a] < least[a] || from[a] > most[a]);
            let behind = eye.nearness(most).max(eye.nearness(least)) < eye.nearness(p);
            if beside || behind {
                return false;
            }
            face.met(from, direction, range).into_iter().any(|t| {
                if t <= 0.0 {
                    return false;
                }
                let hit = crate::brep::along(from, t, direction);
                // A face that the line lies on is met before it where it slopes towards the eye; the steeper,
                // the further.
                let facing = dot(face.surface().normal(hit), direction).abs().max(1e-9);
                let slope = (1.0 - facing * facing).max(0.0).sqrt() / facing;
                t > aside.abs() * (1.0 + 4.0 * slope) && face.contains(hit)
            })
        })
    }
}
