//! Dimensions snapped to a grid, if the statistics allow it.
//!
//! In: a constrained estimate and a grid, such as 0.5 mm. Out: the dimensions that lie on it, imposed like
//! other constraints, and the reason why the others do not. Not guaranteed: that the designer used this grid.
//! A dimension whose σ is far below the grid, but which is off it, is evidence against it.

use super::candidates::Candidate;
use super::drawing::{BarId, CircleId, ParametricDrawing, PointId};
use super::evidence::State;
use super::impose::{Imposed, chi_square_tail};
use super::propose::Constrained;
use super::relation::Constraint;
use super::scheme::sigma as sigma_of;
use planish_estimate::{Error, Result};
use serde::Serialize;

/// A size that may lie on a grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Dimension {
    /// The length of a bar.
    Length(BarId),
    /// The diameter of a circle.
    Diameter(CircleId),
    /// The distance between two points, such as the centres of holes.
    Distance(PointId, PointId),
    /// The signed distance of a point from the line of a bar, positive to the left.
    Offset(PointId, BarId),
}

impl Dimension {
    /// The lengths of all bars except axes, and all diameters.
    #[must_use]
    pub fn all(drawing: &ParametricDrawing) -> Vec<Self> {
        let bars = drawing.bars().filter(|&bar| !drawing.is_axis(bar)).map(Self::Length);
        bars.chain(drawing.circles().map(Self::Diameter)).collect()
    }

    /// The constraint that fixes it at a value.
    #[must_use]
    pub fn constraint(self, drawing: &ParametricDrawing, value: f64) -> Constraint {
        match self {
            Self::Length(bar) => {
                let [a, b] = drawing.ends(bar);
                Constraint::Distance { a, b, value }
            }
            Self::Diameter(circle) => Constraint::Radius { circle, value: 0.5 * value },
            Self::Distance(a, b) => Constraint::Distance { a, b, value },
            Self::Offset(point, bar) => Constraint::PointLineDistance { point, bar, value },
        }
    }

    /// Ratio of the dimension to the residual of its constraint: a diameter is constrained by its radius.
    fn factor(self) -> f64 {
        if matches!(self, Self::Diameter(_)) { 2.0 } else { 1.0 }
    }

    fn describe(self, drawing: &ParametricDrawing) -> String {
        match self {
            Self::Length(bar) => format!("length of {}", drawing.bar_name(bar)),
            Self::Diameter(circle) => format!("diameter of {}", drawing.circle_name(circle)),
            Self::Distance(a, b) => {
                format!("distance of {} and {}", drawing.point_name(a), drawing.point_name(b))
            }
            Self::Offset(point, bar) => format!("{} to {}", drawing.point_name(point), drawing.bar_name(bar)),
        }
    }
}

/// Outcome of a dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SnapOutcome {
    /// It agrees with exactly one grid value and was imposed.
    Snapped,
    /// Other constraints already fix it on the grid.
    Implied,
    /// Other constraints already fix it off the grid.
    FixedOffGrid,
    /// It contradicts every grid value.
    OffGrid,
    /// It agrees with more than one value: its σ is too large for this grid.
    Ambiguous,
    /// It agrees alone, but not together with the imposed constraints.
    Refused,
}

/// Result of snapping one dimension.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Snap {
    /// The dimension.
    pub dimension: Dimension,
    /// The dimension as text.
    pub text: String,
    /// Value before snapping.
    pub value: f64,
    /// σ before snapping; zero if other constraints fix it.
    pub sigma: f64,
    /// Nearest grid value.
    pub nearest: f64,
    /// Probability of a deviation at least as large if `nearest` is the true value.
    pub p_value: f64,
    /// Outcome of the dimension.
    pub outcome: SnapOutcome,
}

/// Snaps dimensions to a grid one by one, in order of increasing σ.
///
/// A dimension `d ± σ` is snapped to the nearest multiple `g` of `grid` on three conditions: `(d − g)²/σ²`
/// passes its χ² test, the next multiple fails it (otherwise the dimension is *ambiguous*), and all imposed
/// constraints still pass together. The level is shared among the dimensions (Bonferroni). Each snapped
/// dimension reduces the σ of others, which is why the best known one comes first. Cost: one
/// [`impose`](crate::constraint::impose) per dimension.
///
/// # Errors
/// `Input` if the grid is not positive.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_contour::constraint::{
///     BarId, ConstrainOptions, Dimension, ParametricDrawing, SnapOutcome, constrain, snap,
/// };
///
/// let seen = ParametricDrawing::polygon(&[[0.03, 0.0], [40.01, -0.04], [40.04, 30.18], [0.02, 30.24]])?;
/// let rectangle = constrain(&seen, &(DMatrix::identity(8, 8) * 0.0009), &ConstrainOptions::default())?;
/// let (snapped, report) = snap(&rectangle, 0.5, &Dimension::all(&seen))?;
/// let (width, height) = (&report[0], &report[1]);
/// assert_eq!((width.nearest, snapped.drawing.length(BarId(0)).round()), (40.0, 40.0));
/// // 30.24 ± 0.03 is not a multiple of half a millimetre.
/// assert_eq!(height.outcome, SnapOutcome::OffGrid);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn snap(
    constrained: &Constrained,
    grid: f64,
    dimensions: &[Dimension],
) -> Result<(Constrained, Vec<Snap>)> {
    if !(grid > 0.0 && grid.is_finite()) {
        return Err(Error::input(format!("expected a grid > 0, found {grid}")));
    }
    let search = &constrained.search;
    let mut state = Imposed {
        drawing: constrained.drawing.clone(),
        covariance: constrained.covariance.clone(),
        chi_square: constrained.chi_square,
        degrees: constrained.degrees,
        p_value: constrained.p_value,
        implied: Vec::new(),
    };
    // Snapped dimensions are imposed together with everything before, from the unconstrained estimate.
    let mut constraints = constrained.constraints.clone();
    let mut report: Vec<Option<Snap>> = vec![None; dimensions.len()];
    // Bonferroni: the level is for all dimensions together.
    let level = search.options.level / dimensions.len().max(1) as f64;
    // Each round tests all remaining dimensions anew: a snapped one reduces the σ of others, or fixes them.
    for _ in 0..dimensions.len() {
        let mut best: Option<(usize, Snap)> = None;
        let now = State::unconstrained(&state.drawing, &state.covariance);
        for (i, &dimension) in dimensions.iter().enumerate().filter(|(i, _)| report[*i].is_none()) {
            let tested = test_dimension(constrained, &state, &now, dimension, grid, level)?;
            if best.as_ref().is_none_or(|(_, known)| tested.sigma < known.sigma) {
                best = Some((i, tested));
            }
        }
        let Some((i, mut found)) = best else {
            break;
        };
        if found.outcome == SnapOutcome::Snapped {
            // The pair of tests concerns this dimension alone; the joint test may still fail.
            constraints.push(found.dimension.constraint(&state.drawing, found.nearest));
            match search.impose_if_accepted(&constraints, &state) {
                Some(next) => state = next,
                None => {
                    constraints.pop();
                    found.outcome = SnapOutcome::Refused;
                }
            }
        }
        report[i] = Some(found);
    }
    let snapped = Constrained {
        freedoms: constrained.drawing.parameters() - state.degrees,
        drawing: state.drawing,
        covariance: state.covariance,
        chi_square: state.chi_square,
        degrees: state.degrees,
        p_value: state.p_value,
        constraints,
        ..constrained.clone()
    };
    Ok((snapped, report.into_iter().flatten().collect()))
}

/// Tests one dimension against the nearest grid value and the one beyond it.
fn test_dimension(
    constrained: &Constrained,
    state: &Imposed,
    now: &State,
    dimension: Dimension,
    grid: f64,
    level: f64,
) -> Result<Snap> {
    let drawing = &state.drawing;
    let constraint = dimension.constraint(drawing, 0.0);
    let value = dimension.factor() * constraint.equations(drawing, drawing.values().as_slice())[0].residual;
    let rounded = (value / grid).round() * grid;
    // Zero is no length; use the first grid value instead.
    let nearest = if rounded == 0.0 { grid.copysign(value) } else { rounded };
    // Unrelated dimensions would be evenly distributed between two multiples.
    let candidate = Candidate { constraint: dimension.constraint(drawing, nearest), range: grid };
    let test = constrained.search.test(&candidate, now);
    let away = (value - nearest).abs();
    let sigma = if test.degrees == 0 {
        0.0
    } else {
        sigma_of(&constraint, drawing, &state.covariance) * dimension.factor()
    };
    let outcome = match (test.degrees, test.holds) {
        (0, true) => SnapOutcome::Implied,
        (0, false) => SnapOutcome::FixedOffGrid,
        _ if test.p_value < level => SnapOutcome::OffGrid,
        // The second nearest multiple is `grid − away` from the value.
        _ if chi_square_tail(((grid - away) / sigma).powi(2), 1) >= level => SnapOutcome::Ambiguous,
        _ => SnapOutcome::Snapped,
    };
    Ok(Snap {
        dimension,
        text: dimension.describe(drawing),
        value,
        sigma,
        nearest,
        p_value: test.p_value,
        outcome,
    })
}
