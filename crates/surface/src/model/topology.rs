//! Numbers of bodies, handles and borders of a surface.

use planish_spline::{Hierarchy, Shape};
use serde::Serialize;
use std::fmt::{Display, Formatter, Result};

/// The topology of a surface.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SurfaceTopology {
    /// `sheet`, `tube`, `ball`, `torus`, or `quads` for a surface over a mesh of quads.
    pub shape: String,
    /// Separate surfaces.
    pub components: usize,
    /// Handles of all of them: holes through the object.
    pub genus: usize,
    /// Border loops.
    pub borders: usize,
    /// Vertices of the mesh of quads at which not four of them meet.
    pub extraordinary_vertices: usize,
}

impl SurfaceTopology {
    /// The topology of the surfaces of a space.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, Shape};
    /// use planish_surface::model::SurfaceTopology;
    /// let of_torus = SurfaceTopology::of(&Hierarchy::uniform(Shape::Torus, [8, 4])?);
    /// assert_eq!((of_torus.genus, of_torus.borders), (1, 0));
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn of(space: &Hierarchy) -> Self {
        let shape = space.topology_name().to_owned();
        match (space.domain(), space.shape()) {
            (Some(domain), _) => Self {
                shape,
                components: domain.components(),
                genus: domain.genus(),
                borders: domain.borders(),
                extraordinary_vertices: domain.extraordinary_vertices().len(),
            },
            (None, of_grid) => Self {
                shape,
                components: 1,
                genus: usize::from(of_grid == Some(Shape::Torus)),
                borders: match of_grid {
                    Some(Shape::Sheet) => 1,
                    Some(Shape::Tube) => 2,
                    _ => 0,
                },
                extraordinary_vertices: 0,
            },
        }
    }
}

/// True if the surfaces of a space have no borders.
pub(crate) fn is_closed(space: &Hierarchy) -> bool {
    match space.domain() {
        Some(domain) => domain.borders() == 0,
        None => !matches!(space.shape(), Some(Shape::Sheet | Shape::Tube)),
    }
}

impl Display for SurfaceTopology {
    /// A noun: the name of a shape, or `closed surface with 2 handles`.
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        if self.shape != "quads" {
            return f.write_str(&self.shape);
        }
        f.write_str(if self.borders == 0 { "closed surface" } else { "surface" })?;
        if self.components > 1 {
            write!(f, " of {} bodies", self.components)?;
        }
        match self.genus {
            0 => Ok(()),
            1 => f.write_str(" with 1 handle"),
            handles => write!(f, " with {handles} handles"),
        }
    }
}
