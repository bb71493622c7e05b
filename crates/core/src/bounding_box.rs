//! Axis-aligned boxes.
//!
//! In: points. Out: the box around them, its centre, its size, and whether it contains a point.
//!
//! A box around no points does not exist, so constructors return an `Option`. A coordinate that is NaN is
//! ignored unless all are.

use crate::vector3::{add, distance, scale};

/// An axis-aligned box.
///
/// # Examples
/// ```
/// use planish_core::BoundingBox;
/// let bounds = BoundingBox::from_points(&[[0.0, 1.0, 2.0], [4.0, -1.0, 2.0]]).expect("two points");
/// assert_eq!((bounds.min, bounds.max), ([0.0, -1.0, 2.0], [4.0, 1.0, 2.0]));
/// assert_eq!(bounds.center(), [2.0, 0.0, 2.0]);
/// assert_eq!(BoundingBox::from_points(&[]), None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundingBox {
    /// Minimum coordinates.
    pub min: [f64; 3],
    /// Maximum coordinates.
    pub max: [f64; 3],
}

impl BoundingBox {
    /// The box around points; `None` without points.
    #[must_use]
    pub fn from_points(points: &[[f64; 3]]) -> Option<Self> {
        Self::around(points.iter().copied())
    }

    /// The box around the points of an iterator; `None` without points.
    pub fn around(mut points: impl Iterator<Item = [f64; 3]>) -> Option<Self> {
        let first = points.next()?;
        let mut bounds = Self { min: first, max: first };
        points.for_each(|p| bounds.include(p));
        Some(bounds)
    }

    /// Extends the box to a point.
    ///
    /// # Examples
    /// ```
    /// use planish_core::BoundingBox;
    /// let mut bounds = BoundingBox { min: [0.0; 3], max: [1.0; 3] };
    /// bounds.include([0.5, 2.0, -1.0]);
    /// assert_eq!(bounds, BoundingBox { min: [0.0, 0.0, -1.0], max: [1.0, 2.0, 1.0] });
    /// ```
    pub fn include(&mut self, point: [f64; 3]) {
        for k in 0..3 {
            self.min[k] = self.min[k].min(point[k]);
            self.max[k] = self.max[k].max(point[k]);
        }
    }

    /// The box moved outwards by a margin on every side.
    ///
    /// # Examples
    /// ```
    /// use planish_core::BoundingBox;
    /// let unit = BoundingBox { min: [0.0; 3], max: [1.0; 3] };
    /// assert_eq!(unit.grown(0.5), BoundingBox { min: [-0.5; 3], max: [1.5; 3] });
    /// ```
    #[must_use]
    pub fn grown(&self, margin: f64) -> Self {
        Self { min: self.min.map(|x| x - margin), max: self.max.map(|x| x + margin) }
    }

    /// True if a point lies in the box or on its surface.
    ///
    /// # Examples
    /// ```
    /// use planish_core::BoundingBox;
    /// let bounds = BoundingBox { min: [0.0; 3], max: [1.0; 3] };
    /// assert!(bounds.contains([1.0, 0.5, 0.0]) && !bounds.contains([1.1, 0.5, 0.0]));
    /// ```
    #[must_use]
    pub fn contains(&self, point: [f64; 3]) -> bool {
        (0..3).all(|k| point[k] >= self.min[k] && point[k] <= self.max[k])
    }

    /// The eight corners; the first is `min`, the last is `max`, and x varies fastest.
    ///
    /// # Examples
    /// The box around a rotated box:
    /// ```
    /// use planish_core::{BoundingBox, Pose};
    /// let own = BoundingBox { min: [0.0; 3], max: [2.0, 1.0, 1.0] };
    /// let pose = Pose::from_rotation_vector([0.0, 0.0, std::f64::consts::FRAC_PI_2], [0.0; 3]);
    /// let moved = BoundingBox::around(own.corners().into_iter().map(|p| pose.apply(p))).expect("corners");
    /// assert!((moved.max[1] - 2.0).abs() < 1e-15);
    /// ```
    #[must_use]
    pub fn corners(&self) -> [[f64; 3]; 8] {
        std::array::from_fn(|corner| {
            std::array::from_fn(|k| if corner >> k & 1 == 0 { self.min[k] } else { self.max[k] })
        })
    }

    /// The length of the longest side.
    #[must_use]
    pub fn longest_side(&self) -> f64 {
        (0..3).map(|k| self.max[k] - self.min[k]).fold(0.0, f64::max)
    }

    /// The centre of the box.
    #[must_use]
    pub fn center(&self) -> [f64; 3] {
        scale(0.5, add(self.min, self.max))
    }

    /// The length of the space diagonal.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        distance(self.min, self.max)
    }
}
