//! Terrain rasters: the height of a sheet and its vertical σ at the middle of every cell of a grid.
//!
//! Input: a model of a sheet with one height over every `(x, y)`, its posterior, and a cell size. Output: a
//! [`HeightGrid`], which [`planish_exchange::geotiff`] writes. Cells whose middle lies on an unmeasured leaf
//! are empty, and so are those whose σ exceeds [`MAX_MEDIANS`] times the median: a large leaf with readings
//! at one end is known from the prior only at the other.
//!
//! At each `(x, y)` Newton's method solves `S_x(u, v) = x, S_y(u, v) = y`. The surface moves along its
//! normal `n` by `σ`, so at that `(x, y)` it moves by `σ_z = σ / |n_z|`.
//!
//! Not guaranteed: σ of detail smaller than a cell; errors of the map position beyond those that the fit
//! knew.

use crate::model::sigmas_along;
use crate::model::{Observed, Posterior, SurfaceModel};
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::geotiff::{HeightGrid, NODATA};
use planish_exchange::{GeoReference, Unit};
use planish_spline::{Shape, Surface};
use rayon::prelude::*;

/// Largest number of cells of a raster: three gigabytes before compression.
pub const MAX_CELLS: f64 = 4e8;

/// Largest σ of a height, in medians of all σ. Heights above it are extrapolation by the prior. See decision
/// 0040.
pub const MAX_MEDIANS: f64 = 30.0;

/// Largest share of cells under an overhang. They are left empty; more of them refuse the raster.
const MAX_OVERHANGS: f64 = 0.01;

/// A raster with its findings.
#[derive(Debug, Clone, PartialEq)]
pub struct Dem {
    /// The raster.
    pub grid: HeightGrid,
    /// Number of cells with a height.
    pub known: usize,
    /// What a user should know.
    pub findings: Vec<Finding>,
}

/// Heights of a sheet on a grid of squares of side `cell`.
///
/// The default side is approximately the spacing of the readings, rounded down to 1, 2 or 5 times a power of
/// ten. Borders of cells are multiples of their side, so that rasters of neighbouring tiles fit together.
///
/// Cost: two or three jets for each cell, and one covariance for each leaf.
///
/// # Errors
/// `Input` for a shape other than a sheet, for a sheet with overhangs, and for a cell that is not positive or
/// gives more than [`MAX_CELLS`] cells; `Undetermined` if nothing was measured.
///
/// # Examples
/// ```
/// use planish_surface::export::dem_from_model;
/// use planish_surface::test_support::small_model;
/// let model = small_model(planish_spline::Shape::Sheet);
/// let dem = dem_from_model(&model, &model.posterior()?, Some(0.1), None)?;
/// assert!(dem.known > 0 && dem.known <= dem.grid.columns * dem.grid.rows);
/// # Ok::<(), planish_core::Error>(())
/// ```
pub fn dem_from_model(
    model: &SurfaceModel,
    posterior: &Posterior<'_>,
    cell: Option<f64>,
    georeference: Option<GeoReference>,
) -> Result<Dem> {
    check_input(model, cell)?;
    let extent = Extent::of_measured_leaves(&model.surface, &model.observed)?;
    let cell = cell.unwrap_or_else(|| round_down((extent.area / model.observations.max(1) as f64).sqrt()));
    let layout = Layout::new(&extent, cell)?;
    let places = places_under_cells(model, &layout, &extent.map);
    let found = places.len();
    let places = without_overhangs(places, &extent.map)?;
    let overhangs = found - places.len();
    let (values, known) = values_of_cells(posterior, &layout, &places)?;
    Ok(Dem {
        grid: HeightGrid {
            corner: [layout.first[0] * cell, (layout.first[1] + layout.rows as f64) * cell],
            cell,
            columns: layout.columns,
            rows: layout.rows,
            values,
            unit: model.unit,
            georeference,
        },
        known,
        findings: findings_of_cells(overhangs, found, cell, model.unit),
    })
}

/// Rejects a model that is not a sheet, and a cell size that is not positive.
fn check_input(model: &SurfaceModel, cell: Option<f64>) -> Result<()> {
    let space = model.surface.space();
    if space.shape() != Some(Shape::Sheet) {
        let found = space.shape().map_or("surface", Shape::name);
        return Err(Error::input(format!("a raster of heights: expected a sheet, found a {found}"))
            .with_setting(Setting::Shape));
    }
    if let Some(cell) = cell.filter(|c| !(c.is_finite() && *c > 0.0)) {
        return Err(Error::input(format!("expected a cell size > 0, found {cell}")));
    }
    Ok(())
}

/// The cells of a raster.
struct Layout {
    cell: f64,
    /// West and south borders, in cells from the origin of the map.
    first: [f64; 2],
    columns: usize,
    rows: usize,
}

impl Layout {
    /// The smallest raster around the measured part of the sheet whose borders are multiples of `cell`.
    fn new(extent: &Extent, cell: f64) -> Result<Self> {
        let first = extent.low.map(|c| (c / cell).floor());
        let [columns, rows] = [0, 1].map(|d| ((extent.high[d] / cell).ceil() - first[d]).max(1.0));
        if columns * rows > MAX_CELLS {
            return Err(Error::input(format!(
                "a raster of heights: expected at most {MAX_CELLS:e} cells, found {columns} × {rows} of \
                 {cell}; choose a larger cell size"
            ))
            .with_setting(Setting::CellSize));
        }
        Ok(Self { cell, first, columns: columns as usize, rows: rows as usize })
    }

    /// The middle of a cell; rows count from the north.
    fn middle(&self, column: usize, row: usize) -> [f64; 2] {
        let x = (self.first[0] + column as f64 + 0.5) * self.cell;
        let y = (self.first[1] + (self.rows - row) as f64 - 0.5) * self.cell;
        [x, y]
    }
}

/// The measured surface points at the middles of the cells, row by row.
fn places_under_cells(model: &SurfaceModel, layout: &Layout, map: &AffineMap) -> Vec<Place> {
    let surface = &model.surface;
    // Rows are independent: a start never comes from another row, so threads do not change the result.
    let lines: Vec<Vec<Place>> = (0..layout.rows)
        .into_par_iter()
        .map(|row| {
            let mut guess = None;
            (0..layout.columns)
                .filter_map(|column| {
                    let at = layout.middle(column, row);
                    // The neighbouring cell is the best start; the affine map helps where there is none.
                    let place = guess
                        .and_then(|from| place_under(surface, at, from))
                        .or_else(|| place_under(surface, at, map.parameters(at)));
                    // Unmeasured places are no cells of the raster, but they are good starts for their
                    // neighbours.
                    guess = place.as_ref().map(|p| p.parameters);
                    place
                        .filter(|p| model.observed_at(p.leaf as usize, p.local).is_measured())
                        .map(|p| Place { cell: row * layout.columns + column, ..p })
                })
                .collect()
        })
        .collect();
    lines.into_iter().flatten().collect()
}

/// The places where the sheet faces the same side as most of it.
///
/// # Errors
/// `Input` if too many places face the other side, or if the whole sheet is vertical.
fn without_overhangs(mut places: Vec<Place>, map: &AffineMap) -> Result<Vec<Place>> {
    let found = places.len();
    let up = places.iter().filter(|p| p.normal[2] > 0.0).count();
    // Normals of a sheet may point down as a whole; the majority decides.
    let side = if 2 * up >= found { 1.0 } else { -1.0 };
    places.retain(|p| p.normal[2] * side > 0.0);
    let overhangs = found - places.len();
    // If no place was found at all, either the sheet is vertical, which is refused, or cells are too large,
    // which is a finding.
    if overhangs as f64 > MAX_OVERHANGS * found as f64 || (found == 0 && map.is_upright()) {
        return Err(Error::input(format!(
            "a raster of heights: expected a sheet with one height at each point, found vertical or \
             overhanging parts in {overhangs} of {found} cells; z must point upwards"
        )));
    }
    Ok(places)
}

/// Height and vertical σ of every cell, and the number of cells that have both.
fn values_of_cells(
    posterior: &Posterior<'_>,
    layout: &Layout,
    places: &[Place],
) -> Result<(Vec<[f32; 2]>, usize)> {
    let leaves: Vec<u32> = places.iter().map(|p| p.leaf).collect();
    let local: Vec<[f64; 2]> = places.iter().map(|p| p.local).collect();
    let normals: Vec<DVec3> = places.iter().map(|p| p.normal).collect();
    let sigmas = sigmas_along(posterior, &leaves, &local, &normals)?;
    let mut values = vec![[NODATA; 2]; layout.columns * layout.rows];
    let vertical: Vec<f64> = places.iter().zip(&sigmas).map(|(p, s)| s / p.normal[2].abs()).collect();
    let mut sorted = vertical.clone();
    sorted.sort_by(f64::total_cmp);
    // The median, because the σ of extrapolated cells would raise a mean above themselves.
    let max_sigma = sorted.get(sorted.len() / 2).map_or(0.0, |median| MAX_MEDIANS * median);
    let mut known = 0;
    for (place, sigma) in places.iter().zip(vertical).filter(|(_, sigma)| *sigma <= max_sigma) {
        values[place.cell] = [place.height as f32, sigma as f32];
        known += 1;
    }
    Ok((values, known))
}

/// Findings about cells without a height: `overhangs` of `found` cells are under an overhang.
fn findings_of_cells(overhangs: usize, found: usize, cell: f64, unit: Unit) -> Vec<Finding> {
    let mut findings = Vec::new();
    if overhangs > 0 {
        let text = format!(
            "{overhangs} of {found} cells of the raster are under an overhang of the sheet: they have no \
             height"
        );
        findings.push(Finding::new(FindingCode::RasterOverhangs, text));
    }
    if found == 0 {
        let text = format!("no cell of the raster has a height: its cells of {cell} {unit} are too large");
        findings.push(Finding::new(FindingCode::RasterEmpty, text).with_setting(Setting::CellSize));
    }
    findings
}

/// The surface point at the middle of a cell.
struct Place {
    cell: usize,
    parameters: [f64; 2],
    leaf: u32,
    local: [f64; 2],
    normal: DVec3,
    height: f64,
}

/// The surface point at `(x, y)`, by Newton's method from the given parameters; none if the search leaves the
/// sheet.
fn place_under(surface: &Surface, [x, y]: [f64; 2], from: [f64; 2]) -> Option<Place> {
    /// Maximum number of steps, and length of the last step, in sides of a leaf.
    const STEPS: usize = 12;
    const MAX_LAST_STEP: f64 = 1e-6;
    let space = surface.space();
    let extent = space.extent();
    let inside = |q: [f64; 2]| [0, 1].map(|d| q[d].clamp(0.0, extent[d]));
    let mut at = inside(from);
    for _ in 0..STEPS {
        let (leaf, local) = space.locate(at[0], at[1]);
        let jet = surface.leaf_jet(leaf, local[0], local[1]);
        let [rx, ry] = [x - jet.point[0], y - jet.point[1]];
        // Cramer's rule: where the sheet is vertical, the determinant is zero and the step is not finite.
        let determinant = jet.du[0] * jet.dv[1] - jet.du[1] * jet.dv[0];
        let step = [
            (rx * jet.dv[1] - ry * jet.dv[0]) / determinant,
            (ry * jet.du[0] - rx * jet.du[1]) / determinant,
        ];
        if !(step[0].is_finite() && step[1].is_finite()) {
            return None;
        }
        let side = space.leaves()[leaf].side();
        let longest = step[0].abs().max(step[1].abs());
        if longest < MAX_LAST_STEP * side {
            return Some(Place {
                cell: 0,
                parameters: at,
                leaf: leaf as u32,
                local,
                normal: jet.normal()?,
                // The last step is added to first order; its square is negligible.
                height: jet.point[2] + jet.du[2] * step[0] + jet.dv[2] * step[1],
            });
        }
        // A few leaves at most, since the linearisation is local.
        let share = (4.0 * side / longest).min(1.0);
        let next = inside([0, 1].map(|d| at[d] + share * step[d]));
        // The clamp has stopped the step: the place lies beyond the border of the sheet.
        if next == at {
            return None;
        }
        at = next;
    }
    None
}

/// The measured part of a sheet, and an approximate map from `(x, y)` to its parameters.
struct Extent {
    low: [f64; 2],
    high: [f64; 2],
    /// Measured area, projected on the ground plane.
    area: f64,
    map: AffineMap,
}

/// `(u, v) ≈ A (x, y) + b`.
struct AffineMap {
    middle: [f64; 2],
    parameters: [f64; 2],
    inverse: Option<[[f64; 2]; 2]>,
}

impl AffineMap {
    fn parameters(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [dx, dy] = [x - self.middle[0], y - self.middle[1]];
        let [u, v] = self.parameters;
        self.inverse.map_or([u, v], |m| [u + m[0][0] * dx + m[0][1] * dy, v + m[1][0] * dx + m[1][1] * dy])
    }

    /// True if the sheet as a whole is vertical.
    fn is_upright(&self) -> bool {
        self.inverse.is_none()
    }
}

impl Extent {
    fn of_measured_leaves(surface: &Surface, observed: &[Observed]) -> Result<Self> {
        let (mut low, mut high, mut area) = ([f64::MAX; 2], [f64::MIN; 2], 0.0);
        for leaf in (0..observed.len()).filter(|&leaf| observed[leaf].is_measured()) {
            // Corners, middles of sides and the centre, since a border may bulge between the corners.
            for k in 0..9 {
                let [s, t] = [k % 3, k / 3].map(|c| 0.5 * f64::from(c));
                let p = surface.leaf_point(leaf, s, t);
                for d in 0..2 {
                    low[d] = low[d].min(p[d]);
                    high[d] = high[d].max(p[d]);
                }
            }
            let jet = surface.leaf_jet(leaf, 0.5, 0.5);
            let side = surface.space().leaves()[leaf].side();
            // One jet for each leaf is enough: the area sets the default cell only, which is rounded.
            area += (jet.du[0] * jet.dv[1] - jet.du[1] * jet.dv[0]).abs() * side * side;
        }
        if low[0] > high[0] {
            return Err(Error::undetermined("a raster of heights: no part of the surface was measured"));
        }
        let extent = surface.space().extent();
        let parameters = extent.map(|e| 0.5 * e);
        // Differences over most of the sheet give its average direction, whatever it does locally.
        let across = |du: f64, dv: f64| {
            let [a, b] = [-0.4, 0.4].map(|s| {
                surface.point(parameters[0] + s * du * extent[0], parameters[1] + s * dv * extent[1])
            });
            [0, 1].map(|d| (b[d] - a[d]) / (0.8 * (du * extent[0] + dv * extent[1])))
        };
        let (du, dv) = (across(1.0, 0.0), across(0.0, 1.0));
        let determinant = du[0] * dv[1] - du[1] * dv[0];
        let scale = du[0].hypot(du[1]).max(dv[0].hypot(dv[1]));
        let middle = surface.point(parameters[0], parameters[1]);
        Ok(Self {
            low,
            high,
            area,
            map: AffineMap {
                middle: [middle[0], middle[1]],
                parameters,
                // The bound is relative, because the determinant scales with the square of the unit.
                inverse: (determinant.abs() > 1e-6 * scale * scale).then(|| {
                    [[dv[1] / determinant, -dv[0] / determinant], [-du[1] / determinant, du[0] / determinant]]
                }),
            },
        })
    }
}

/// The largest number of the form 1, 2 or 5 times a power of ten that is at most `length`.
fn round_down(length: f64) -> f64 {
    if !(length.is_finite() && length > 0.0) {
        return 1.0;
    }
    let power = 10_f64.powi(length.log10().floor() as i32);
    // Logarithm and division may fall short of a whole digit by rounding: 5 must stay 5.
    let digits = length / power * (1.0 + 1e-12);
    [5.0, 2.0].into_iter().find(|d| digits >= *d).unwrap_or(1.0) * power
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{model_of, refined_surface, small_model};
    use planish_spline::{FootPointSearch, ProjectionOptions};

    /// A hilly sheet over a square of side 2 and 1.6 about a place of a map.
    fn hills(place: [f64; 2], observed: impl Fn(usize) -> bool) -> SurfaceModel {
        let flat = refined_surface(Shape::Sheet);
        let vertices = (flat.vertices().iter())
            .map(|p| DVec3::new(p[0] + place[0], p[1] + place[1], 0.3 * (3.0 * p[0]).sin() * p[1]))
            .collect();
        model_of(flat.with_vertices(vertices).unwrap(), observed)
    }

    #[test]
    fn heights_match_the_surface_and_sigma_is_vertical() {
        let model = hills([0.0; 2], |_| true);
        let posterior = model.posterior().unwrap();
        let dem = dem_from_model(&model, &posterior, Some(0.05), None).unwrap();
        let grid = &dem.grid;
        assert!(dem.findings.is_empty() && dem.known > grid.values.len() / 2);
        let search = FootPointSearch::new(&model.surface, 4, 0.0).unwrap();
        for (at, [height, sigma]) in grid.values.iter().enumerate().filter(|(_, v)| v[0] != NODATA).step_by(7)
        {
            let x = grid.corner[0] + (0.5 + (at % grid.columns) as f64) * grid.cell;
            let y = grid.corner[1] - (0.5 + (at / grid.columns) as f64) * grid.cell;
            let p = DVec3::new(x, y, f64::from(*height));
            let foot =
                (model.surface).project(p, search.nearest(p, DVec3::ZERO), &ProjectionOptions::default());
            assert!(foot.height.abs() < 1e-6 && foot.slip < 1e-5, "{p:?}");
            let along =
                Posterior::sigma_along(&posterior.leaf(foot.leaf as usize).unwrap(), foot.local, foot.normal);
            let vertical = along / foot.normal[2].abs();
            assert!((f64::from(*sigma) / vertical - 1.0).abs() < 1e-3, "{sigma} {vertical}");
        }
    }

    #[test]
    fn a_map_offset_moves_the_grid_only() {
        let plain = hills([0.0; 2], |_| true);
        // A multiple of the cell, and a cell of which the sheet's sides are none: rounding moves no border.
        let offset = hills([600_000.0, 3_999_999.0], |_| true);
        let [a, b] = [plain, offset]
            .map(|m| dem_from_model(&m, &m.posterior().unwrap(), Some(0.1875), None).unwrap().grid);
        assert_eq!(b.corner, [a.corner[0] + 600_000.0, a.corner[1] + 3_999_999.0]);
        for (a, b) in a.values.iter().zip(&b.values) {
            assert!((a[0] - b[0]).abs() < 1e-4, "{a:?} {b:?}");
        }
    }

    #[test]
    fn unmeasured_cells_have_no_height() {
        let all = hills([0.0; 2], |_| true);
        let some = hills([0.0; 2], |leaf| leaf % 2 == 0);
        let [all, some] =
            [all, some].map(|m| dem_from_model(&m, &m.posterior().unwrap(), Some(0.02), None).unwrap().known);
        assert!((0.3..0.7).contains(&(some as f64 / all as f64)), "{some} of {all}");
    }

    #[test]
    fn other_shapes_and_vertical_sheets_are_refused() {
        let refused = |model: &SurfaceModel, cell| {
            dem_from_model(model, &model.posterior().unwrap(), cell, None).unwrap_err().to_string()
        };
        assert!(refused(&small_model(Shape::Ball), None).contains("expected a sheet, found a ball"));
        let flat = refined_surface(Shape::Sheet);
        let upright = flat.vertices().iter().map(|p| DVec3::new(p[0], p[2], p[1])).collect();
        let upright = model_of(flat.with_vertices(upright).unwrap(), |_| true);
        assert!(refused(&upright, Some(0.1)).contains("one height at each point"));
        let rolled = (flat.vertices().iter())
            .map(|p| DVec3::new(p[1], (3.0 * p[0]).sin(), (3.0 * p[0]).cos()))
            .collect();
        let rolled = model_of(flat.with_vertices(rolled).unwrap(), |_| true);
        assert!(
            refused(&rolled, Some(0.02)).contains("overhanging parts"),
            "{}",
            refused(&rolled, Some(0.02))
        );
        assert!(refused(&hills([0.0; 2], |_| true), Some(1e-6)).contains("a larger cell size"));
        assert!(refused(&hills([0.0; 2], |_| true), Some(-1.0)).contains("cell size > 0"));
    }

    #[test]
    fn default_cells_have_the_spacing_of_the_readings() {
        let model = hills([0.0; 2], |_| true);
        let dem = dem_from_model(&model, &model.posterior().unwrap(), None, None).unwrap();
        let spacing = (2.0 * 1.6 / model.observations as f64).sqrt();
        assert!(
            dem.grid.cell <= 2.5 * spacing && dem.grid.cell > 0.2 * spacing,
            "{} {spacing}",
            dem.grid.cell
        );
        assert_eq!([0.99, 1.0, 4.9, 5.0, 73.0].map(round_down), [0.5, 1.0, 2.0, 5.0, 50.0]);
    }
}
