//! Dimensions put on a grid, where the statistics allow it.
//!
//! Comes in: a constrained estimate and a grid, such as 0.5 mm. Goes out: which dimensions lie on it, imposed
//! like other constraints, and why the others were left. Not guaranteed: that a designer used this grid; a
//! dimension known far better than the grid that is off it says no.

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
    /// The distance of two points, such as the centres of holes.
    Distance(PointId, PointId),
    /// The distance of a point from a bar's line, to the left; to the right it is negative.
    Offset(PointId, BarId),
}

impl Dimension {
    /// The lengths of all bars but axes, and all diameters.
    #[must_use]
    pub fn all(drawing: &ParametricDrawing) -> Vec<Self> {
        let bars = drawing.bars().filter(|&bar| !drawing.is_axis(bar)).map(Self::Length);
        bars.chain(drawing.circles().map(Self::Diameter)).collect()
    }

    /// The constraint that gives it a value.
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

    /// Its constraint's residual is this many times smaller.
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

/// What became of a dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SnapOutcome {
    /// It agrees with one value of the grid and with no other, and was imposed.
    Snapped,
    /// Others had fixed it before, on the grid.
    Implied,
    /// Others had fixed it before, off the grid.
    FixedOffGrid,
    /// It disagrees with every value of the grid.
    OffGrid,
    /// It agrees with more than one value: known too badly for this grid.
    Ambiguous,
    /// Alone it agrees, but all that is imposed would fail its test with it.
    Refused,
}

/// A dimension and the grid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Snap {
    /// The dimension.
    pub dimension: Dimension,
    /// The dimension in words.
    pub text: String,
    /// Its value before.
    pub value: f64,
    /// Its standard deviation before; zero where others had fixed it.
    pub sigma: f64,
    /// The nearest value of the grid.
    pub nearest: f64,
    /// The probability of a value at least as far from it, if it were the true one.
    pub p_value: f64,
    /// What became of it.
    pub outcome: SnapOutcome,
}

/// Puts dimensions on a grid, one after the other, the best known first.
///
/// A dimension `d ± σ` is snapped to the nearest multiple `g` of `grid` when `(d − g)²/σ²` passes its χ²
/// test, when the next multiple fails it (else the grid says nothing, and the dimension is left as
/// *ambiguous*), and when all that is imposed still passes together. The level is shared among the dimensions
/// (Bonferroni). σ falls on the way, as snapped dimensions sharpen the others. Cost: one
/// [`impose`](crate::constraint::impose) a dimension.
///
/// # Errors
/// `Input` when the grid is not positive.
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
/// // 30.24 ± 0.03 lies on no half millimetre.
/// assert_eq!(height.outcome, SnapOutcome::OffGrid);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn snap(
    constrained: &Constrained,
    grid: f64,
    dimensions: &[Dimension],
) -> Result<(Constrained, Vec<Snap>)> {
    if !(grid > 0.0 && grid.is_finite()) {
        return Err(Error::input(format!("the grid to snap to must be positive, not {grid}")));
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
    let mut constraints = constrained.constraints.clone();
    let mut report: Vec<Option<Snap>> = vec![None; dimensions.len()];
    let level = search.options.level / dimensions.len().max(1) as f64;
    for _ in 0..dimensions.len() {
        let mut best: Option<(usize, Snap)> = None;
        let now = State::unconstrained(&state.drawing, &state.covariance);
        for (i, &dimension) in dimensions.iter().enumerate().filter(|(i, _)| report[*i].is_none()) {
            let looked_at = look_at(constrained, &state, &now, dimension, grid, level)?;
            if best.as_ref().is_none_or(|(_, known)| looked_at.sigma < known.sigma) {
                best = Some((i, looked_at));
            }
        }
        let Some((i, mut found)) = best else {
            break;
        };
        if found.outcome == SnapOutcome::Snapped {
            constraints.push(found.dimension.constraint(&state.drawing, found.nearest));
            match search.tried(&constraints, &state) {
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

fn look_at(
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
    // A length of zero is none.
    let nearest = if rounded == 0.0 { grid.copysign(value) } else { rounded };
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
