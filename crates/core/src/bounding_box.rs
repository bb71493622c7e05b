//! Axis-aligned boxes in the plane and in space.
//!
//! In: points. Out: the box around them, its centre, its size, and whether it contains a point.
//!
//! A coordinate that is NaN is ignored unless all are.

use glam::DVec3;
use std::ops::{Index, IndexMut};

/// Points that a [`BoundingBox`] contains: [`DVec3`], or `[f64; N]` in other dimensions.
pub trait Coordinates: Copy + PartialEq + Index<usize, Output = f64> + IndexMut<usize> {
    /// Number of coordinates.
    const DIMENSION: usize;
    /// All coordinates +∞.
    const INFINITY: Self;
    /// All coordinates −∞.
    const NEG_INFINITY: Self;

    /// The point of a coordinate for each axis.
    fn from_coordinates(coordinate: impl FnMut(usize) -> f64) -> Self;
}

// In the plane, points are arrays: a second vector type would serve boxes only.
impl<const N: usize> Coordinates for [f64; N] {
    const DIMENSION: usize = N;
    const INFINITY: Self = [f64::INFINITY; N];
    const NEG_INFINITY: Self = [f64::NEG_INFINITY; N];

    #[inline]
    fn from_coordinates(coordinate: impl FnMut(usize) -> f64) -> Self {
        std::array::from_fn(coordinate)
    }
}

impl Coordinates for DVec3 {
    const DIMENSION: usize = 3;
    const INFINITY: Self = DVec3::INFINITY;
    const NEG_INFINITY: Self = DVec3::NEG_INFINITY;

    #[inline]
    fn from_coordinates(coordinate: impl FnMut(usize) -> f64) -> Self {
        Self::from_array(std::array::from_fn(coordinate))
    }
}

/// An axis-aligned box, in space unless stated.
///
/// # Examples
/// ```
/// use planish_core::{BoundingBox, DVec3};
/// let points = [DVec3::new(0.0, 1.0, 2.0), DVec3::new(4.0, -1.0, 2.0)];
/// let bounds = BoundingBox::from_points(&points).expect("two points");
/// assert_eq!((bounds.min, bounds.max), (DVec3::new(0.0, -1.0, 2.0), DVec3::new(4.0, 1.0, 2.0)));
/// assert_eq!((bounds.center(), bounds.extent()), (DVec3::new(2.0, 0.0, 2.0), DVec3::new(4.0, 2.0, 0.0)));
///
/// let in_the_plane: BoundingBox<[f64; 2]> = [[1.0, 5.0], [3.0, 2.0]].into_iter().collect();
/// assert_eq!(in_the_plane.longest_side(), 3.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundingBox<P = DVec3> {
    /// Minimum coordinates.
    pub min: P,
    /// Maximum coordinates.
    pub max: P,
}

impl<P: Coordinates> BoundingBox<P> {
    /// The box that contains no point, to start from. Its minimum, +∞, is above its maximum, −∞.
    ///
    /// # Examples
    /// ```
    /// use planish_core::BoundingBox;
    /// let mut bounds = BoundingBox::EMPTY;
    /// bounds.include([1.0, 2.0]);
    /// assert_eq!(bounds, BoundingBox { min: [1.0, 2.0], max: [1.0, 2.0] });
    /// ```
    pub const EMPTY: Self = Self { min: P::INFINITY, max: P::NEG_INFINITY };

    /// The box around points; `None` without points.
    ///
    /// # Examples
    /// ```
    /// use planish_core::BoundingBox;
    /// assert_eq!(BoundingBox::<[f64; 3]>::from_points(&[]), None);
    /// ```
    #[must_use]
    pub fn from_points(points: &[P]) -> Option<Self> {
        Self::around(points.iter().copied())
    }

    /// The box around the points of an iterator; `None` without points.
    pub fn around(mut points: impl Iterator<Item = P>) -> Option<Self> {
        // The first point, not `EMPTY`: a coordinate that is NaN in all points then stays NaN instead of
        // infinite.
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
    #[inline]
    pub fn include(&mut self, point: P) {
        self.include_box(&Self { min: point, max: point });
    }

    /// Extends the box to another box.
    ///
    /// # Examples
    /// ```
    /// use planish_core::BoundingBox;
    /// let mut bounds = BoundingBox { min: [0.0; 2], max: [1.0; 2] };
    /// bounds.include_box(&BoundingBox { min: [0.5, -2.0], max: [3.0, 0.5] });
    /// assert_eq!(bounds, BoundingBox { min: [0.0, -2.0], max: [3.0, 1.0] });
    /// ```
    #[inline]
    pub fn include_box(&mut self, other: &Self) {
        // `min` and `max` of `f64` return the other number for NaN.
        for k in 0..P::DIMENSION {
            self.min[k] = self.min[k].min(other.min[k]);
            self.max[k] = self.max[k].max(other.max[k]);
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
        Self {
            min: P::from_coordinates(|k| self.min[k] - margin),
            max: P::from_coordinates(|k| self.max[k] + margin),
        }
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
    pub fn contains(&self, point: P) -> bool {
        // Comparisons with NaN are false: no box contains such a point.
        (0..P::DIMENSION).all(|k| point[k] >= self.min[k] && point[k] <= self.max[k])
    }

    /// The lengths of the sides.
    #[must_use]
    pub fn extent(&self) -> P {
        P::from_coordinates(|k| self.side(k))
    }

    /// The length of the longest side.
    #[must_use]
    pub fn longest_side(&self) -> f64 {
        // The sides of the empty box are −∞; the start of the fold makes its length zero.
        (0..P::DIMENSION).map(|k| self.side(k)).fold(0.0, f64::max)
    }

    /// The length of the diagonal.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        (0..P::DIMENSION).map(|k| self.side(k) * self.side(k)).sum::<f64>().sqrt()
    }

    fn side(&self, axis: usize) -> f64 {
        self.max[axis] - self.min[axis]
    }

    /// The centre of the box.
    #[must_use]
    pub fn center(&self) -> P {
        P::from_coordinates(|k| 0.5 * (self.min[k] + self.max[k]))
    }
}

impl BoundingBox {
    /// The eight corners; the first is `min`, the last is `max`, and x varies fastest.
    ///
    /// # Examples
    /// The box around a rotated box:
    /// ```
    /// use planish_core::{BoundingBox, DVec3, Pose};
    /// let own = BoundingBox { min: DVec3::ZERO, max: DVec3::new(2.0, 1.0, 1.0) };
    /// let pose = Pose::from_rotation_vector(std::f64::consts::FRAC_PI_2 * DVec3::Z, DVec3::ZERO);
    /// let moved = BoundingBox::around(own.corners().into_iter().map(|p| pose.apply(p))).expect("corners");
    /// assert!((moved.max[1] - 2.0).abs() < 1e-15);
    /// ```
    #[must_use]
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|corner| {
            DVec3::from_coordinates(|k| if corner >> k & 1 == 0 { self.min[k] } else { self.max[k] })
        })
    }
}

/// The box around all points; [`BoundingBox::EMPTY`] without points.
impl<P: Coordinates> FromIterator<P> for BoundingBox<P> {
    fn from_iter<I: IntoIterator<Item = P>>(points: I) -> Self {
        let mut bounds = Self::EMPTY;
        points.into_iter().for_each(|p| bounds.include(p));
        bounds
    }
}
