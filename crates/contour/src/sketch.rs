//! Estimated contours as one drawing, on which constraints are found and imposed, and back.
//!
//! Comes in: [`EstimatedContour`]s, each with the covariance of its own parameters. Goes out: a [`Sketch`]:
//! points, bars and circles with their covariance, and the constraints that make a rectangle a rectangle
//! ([`Sketch::given`]); from the drawing that obeys more of them, the contours' parameters again. Not
//! guaranteed: that contours overlap or not.
//!
//! | kind | drawn as | held by |
//! |---|---|---|
//! | line | a bar between the ends of what was seen | – |
//! | circle | centre and radius | – |
//! | ellipse | two bars from the centre: its semi-axes | perpendicular |
//! | rectangle | four corners and bars | three right angles |
//! | rounded rectangle | its rectangle, a circle at the first corner | and tangent to the two sides there |
//! | slot | a bar between the centres of its ends, a circle at each | equal radii |
//! | regular polygon | corners and bars | equal lengths, and angles |
//! | polygon | corners and bars | – |
//! | chain | corners, bars, and a circle for each arc | ends on their circles |

mod shapes;

use crate::constraint::{Constraint, Offset, ParametricDrawing};
use crate::planar::ContourKind;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use planish_estimate::{Error, Result};

/// A contour with the covariance of its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimatedContour {
    /// Its kind.
    pub kind: ContourKind,
    /// Its parameters as [`ContourKind`] says, angles in radians.
    pub theta: Vec<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Of a line, the ends of what was seen.
    pub seen: Option<[[f64; 2]; 2]>,
}

/// A contour's place in a sketch.
#[derive(Debug, Clone, PartialEq)]
pub struct SketchPart {
    /// Its kind.
    pub kind: ContourKind,
    /// Its parameters as they were estimated.
    pub theta: Vec<f64>,
    /// What its points, bars and circles begin with.
    pub first: Offset,
    /// How many points, bars and circles it has.
    pub count: Offset,
    /// Where its values begin among the drawing's parameters, and how many there are.
    values: [usize; 2],
}

/// Estimated contours as one drawing with its covariance.
///
/// # Examples
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_contour::constraint::{ConstrainOptions, constrain};
/// use planish_contour::planar::ContourKind;
/// use planish_contour::sketch::{EstimatedContour, Sketch};
///
/// // A rectangle turned by 0.1°, known to 0.3°: it may as well stand upright.
/// let sigmas = DMatrix::from_diagonal(&DVector::from_vec(vec![0.04, 0.04, 0.04, 0.04, 2.7e-5]));
/// let theta = vec![0.0, 0.0, 40.0, 30.0, 0.00175];
/// let seen = EstimatedContour { kind: ContourKind::Rectangle, theta, covariance: sigmas, seen: None };
/// let sketch = Sketch::new(&[seen])?;
/// assert_eq!((sketch.drawing.parameters(), sketch.given.len()), (8, 3));
/// let options = ConstrainOptions { given: sketch.given.clone(), ..ConstrainOptions::default() };
/// let found = constrain(&sketch.drawing, &sketch.covariance, &options)?;
/// assert_eq!(found.freedoms, 4);
/// let (theta, covariance) = sketch.contour(0, &found.drawing, &found.covariance)?;
/// assert!(theta[4].abs() < 1e-9 && covariance[(4, 4)] < 1e-12);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sketch {
    /// All parts.
    pub drawing: ParametricDrawing,
    /// The covariance of its parameters: that of the estimates along what the kinds allow, and about as much
    /// across it, where [`Self::given`] leaves nothing.
    pub covariance: DMatrix<f64>,
    /// The constraints that make every contour one of its kind.
    pub given: Vec<Constraint>,
    /// The contours, in the order given.
    pub parts: Vec<SketchPart>,
}

/// A step of the differences, in σ.
const STEP: f64 = 1e-3;

impl Sketch {
    /// The drawing of contours, with block after block of their covariance.
    ///
    /// With `x = h(θ)` and `J = ∂h/∂θ` (by central differences), a block is `J Σ Jᵀ + s² (I − Q Qᵀ)`, `Q` an
    /// orthonormal basis of the columns of `J` and `s²` the largest eigenvalue of the first term. Once the
    /// kind's own constraints are imposed exactly, the second term is gone, and only what is nonlinear in
    /// between depends on it.
    ///
    /// # Errors
    /// `Input` when a contour's parameters or covariance do not fit its kind, or are none; messages count
    /// contours from 1.
    pub fn new(contours: &[EstimatedContour]) -> Result<Self> {
        let mut sketch = Self::default();
        let mut blocks = Vec::new();
        for (i, contour) in contours.iter().enumerate() {
            let block = sketch
                .add(contour)
                .map_err(|e| e.in_context(format!("contour {} ({})", i + 1, contour.kind)))?;
            blocks.push(block);
        }
        sketch.covariance = block_diagonal(&blocks);
        Ok(sketch)
    }

    fn add(&mut self, contour: &EstimatedContour) -> Result<DMatrix<f64>> {
        let EstimatedContour { kind, theta, .. } = contour;
        let count = kind.parameters();
        if theta.len() != count || contour.covariance.shape() != (count, count) {
            return Err(Error::input(format!(
                "needed {count} parameters and a covariance of {count} × {count}, found {} and {} × {}",
                theta.len(),
                contour.covariance.nrows(),
                contour.covariance.ncols()
            )));
        }
        if !kind.is_valid(theta) {
            return Err(Error::input(format!(
                "parameters {theta:?} mean no {kind}: sizes must be positive and numbers finite"
            )));
        }
        if !contour.covariance.iter().all(|c| c.is_finite())
            || contour.covariance.diagonal().iter().any(|&d| d < 0.0)
        {
            return Err(Error::input(
                "the covariance holds a number that is not finite, or a negative variance",
            ));
        }
        let made = shapes::drawn(kind, theta, contour.seen)?;
        let first = self.drawing.append(&made.drawing, None);
        self.given.extend(made.given.iter().map(|constraint| constraint.shifted(first)));
        self.parts.push(SketchPart {
            kind: kind.clone(),
            theta: theta.clone(),
            first,
            count: made.drawing.counts(),
            values: [self.drawing.parameters() - made.drawing.parameters(), made.drawing.parameters()],
        });
        carried(contour, made.given.is_empty())
    }

    /// A contour's parameters and their covariance, from a drawing that obeys [`Self::given`].
    ///
    /// # Errors
    /// `Input` when the drawing or its covariance is not one of this sketch, or its parameters mean no
    /// contour of the kind.
    ///
    /// # Panics
    /// When there is no such contour.
    pub fn contour(
        &self,
        part: usize,
        drawing: &ParametricDrawing,
        covariance: &DMatrix<f64>,
    ) -> Result<(Vec<f64>, DMatrix<f64>)> {
        let n = self.drawing.parameters();
        if drawing.parameters() != n || covariance.shape() != (n, n) {
            return Err(Error::input(format!(
                "the sketch has {n} parameters; the drawing has {} and its covariance {}",
                drawing.parameters(),
                covariance.nrows()
            )));
        }
        let SketchPart { kind, theta: before, values: [from, count], .. } = &self.parts[part];
        let values = drawing.values().rows(*from, *count).into_owned();
        let block = covariance.view((*from, *from), (*count, *count)).into_owned();
        let theta = shapes::parameters(kind, values.as_slice(), before);
        if !kind.is_valid(&theta) {
            return Err(Error::input(format!(
                "contour {} ({kind}): what was imposed leaves no {kind}: {theta:?}",
                part + 1
            )));
        }
        let sigmas = block.diagonal().map(|v| v.max(0.0).sqrt());
        let step = STEP * sigmas.amax().max(1e-6 * drawing.extent());
        let inverse = differences(&values, &DVector::from_element(*count, step), |x| {
            DVector::from_vec(shapes::parameters(kind, x.as_slice(), before))
        });
        let moved = &inverse * block * inverse.transpose();
        Ok((theta, 0.5 * (&moved + moved.transpose())))
    }
}

/// The covariance of a contour's values, and across what its kind allows; not there where nothing holds it
/// together.
fn carried(contour: &EstimatedContour, is_free: bool) -> Result<DMatrix<f64>> {
    let EstimatedContour { kind, theta, covariance, seen } = contour;
    if matches!(kind, ContourKind::Polygon(_) | ContourKind::Circle) {
        return Ok(covariance.clone());
    }
    let size = theta.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let steps = covariance.diagonal().map(|v| STEP * v.sqrt().max(1e-6 * size.max(f64::MIN_POSITIVE)));
    let theta = DVector::from_column_slice(theta);
    let jacobian = differences(&theta, &steps, |t| {
        shapes::drawn(kind, t.as_slice(), *seen)
            .map_or_else(|_| DVector::zeros(0), |made| made.drawing.values())
    });
    if jacobian.nrows() == 0 {
        return Err(Error::input("the contour is too small beside its σ to be drawn"));
    }
    let along = &jacobian * covariance * jacobian.transpose();
    let along = 0.5 * (&along + along.transpose());
    if is_free {
        return Ok(along);
    }
    let largest = SymmetricEigen::new(along.clone()).eigenvalues.amax();
    // Columns of equal length, so that none is lost.
    let mut columns = jacobian;
    for mut column in columns.column_iter_mut() {
        let length = column.norm();
        column.unscale_mut(length);
    }
    let basis = columns.qr().q();
    let across = DMatrix::identity(along.nrows(), along.nrows()) - &basis * basis.transpose();
    Ok(along + across * largest)
}

/// `∂f/∂x` by central differences.
fn differences(
    x: &DVector<f64>,
    steps: &DVector<f64>,
    f: impl Fn(&DVector<f64>) -> DVector<f64>,
) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = (0..x.len())
        .map(|i| {
            let [mut below, mut above] = [x.clone(), x.clone()];
            below[i] -= steps[i];
            above[i] += steps[i];
            let (low, high) = (f(&below), f(&above));
            if low.len() == high.len() { (high - low) / (above[i] - below[i]) } else { DVector::zeros(0) }
        })
        .collect();
    if columns.iter().any(DVector::is_empty) {
        return DMatrix::zeros(0, 0);
    }
    DMatrix::from_columns(&columns)
}

/// The block-diagonal matrix of these blocks, in their order.
#[must_use]
pub fn block_diagonal(blocks: &[DMatrix<f64>]) -> DMatrix<f64> {
    let size = blocks.iter().map(DMatrix::nrows).sum();
    let mut whole = DMatrix::zeros(size, size);
    let mut at = 0;
    for block in blocks {
        whole.view_mut((at, at), block.shape()).copy_from(block);
        at += block.nrows();
    }
    whole
}

#[cfg(test)]
mod tests;
