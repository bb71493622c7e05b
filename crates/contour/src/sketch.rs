//! Conversion of estimated contours to one drawing for constraints, and back.
//!
//! In: [`EstimatedContour`]s, each with the covariance of its parameters. Out: a [`Sketch`] of points, bars
//! and circles with their joint covariance, and the constraints of each kind, such as right angles of a
//! rectangle ([`Sketch::given`]). After further constraints are imposed, [`Sketch::contour`] recovers the
//! parameters of each contour. Not guaranteed: that contours do not overlap.
//!
//! A rectangle becomes four free corners with three right angles instead of five parameters. All nonlinearity
//! is then in the constraints, and relations between parts of any kind have the same form (decision record
//! 0047).
//!
//! | kind | drawing | constraints |
//! |---|---|---|
//! | line | a bar between the ends of its observed part | – |
//! | circle | centre and radius | – |
//! | ellipse | two bars from the centre: its semi-axes | perpendicular |
//! | rectangle | four corners and bars | three right angles |
//! | rounded rectangle | its rectangle, a circle at the first corner | right angles, both tangents there |
//! | slot | a bar between the centres of its ends, a circle at each | equal radii |
//! | regular polygon | corners and bars | equal lengths, and angles |
//! | polygon | corners and bars | – |
//! | chain | corners, bars, and a circle for each arc | ends of arcs on their circles |

mod shapes;

use crate::constraint::{Constraint, Offset, ParametricDrawing};
use crate::planar::ContourKind;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use planish_estimate::{Error, Result};

/// A contour with the covariance of its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimatedContour {
    /// Kind of the contour.
    pub kind: ContourKind,
    /// Parameters in the order of [`ContourKind`], angles in radians.
    pub theta: Vec<f64>,
    /// Covariance of the parameters.
    pub covariance: DMatrix<f64>,
    /// Ends of the observed part; required for a line, ignored otherwise.
    pub observed_ends: Option<[[f64; 2]; 2]>,
}

/// The part of a sketch that belongs to one contour.
#[derive(Debug, Clone, PartialEq)]
pub struct SketchPart {
    /// Kind of the contour.
    pub kind: ContourKind,
    /// Estimated parameters.
    pub theta: Vec<f64>,
    /// Indices of its first point, bar and circle.
    pub first: Offset,
    /// Numbers of its points, bars and circles.
    pub count: Offset,
    /// Index of its first parameter in the drawing, and the number of its parameters.
    values: [usize; 2],
}

/// Estimated contours as one drawing with a joint covariance.
///
/// # Examples
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_contour::constraint::{ConstrainOptions, constrain};
/// use planish_contour::planar::ContourKind;
/// use planish_contour::sketch::{EstimatedContour, Sketch};
///
/// // A rectangle rotated by 0.1° with σ = 0.3°: it agrees with an upright one.
/// let sigmas = DMatrix::from_diagonal(&DVector::from_vec(vec![0.04, 0.04, 0.04, 0.04, 2.7e-5]));
/// let theta = vec![0.0, 0.0, 40.0, 30.0, 0.00175];
/// let kind = ContourKind::Rectangle;
/// let estimate = EstimatedContour { kind, theta, covariance: sigmas, observed_ends: None };
/// let sketch = Sketch::new(&[estimate])?;
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
    /// Drawing of all contours.
    pub drawing: ParametricDrawing,
    /// Covariance of its parameters. It is that of the estimates in directions that keep the kind, and of
    /// similar size in the others, which [`Self::given`] fixes.
    pub covariance: DMatrix<f64>,
    /// Constraints that make each contour one of its kind.
    pub given: Vec<Constraint>,
    /// The contours, in the order given.
    pub parts: Vec<SketchPart>,
}

/// Step of the differences, in σ: the drawing is linear on this scale.
const STEP: f64 = 1e-3;

impl Sketch {
    /// The drawing of contours, with one block of the covariance per contour.
    ///
    /// With `x = h(θ)` and `J = ∂h/∂θ` by central differences, a block is `J Σ Jᵀ + s² (I − Q Qᵀ)`. `Q` is an
    /// orthonormal basis of the columns of `J`, and `s²` the largest eigenvalue of the first term. The second
    /// term makes the block regular, so that the given constraints are not already known. Imposing them
    /// exactly removes it again, except for effects of second order.
    ///
    /// # Errors
    /// `Input` if the parameters or the covariance of a contour do not fit its kind, or are not finite.
    /// Messages count contours from 1.
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
                "expected {count} parameters and a covariance of {count} × {count}, found {} and {} × {}",
                theta.len(),
                contour.covariance.nrows(),
                contour.covariance.ncols()
            )));
        }
        if !kind.is_valid(theta) {
            return Err(Error::input(format!(
                "parameters {theta:?} do not describe a {kind}: sizes must be positive and all values finite"
            )));
        }
        if !contour.covariance.iter().all(|c| c.is_finite())
            || contour.covariance.diagonal().iter().any(|&d| d < 0.0)
        {
            return Err(Error::input(
                "the covariance contains a value that is not finite, or a negative variance",
            ));
        }
        // Drawn by itself, so that `append` can number its parts after those of the earlier contours.
        let made = shapes::drawn(kind, theta, contour.observed_ends)?;
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

    /// Parameters and covariance of a contour, from a drawing that satisfies [`Self::given`].
    ///
    /// # Errors
    /// `Input` if the drawing or its covariance does not belong to this sketch, or its parameters do not
    /// describe a contour of the kind.
    ///
    /// # Panics
    /// If there is no such contour.
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
                "contour {} ({kind}): the imposed constraints leave no valid {kind}: {theta:?}",
                part + 1
            )));
        }
        let sigmas = block.diagonal().map(|v| v.max(0.0).sqrt());
        let step = STEP * sigmas.amax().max(1e-6 * drawing.extent());
        // The same step for all values: they are coordinates and radii, all of them lengths.
        let inverse = differences(&values, &DVector::from_element(*count, step), |x| {
            DVector::from_vec(shapes::parameters(kind, x.as_slice(), before))
        });
        let moved = &inverse * block * inverse.transpose();
        Ok((theta, 0.5 * (&moved + moved.transpose())))
    }
}

/// The covariance of the drawing of one contour; see [`Sketch::new`].
///
/// `is_free` is true if the kind has no constraints, so that nothing would remove the second term.
fn carried(contour: &EstimatedContour, is_free: bool) -> Result<DMatrix<f64>> {
    let EstimatedContour { kind, theta, covariance, observed_ends } = contour;
    // The parameters of these kinds are the values of the drawing.
    if matches!(kind, ContourKind::Polygon(_) | ContourKind::Circle) {
        return Ok(covariance.clone());
    }
    let size = theta.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    // A known parameter has σ of zero and still needs a step.
    let steps = covariance.diagonal().map(|v| STEP * v.sqrt().max(1e-6 * size.max(f64::MIN_POSITIVE)));
    let theta = DVector::from_column_slice(theta);
    let jacobian = differences(&theta, &steps, |t| {
        shapes::drawn(kind, t.as_slice(), *observed_ends)
            .map_or_else(|_| DVector::zeros(0), |made| made.drawing.values())
    });
    if jacobian.nrows() == 0 {
        return Err(Error::input("the contour is too small compared with its σ to be drawn"));
    }
    let along = &jacobian * covariance * jacobian.transpose();
    let along = 0.5 * (&along + along.transpose());
    if is_free {
        return Ok(along);
    }
    // The size of the added variance is arbitrary, as the constraints remove it; the largest one of the
    // estimate keeps the matrix well-conditioned.
    let largest = SymmetricEigen::new(along.clone()).eigenvalues.amax();
    // Unit columns: angles and lengths may differ by orders of magnitude, and QR would lose the small ones.
    let mut columns = jacobian;
    for mut column in columns.column_iter_mut() {
        let length = column.norm();
        column.unscale_mut(length);
    }
    let basis = columns.qr().q();
    let across = DMatrix::identity(along.nrows(), along.nrows()) - &basis * basis.transpose();
    Ok(along + across * largest)
}

/// `∂f/∂x` by central differences; empty if `f` is undefined at a step.
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
            // A step can make a contour invalid; it then has no drawing.
            if low.len() == high.len() { (high - low) / (above[i] - below[i]) } else { DVector::zeros(0) }
        })
        .collect();
    if columns.iter().any(DVector::is_empty) {
        return DMatrix::zeros(0, 0);
    }
    DMatrix::from_columns(&columns)
}

/// The block-diagonal matrix of square blocks.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_contour::sketch::block_diagonal;
///
/// let joint = block_diagonal(&[DMatrix::identity(1, 1) * 2.0, DMatrix::identity(2, 2)]);
/// assert_eq!((joint.nrows(), joint[(0, 0)], joint[(0, 1)]), (3, 2.0, 0.0));
/// ```
#[must_use]
pub fn block_diagonal(blocks: &[DMatrix<f64>]) -> DMatrix<f64> {
    let size = blocks.iter().map(DMatrix::nrows).sum();
    let mut covariance = DMatrix::zeros(size, size);
    let mut at = 0;
    for block in blocks {
        covariance.view_mut((at, at), block.shape()).copy_from(block);
        at += block.nrows();
    }
    covariance
}

#[cfg(test)]
mod tests;
