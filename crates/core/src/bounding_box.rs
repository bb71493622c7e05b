//! Axis-aligned boxes in the plane and in space.
//!
//! In: points. Out: the box around them, its centre, its size, and whether it contains a point.
//!
//! A coordinate that is NaN is ignored unless all are.

/// An axis-aligned box in `N` dimensions, three unless stated.
///
/// # Examples
/// ```
/// use planish_core::BoundingBox;
/// let bounds = BoundingBox::from_points(&[[0.0, 1.0, 2.0], [4.0, -1.0, 2.0]]).expect("two points");
/// assert_eq!((bounds.min, bounds.max), ([0.0, -1.0, 2.0], [4.0, 1.0, 2.0]));
/// assert_eq!((bounds.center(), bounds.extent()), ([2.0, 0.0, 2.0], [4.0, 2.0, 0.0]));
///
/// let in_the_plane: BoundingBox<2> = [[1.0, 5.0], [3.0, 2.0]].into_iter().collect();
/// assert_eq!(in_the_plane.longest_side(), 3.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundingBox<const N: usize = 3> {
    /// Minimum coordinates.
    pub min: [f64; N],
    /// Maximum coordinates.
    pub max: [f64; N],
}

impl<const N: usize> BoundingBox<N> {
    /// The box that contains no point, to start from. Its minimum, +∞, is above its maximum, −∞.
    ///
    /// # Examples
    /// ```
    /// use planish_core::BoundingBox;
    /// let mut bounds = BoundingBox::EMPTY;
    /// bounds.include([1.0, 2.0]);
    /// assert_eq!(bounds, BoundingBox { min: [1.0, 2.0], max: [1.0, 2.0] });
    /// ```
    pub const EMPTY: Self = Self { min: [f64::INFINITY; N], max: [f64::NEG_INFINITY; N] };

    /// The box around points; `None` without points.
    ///
    /// # Examples
    /// ```
    /// use planish_core::BoundingBox;
    /// assert_eq!(BoundingBox::<3>::from_points(&[]), None);
    /// ```
    #[must_use]
    pub fn from_points(points: &[[f64; N]]) -> Option<Self> {
        Self::around(points.iter().copied())
    }

    /// The box around the points of an iterator; `None` without points.
    pub fn around(mut points: impl Iterator<Item = [f64; N]>) -> Option<Self> {
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
    pub fn include(&mut self, point: [f64; N]) {
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
        for k in 0..N {
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
    pub fn contains(&self, point: [f64; N]) -> bool {
        (0..N).all(|k| point[k] >= self.min[k] && point[k] <= self.max[k])
    }

    /// The lengths of the sides.
    #[must_use]
    pub fn extent(&self) -> [f64; N] {
        std::array::from_fn(|k| self.max[k] - self.min[k])
    }

    /// The length of the longest side.
    #[must_use]
    pub fn longest_side(&self) -> f64 {
        self.extent().into_iter().fold(0.0, f64::max)
    }

    /// The length of the diagonal.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        self.extent().into_iter().map(|side| side * side).sum::<f64>().sqrt()
    }

    /// The centre of the box.
    #[must_use]
    pub fn center(&self) -> [f64; N] {
        std::array::from_fn(|k| 0.5 * (self.min[k] + self.max[k]))
    }
}

impl BoundingBox {
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
}

/// The box around all points; [`BoundingBox::EMPTY`] without points.
impl<const N: usize> FromIterator<[f64; N]> for BoundingBox<N> {
    fn from_iter<I: IntoIterator<Item = [f64; N]>>(points: I) -> Self {
        let mut bounds = Self::EMPTY;
        points.into_iter().for_each(|p| bounds.include(p));
        bounds
    }
}
