//! Topologies of surfaces.

/// Topology of a surface: which parameter directions are closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Shape {
    /// Open in both directions.
    Sheet,
    /// Periodic in u, open in v.
    Tube,
    /// Periodic in u, with a pole at each end of v.
    Ball,
    /// Periodic in both directions.
    Torus,
}

impl Shape {
    /// True if u is periodic.
    #[must_use]
    pub fn periodic_u(self) -> bool {
        self != Self::Sheet
    }

    /// True if v is periodic.
    #[must_use]
    pub fn periodic_v(self) -> bool {
        self == Self::Torus
    }

    /// True if the ends of v are poles.
    #[must_use]
    pub fn polar(self) -> bool {
        self == Self::Ball
    }

    /// The name used in files and options.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Sheet => "sheet",
            Self::Tube => "tube",
            Self::Ball => "ball",
            Self::Torus => "torus",
        }
    }

    /// The shape with the given name.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::Shape;
    ///
    /// assert_eq!(Shape::from_name("torus"), Some(Shape::Torus));
    /// assert_eq!(Shape::from_name("cube"), None);
    /// ```
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Sheet, Self::Tube, Self::Ball, Self::Torus].into_iter().find(|shape| shape.name() == name)
    }
}
