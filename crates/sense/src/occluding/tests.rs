use super::*;
use planish_core::matrix3::{from_rows, times};
use planish_core::{DVec3, Pinhole};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const FOCAL: f64 = 900.0;

/// A camera at a position, directed towards another.
fn camera(from: DVec3, to: DVec3) -> Pinhole {
    let forward = (to - from).try_normalize().unwrap();
    let right = forward.cross(DVec3::Z).try_normalize().unwrap();
    let r = from_rows([right, forward.cross(right), forward]);
    Pinhole { k: [[FOCAL, 0.0, 320.0], [0.0, FOCAL, 240.0], [0.0, 0.0, 1.0]], r, t: -times(&r, from) }
}

/// An ellipsoid whose axes are those of the coordinate system.
#[derive(Clone, Copy)]
struct Ellipsoid {
    middle: DVec3,
    axes: DVec3,
}

impl Ellipsoid {
    /// Ordered points of the contour generator on it, for a camera at a position.
    fn generator(&self, from: DVec3, count: usize) -> Vec<DVec3> {
        let c: DVec3 = (from - self.middle) / self.axes;
        let far2 = c.length_squared();
        let (a, b) = planish_core::vector3::tangents(c.try_normalize().unwrap());
        let radius = (1.0 - 1.0 / far2).sqrt();
        (0..count)
            .map(|k| {
                let t = std::f64::consts::TAU * k as f64 / count as f64;
                let x = 1.0 / far2 * c + (radius * t.cos() * a + radius * t.sin() * b);
                self.middle + self.axes * x
            })
            .collect()
    }

    fn normal(&self, at: DVec3) -> DVec3 {
        ((at - self.middle) / (self.axes * self.axes)).try_normalize().unwrap()
    }

    /// First-order distance from the surface.
    fn height(&self, at: DVec3) -> f64 {
        let g = (at - self.middle) / (self.axes * self.axes);
        let f = (0..3).map(|k| ((at[k] - self.middle[k]) / self.axes[k]).powi(2)).sum::<f64>() - 1.0;
        0.5 * f / g.length()
    }

    /// Its outline, with the object on the right.
    fn outline(&self, camera: &Pinhole, sigma: f64, random: &mut ChaCha8Rng) -> Contour {
        let exact: Vec<[f64; 2]> =
            (self.generator(camera.center(), 900).iter()).map(|p| camera.project(*p).unwrap()).collect();
        let middle = camera.project(self.middle).unwrap();
        let turn: f64 = (0..exact.len())
            .map(|k| {
                let [p, q] =
                    [exact[k], exact[(k + 1) % exact.len()]].map(|p| [p[0] - middle[0], p[1] - middle[1]]);
                p[0] * q[1] - p[1] * q[0]
            })
            .sum();
        let mut places: Vec<[f64; 2]> = exact
            .iter()
            .map(|p| {
                p.map(|x| {
                    let e: f64 = StandardNormal.sample(random);
                    x + sigma * e
                })
            })
            .collect();
        if turn < 0.0 {
            places.reverse();
        }
        Contour { places, closed: true }
    }
}

fn seen(cameras: &[Pinhole], object: &Ellipsoid, sigma: f64) -> Vec<ContourView> {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    (cameras.iter().enumerate())
        .map(|(k, camera)| {
            let outline = object.outline(camera, sigma, &mut random);
            ContourView {
                name: format!("view{k}"),
                camera: *camera,
                contours: vec![outline.clone()],
                silhouette: vec![outline],
                sigma_px: sigma.max(1e-3),
                apart_px: 0.0,
            }
        })
        .collect()
}

/// An arc of views around the middle, slightly from above.
fn arc(views: usize, step_deg: f64, height: f64) -> Vec<Pinhole> {
    (0..views)
        .map(|k| {
            let a = (step_deg * (k as f64 - 0.5 * views as f64)).to_radians();
            camera(DVec3::new(7.0 * a.cos(), 7.0 * a.sin(), height), DVec3::ZERO)
        })
        .collect()
}

fn run(views: &[ContourView]) -> Result<OccludingContours> {
    occluding_contours(views, &OccludingOptions::default(), &mut |_| Ok(()))
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for v in values {
        sum += v * v;
        n += 1.0;
    }
    (sum / n).sqrt()
}

/// Error of a point's depth, relative to the true contour point at its pixel.
fn depth_error(object: &Ellipsoid, camera: &Pinhole, point: &OccludingPoint) -> f64 {
    let way = (point.position - camera.center()).try_normalize().unwrap();
    let nearest = (object.generator(camera.center(), 3000).into_iter())
        .min_by(|a, b| {
            let off = |p: &DVec3| {
                let pixel = camera.project(*p).unwrap();
                (pixel[0] - point.pixel[0]).hypot(pixel[1] - point.pixel[1])
            };
            off(a).total_cmp(&off(b))
        })
        .unwrap();
    (point.position - nearest).dot(way)
}

const BALL: Ellipsoid = Ellipsoid { middle: DVec3::ZERO, axes: DVec3::splat(1.0) };
const EGG: Ellipsoid = Ellipsoid { middle: DVec3::new(0.1, -0.2, 0.1), axes: DVec3::new(1.4, 0.8, 1.1) };

#[test]
fn points_of_a_ball_without_noise_are_accurate() {
    let cameras = arc(9, 6.0, 2.0);
    let found = run(&seen(&cameras, &BALL, 0.0)).unwrap();
    assert!(found.points.len() > 300, "{:?}", found.rejected);
    for p in &found.points {
        assert!(depth_error(&BALL, &cameras[p.view], p).abs() < 0.02 * p.sigma_depth.max(0.05));
        assert!(BALL.height(p.position).abs() < 1e-4, "{}", BALL.height(p.position));
        assert!((p.radius - 1.0).abs() < 0.02 + 3.0 * p.sigma_radius, "{} {}", p.radius, p.sigma_radius);
        assert!(p.normal.dot(BALL.normal(p.position)) > 0.9999);
    }
    // At the top and the bottom, epipolar planes are tangent to the ball.
    assert!(found.rejected["frontier"] > 20 && found.rejected["end_of_sequence"] > 100);
    assert_eq!(
        (found.sequences, found.asked),
        (1, found.points.len() + found.rejected.values().sum::<usize>())
    );
}

/// Ratios of the errors to the stated σ: of the depth, the position along the normal, the normal, and χ² of
/// the contours.
#[test]
fn sigma_of_noisy_contours_is_consistent() {
    let cameras = arc(21, 5.0, 1.5);
    let found = run(&seen(&cameras, &EGG, 0.15)).unwrap();
    assert!(found.points.len() > 800, "{:?}", found.rejected);
    assert!((found.reduced_chi_square - 1.0).abs() < 0.05, "{}", found.reduced_chi_square);
    let depth = rms(found.points.iter().map(|p| depth_error(&EGG, &cameras[p.view], p) / p.sigma_depth));
    assert!((0.8..1.15).contains(&depth), "{depth}");
    let height = rms(found.points.iter().map(|p| {
        let n = EGG.normal(p.position);
        let variance: f64 =
            (0..3).map(|i| (0..3).map(|j| n[i] * p.covariance[i][j] * n[j]).sum::<f64>()).sum();
        EGG.height(p.position) / variance.sqrt()
    }));
    assert!((0.8..1.2).contains(&height), "{height}");
    // The angle is that of both axes together.
    let turned = rms(found
        .points
        .iter()
        .map(|p| p.normal.dot(EGG.normal(p.position)).min(1.0).acos().to_degrees() / p.sigma_normal_deg));
    let turned = turned / 2_f64.sqrt();
    assert!((0.75..1.25).contains(&turned), "{turned}");
}

/// In views 20° apart, the radius of the egg changes from one to the next. The model error of the circle is
/// most of the error, and σ includes it.
#[test]
fn sigma_includes_the_model_error_of_the_circle() {
    let cameras = arc(7, 20.0, 1.0);
    let found = run(&seen(&cameras, &EGG, 0.02)).unwrap();
    assert!(found.points.len() > 150, "{:?}", found.rejected);
    let errors: Vec<f64> = (found.points.iter()).map(|p| depth_error(&EGG, &cameras[p.view], p)).collect();
    let stated = rms(errors.iter().zip(&found.points).map(|(e, p)| e / p.sigma_depth));
    let without = rms(errors
        .iter()
        .zip(&found.points)
        .map(|(e, p)| e / (p.sigma_depth.powi(2) - p.sigma_circle.powi(2)).sqrt()));
    assert!((0.5..1.6).contains(&stated), "{stated}");
    assert!(without > 3.0, "{without}");
}

/// A camera moves along a tangent of the ball. That line of sight does not determine a depth and is rejected.
#[test]
fn lines_of_sight_along_the_baseline_are_rejected() {
    let cameras: Vec<Pinhole> =
        (0..9).map(|k| camera(DVec3::new(-8.0 + 0.4 * f64::from(k), 1.0, 0.0), DVec3::ZERO)).collect();
    let views = seen(&cameras, &BALL, 0.1);
    let found = run(&views).unwrap();
    assert!(
        found.rejected.contains_key("along_baseline") || found.rejected.contains_key("uncertain"),
        "{:?}",
        found.rejected
    );
    for p in &found.points {
        assert!(depth_error(&BALL, &cameras[p.view], p).abs() < 5.0 * p.sigma_depth);
    }
    // A camera that only rotates determines no depth.
    let turning: Vec<Pinhole> = (0..5)
        .map(|k| camera(DVec3::new(7.0, 1e-9 * f64::from(k), 0.0), DVec3::new(0.0, 0.05 * f64::from(k), 0.0)))
        .collect();
    let message = run(&seen(&turning, &BALL, 0.1)).unwrap_err().to_string();
    assert!(
        message.contains("expected points with a depth on the contours")
            && message.contains("across the lines of sight"),
        "{message}"
    );
}

/// One ball passes in front of another: their common outline splits and merges. Every accepted point is on
/// one of them.
#[test]
fn splitting_outlines_are_not_joined() {
    let balls = [
        Ellipsoid { middle: DVec3::new(1.2, 0.3, 0.0), axes: DVec3::splat(0.8) },
        Ellipsoid { middle: DVec3::new(-1.2, -0.3, 0.1), axes: DVec3::splat(0.9) },
    ];
    let cameras = arc(25, 5.0, 1.0);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut counts = std::collections::BTreeSet::new();
    let views: Vec<ContourView> = (cameras.iter().enumerate())
        .map(|(k, camera)| {
            let full = balls.map(|b| b.outline(camera, 0.1, &mut random));
            let mut contours = Vec::new();
            for (own, other) in [(0, 1), (1, 0)] {
                let hidden: Vec<bool> =
                    (full[own].places.iter()).map(|p| matching::inside(&full[other..=other], *p)).collect();
                let count = hidden.len();
                match (0..count).find(|k| hidden[*k] && !hidden[(k + 1) % count]) {
                    None if !hidden[0] => contours.push(full[own].clone()),
                    None => {}
                    Some(start) => {
                        let places = (1..count)
                            .map(|k| (start + k) % count)
                            .take_while(|k| !hidden[*k])
                            .map(|k| full[own].places[k])
                            .collect();
                        contours.push(Contour { places, closed: false });
                    }
                }
            }
            counts.insert(contours.iter().filter(|c| c.closed).count());
            ContourView {
                name: format!("view{k}"),
                camera: *camera,
                contours,
                silhouette: Vec::new(),
                sigma_px: 0.1,
                apart_px: 0.0,
            }
        })
        .collect();
    assert!(counts.len() > 1, "the outlines do part");
    let found = run(&views).unwrap();
    assert!(found.points.len() > 800 && found.strips > 1, "{} {:?}", found.points.len(), found.rejected);
    let mut points_of_balls = vec![[0, 0]; found.strips];
    for p in &found.points {
        let heights = balls.map(|b| b.height(p.position).abs());
        let nearest = usize::from(heights[1] < heights[0]);
        assert!(heights[nearest] < 0.03, "{heights:?} {p:?}");
        points_of_balls[p.strip][nearest] += 1;
    }
    assert!(points_of_balls.iter().all(|[a, b]| *a == 0 || *b == 0), "{points_of_balls:?}");
}

/// The hull of a ball in a ring of views is the ball. Views from one side leave a part of it unobserved.
#[test]
fn the_hull_reports_the_unobserved_share() {
    let around: Vec<Pinhole> = (0..24)
        .map(|k| {
            let a = std::f64::consts::TAU * f64::from(k) / 24.0;
            camera(DVec3::new(7.0 * a.cos(), 7.0 * a.sin(), 1.0), DVec3::ZERO)
        })
        .collect();
    let views = seen(&around, &BALL, 0.05);
    let bounds = planish_mesh::BoundingBox { min: DVec3::splat(-1.5), max: DVec3::splat(1.5) };
    let hull = VisualHull::new(&views, &bounds, 60).unwrap();
    let all = run(&views).unwrap();
    assert_eq!(all.rejected.get("end_of_sequence"), None);
    for p in &hull.mesh.positions {
        assert!(p.length() > 0.97 && p.length() < 1.25, "{}", p.length());
    }
    assert!(hull.holds(DVec3::new(0.0, 0.9, 0.0)) && !hull.holds(DVec3::new(0.0, 1.1, 0.0)));
    // Without one view the hull is larger, and depths inside of it do not decrease.
    let bound = SilhouetteBound::new(&views).unwrap();
    for p in hull.mesh.positions.iter().step_by(7) {
        assert!(bound.depth(*p).abs() < 0.1 && bound.depth_without_one(*p) >= bound.depth(*p), "{p:?}");
        let fewer = |rejected: usize| {
            let rest: Vec<ContourView> = (views.iter().enumerate())
                .filter(|(k, _)| *k != rejected)
                .map(|(_, view)| view.clone())
                .collect();
            SilhouetteBound::new(&rest).unwrap().depth(*p)
        };
        if p[0] > 1.0 {
            let largest = (0..views.len()).map(fewer).fold(f64::NEG_INFINITY, f64::max);
            assert!((bound.depth_without_one(*p) - largest).abs() < 1e-12, "{p:?}");
        }
    }
    let unseen = hull.unseen_share(&all.points);
    let few = run(&views[..6]).unwrap();
    let more = hull.unseen_share(&few.points);
    assert!(unseen < 0.25 && more > unseen + 0.3, "{unseen} {more}");
}

/// The mesh of an egg's strips is manifold and faces outwards; its error agrees with σ, and its depths are
/// more accurate than those of the points.
#[test]
fn strips_become_meshes_with_regularised_depths() {
    let cameras = arc(25, 4.0, 1.0);
    let found = run(&seen(&cameras, &EGG, 0.15)).unwrap();
    let (mut vertices, mut area) = (0, 0.0);
    for strip in 0..found.strips {
        let (mesh, sigma) = found.patch(strip).unwrap();
        let check = mesh.check();
        assert_eq!((check.nonmanifold_edges, check.components), (0, 1), "{check:?}");
        let off = rms(mesh.positions.iter().zip(&sigma).map(|(p, s)| EGG.height(*p) / s));
        assert!((0.6..1.3).contains(&off), "{off}");
        let normals = mesh.vertex_normals();
        assert!((normals.iter().zip(&mesh.positions)).all(|(n, p)| n.dot(EGG.normal(*p)) > 0.7));
        vertices += mesh.positions.len();
        area += mesh.area();
    }
    assert!(vertices as f64 > 0.95 * found.points.len() as f64 && area > 4.0, "{vertices} {area}");
    let error = |moved: bool| {
        rms((found.points.iter().zip(&found.relaxed)).map(|(p, relaxed)| {
            let at = if moved { *relaxed } else { p.position };
            depth_error(&EGG, &cameras[p.view], &OccludingPoint { position: at, ..*p })
        }))
    };
    assert!(error(true) < 0.85 * error(false), "{} {}", error(true), error(false));
}

#[test]
fn messages_name_the_invalid_value() {
    let views = seen(&arc(3, 5.0, 1.0), &BALL, 0.1);
    assert!(run(&views[..2]).unwrap_err().to_string().contains("three views"));
    let mut invalid = views.clone();
    invalid[1].sigma_px = 0.0;
    assert!(run(&invalid).unwrap_err().to_string().contains("view `view1`"));
    let options = OccludingOptions { half_window_px: -1.0, ..OccludingOptions::default() };
    let message = occluding_contours(&views, &options, &mut |_| Ok(())).unwrap_err().to_string();
    assert!(message.contains("window"), "{message}");
}
