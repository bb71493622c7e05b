//! Visibility of points of a solid, by rays towards the viewer.

use crate::brep::TrimmedFace;
use crate::drawing::View;
use planish_core::DVec3;
use std::collections::BTreeMap;

/// Distance of rays from the line that they pass, relative to the size.
///
/// It must exceed the gaps between edges and their faces, or a ray may pass through a gap. It must be small
/// against the distance of neighbouring lines.
const LATERAL_OFFSET: f64 = 3e-5;

/// Viewing direction of a view, with its axes.
#[derive(Clone, Copy)]
pub(super) struct Eye {
    axes: [usize; 3],
    /// +1 if points nearer to the eye have the larger coordinate along the line of sight, else −1.
    sign: f64,
    /// The coordinate towards the eye of the cutting plane of a section; without one, infinite.
    cut: f64,
}

impl Eye {
    pub(super) fn new(view: &View) -> Self {
        let sign = if view.kind.depth_increases_away() { -1.0 } else { 1.0 };
        let cut = view.section().map_or(f64::INFINITY, |section| sign * section.at);
        Self { axes: view.kind.axes(), sign, cut }
    }

    /// Whether a view shows a section.
    pub(super) fn is_section(self) -> bool {
        self.cut.is_finite()
    }

    /// Whether a point is behind the cutting plane by more than a distance.
    pub(super) fn is_behind_cut(self, p: DVec3, near: f64) -> bool {
        self.nearness(p) < self.cut - near
    }

    /// The point of the cutting plane at a place of the view.
    pub(super) fn on_cut(self, at: [f64; 2]) -> DVec3 {
        let mut p = DVec3::ZERO;
        (p[self.axes[0]], p[self.axes[1]], p[self.axes[2]]) = (at[0], at[1], self.sign * self.cut);
        p
    }

    /// The unit vector to the eye.
    pub(super) fn towards(self) -> DVec3 {
        let mut e = DVec3::ZERO;
        e[self.axes[2]] = self.sign;
        e
    }

    /// Image of a point in the view.
    pub(super) fn seen(self, p: DVec3) -> [f64; 2] {
        [p[self.axes[0]], p[self.axes[1]]]
    }

    /// Coordinate towards the eye; larger is nearer.
    pub(super) fn nearness(self, p: DVec3) -> f64 {
        self.sign * p[self.axes[2]]
    }
}

/// The faces of a solid, prepared for rays.
pub(super) struct Scene<'a> {
    pub(super) faces: Vec<TrimmedFace<'a>>,
    /// The body of each face.
    pub(super) body_of: Vec<usize>,
    pub(super) size: f64,
    /// Minimum and maximum corner of a box around the solid.
    pub(super) reach: [DVec3; 2],
}

impl Scene<'_> {
    /// True if a point of a line is visible: on one side of the line, along ± `across` in the view, no face
    /// is in front of it.
    ///
    /// The ray through the point itself touches the faces at the line, so rounding would decide. An outline
    /// also has its own face on one side.
    pub(super) fn is_visible(&self, eye: Eye, p: DVec3, across: [f64; 2]) -> bool {
        [-1.0, 1.0]
            .into_iter()
            .any(|side| !self.is_covered(eye, p, across, side * LATERAL_OFFSET * self.size))
    }

    /// The body whose material is cut at a place of a section; none where the cut is empty.
    pub(super) fn cut_body(&self, eye: Eye, at: [f64; 2]) -> Option<usize> {
        // Just behind the plane, where the part is kept. A ray leaves the body around its origin once more
        // than it enters it.
        let direction = eye.towards();
        let from = eye.on_cut(at) - LATERAL_OFFSET * self.size * direction;
        let range = self.range(eye, from);
        let mut crossings: BTreeMap<usize, usize> = BTreeMap::new();
        for (face, body) in self.faces.iter().zip(&self.body_of) {
            let [low, high] = face.bounds;
            if eye.axes[..2].iter().any(|&a| from[a] < low[a] || from[a] > high[a]) {
                continue;
            }
            let hits = face.met(from, direction, range).into_iter();
            let count = hits.filter(|t| *t > 0.0 && face.contains(from + *t * direction)).count();
            *crossings.entry(*body).or_default() += count;
        }
        crossings.into_iter().find(|(_, count)| count % 2 == 1).map(|(body, _)| body)
    }

    /// Distances along the line of sight from a point at which it is within the box around the solid.
    fn range(&self, eye: Eye, p: DVec3) -> [f64; 2] {
        let along = eye.axes[2];
        let range = self.reach.map(|corner| (corner[along] - p[along]) * eye.sign);
        [range[0].min(range[1]), range[0].max(range[1])]
    }

    /// True if a ray from a point, moved by `offset` along `across`, meets a face before the eye, or material
    /// in the cutting plane of a section.
    fn is_covered(&self, eye: Eye, p: DVec3, across: [f64; 2], offset: f64) -> bool {
        let mut from = p;
        from[eye.axes[0]] += offset * across[0];
        from[eye.axes[1]] += offset * across[1];
        let direction = eye.towards();
        let range = self.range(eye, p);
        let cut = eye.cut - eye.nearness(p);
        // Material is in the cutting plane if the ray leaves it beyond.
        let mut beyond = 0_usize;
        let is_met = self.faces.iter().any(|face| {
            let [low, high] = face.bounds;
            let outside = eye.axes[..2].iter().any(|&a| from[a] < low[a] || from[a] > high[a]);
            let behind = eye.nearness(high).max(eye.nearness(low)) < eye.nearness(p);
            if outside || behind {
                return false;
            }
            face.met(from, direction, range).into_iter().any(|t| {
                if t <= 0.0 {
                    return false;
                }
                let hit = from + t * direction;
                if t >= cut {
                    beyond += usize::from(face.contains(hit));
                    return false;
                }
                // A face through the line that slopes towards the eye is met in front of the line, although
                // it does not cover it. This is at most `offset` times the slope away; the factor leaves room
                // for curved faces.
                let facing = face.surface().normal(hit).dot(direction).abs().max(1e-9);
                let slope = (1.0 - facing * facing).max(0.0).sqrt() / facing;
                t > offset.abs() * (1.0 + 4.0 * slope) && face.contains(hit)
            })
        });
        is_met || beyond % 2 == 1
    }
}
