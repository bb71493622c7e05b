//! The equations of all readings at one sharpness of the shell.
//!
//! In: parameters and poses. Out: the deformed mesh, and an equation for every reading.
//!
//! - A point: `D(x_i) = 0`, with variance `nᵀ Σ_i n` along the gradient (C eq. 9); in the last stage one such
//!   equation for each sheet near it ([`super::sheets`]).
//! - An outline point: `min_t D(o + t d) = 0`. At the minimum `∂D/∂t = 0`, so other derivatives of the
//!   minimum are those of `D` at its position (the envelope theorem). σ in pixels is converted to a distance
//!   by `|∂D/∂(x, y)|`.
//! - A pixel inside a mask must hit: the same minimum is an equation while its sign is wrong. A pixel outside
//!   must not hit: the surface that it hits is moved to the nearest border in the image.
//! - A track: [`super::tracks`].
//! - A landmark: [`super::landmarks`].

use super::equations::{ByVertex, Equations, SCALES, Source};
use super::landmarks;
use super::readings::{OutlineKind, OutlinePoint, ShellReadings};
use super::sheets::Sheets;
use super::sight::{DistanceSource, Sight, Touch};
use super::tracks;
use crate::camera::Camera;
use crate::deformation::{Deformation, displaced_positions};
use crate::field::{FacetShare, Shell, ShellOptions};
use nalgebra::DVector;
use planish_core::DVec3;
use planish_estimate::{Error, Loss, Result};
use planish_mesh::{MeshSearch, TriangleMesh};
use rayon::prelude::*;

/// Points and lines of sight per task: fixed, so that sums do not depend on the number of threads.
const POINTS: usize = 256;
const LINES: usize = 48;
/// Minimum of `|∂D/∂(x, y)|` as a share of the width of a pixel. Where the shell is nearly parallel to the
/// image the derivative vanishes, and without a floor the weight would be infinite.
const MIN_PIXEL_SLOPE: f64 = 0.3;
/// Derivatives of a reading are omitted if its weight is zero even with σ larger by this factor. The margin
/// covers changes of the factors of σ between iterations.
const OMISSION_MARGIN: f64 = 2.0;

/// The estimated quantities.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub q: DVector<f64>,
    pub cameras: Vec<Camera>,
}

/// The problem at one sharpness.
pub(super) struct Problem<'a> {
    pub mesh: &'a TriangleMesh,
    /// For each vertex of the subdivided mesh, its vertices and weights on the deformed mesh.
    pub origins: Option<&'a [[(u32, f64); 3]]>,
    pub triangles: &'a [[u32; 3]],
    pub deformation: &'a dyn Deformation,
    pub readings: &'a ShellReadings<'a>,
    pub shell: ShellOptions,
    /// For each view the index of its pose in the state, if the pose is uncertain.
    pub slots: &'a [Option<u32>],
    /// The points that are used, in this order.
    pub chosen: &'a [u32],
    /// True if each sheet near a point has its own equation.
    pub by_sheets: bool,
}

/// Loss and factors of σ, by which readings of zero weight are found: these need no derivatives.
#[derive(Clone, Copy)]
pub(super) struct WeightRule<'a> {
    pub loss: &'a Loss,
    pub factors: [f64; SCALES],
}

impl WeightRule<'_> {
    fn has_zero_weight(&self, source: Source, normalized: f64) -> bool {
        // Factors of σ may shrink before the equation is used, hence the margin.
        let factor = OMISSION_MARGIN * self.factors[source.scale()];
        source.loss(self.loss).weight(normalized / factor) <= 0.0
    }
}

/// Accumulates the derivatives of one equation by vertices.
#[derive(Default)]
struct Gathered {
    /// One more than the index of each vertex in `list`; zero if it is not in it.
    places: Vec<u32>,
    list: Vec<ByVertex>,
    sheets: Sheets,
}

impl Gathered {
    fn add(&mut self, vertex: u32, by: DVec3) {
        let v = vertex as usize;
        if v >= self.places.len() {
            self.places.resize(v + 1, 0);
        }
        if self.places[v] == 0 {
            self.list.push((vertex, DVec3::ZERO));
            self.places[v] = self.list.len() as u32;
        }
        self.list[self.places[v] as usize - 1].1 += by;
    }

    /// Returns the sums and resets the index.
    fn take(&mut self) -> &mut Vec<ByVertex> {
        for (vertex, _) in &self.list {
            self.places[*vertex as usize] = 0;
        }
        &mut self.list
    }
}

/// A task: a range of readings of one kind.
#[derive(Clone, Copy)]
enum Work {
    Points(usize, usize),
    Outline(usize, usize, usize),
    Inside(usize, usize, usize),
    Outside(usize, usize, usize),
    Tracks(usize, usize),
}

fn pieces(count: usize, each: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..count.div_ceil(each)).map(move |k| (k * each, ((k + 1) * each).min(count)))
}

impl Problem<'_> {
    /// The mesh of the deformation, moved.
    fn moved(&self, q: &DVector<f64>) -> TriangleMesh {
        TriangleMesh {
            positions: displaced_positions(&self.mesh.positions, self.deformation, q),
            triangles: self.mesh.triangles.clone(),
        }
    }

    /// The equations of all selected readings. With a `weighing`, points of zero weight have no derivatives
    /// ([`Equations::lack_derivatives`]).
    pub(super) fn equations(
        &self,
        state: &State,
        weighing: Option<WeightRule<'_>>,
    ) -> Result<Vec<Equations>> {
        let own = self.moved(&state.q);
        // Vertices of the subdivision are fixed linear combinations of those of the mesh, so derivatives are
        // passed on by the same weights.
        let subdivided = self.origins.map(|origins| TriangleMesh {
            positions: (origins.iter())
                .map(|origin| {
                    DVec3::from_array(std::array::from_fn(|k| {
                        origin.iter().map(|(v, w)| w * own.positions[*v as usize][k]).sum()
                    }))
                })
                .collect(),
            triangles: self.triangles.to_vec(),
        });
        let shell = Shell::new(subdivided.as_ref().unwrap_or(&own), &self.shell)?;
        let lines = self.readings.views.iter().any(|view| !view.outline.is_empty());
        let search = if lines { Some(MeshSearch::try_new(&own)?) } else { None };
        let bounds =
            own.surface_bounds().ok_or_else(|| Error::input("expected a mesh with vertices, found none"))?;
        let sight =
            search.as_ref().map(|search| Sight::new(&shell, search, &bounds, 1.0 / self.shell.sharpness));
        // One list of tasks for all kinds of readings keeps all threads busy to the end. `collect` keeps the
        // order.
        let mut work: Vec<Work> =
            pieces(self.chosen.len(), POINTS).map(|(a, b)| Work::Points(a, b)).collect();
        for (v, view) in self.readings.views.iter().enumerate().filter(|_| lines) {
            work.extend(pieces(view.outline.len(), LINES).map(|(a, b)| Work::Outline(v, a, b)));
            work.extend(pieces(view.inside.len(), LINES).map(|(a, b)| Work::Inside(v, a, b)));
            work.extend(pieces(view.outside.len(), LINES).map(|(a, b)| Work::Outside(v, a, b)));
        }
        work.extend(pieces(self.readings.tracks.len(), LINES).map(|(a, b)| Work::Tracks(a, b)));
        let mut all: Vec<Equations> = (work.into_par_iter())
            .map_init(Gathered::default, |gathered, work| {
                self.work(work, state, &shell, sight.as_ref(), weighing, gathered)
            })
            .collect();
        if !self.readings.landmarks.is_empty() {
            all.push(landmarks::equations(self.readings.landmarks, &own.positions, self.by_sheets));
        }
        Ok(all)
    }

    fn work(
        &self,
        work: Work,
        state: &State,
        shell: &Shell<'_>,
        sight: Option<&Sight<'_>>,
        weighing: Option<WeightRule<'_>>,
        gathered: &mut Gathered,
    ) -> Equations {
        let mut made = Equations::default();
        let mut shares = Vec::new();
        match (work, sight) {
            (Work::Points(a, b), _) => {
                for &i in &self.chosen[a..b] {
                    let point = &self.readings.points[i as usize];
                    let Some(found) = shell.distance(point.at, &mut shares) else {
                        continue;
                    };
                    if let Some(weighing) = weighing.filter(|_| self.by_sheets)
                        && self.point_by_sheets(i, shell, &shares, weighing, gathered, &mut made)
                    {
                        continue;
                    }
                    let residual = (found.distance, point.sigma(found.gradient));
                    if weighing.is_some_and(|w| w.has_zero_weight(Source::Point, residual.0 / residual.1)) {
                        made.push_without_derivatives(Source::Point, i, residual);
                        continue;
                    }
                    shell.by_vertices(point.at, &shares, &found, |v, by| {
                        self.for_each_vertex(v, by, |v, by| gathered.add(v, by))
                    });
                    made.push_distinct(Source::Point, i, residual, gathered.take(), &[]);
                }
            }
            (Work::Tracks(a, b), _) => {
                let map_derivative =
                    |vertex: u32, by: DVec3, to: &mut Vec<(u32, DVec3)>| self.map_derivative(vertex, by, to);
                for (i, track) in self.readings.tracks.iter().enumerate().take(b).skip(a) {
                    let cameras = (&state.cameras[..], self.slots);
                    // A track behind a camera, or seen from one direction only, has no equation at this
                    // state.
                    let _ =
                        tracks::add(track, i as u32, cameras, shell, &mut shares, &map_derivative, &mut made);
                }
            }
            (Work::Outline(v, a, b), Some(sight)) => {
                self.outline(v, (a, b), &state.cameras[v], sight, &mut shares, &mut made);
            }
            (Work::Inside(v, a, b), Some(sight)) => {
                let camera = &state.cameras[v];
                for pixel in &self.readings.views[v].inside[a..b] {
                    let (origin, direction) = (camera.center(), camera.direction(*pixel));
                    // A hit satisfies the inequality; only a miss is an equation.
                    if sight.search.first_hit(origin, direction).is_none() {
                        let found = sight.minimum(origin, direction, &mut shares);
                        if let Some(touch) = found.filter(|touch| touch.distance > 0.0) {
                            self.line(
                                Source::Region,
                                v,
                                0,
                                1.0,
                                camera,
                                &touch,
                                sight,
                                &mut shares,
                                &mut made,
                            );
                        }
                    }
                }
            }
            (Work::Outside(v, a, b), Some(sight)) => {
                for pixel in &self.readings.views[v].outside[a..b] {
                    self.beyond_mask(v, *pixel, &state.cameras[v], sight, &mut made);
                }
            }
            (_, None) => {}
        }
        made
    }

    /// Adds the equations of a point, one for each likely sheet. Returns false if no facet nearby has an
    /// area.
    fn point_by_sheets(
        &self,
        i: u32,
        shell: &Shell<'_>,
        shares: &[FacetShare],
        weighing: WeightRule<'_>,
        gathered: &mut Gathered,
        made: &mut Equations,
    ) -> bool {
        let point = &self.readings.points[i as usize];
        let factor = weighing.factors[Source::Point.scale()];
        // The mean σ of the point: the assignment to sheets needs a radius, and its direction is not known
        // yet.
        let mut sheets = std::mem::take(&mut gathered.sheets);
        sheets.find(shell, point.at, shares, factor * (point.covariance.trace() / 3.0).sqrt(), weighing.loss);
        let mut any = false;
        for (g, sheet) in sheets.likely() {
            any = true;
            let residual = (sheet.height, point.sigma(sheet.normal));
            if weighing.has_zero_weight(Source::Point, residual.0 / residual.1) {
                made.push_without_derivatives(Source::Point, i, residual);
            } else {
                sheets.by_vertices(g, shell, point.at, shares, |v, by| {
                    self.for_each_vertex(v, by, |v, by| gathered.add(v, by))
                });
                made.push_distinct(Source::Point, i, residual, gathered.take(), &[]);
            }
            made.set_last_probability(sheet.probability, sheet.log_ratio);
        }
        gathered.sheets = sheets;
        any
    }

    fn outline(
        &self,
        v: usize,
        (a, b): (usize, usize),
        camera: &Camera,
        sight: &Sight<'_>,
        shares: &mut Vec<FacetShare>,
        made: &mut Equations,
    ) {
        // Readings of outlines are numbered over all views.
        let before: usize = self.readings.views[..v].iter().map(|view| view.outline.len()).sum();
        for (i, place) in self.readings.views[v].outline.iter().enumerate().take(b).skip(a) {
            let (origin, direction) = (camera.center(), camera.direction(place.pixel));
            let found = match place.kind {
                OutlineKind::Border => sight.minimum(origin, direction, shares),
                // A line of sight on a contour may have several minima; the one with the smallest residual is
                // used.
                OutlineKind::Contour => (sight.minima(origin, direction, shares).into_iter())
                    .min_by(|a, b| a.distance.abs().total_cmp(&b.distance.abs())),
            };
            if let Some(touch) = found {
                let reading = (before + i) as u32;
                self.line(Source::Outline, v, reading, place.sigma_px, camera, &touch, sight, shares, made);
            }
        }
    }

    /// Adds equations for a pixel outside of a mask whose line of sight hits the mesh: the first and the last
    /// hit are moved to the nearest border in the image.
    ///
    /// The equation is `uᵀ(π(x) − b) = 0`, with `u` from the border point `b` to the pixel, and `x` moving
    /// with its facet. The depth of the line inside the mesh is not used instead: for a thin part that faces
    /// the camera it is half the thickness, whatever the distance to the rim.
    fn beyond_mask(
        &self,
        v: usize,
        pixel: [f64; 2],
        camera: &Camera,
        sight: &Sight<'_>,
        made: &mut Equations,
    ) {
        let (origin, direction) = (camera.center(), camera.direction(pixel));
        let Some(first) = sight.search.first_hit(origin, direction) else {
            return;
        };
        let off = |place: &OutlinePoint| [pixel[0] - place.pixel[0], pixel[1] - place.pixel[1]];
        let Some(off) = (self.readings.views[v].outline.iter())
            .filter(|place| place.kind == OutlineKind::Border)
            .map(off)
            .min_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])))
        else {
            return;
        };
        let away = off[0].hypot(off[1]);
        if away == 0.0 {
            return;
        }
        // The residual in pixels along the direction to the border.
        let along = off.map(|x| x / away);
        // Both the nearest and the farthest surface extend beyond the mask; moving only one would fold thin
        // objects.
        let last = sight.last_hit(origin, direction);
        for hit in [Some(first), last.filter(|last| last.triangle != first.triangle)].into_iter().flatten() {
            let gradient = camera.by_place(hit.point, along);
            let mut vertices: Vec<ByVertex> = (self.mesh.triangles[hit.triangle as usize].into_iter())
                .zip(hit.barycentric)
                .map(|(vertex, weight)| (vertex, weight * gradient))
                .collect();
            // The negative sign: a motion of the camera moves the image opposite to a motion of the mesh.
            let by_pose = self.slots[v].map(|slot| (slot, camera.by_pose(hit.point, gradient).map(|x| -x)));
            made.push(Source::Region, 0, (away, 1.0), &mut vertices, by_pose.as_slice());
        }
    }

    /// Adds the equation of one line of sight.
    #[allow(clippy::too_many_arguments, reason = "one call site of each kind of line")]
    fn line(
        &self,
        source: Source,
        view: usize,
        reading: u32,
        sigma_px: f64,
        camera: &Camera,
        touch: &Touch,
        sight: &Sight<'_>,
        shares: &mut Vec<FacetShare>,
        made: &mut Equations,
    ) {
        if camera.project(touch.at).is_none() {
            // This part of the mesh has moved behind the camera and is not visible.
            return;
        }
        let mut vertices = Vec::new();
        match &touch.source {
            DistanceSource::Foot(foot) => {
                let triangle = self.mesh.triangles[foot.triangle as usize];
                for (vertex, weight) in triangle.into_iter().zip(foot.barycentric) {
                    if weight != 0.0 {
                        vertices.push((vertex, -weight * touch.gradient));
                    }
                }
            }
            DistanceSource::Shell(sides) => {
                for (at, found, share) in sides.iter().filter(|(_, _, share)| *share > 0.0) {
                    // `shares` belongs to the last evaluated point, which may be another one.
                    if sight.shell.distance(*at, shares).is_some() {
                        (sight.shell).by_vertices(*at, shares, found, |v, by| {
                            self.map_derivative(v, *share * by, &mut vertices);
                        });
                    }
                }
            }
        }
        let [x, y] = camera.by_pixel(touch.at, touch.gradient);
        let pixel_width = camera.pixel_width(touch.at);
        // σ in pixels times the change of the distance per pixel. The floor handles lines of sight along the
        // surface, where that vanishes and the weight would be infinite.
        let sigma = sigma_px * x.hypot(y).max(MIN_PIXEL_SLOPE * pixel_width);
        let by_pose = self.slots[view].map(|slot| (slot, camera.by_pose(touch.at, touch.gradient)));
        made.push(source, reading, (touch.distance, sigma), &mut vertices, by_pose.as_slice());
    }

    /// Converts a derivative by a vertex of the wrapped mesh to derivatives by vertices of the deformed mesh.
    fn map_derivative(&self, vertex: u32, by: DVec3, to: &mut Vec<ByVertex>) {
        self.for_each_vertex(vertex, by, |vertex, by| to.push((vertex, by)));
    }

    fn for_each_vertex(&self, vertex: u32, by: DVec3, mut visit: impl FnMut(u32, DVec3)) {
        match self.origins {
            None => visit(vertex, by),
            Some(origins) => {
                for (v, w) in origins[vertex as usize].iter().filter(|(_, w)| *w != 0.0) {
                    visit(*v, by.map(|x| w * x));
                }
            }
        }
    }
}
