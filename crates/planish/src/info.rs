//! Describes the contents of a file.
//!
//! Input: a scan, a list of scans, a height map, a mesh, a STEP file, or a saved model. Output: [`FileInfo`].
//! The whole file is read, not only the header, so that truncated and malformed files are detected.

use planish_core::finding::with_warnings;
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::{PolygonMesh, read_mesh};
use planish_exchange::ply::read_contents;
use planish_exchange::step::read_step;
use planish_exchange::{
    FileKind, PosedScan, ScanSet, Unit, extension, read_inputs, recover_outputs_in_folder_of,
};
use planish_mesh::{BoundingBox, DeviationStatistics, TriangleMesh};
use planish_sense::{Noise, RangeGrid, Scan, Viewing};
use planish_surface::export::sigma_summary;
use planish_surface::fit::SigmaSummary;
use planish_surface::model::{Observed, ScanPoseReport, SensorReport, SurfaceTopology};
use planish_surface::saved::{SavedModel, Session, load_with_provenance};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Contents of a file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FileInfo {
    /// Unit of every length, if known.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Every file that was read: the file itself, and those that it names.
    #[serde(skip)]
    pub files: Vec<PathBuf>,
    /// The contents.
    #[serde(flatten)]
    pub contents: Contents,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

/// The contents of a file.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Contents {
    /// Points of one sensor from one pose.
    Scan(ScanInfo),
    /// A list of scans.
    Scans(ScanListInfo),
    /// Triangles.
    Mesh(MeshInfo),
    /// A saved model.
    Model(Box<ModelInfo>),
}

/// The box around points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BoxInfo {
    /// Smallest coordinates.
    pub min: DVec3,
    /// Greatest coordinates.
    pub max: DVec3,
}

/// A scan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanInfo {
    /// Its name.
    pub name: String,
    /// Points with finite coordinates.
    pub points: usize,
    /// Number of records without finite coordinates.
    pub dropped_not_finite: usize,
    /// Columns of each point: `x y z`, and `sigma`, `cxx …`, `nx ny nz`, `sigma_n_deg` if present.
    pub columns: Vec<String>,
    /// Around the points, in the scanner's frame.
    #[serde(rename = "box")]
    pub bounds: Option<BoxInfo>,
    /// Columns, rows and filled cells of an organised scan.
    pub grid: Option<GridInfo>,
    /// Viewing direction of the sensor, in words.
    pub viewing: String,
}

/// The sampling grid of an organised scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct GridInfo {
    /// Columns.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Number of cells with a point.
    pub filled: usize,
}

/// A sensor as a job states it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorInfo {
    /// Its name.
    pub name: String,
    /// `range` or `touch`.
    pub kind: String,
    /// σ along the ray, or in every direction. Absent if it must be estimated.
    pub sigma_along: Option<f64>,
    /// σ across the ray.
    pub sigma_across: Option<f64>,
    /// Whether every point of its scans states its own σ or covariance, which then counts.
    pub sigma_of_points: bool,
    /// Number of its scans.
    pub scans: usize,
}

/// A scan of a list.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ListedScanInfo {
    /// The scan itself.
    #[serde(flatten)]
    pub scan: ScanInfo,
    /// Its sensor.
    pub sensor: String,
    /// World from scanner: translation.
    pub translation: DVec3,
    /// World from scanner: rotation.
    pub quaternion_xyzw: [f64; 4],
    /// σ of the translation, where stated.
    pub sigma_translation: Option<f64>,
    /// σ of the rotation, where stated.
    pub sigma_rotation_deg: Option<f64>,
}

/// A list of scans.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScanListInfo {
    /// Points in all.
    pub points: usize,
    /// Around all points, in the world's frame.
    #[serde(rename = "box")]
    pub bounds: Option<BoxInfo>,
    /// The sensors.
    pub sensors: Vec<SensorInfo>,
    /// The scans.
    pub scans: Vec<ListedScanInfo>,
}

/// The faces of a STEP file. Faces that an assembly contains several times count as often.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FacesInfo {
    /// Number of faces that were triangulated.
    #[serde(rename = "read")]
    pub faces: usize,
    /// Number of faces by the kind of their surface, such as `plane`, including unreadable ones.
    pub kinds: BTreeMap<&'static str, usize>,
    /// Faces that cannot be read: number in the file and reason.
    pub unreadable: Vec<String>,
    /// Items that are no faces, such as tessellations and wires: keyword and number.
    pub ignored: BTreeMap<String, usize>,
}

/// A mesh, or the triangles of faces.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeshInfo {
    /// The faces of a STEP file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub faces: Option<FacesInfo>,
    /// Vertices.
    pub vertices: usize,
    /// Triangles, after polygons were cut.
    pub triangles: usize,
    /// Properties of a vertex.
    pub columns: Vec<String>,
    /// Two triangles at every edge.
    pub watertight: bool,
    /// No edge of three triangles, no two fans at a vertex.
    pub manifold: bool,
    /// Edges of one triangle.
    pub boundary_edges: usize,
    /// Edges of three or more triangles.
    pub nonmanifold_edges: usize,
    /// Parts that are connected.
    pub components: usize,
    /// Sum of the triangles' areas.
    pub area: f64,
    /// Enclosed volume; none for an open mesh.
    pub volume: Option<f64>,
    /// Around the vertices.
    #[serde(rename = "box")]
    pub bounds: Option<BoxInfo>,
    /// σ of the measured vertices, if the file has it.
    pub sigma: Option<SigmaSummary>,
    /// Share of the vertices that were measured, if the file has it.
    pub observed_vertex_fraction: Option<f64>,
}

/// A saved model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelInfo {
    /// The topology.
    #[serde(flatten)]
    pub topology: SurfaceTopology,
    /// Control vertices.
    pub coefficients: usize,
    /// Levels of the hierarchy.
    pub levels: usize,
    /// Leaf cells.
    pub cells: usize,
    /// Cells of the base grid along u and v.
    pub base: [usize; 2],
    /// Number of readings in the model.
    pub observations: usize,
    /// Area of the surface.
    pub area: f64,
    /// Share of it that was measured.
    pub observed_area_fraction: f64,
    /// Share of it that was completed from measured parts.
    #[serde(rename = "invented_area_fraction")]
    pub inferred_area_fraction: f64,
    /// Around the surface, at nine by nine points of every cell.
    #[serde(rename = "box")]
    pub bounds: Option<BoxInfo>,
    /// σ along the normal, where measured.
    pub sigma: SigmaSummary,
    /// Weight of the thin-plate energy.
    pub smoothness_weight: f64,
    /// Sensors of the last session.
    pub sensors: Vec<SensorReport>,
    /// Poses of the scans.
    pub poses: Vec<ScanPoseReport>,
    /// The sessions that made it, oldest first.
    pub sessions: Vec<Session>,
}

/// Reads a file and describes its contents. `unit` applies to files without a unit.
///
/// # Errors
/// Those of the readers; `Unsupported` for other extensions.
///
/// # Examples
/// ```no_run
/// use planish::info::{Contents, info};
/// if let Contents::Mesh(mesh) = info("part.ply".as_ref(), None)?.contents {
///     assert!(mesh.watertight, "{} boundary edges", mesh.boundary_edges);
/// }
/// # Ok::<(), planish::Error>(())
/// ```
pub fn info(path: &Path, unit: Option<Unit>) -> Result<FileInfo> {
    // A killed run may have left outputs that are only partly renamed (docs/decisions/0087-output-sets.md).
    recover_outputs_in_folder_of(path);
    // The reader of scans explains what is wrong with a file of no kind.
    match FileKind::of_file(path).unwrap_or(FileKind::Points) {
        FileKind::Model => model(path, unit),
        FileKind::Step => step(path, unit),
        FileKind::Mesh => match MeshFile::read(path, read_mesh)? {
            MeshFile::Mesh(file, columns) => mesh(path, file, columns, unit),
            MeshFile::Points(stated) => scans(path, stated, unit),
        },
        FileKind::Points | FileKind::ScanList | FileKind::Picture => scans(path, None, unit),
        other => Err(Error::unsupported(format!(
            "{}: expected a scan, a list of scans, a mesh, faces or a saved model, found {}",
            path.display(),
            other.with_article()
        ))),
    }
}

/// A file of a mesh format.
pub(crate) enum MeshFile {
    /// Triangles, and the names of the columns of their vertices.
    Mesh(PolygonMesh, Vec<String>),
    /// Points only, with their unit. They are read again as a scan, which has other columns.
    Points(Option<Unit>),
}

impl MeshFile {
    /// Reads a file by a reader of meshes.
    pub(crate) fn read(path: &Path, mut reader: impl FnMut(&Path) -> Result<PolygonMesh>) -> Result<Self> {
        if extension(path) == "ply" {
            // The header names more columns than a mesh has. A file of points may carry an empty list of
            // faces.
            let contents = read_contents(path)?;
            return Ok(match contents.count("face") {
                0 => Self::Points(contents.unit),
                _ => Self::Mesh(reader(path)?, contents.properties("vertex").to_vec()),
            });
        }
        let file = reader(path)?;
        if file.triangles.is_empty() {
            return Ok(Self::Points(file.unit));
        }
        let columns = columns_of(&file);
        Ok(Self::Mesh(file, columns))
    }
}

fn columns_of(file: &PolygonMesh) -> Vec<String> {
    let others = file.columns.iter().map(|(name, _)| name.as_str());
    ["x", "y", "z"].into_iter().chain(others).map(str::to_owned).collect()
}

/// Describes the faces of a STEP file and their triangles.
fn step(path: &Path, unit: Option<Unit>) -> Result<FileInfo> {
    let faces = read_step(path)?;
    let made = faces.triangles(&faces.fineness(None)).map_err(|e| e.in_context(path.display()))?;
    let unreadable = made.unreadable.clone();
    let count = made.faces;
    let file = made.combined(faces.unit());
    let columns = columns_of(&file);
    let mut found = mesh(path, file, columns, unit)?;
    let mut findings = Vec::new();
    if let Some(first) = unreadable.first() {
        findings.push(Finding::new(
            FindingCode::MeshDefects,
            format!(
                "{} of {} faces cannot be read; the first is {first}",
                unreadable.len(),
                unreadable.len() + count
            ),
        ));
    }
    let ignored = faces.ignored().clone();
    for (kind, count) in &ignored {
        let text = format!("ignored {count} × {kind}, which has no exact faces");
        findings.push(Finding::new(FindingCode::EntitiesSkipped, text));
    }
    if let Contents::Mesh(mesh) = &mut found.contents {
        mesh.faces = Some(FacesInfo { faces: count, kinds: faces.faces_by_kind(), unreadable, ignored });
    }
    found.findings.splice(0..0, findings);
    Ok(found)
}

/// Describes a file of points. Its own unit has priority over the given one.
pub(crate) fn scans(path: &Path, named: Option<Unit>, unit: Option<Unit>) -> Result<FileInfo> {
    // A unit in the file has priority over the given one.
    let set = read_inputs(&[path], if named.is_some() { None } else { unit })?;
    // Range scanners write missing readings as NaN, so this is a finding and not an error.
    let dropped: usize = set.scans.iter().map(|s| s.scan.dropped_not_finite).sum();
    let mut findings = Vec::new();
    if dropped > 0 {
        findings.push(Finding::new(
            FindingCode::PointsNotFinite,
            format!("{dropped} records without finite coordinates are ignored"),
        ));
    }
    let contents = match &set.scans[..] {
        // A list with a single scan is still a list: its sensor and pose must be shown.
        [one] if !matches!(extension(path).as_str(), "toml" | "conf") => Contents::Scan(scan_info(&one.scan)),
        _ => Contents::Scans(scan_list(&set)),
    };
    Ok(FileInfo {
        unit: set.unit,
        files: set.inputs.into_iter().map(|input| input.path).collect(),
        contents,
        findings,
    })
}

fn scan_info(scan: &Scan) -> ScanInfo {
    let known: [(bool, &[&str]); 8] = [
        // Names as in files, so that a user can find and add columns.
        (true, &["x", "y", "z"]),
        (scan.sigma.is_some(), &["sigma"]),
        (scan.covariance.is_some(), &["cxx", "cxy", "cxz", "cyy", "cyz", "czz"]),
        (scan.normals.is_some(), &["nx", "ny", "nz"]),
        (scan.sigma_normal_deg.is_some(), &["sigma_n_deg"]),
        (scan.curvatures.is_some(), &["k1", "k2", "d1x", "d1y", "d1z"]),
        (scan.sigma_curvature.is_some(), &["sigma_k"]),
        (scan.classes.is_some(), &["class"]),
    ];
    let columns = known.iter().filter(|(known, _)| *known).flat_map(|(_, names)| *names);
    let filled = |grid: &RangeGrid| grid.cells.iter().filter(|&&cell| cell != RangeGrid::EMPTY).count();
    ScanInfo {
        name: scan.name.clone(),
        points: scan.points.len(),
        dropped_not_finite: scan.dropped_not_finite,
        columns: columns.map(|&name| name.to_owned()).collect(),
        bounds: bounds(&scan.points),
        grid: scan.grid.as_ref().map(|grid| GridInfo {
            columns: grid.columns,
            rows: grid.rows,
            filled: filled(grid),
        }),
        viewing: match scan.viewing {
            Viewing::Unknown => "not stated".to_owned(),
            Viewing::Direction(DVec3 { x, y, z }) => format!("along ({x}, {y}, {z})"),
            Viewing::Origin(DVec3 { x, y, z }) => format!("from the point ({x}, {y}, {z})"),
        },
    }
}

fn scan_list(set: &ScanSet) -> ScanListInfo {
    let world: Vec<DVec3> = set
        .scans
        .iter()
        .flat_map(|posed| {
            // The box of a list is in the world's frame, while that of each scan is in its own.
            let pose = &posed.scan.world_from_scanner;
            posed.scan.points.iter().map(|p| pose.apply(*p))
        })
        .collect();
    let listed = |posed: &PosedScan| ListedScanInfo {
        scan: scan_info(&posed.scan),
        sensor: set.sensors[posed.sensor].name.clone(),
        translation: posed.scan.world_from_scanner.translation,
        quaternion_xyzw: posed.scan.world_from_scanner.quaternion_xyzw(),
        sigma_translation: posed.sigma_translation,
        sigma_rotation_deg: posed.sigma_rotation_deg,
    };
    let sensors = set.sensors.iter().enumerate().map(|(index, sensor)| {
        let (sigma_along, sigma_across) = match sensor.noise {
            None => (None, None),
            // One number for all directions is shown as both.
            Some(Noise::Isotropic { sigma }) => (Some(sigma), Some(sigma)),
            Some(Noise::Ray { sigma_along, sigma_across }) => (Some(sigma_along), Some(sigma_across)),
        };
        let scans: Vec<&Scan> =
            set.scans.iter().filter(|s| s.sensor == index).map(|posed| &posed.scan).collect();
        SensorInfo {
            name: sensor.name.clone(),
            kind: sensor.kind.name().to_owned(),
            sigma_along,
            sigma_across,
            // σ of the points overrides that of the sensor, but only if all scans state it. A sensor without
            // scans has no points that could.
            sigma_of_points: !scans.is_empty()
                && scans.iter().all(|scan| scan.sigma.is_some() || scan.covariance.is_some()),
            scans: scans.len(),
        }
    });
    ScanListInfo {
        points: world.len(),
        bounds: bounds(&world),
        sensors: sensors.collect(),
        scans: set.scans.iter().map(listed).collect(),
    }
}

pub(crate) fn mesh(
    path: &Path,
    file: PolygonMesh,
    columns: Vec<String>,
    unit: Option<Unit>,
) -> Result<FileInfo> {
    // Completed parts (2) do not count: the summary is that of measured parts.
    let observed: Option<Vec<bool>> = file.column("observed").map(|c| c.iter().map(|&o| o == 1.0).collect());
    let measured = |k: usize| observed.as_ref().is_none_or(|observed| observed[k]);
    let sigma = match file.column("sigma") {
        None => None,
        Some(column) => {
            let known: Vec<f64> = (0..column.len()).filter(|&k| measured(k)).map(|k| column[k]).collect();
            match known.is_empty() {
                true => None,
                false => {
                    Some(DeviationStatistics::from_signed(&known).map_err(|e| e.in_context(path.display()))?)
                }
            }
        }
    };
    // Defects are reported and not repaired: the file is described as it is.
    let mesh =
        TriangleMesh::try_new(file.points, file.triangles).map_err(|e| e.in_context(path.display()))?;
    let check = mesh.check();
    let mut findings = Vec::new();
    for (n, what) in [
        (check.nonmanifold_edges, "edges belong to more than two triangles"),
        (check.misoriented_edges, "edges join triangles of opposite orientation"),
        (check.degenerate_triangles, "triangles have no area"),
        (check.unused_vertices, "vertices belong to no triangle"),
    ] {
        if n > 0 {
            findings.push(Finding::new(FindingCode::MeshDefects, format!("{n} {what}")));
        }
    }
    Ok(FileInfo {
        unit: file.unit.or(unit),
        files: vec![path.to_path_buf()],
        contents: Contents::Mesh(MeshInfo {
            faces: None,
            vertices: check.vertices,
            triangles: check.triangles,
            columns,
            watertight: check.watertight,
            manifold: check.manifold,
            boundary_edges: check.boundary_edges,
            nonmanifold_edges: check.nonmanifold_edges,
            components: check.components,
            area: mesh.area(),
            // Negative for a mesh that is turned inside out.
            volume: mesh.signed_volume(),
            bounds: bounds(&mesh.positions),
            sigma: sigma.map(|s| SigmaSummary { median: s.p50, p95: s.p95, max: s.max }),
            observed_vertex_fraction: observed
                .map(|o| o.iter().filter(|seen| **seen).count() as f64 / o.len().max(1) as f64),
        }),
        findings,
    })
}

fn model(path: &Path, unit: Option<Unit>) -> Result<FileInfo> {
    let SavedModel { mut model, provenance, mut findings } = load_with_provenance(path)?;
    match unit.filter(|_| model.unit_assumed) {
        Some(unit) => model.unit = unit,
        None if model.unit_assumed => findings.push(
            Finding::new(
                FindingCode::UnitAssumed,
                format!("no scan of the model stated its unit of length: {} is assumed", model.unit),
            )
            .with_setting(Setting::Unit),
        ),
        None => {}
    }
    let sigma = model
        .posterior()
        .and_then(|posterior| sigma_summary(&model, &posterior))
        .map_err(|e| e.in_context(path.display()))?;
    let surface = &model.surface;
    let space = surface.space();
    let areas: Vec<f64> = (0..space.leaves().len()).map(|leaf| surface.leaf_area(leaf)).collect();
    let area: f64 = areas.iter().sum();
    Ok(FileInfo {
        unit: Some(model.unit),
        files: vec![path.to_path_buf()],
        contents: Contents::Model(Box::new(ModelInfo {
            topology: SurfaceTopology::of(space),
            coefficients: space.node_count(),
            levels: space.levels(),
            cells: space.leaves().len(),
            base: space.base(),
            observations: model.observations,
            area,
            observed_area_fraction: model.area_fraction(Observed::Measured),
            inferred_area_fraction: model.area_fraction(Observed::Inferred),
            // Control vertices lie outside of a curved surface and would enlarge the box.
            bounds: bounds(&points_of_cells(surface)),
            sigma,
            smoothness_weight: model.smoothness_weight,
            sensors: model.sensors.clone(),
            poses: model.poses.clone(),
            sessions: provenance,
        })),
        findings,
    })
}

/// Nine by nine points of every cell, its corners among them.
fn points_of_cells(surface: &planish_spline::Surface) -> Vec<DVec3> {
    (0..surface.space().leaves().len())
        .flat_map(|leaf| {
            (0..81).map(move |k| surface.leaf_point(leaf, f64::from(k % 9) / 8.0, f64::from(k / 9) / 8.0))
        })
        .collect()
}

fn bounds(points: &[DVec3]) -> Option<BoxInfo> {
    BoundingBox::from_points(points).map(|b| BoxInfo { min: b.min, max: b.max })
}
