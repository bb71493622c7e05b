//! How many readings a shape needs, and which clouds are too poor for it.
//!
//! A shape has parameters of its own, such as centre and radius of a ball. Residuals are left only by
//! readings beyond these, and σ follows from residuals.

use planish_core::Setting;
use planish_estimate::{Error, Result};
use planish_spline::{BaseShape, Shape};

/// Readings beyond the parameters of the shape.
///
/// Seven degrees of freedom give σ to 27 %, and 95 % intervals of Student's t that are a fifth longer than
/// normal ones. With three they are 62 % longer, and rest on the normal distribution far into its tails.
const MIN_DEGREES: usize = 7;
/// Readings of a torus, which varies in two directions around. 95 % intervals from 20 to 40 readings of
/// tori with random waves covered 0.89 to 0.92, those from 50 or more (45 and a tenth held out) 0.94 to 0.95.
const MIN_OF_TORUS: usize = 45;
/// Smallest standard deviation of the readings across a sheet, in σ of a reading.
///
/// The tilt of a plane about the longer axis of its readings has a σ of `σ / (s √n)`, `s` the standard
/// deviation across. Ten readings with s = 3 σ leave 6°; with less, heights and widths are no longer
/// distinct.
const MIN_WIDTH: f64 = 3.0;
/// Largest σ of the surface, as a share of its size.
///
/// A 95 % interval of half the size holds shapes of all kinds: σ no longer describes the surface.
const MAX_SIGMA: f64 = 0.125;

/// Free parameters of a shape, whose changes the prior does not resist: a quadratic height field has 6, a
/// ball 4, a circular cone (of which a cylinder is one) 6, a torus 7.
pub(super) fn free_parameters(shape: Shape) -> usize {
    match shape {
        Shape::Sheet | Shape::Tube => 6,
        Shape::Ball => 4,
        Shape::Torus => 7,
    }
}

/// Refuses fewer readings than a shape needs.
pub(super) fn refuse_too_few(shape: Shape, found: usize) -> Result<()> {
    let free = free_parameters(shape);
    let (needed, reason) = match shape {
        Shape::Torus => (MIN_OF_TORUS, "fewer do not show how its section varies around the ring".to_owned()),
        _ => (
            free + MIN_DEGREES,
            format!("its place and size take {free} of them, and σ needs {MIN_DEGREES} more"),
        ),
    };
    if found >= needed {
        return Ok(());
    }
    Err(Error::undetermined(format!(
        "expected at least {needed} readings for a {}, found {found}: {reason}",
        shape.name()
    ))
    .with_setting(Setting::Shape))
}

/// Refuses readings of a sheet that lie about a line. `sigma` is that of a reading, `spread` the standard
/// deviations of the readings along the three axes of their cloud.
pub(super) fn refuse_line(shape: Shape, spread: [f64; 3], sigma: f64) -> Result<()> {
    if shape != Shape::Sheet || spread[1] >= MIN_WIDTH * sigma {
        return Ok(());
    }
    Err(Error::undetermined(format!(
        "expected readings that span an area, found readings about a line: they spread {:.3e} along it and \
         {:.3e} across it, with errors of {sigma:.3e}; add readings beside the line",
        spread[0], spread[1]
    )))
}

/// Refuses a surface that is not known well enough to be called one. `sigma` is the median of σ where it was
/// measured.
pub(super) fn refuse_vague(base: &BaseShape, found: usize, sigma: f64) -> Result<()> {
    let size = base.size.iter().copied().filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min);
    if sigma <= MAX_SIGMA * size {
        return Ok(());
    }
    Err(Error::undetermined(format!(
        "{found} readings do not determine the shape of this {}: σ of the surface would be {sigma:.3e}, \
         {:.0} % of its radius or half width ({size:.3e}); add readings, state σ if it is known, or specify \
         a simpler shape",
        base.shape.name(),
        100.0 * sigma / size
    ))
    .with_setting(Setting::Shape))
}
