//! Options of a patch filter.

use super::quadtree::VERTICES;

/// The unknowns of a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StateLayout {
    /// The third coordinate of every vertex; the others stay those of the initial surface. 49 unknowns:
    /// heights over a plane.
    Height,
    /// Three coordinates that share one covariance of 49 unknowns, for positions with isotropic noise.
    Isotropic,
    /// Three coordinates that share one covariance of 49 unknowns, for readings along the normal at foot
    /// points. The mean uses every reading exactly. The covariance treats it as isotropic, which is correct
    /// along the normal, as far as the normal is constant over a patch. It has no meaning for tangential
    /// motion, which changes only the parametrisation.
    Normal,
    /// 147 unknowns, for all kinds of readings. Nine times the memory and work.
    Full,
}

impl StateLayout {
    /// Number of unknowns of a patch, and of columns of its mean.
    pub(super) fn size(self) -> (usize, usize) {
        match self {
            Self::Height => (VERTICES, 1),
            Self::Isotropic | Self::Normal => (VERTICES, 3),
            Self::Full => (3 * VERTICES, 1),
        }
    }
}

/// Options of a patch filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchFilterOptions {
    /// The unknowns of a patch.
    pub layout: StateLayout,
    /// Maximum subdivision depth of a base patch.
    pub maximum_depth: u8,
    /// Do not send information to neighbours that reduces a variance by less than this fraction.
    pub min_gain: f64,
    /// If true, a patch that can still be subdivided expects detail that it cannot represent: the prior
    /// variance of that detail is added to the variance of positions. Without it, σ of a patch and of its
    /// children can be too small. With it, patches that are never subdivided lose information. The global
    /// filter over the same cells expects no detail.
    pub expect_detail: bool,
    /// If true, normals and curvatures are linearised at the initial surface instead of the estimate. Every
    /// equation is then linear and the result does not depend on the order of readings, but the initial
    /// surface must be close to the true one.
    pub linearize_at_initial: bool,
}

impl Default for PatchFilterOptions {
    /// Isotropic, depth 3, a minimum gain of 1e-6, and no expected detail, like the global filter.
    fn default() -> Self {
        Self {
            layout: StateLayout::Isotropic,
            maximum_depth: 3,
            min_gain: 1e-6,
            expect_detail: false,
            linearize_at_initial: false,
        }
    }
}
