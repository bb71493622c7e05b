//! Initial parameters of a shape, derived from the points alone.

use super::shape::{Chart, PrimitiveKind};
use crate::planar::circle_of_points;
use nalgebra::{Matrix3, Matrix4, Rotation3, Unit, UnitQuaternion, Vector3, Vector4};
use planish_core::DVec3;

/// Number of axis directions tried for a cylinder, spread over a half sphere: one per about 0.04 sr, 0.2 rad
/// apart. The fit converges from there.
const DIRECTIONS: usize = 150;
/// Number of rotations tried for a box, spread over those that differ by more than a symmetry of the cube.
const ROTATIONS: usize = 500;

/// Charts with initial unknowns, most promising first; empty if the points do not determine the shape.
///
/// Planes use the direction of least variance, spheres Kåsa's fit. Cylinders use Taubin's circle across each
/// of many directions. Boxes use the bounding box in each of many rotations, ranked by the mean squared
/// distance of the points to its sides.
///
/// # References
/// Kåsa 1976, *A circle fitting procedure and its error analysis*; Taubin 1991.
pub(crate) fn starts(shape: PrimitiveKind, points: &[DVec3]) -> Vec<(Chart, Vec<f64>)> {
    let points: Vec<Vector3<f64>> = points.iter().map(|&p| Vector3::from(p)).collect();
    // Charts are centred on the points, so that lever arms of the rotations are short.
    let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    match shape {
        PrimitiveKind::Plane => {
            let spread: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
            let eigen = spread.symmetric_eigen();
            let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
            vec![(Chart::along(middle, outward(normal)), vec![0.0; 3])]
        }
        PrimitiveKind::Sphere => sphere(&points, middle).into_iter().collect(),
        PrimitiveKind::Cylinder => cylinders(&points, middle),
        PrimitiveKind::Box => boxes(&points, middle),
    }
}

/// Of two opposite directions, the one whose largest component is positive.
fn outward(n: Vector3<f64>) -> Vector3<f64> {
    if n[n.iamax()] < 0.0 { -n } else { n }
}

/// Kåsa's sphere: linear least squares for centre and squared radius.
fn sphere(points: &[Vector3<f64>], middle: Vector3<f64>) -> Option<(Chart, Vec<f64>)> {
    // Coordinates relative to the centroid: |p|² of distant points would cancel.
    let mut normal = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for p in points {
        let d = p - middle;
        let row = Vector4::new(d.x, d.y, d.z, 1.0);
        normal += row * row.transpose();
        right += row * d.norm_squared();
    }
    let solved = normal.cholesky()?.solve(&right);
    let center = 0.5 * solved.xyz();
    let radius = (solved.w + center.norm_squared()).sqrt();
    radius.is_finite().then(|| {
        let chart = Chart::along(middle, Vector3::z());
        (chart, vec![center.x, center.y, center.z, radius])
    })
}

/// Directions spread evenly over a half sphere: a Fibonacci spiral with the golden angle of 2.4 rad.
fn directions() -> impl Iterator<Item = Vector3<f64>> {
    (0..DIRECTIONS).map(|k| {
        let z = (k as f64 + 0.5) / DIRECTIONS as f64;
        let (sin, cos) = (k as f64 * 2.399_963_229_728_653).sin_cos();
        let across = (1.0 - z * z).sqrt();
        Vector3::new(across * cos, across * sin, z)
    })
}

/// The three best cylinders among all directions.
fn cylinders(points: &[Vector3<f64>], middle: Vector3<f64>) -> Vec<(Chart, Vec<f64>)> {
    let mut found: Vec<(f64, Chart, Vec<f64>)> = directions()
        .filter_map(|direction| {
            let chart = Chart::along(middle, direction);
            let flat: Vec<[f64; 2]> =
                points.iter().map(|p| [0, 1].map(|k| chart.frame.column(k).dot(&(p - middle)))).collect();
            let circle = circle_of_points(&flat)?;
            let off = |p: &[f64; 2]| ((p[0] - circle[0]).hypot(p[1] - circle[1]) - circle[2]).powi(2);
            let cost = flat.iter().map(off).sum();
            Some((cost, chart, vec![circle[0], circle[1], 0.0, 0.0, circle[2]]))
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Several starts, because noise and uneven readings can make a wrong direction the best one.
    found.into_iter().take(3).map(|(_, chart, start)| (chart, start)).collect()
}

/// The four best boxes among all rotations.
fn boxes(points: &[Vector3<f64>], middle: Vector3<f64>) -> Vec<(Chart, Vec<f64>)> {
    let mut found: Vec<(f64, Chart, Vec<f64>)> = (0..ROTATIONS)
        .map(|k| {
            let chart = Chart { pivot: middle, frame: rotation(k) };
            let local: Vec<Vector3<f64>> = points.iter().map(|p| chart.frame.tr_mul(&(p - middle))).collect();
            let (mut low, mut high) = (Vector3::zeros(), Vector3::zeros());
            for axis in 0..3 {
                let mut values: Vec<f64> = local.iter().map(|q| q[axis]).collect();
                // Noise and outliers lie outside of the true sides: cut 4 % of the points at each end.
                let cut = values.len() / 25;
                let last = values.len() - 1 - cut;
                low[axis] = *values.select_nth_unstable_by(cut, f64::total_cmp).1;
                high[axis] = *values.select_nth_unstable_by(last, f64::total_cmp).1;
            }
            let nearest = |q: &Vector3<f64>| {
                let each = (0..3).map(|k| (q[k] - low[k]).abs().min((q[k] - high[k]).abs()));
                each.fold(f64::INFINITY, f64::min).powi(2)
            };
            let cost = local.iter().map(nearest).sum();
            let center = chart.frame * (0.5 * (low + high));
            let size = high - low;
            let start = vec![center.x, center.y, center.z, 0.0, 0.0, 0.0, size.x, size.y, size.z];
            (cost, chart, start)
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().take(4).map(|(_, chart, start)| (chart, start)).collect()
}

/// Rotation `k` of a low-discrepancy sequence, reduced by the symmetries of the cube to the smallest angle.
///
/// Without the reduction, most of the rotations would repeat the same box with its axes exchanged.
///
/// # References
/// Shoemake 1992, *Uniform random rotations*; Roberts 2018 for the sequence.
fn rotation(k: usize) -> Matrix3<f64> {
    // Powers 1/φ, 1/φ², 1/φ³ of the root of φ⁴ = φ + 1 (Roberts).
    let [a, b, c] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3]
        .map(|step: f64| (0.5 + step * k as f64).fract());
    let (inner, outer) = ((1.0 - a).sqrt(), a.sqrt());
    let turn = std::f64::consts::TAU;
    let quaternion = nalgebra::Quaternion::new(
        outer * (turn * c).cos(),
        inner * (turn * b).sin(),
        inner * (turn * b).cos(),
        outer * (turn * c).sin(),
    );
    let uniform = UnitQuaternion::new_normalize(quaternion);
    // Every symmetry of the cube is a product of two multiples of quarter turns about axes.
    let mut best = uniform;
    for about in [Vector3::x(), Vector3::y(), Vector3::z()] {
        for quarters in 0..4 {
            for second in [Vector3::x(), Vector3::y(), Vector3::z()] {
                for more in 0..4 {
                    let quarter = |axis, count| {
                        let angle = std::f64::consts::FRAC_PI_2 * f64::from(count);
                        UnitQuaternion::from_axis_angle(&Unit::new_unchecked(axis), angle)
                    };
                    let same = uniform * quarter(about, quarters) * quarter(second, more);
                    if same.angle() < best.angle() {
                        best = same;
                    }
                }
            }
        }
    }
    Rotation3::from(best).into_inner()
}
