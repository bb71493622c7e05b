//! Crossed stripes on surfaces whose points, normals and curvatures are known: pictures are rendered, read,
//! and judged by the stated covariances.

use planish::GridOptions;
use planish::simulate::{Exposure, Light, RaySurface, Texture};
use planish_core::vector3::tangents;
use planish_core::{DVec3, Pinhole};
use planish_sense::Image;
use planish_sense::stripes::{GridCamera, GridReadings, StripePattern, read_grid};

const SIZE: [usize; 2] = [480, 400];

/// A camera at a place that looks at the origin, with −y upright.
fn pinhole_at(from: DVec3) -> Pinhole {
    let z = (-from).try_normalize().unwrap();
    let x = DVec3::Y.cross(z).try_normalize().unwrap();
    let rows = [x, z.cross(x), z];
    Pinhole {
        k: [[1500.0, 0.0, 239.5], [0.0, 1500.0, 199.5], [0.0, 0.0, 1.0]],
        r: rows.map(|row| row.to_array()),
        t: rows.map(|row| -row.dot(from)).into(),
    }
}

fn rig() -> GridCamera {
    GridCamera {
        camera: pinhole_at(DVec3::new(0.0, 0.0, -400.0)),
        projector: pinhole_at(DVec3::new(170.0, -20.0, -360.0)),
        pattern: StripePattern {
            directions_rad: [35.0_f64.to_radians(), 125.0_f64.to_radians()],
            spacing: 18.0,
            origin: [239.5, 199.5],
            range: [[-20, 20]; 2],
        },
        sigma_px: 0.005,
    }
}

/// A surface with what is true of it: where a ray meets it, the normal there, and the second fundamental form
/// against the normal as a matrix.
struct Shape<'a> {
    hit: &'a (dyn Fn(DVec3, DVec3) -> Option<(DVec3, DVec3)> + Sync),
    /// Signed distance to the surface, to first order.
    distance: &'a dyn Fn(DVec3) -> f64,
    normal: &'a dyn Fn(DVec3) -> DVec3,
    /// Curvature in a unit direction, positive where the surface bends towards its normal.
    curvature: &'a dyn Fn(DVec3, DVec3) -> f64,
}

fn take(target: &impl RaySurface, light: &Light, texture: f64, sigma: f64, seed: u64) -> Image {
    let rig = rig();
    let exposure = Exposure {
        camera: &rig.camera,
        size: SIZE,
        light,
        texture: &Texture { contrast: texture, grain: 0.8, seed: 1 },
        sigma_brightness: sigma,
        seed,
    };
    let values = exposure.take(target, &mut |_| Ok(())).unwrap();
    Image::try_new(SIZE[0], SIZE[1], values.into_iter().map(f32::from).collect()).unwrap()
}

fn read(shape: &Shape, texture: f64, sigma: f64, seed: u64) -> GridReadings {
    let rig = rig();
    let light = Light::Stripes { projector: rig.projector, pattern: rig.pattern, sigma_px: 1.8 };
    let stripes = take(&shape.hit, &light, texture, sigma, seed);
    let plain = take(&shape.hit, &Light::Lamp(DVec3::new(0.0, -150.0, -400.0)), texture, sigma, seed + 1000);
    read_grid(&stripes, Some(&plain), &rig, &GridOptions::default()).unwrap()
}

/// Squares of errors over their variances.
#[derive(Default)]
struct Judged {
    place: Vec<f64>,
    normal: Vec<f64>,
    curvature: Vec<f64>,
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn covered(values: &[f64], bound: f64) -> f64 {
    values.iter().filter(|x| **x <= bound).count() as f64 / values.len() as f64
}

impl Judged {
    fn add(&mut self, shape: &Shape, found: &GridReadings) {
        for r in &found.readings {
            let o = &r.orientation;
            let truth = (shape.normal)(o.point);
            let truth = if truth.dot(o.normal) < 0.0 { -truth } else { truth };
            self.place.push((shape.distance)(o.point).powi(2) / o.covariance.along(truth));
            // Two tangential components.
            let (e1, e2) = tangents(o.normal);
            let sigma = o.sigma_normal_deg.to_radians();
            self.normal.extend([e1, e2].map(|e| (truth.dot(e) / sigma).powi(2)));
            if let Some(c) = &r.curvature {
                let side = if (shape.normal)(o.point).dot(o.normal) < 0.0 { -1.0 } else { 1.0 };
                let d2 = o.normal.cross(c.d1);
                // The three components of the second fundamental form in its own frame, the mixed one with √2
                // of its σ off the diagonal.
                let of = |d: DVec3| side * (shape.curvature)(o.point, d);
                let both = (c.d1 + d2).try_normalize().unwrap();
                let (a, b) = (of(c.d1), of(d2));
                let mixed = of(both) - 0.5 * (a + b);
                self.curvature.extend(
                    [(c.k1 - a).powi(2), (c.k2 - b).powi(2), 2.0 * mixed * mixed]
                        .map(|e| e / (c.sigma * c.sigma)),
                );
            }
        }
    }

    fn assert(&self, name: &str) {
        let all = [&self.place, &self.normal, &self.curvature]
            .map(|errors| (mean(errors), covered(errors, 1.96 * 1.96)));
        let [place, normal, curvature] = all;
        // Two pictures of some hundred crossings each; normals are judged by one σ for all directions of
        // their error, and shading bends stripes.
        assert!(place.0 < 1.6 && (0.9..=1.0).contains(&place.1), "{name}: {all:?}");
        assert!(normal.0 < 2.5 && normal.1 > 0.8, "{name}: {all:?}");
        assert!(curvature.0 < 1.6 && curvature.1 > 0.9, "{name}: {all:?}");
        assert!(
            self.place.len() > 250 && self.curvature.len() > 500,
            "{name}: {} {}",
            self.place.len(),
            self.curvature.len()
        );
    }
}

fn ball(o: DVec3, d: DVec3) -> Option<(DVec3, DVec3)> {
    let (a, b, c) = (d.length_squared(), o.dot(d), o.length_squared() - 50.0 * 50.0);
    let root = b * b - a * c;
    (root > 0.0).then(|| {
        let p = o + (-b - root.sqrt()) / a * d;
        (p, 1.0 / 50.0 * p)
    })
}

/// An upright cylinder.
fn tube(o: DVec3, d: DVec3) -> Option<(DVec3, DVec3)> {
    let (a, b, c) =
        (d[0] * d[0] + d[2] * d[2], o[0] * d[0] + o[2] * d[2], o[0] * o[0] + o[2] * o[2] - 40.0 * 40.0);
    let root = b * b - a * c;
    (root > 0.0).then(|| {
        let p = o + (-b - root.sqrt()) / a * d;
        (p, DVec3::new(p[0] / 40.0, 0.0, p[2] / 40.0))
    })
}

/// z = (x² − y²)/160, within 45 of the middle.
fn saddle_gradient(p: DVec3) -> DVec3 {
    DVec3::new(-p[0] / 80.0, p[1] / 80.0, 1.0)
}

fn saddle_height(p: DVec3) -> f64 {
    p[2] - (p[0] * p[0] - p[1] * p[1]) / 160.0
}

fn saddle(o: DVec3, d: DVec3) -> Option<(DVec3, DVec3)> {
    // Newton's method from the plane z = 0: the slopes are gentle.
    let mut t = -o[2] / d[2];
    for _ in 0..30 {
        let p = o + t * d;
        t -= saddle_height(p) / saddle_gradient(p).dot(d);
    }
    let p = o + t * d;
    (saddle_height(p).abs() < 1e-9 && p[0].hypot(p[1]) < 45.0)
        .then(|| (p, saddle_gradient(p).try_normalize().unwrap()))
}

fn shapes<'a>() -> [(&'static str, Shape<'a>); 3] {
    [
        (
            "ball",
            Shape {
                hit: &ball,
                distance: &|p| p.length() - 50.0,
                normal: &|p| p.try_normalize().unwrap(),
                curvature: &|_, _| -1.0 / 50.0,
            },
        ),
        (
            "tube",
            Shape {
                hit: &tube,
                distance: &|p| p[0].hypot(p[2]) - 40.0,
                normal: &|p| DVec3::new(p[0], 0.0, p[2]).try_normalize().unwrap(),
                curvature: &|_, d| -(1.0 - d[1] * d[1]) / 40.0,
            },
        ),
        (
            "saddle",
            Shape {
                hit: &saddle,
                distance: &|p| saddle_height(p) / saddle_gradient(p).length(),
                normal: &|p| saddle_gradient(p).try_normalize().unwrap(),
                // −dᵀ∇²F d/|∇F| with F = z − (x² − y²)/160.
                curvature: &|p, d| (d[0] * d[0] - d[1] * d[1]) / 80.0 / saddle_gradient(p).length(),
            },
        ),
    ]
}

#[test]
fn errors_of_points_normals_and_curvatures_match_their_sigma() {
    for (name, shape) in shapes() {
        for (texture, sigma) in [(0.0, 4.0), (0.5, 1.0)] {
            let mut judged = Judged::default();
            for seed in 0..2 {
                let found = read(&shape, texture, sigma, 10 * seed);
                judged.add(&shape, &found);
            }
            judged.assert(&format!("{name} texture {texture} noise {sigma}"));
        }
    }
}
