//! Reads an image of crossed stripes: points with normals and curvatures.
//!
//! In: an image and the calibration of camera, projector and pattern. Out: [`GridReadings`].
//!
//! | step | module |
//! |---|---|
//! | points on bright lines | ridges |
//! | crossings, angles and their covariance | crossings |
//! | neighbours along stripes | network |
//! | identification of the stripes | indexing |
//! | points, normals, curvatures | the module above |
//!
//! σ follows from the noise of the image and the contrast of each stripe. Texture of the object also moves
//! stripes, so σ is calibrated by the distances of crossings from their epipolar lines, which no unknown was
//! fitted to: one factor scales the covariances of all crossings. Shading and texture also bend stripes. The
//! chords between adjacent crossings show by how much, and one σ is added to all angles.

use std::collections::BTreeMap;

use planish_core::{DVec3, Pinhole};
use planish_estimate::{Error, Result};

use super::crossings::{Crossing, Crossings};
use super::indexing::{EpipolarLines, Indexed, MIN_KNOTS, index};
use super::network::pieces;
use super::pattern::StripePattern;
use super::ridges::{Ridges, sigma_of_brightness};
use super::{Junction, JunctionCovariance, Orientation, StripeCurvature, curvature, orientation};
use crate::{Image, PrincipalCurvatures, Scan, Viewing};

/// Crossings farther than this from their epipolar lines are rejected, in σ.
const GATE: f64 = 4.0;
/// Minimum number of crossings from which the factor on σ is estimated: the relative standard error of a σ
/// from 30 residuals is 13 %.
const MIN_CALIBRATION_CROSSINGS: usize = 30;
/// Limit of squared normalised residuals, and their mean under this limit for a normal distribution.
const MAX_SQUARE: f64 = 9.0;
const MEAN_SQUARE: f64 = 0.9875;

/// A camera and a projector of crossed stripes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridCamera {
    /// The camera.
    pub camera: Pinhole,
    /// The projector.
    pub projector: Pinhole,
    /// The projected pattern.
    pub pattern: StripePattern,
    /// σ of each image coordinate, in either image, that is not from the detection, such as of the
    /// calibration, in pixels.
    pub sigma_px: f64,
}

/// Options of [`read_grid`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridOptions {
    /// Smoothing scale in pixels: about half the width of a stripe.
    pub scale_px: f64,
}

impl Default for GridOptions {
    fn default() -> Self {
        Self { scale_px: 1.5 }
    }
}

/// Number of rejected bright spots by cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GridRejected {
    /// No two stripes cross there.
    pub no_crossing: usize,
    /// They belong to no piece of the net, or to one that is too small or whose stripes are ambiguous.
    pub no_index: usize,
    /// They are off their epipolar lines, or their stripes do not continue those of adjacent crossings.
    pub off_line: usize,
    /// They do not determine an orientation.
    pub undetermined: usize,
}

/// A crossing of the grid on the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridReading {
    /// Its pixel.
    pub image: [f64; 2],
    /// Indices of its stripes in both sets.
    pub stripes: [i32; 2],
    /// Point and normal, in the world frame of the calibration.
    pub orientation: Orientation,
    /// Curvature, if there are enough neighbours.
    pub curvature: Option<StripeCurvature>,
}

/// Readings of a surface from an image of crossed stripes.
#[derive(Debug, Clone, PartialEq)]
pub struct GridReadings {
    /// Crossings, in the order of the pieces and their stripes.
    pub readings: Vec<GridReading>,
    /// σ of each crossing: the root of the mean variance of its coordinates, in pixels.
    pub sigma_px: Vec<f64>,
    /// Estimated factor on the σ that follows from the image noise; `None` if there are too few crossings.
    pub enlarged: Option<f64>,
    /// Counts of rejected spots.
    pub rejected: GridRejected,
    /// The camera's centre.
    pub viewpoint: DVec3,
}

/// Finds the stripes in an image and computes points, normals and curvatures at their crossings.
///
/// `plain` is the same view without stripes. The image is divided by it, so that texture does not shift
/// stripes.
///
/// Cost: about 0.7 s for an image of 960 × 720 pixels.
///
/// # Errors
/// `Input` for an invalid pattern, scale or σ, and a plain image of a different size; `Undetermined` if no
/// crossing is identified.
pub fn read_grid(
    image: &Image,
    plain: Option<&Image>,
    grid: &GridCamera,
    options: &GridOptions,
) -> Result<GridReadings> {
    grid.pattern.sanity_check()?;
    check(options.scale_px, "scale of the stripes", 0.5, 20.0)?;
    check(grid.sigma_px, "sigma_px", f64::MIN_POSITIVE, 100.0)?;
    let divided = plain.map(|plain| divide(image, plain)).transpose()?;
    let image = divided.as_ref().unwrap_or(image);
    let lines = EpipolarLines::new(&grid.camera, &grid.projector)
        .ok_or_else(|| Error::input("expected matrices K that have an inverse"))?;
    let ridges = Ridges::new(image, options.scale_px);
    let crossings = Crossings::new(image, &ridges);
    let net = pieces(&crossings, &ridges);
    let indexed: Vec<Vec<Indexed>> =
        (net.iter()).filter_map(|piece| index(piece, &crossings.found, &lines, &grid.pattern)).collect();
    let identified: usize = indexed.iter().map(Vec::len).sum();
    if identified == 0 {
        return Err(Error::undetermined(format!(
            "expected connected pieces of at least {MIN_KNOTS} crossings that agree with the calibration, \
             found {} crossings whose stripes could not be identified",
            crossings.found.len()
        )));
    }
    let mut rejected = GridRejected {
        no_crossing: crossings.no_crossing,
        no_index: crossings.found.len() - identified,
        ..GridRejected::default()
    };
    let off_line = |k: &Indexed| Residual::of_line(&crossings.found[k.crossing], grid, &lines, k.stripes);
    // σ from the noise of the image misses texture; the distances from epipolar lines contain both, and
    // nothing was fitted to them.
    let by_noise = ridges.unit_sigma(sigma_of_brightness(image, bright(image)));
    let factor = calibrated(&indexed.iter().flatten().map(off_line).collect::<Vec<_>>());
    let unit = factor.unwrap_or(by_noise);
    let mut made = GridReadings {
        readings: Vec::new(),
        sigma_px: Vec::new(),
        enlarged: factor.map(|f| f / by_noise).filter(|f| f.is_finite()),
        rejected,
        viewpoint: grid.camera.center(),
    };
    // A crossing far from its epipolar line was misplaced, for example by a highlight. It is removed before
    // its neighbours' angles are compared with it.
    let near = |k: &&Indexed| off_line(k).normalised(unit) <= GATE * GATE;
    let identified_pieces: Vec<BTreeMap<[i32; 2], OrderedCrossing>> = (indexed.iter())
        .map(|piece| {
            let ordered =
                |k: &Indexed| (k.stripes, OrderedCrossing::new(&crossings.found[k.crossing], k.first, unit));
            piece.iter().filter(near).map(ordered).collect()
        })
        .collect();
    let both_sides = |piece: &BTreeMap<[i32; 2], OrderedCrossing>| -> Vec<Residual> {
        let all = piece.keys().flat_map(|at| off_chords(piece, *at));
        // Only crossings with neighbours on both sides: their residual contains the error of one angle, not
        // of two.
        all.flatten().filter(|r| r.scaled == 1.0).collect()
    };
    // Shading and texture bend stripes, which noise does not explain. Chords between neighbours measure that
    // in the image itself.
    let sigma_angle =
        calibrated(&identified_pieces.iter().flat_map(both_sides).collect::<Vec<_>>()).unwrap_or(0.0);
    for piece in &identified_pieces {
        let straight = |at: &[i32; 2]| {
            off_chords(piece, *at).iter().flatten().all(|r| r.normalised(sigma_angle) <= GATE * GATE)
        };
        let kept: BTreeMap<[i32; 2], &OrderedCrossing> =
            piece.iter().filter(|(at, _)| straight(at)).map(|(at, t)| (*at, t)).collect();
        rejected.undetermined += made.add_piece(&kept, sigma_angle, grid);
    }
    rejected.off_line = identified - made.readings.len() - rejected.undetermined;
    made.rejected = rejected;
    if made.readings.is_empty() {
        return Err(Error::undetermined(
            "expected crossings of stripes that determine an orientation, found none",
        ));
    }
    Ok(made)
}

fn check(value: f64, name: &str, low: f64, high: f64) -> Result<()> {
    match value >= low && value <= high {
        true => Ok(()),
        false => {
            Err(Error::input(format!("expected a {name} from {low:e} to {high} pixels, found {value:e}")))
        }
    }
}

/// Brightness divided by that of the plain image, in the scale of the image; zero where the plain one is
/// nearly black.
fn divide(image: &Image, plain: &Image) -> Result<Image> {
    if (image.columns, image.rows) != (plain.columns, plain.rows) {
        return Err(Error::input(format!(
            "expected a plain image of the same {} × {} pixels, found {} × {}",
            image.columns, image.rows, plain.columns, plain.rows
        )));
    }
    // Division instead of subtraction: the reflectance multiplies the light of the stripes.
    let white = plain.values.iter().fold(0.0_f32, |a, b| a.max(*b));
    // Below this share of white, the quotient would be noise.
    let minimum = 0.04 * white;
    let ratio =
        (image.values.iter().zip(&plain.values)).map(|(i, p)| if *p > minimum { i * white / p } else { 0.0 });
    Image::try_new(image.columns, image.rows, ratio.collect())
}

/// A fifth of the 99th percentile of the brightness.
fn bright(image: &Image) -> f32 {
    let mut values = image.values.clone();
    let k = values.len() * 99 / 100;
    let (_, v, _) = values.select_nth_unstable_by(k.min(image.values.len() - 1), f32::total_cmp);
    0.2 * *v
}

/// A residual whose variance is `known + x² scaled`, with one x for all.
#[derive(Debug, Clone, Copy)]
struct Residual {
    square: f64,
    known: f64,
    scaled: f64,
}

impl Residual {
    /// Distance of a crossing to its epipolar line; x is the σ of places of strength one.
    fn of_line(crossing: &Crossing, grid: &GridCamera, lines: &EpipolarLines, stripes: [i32; 2]) -> Self {
        let line = lines.line(grid.pattern.crossing(stripes.map(f64::from)));
        let line = line.unwrap_or(DVec3::INFINITY);
        let DVec3 { x: a, y: b, .. } = line;
        let [x, y] = crossing.image;
        let s = &crossing.covariance;
        Self {
            square: line.dot(DVec3::new(x, y, 1.0)).powi(2),
            // For both images.
            known: 2.0 * grid.sigma_px.powi(2),
            scaled: a * a * s[0][0] + 2.0 * a * b * s[0][1] + b * b * s[1][1],
        }
    }

    fn normalised(&self, x: f64) -> f64 {
        self.square / (self.known + x * x * self.scaled)
    }
}

/// The x for which the residuals have the expected size; `None` for too few residuals.
fn calibrated(residuals: &[Residual]) -> Option<f64> {
    if residuals.len() < MIN_CALIBRATION_CROSSINGS {
        return None;
    }
    let mean = |x: f64| {
        // Truncated squares, so that few wrong indices do not enlarge σ.
        residuals.iter().map(|r| r.normalised(x).min(MAX_SQUARE)).sum::<f64>() / residuals.len() as f64
    };
    // The mean decreases with x, so bisection (in logarithms) finds the root.
    let strength = residuals.iter().map(|r| r.scaled).sum::<f64>() / residuals.len() as f64;
    let (mut low, mut high) = (1e-5 / strength.sqrt(), 10.0 / strength.sqrt());
    for _ in 0..60 {
        let middle = (low * high).sqrt();
        if mean(middle) > MEAN_SQUARE { low = middle } else { high = middle }
    }
    Some((low * high).sqrt())
}

/// A crossing with its stripes in order.
struct OrderedCrossing {
    image: [f64; 2],
    angles_rad: [f64; 2],
    /// Covariance of x, y and both angles due to the noise of the image.
    covariance: [[f64; 4]; 4],
}

impl OrderedCrossing {
    fn new(crossing: &Crossing, first: usize, unit: f64) -> Self {
        // Stripes in the order of the projector's sets, whatever their order in the image.
        let order = [first, 1 - first];
        let entry = [0, 1, 2 + order[0], 2 + order[1]];
        Self {
            image: crossing.image,
            angles_rad: order.map(|s| crossing.angles_rad[s]),
            covariance: entry.map(|i| entry.map(|j| unit * unit * crossing.covariance[i][j])),
        }
    }

    /// Variance of a coordinate of its position.
    fn place(&self) -> f64 {
        0.5 * (self.covariance[0][0] + self.covariance[1][1])
    }
}

/// The deviation of each stripe's angle at a crossing from the chords to the adjacent crossings on the
/// stripe.
///
/// On a parabola, the chord between the two neighbours has the slope of the middle, and the chord to one
/// neighbour has the mean slope of both ends. x is the σ of an angle that is not due to noise.
fn off_chords(piece: &BTreeMap<[i32; 2], OrderedCrossing>, at: [i32; 2]) -> [Option<Residual>; 2] {
    let own = &piece[&at];
    [0, 1].map(|set| {
        // Along a stripe of one set, the index of the other set changes.
        let neighbour =
            |by: i32| piece.get(&if set == 0 { [at[0], at[1] + by] } else { [at[0] + by, at[1]] });
        let chord = |a: &OrderedCrossing, b: &OrderedCrossing| {
            let d = [b.image[0] - a.image[0], b.image[1] - a.image[1]];
            (d[1].atan2(d[0]), (a.place() + b.place()) / (d[0] * d[0] + d[1] * d[1]))
        };
        let angle = own.angles_rad[set];
        let variance = own.covariance[2 + set][2 + set];
        let (off, known, scaled) = match (neighbour(-1), neighbour(1)) {
            (Some(a), Some(b)) => {
                let (slope, of_chord) = chord(a, b);
                (half_turn(angle - slope), variance + of_chord, 1.0)
            }
            (Some(other), None) | (None, Some(other)) => {
                let (slope, of_chord) = chord(own, other);
                let other_angle = half_turn(other.angles_rad[set] - slope);
                let of_other = other.covariance[2 + set][2 + set];
                // On a circular arc, the angles to the chord at both ends are opposite and cancel.
                (half_turn(angle - slope) + other_angle, variance + of_other + 4.0 * of_chord, 2.0)
            }
            (None, None) => return None,
        };
        Some(Residual { square: off * off, known, scaled })
    })
}

/// The angle between two lines, from −π/2 to π/2.
fn half_turn(angle: f64) -> f64 {
    let turned = angle.rem_euclid(std::f64::consts::PI);
    if turned > std::f64::consts::FRAC_PI_2 { turned - std::f64::consts::PI } else { turned }
}

impl GridReadings {
    /// Adds a piece of the net. Returns the number of its crossings that do not determine an orientation.
    fn add_piece(
        &mut self,
        piece: &BTreeMap<[i32; 2], &OrderedCrossing>,
        sigma_angle: f64,
        grid: &GridCamera,
    ) -> usize {
        let mut found: BTreeMap<[i32; 2], (Orientation, [f64; 2], f64)> = BTreeMap::new();
        for (stripes, crossing) in piece {
            let junction = Junction {
                image: crossing.image,
                angles_rad: crossing.angles_rad,
                projector: grid.pattern.crossing(stripes.map(f64::from)),
            };
            let mut image = crossing.covariance;
            (0..2).for_each(|i| image[i][i] += grid.sigma_px.powi(2));
            (2..4).for_each(|i| image[i][i] += sigma_angle.powi(2));
            let covariance = JunctionCovariance { image, projector_px: grid.sigma_px };
            let directions = grid.pattern.directions();
            if let Ok(made) = orientation(&grid.camera, &grid.projector, directions, &junction, &covariance) {
                let sigma = (0.5 * (image[0][0] + image[1][1])).sqrt();
                found.insert(*stripes, (made, crossing.image, sigma));
            }
        }
        for (at, (made, image, sigma)) in &found {
            let pairs: Vec<[Orientation; 2]> = [[1, 0], [0, 1], [1, 1], [1, -1]]
                .into_iter()
                // Both diagonals as well: two directions do not determine the mixed component of curvature.
                .filter_map(|[a, b]| {
                    let other = |s: i32| found.get(&[at[0] + s * a, at[1] + s * b]).map(|f| f.0);
                    Some([other(1)?, other(-1)?])
                })
                .collect();
            self.readings.push(GridReading {
                image: *image,
                stripes: *at,
                orientation: *made,
                curvature: curvature(made, &pairs).ok(),
            });
            self.sigma_px.push(*sigma);
        }
        piece.len() - found.len()
    }

    /// The readings as a scan: points with covariance, normals with σ, and curvatures, with a direction of
    /// zero where there are none.
    #[must_use]
    pub fn scan(&self, name: &str) -> Scan {
        let orientation_of = |r: &GridReading| r.orientation;
        let curvatures = self.readings.iter().map(|r| {
            r.curvature.map_or(PrincipalCurvatures { values: [0.0; 2], direction: DVec3::ZERO }, |c| {
                PrincipalCurvatures { values: [c.k1, c.k2], direction: c.d1 }
            })
        });
        Scan {
            name: name.to_owned(),
            points: self.readings.iter().map(|r| orientation_of(r).point).collect(),
            covariance: Some(self.readings.iter().map(|r| orientation_of(r).covariance).collect()),
            normals: Some(self.readings.iter().map(|r| orientation_of(r).normal).collect()),
            sigma_normal_deg: Some(
                self.readings.iter().map(|r| orientation_of(r).sigma_normal_deg).collect(),
            ),
            curvatures: Some(curvatures.collect()),
            // A σ is wanted above zero even where nothing is known.
            sigma_curvature: Some(
                self.readings.iter().map(|r| r.curvature.map_or(1.0, |c| c.sigma)).collect(),
            ),
            viewing: Viewing::Origin(self.viewpoint),
            ..Scan::default()
        }
    }
}
