//! Reads the faces of STEP files as triangles: bodies, shells and single surfaces of AP203, AP214 and AP242,
//! at their positions in assemblies.
//!
//! **Input.** A file.
//!
//! **Output.** One mesh per set of faces that share edges, and the faces that could not be read or
//! triangulated, each with the reason.
//!
//! **Limits.** Other geometry (wires, tessellations, annotations) is ignored. Parameter curves of edges are
//! not used: edges are projected onto the surfaces.
//!
//! # References
//! ISO 10303-21, -41 to -44; the recommended practices of MBx-IF for assemblies and units.

mod attributes;
mod geometry;
mod product;
mod syntax;
#[cfg(test)]
mod tests;
mod topology;

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use planish_core::{BoundingBox, Budget, DVec3};
use planish_estimate::{Error, Result};
use planish_solid::parametric::{Fineness, Meshed};

use crate::Unit;
use crate::mesh_data::PolygonMesh;
use crate::source::open;
use geometry::Geometry;
use product::{Motion, Products, Units};
use syntax::Index;
use topology::{Builder, Read as ReadShape};

/// Maximum number of parts of an assembly: parts multiply through nested assemblies, so a small file could
/// request any number.
const MAX_PARTS: usize = 100_000;
/// Bytes of memory that triangles may take per byte of the file. A face of some hundred bytes has a few
/// hundred points of a hundred bytes each (decision 0089).
const TRIANGLE_RATIO: u64 = 64;
/// Minimum distance at which points are merged, as a share of the size. Used if the file states no
/// uncertainty or a smaller one; it absorbs the rounding of coordinates.
const MIN_TOLERANCE_SHARE: f64 = 1e-7;
/// Maximum distance at which points are merged, as a share of the size. A larger stated uncertainty would
/// merge small features.
const MAX_TOLERANCE_SHARE: f64 = 1e-4;

/// A shape and its placements.
struct Placed {
    read: ReadShape,
    motions: Vec<Motion>,
}

/// The exact faces of a file.
pub struct StepFaces {
    shapes: Vec<Placed>,
    unit: Option<Unit>,
    size: f64,
    /// Size of the file in bytes, which limits its triangles.
    length: u64,
    ignored: Ignored,
}

/// The faces of a file as triangles.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StepMesh {
    /// One mesh per set of faces that share edges.
    pub parts: Vec<PolygonMesh>,
    /// Number of triangulated faces; a face that an assembly contains several times counts as often.
    pub faces: usize,
    /// Faces that could not be read or triangulated: number in the file and reason.
    pub unreadable: Vec<String>,
}

/// Reads the faces of a STEP file, which may be compressed by gzip.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input), naming file, line and instance, if it is not a STEP file,
/// if it is damaged in the description of a shape, or if it has no faces;
/// [`Io`](planish_estimate::ErrorKind::Io) if it cannot be read. An invalid face is not an error, but listed
/// in [`StepMesh::unreadable`].
///
/// # Examples
/// ```
/// use planish_exchange::step::read_step;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("triangle.step");
/// std::fs::write(&path, "ISO-10303-21;
/// DATA;
/// #1=CARTESIAN_POINT('',(0.,0.,0.));
/// #2=CARTESIAN_POINT('',(1.,0.,0.));
/// #3=CARTESIAN_POINT('',(0.,1.,0.));
/// #4=DIRECTION('',(0.,0.,1.));
/// #5=DIRECTION('',(1.,0.,0.));
/// #6=AXIS2_PLACEMENT_3D('',#1,#4,#5);
/// #7=PLANE('',#6);
/// #8=POLY_LOOP('',(#1,#2,#3));
/// #9=FACE_OUTER_BOUND('',#8,.T.);
/// #10=FACE_SURFACE('',(#9),#7,.T.);
/// #11=OPEN_SHELL('',(#10));
/// ENDSEC;
/// END-ISO-10303-21;
/// ")?;
/// let faces = read_step(&path)?;
/// let mesh = faces.triangles(&faces.fineness(None))?;
/// assert_eq!((mesh.faces, mesh.unreadable.len()), (1, 0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_step(path: &Path) -> Result<StepFaces> {
    let read = || -> Result<StepFaces> {
        // As a whole, because instances may refer to later ones and are parsed on request.
        let bytes = open(path)?.rest()?;
        StepFaces::from_bytes(&bytes)
    };
    read().map_err(|e| e.in_context(path.display()))
}

/// Default chord error of triangles, as a share of the size. A larger one shows facets, a smaller one
/// multiplies the triangles.
const DEFAULT_CHORD_SHARE: f64 = 1e-4;
/// Default maximum side of triangles, as a share of the size. Planes have no chord error, so it alone limits
/// their triangles.
const DEFAULT_SIDE_SHARE: f64 = 1.0 / 64.0;

/// Reads the triangles of all faces as one mesh.
///
/// # Errors
/// As [`read_step`]; `Unsupported` if a face cannot be read or triangulated, because a mesh without some
/// faces would be mistaken for the whole.
pub(crate) fn read_mesh(path: &Path) -> Result<PolygonMesh> {
    let faces = read_step(path)?;
    let named = |e: Error| e.in_context(path.display());
    let mesh = faces.triangles(&faces.fineness(None)).map_err(named)?;
    if let Some(first) = mesh.unreadable.first() {
        return Err(named(Error::unsupported(format!(
            "{} of {} faces cannot be read; the first is {first}",
            mesh.unreadable.len(),
            mesh.unreadable.len() + mesh.faces
        ))));
    }
    Ok(mesh.combined(faces.unit()))
}

impl StepMesh {
    /// All parts as one mesh; their vertices are not merged.
    #[must_use]
    pub fn combined(self, unit: Option<Unit>) -> PolygonMesh {
        let mut combined = PolygonMesh { unit, ..PolygonMesh::default() };
        for part in self.parts {
            let first = combined.points.len() as u32;
            combined.points.extend(part.points);
            combined.triangles.extend(part.triangles.iter().map(|t| t.map(|v| first + v)));
        }
        combined
    }
}

/// Items other than faces, with their number by keyword.
type Ignored = BTreeMap<String, usize>;

impl StepFaces {
    /// Unit of every length, if the file states one. Lengths in units other than [`Unit`] are converted to
    /// millimetres.
    #[must_use]
    pub fn unit(&self) -> Option<Unit> {
        self.unit
    }

    /// Items that are no faces, such as tessellations and wires, with their number by keyword.
    #[must_use]
    pub fn ignored(&self) -> &BTreeMap<String, usize> {
        &self.ignored
    }

    /// Number of faces by the kind of their surface, such as `plane`; a face that an assembly contains
    /// several times counts as often. Faces that cannot be read count as `unreadable`.
    #[must_use]
    pub fn faces_by_kind(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for Placed { read, motions } in &self.shapes {
            let kinds = read.shape.faces.iter().map(|face| face.surface.kind());
            for kind in kinds.chain(read.unreadable.iter().map(|_| "unreadable")) {
                *counts.entry(kind).or_default() += motions.len();
            }
        }
        counts
    }

    /// Diagonal of the bounding box of all faces, in the unit.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Fineness with a maximum chord error of `chord` (default 1/10 000 of the size) and sides of at most
    /// 1/64 of the size.
    #[must_use]
    pub fn fineness(&self, chord: Option<f64>) -> Fineness {
        Fineness {
            chord: chord.unwrap_or(DEFAULT_CHORD_SHARE * self.size),
            longest: DEFAULT_SIDE_SHARE * self.size,
        }
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let index = Index::new(bytes)?;
        let products = Products::find(&index)?;
        // The first stated unit becomes that of the result; other representations are converted.
        let with_unit = products.representations.values().find_map(|r| r.units.length_mm);
        let unit = with_unit.map(named_unit);
        let length = |units: &Units| match (units.length_mm, unit) {
            (Some(mm), Some(unit)) => mm / unit.millimetres(),
            _ => 1.0,
        };
        let places = products.places(&index, &length, MAX_PARTS)?;
        let mut shapes = Vec::new();
        let mut ignored = Ignored::new();
        let mut read_items: HashSet<u64> = HashSet::new();
        for (id, representation) in products.specialised_first() {
            // Items of several representations are read once.
            let items: Vec<u64> =
                representation.items.iter().copied().filter(|i| read_items.insert(*i)).collect();
            let geometry = Geometry {
                index: &index,
                length: length(&representation.units),
                angle: representation.units.angle,
            };
            let uncertainty = representation.units.uncertainty.map(|u| u * geometry.length);
            let motions = places.get(id).cloned().unwrap_or_default();
            for read in shapes_of(geometry, &items, uncertainty, &mut ignored)? {
                let motions = motions.clone();
                shapes.push(Placed { read, motions });
            }
        }
        if shapes.is_empty() {
            // Some files have shells that no representation refers to.
            // Units belong to representations, so a loose shell has none.
            let geometry = Geometry { index: &index, length: 1.0, angle: 1.0 };
            for read in loose_shells(geometry)? {
                let motions = vec![Motion::NONE];
                shapes.push(Placed { read, motions });
            }
        }
        if shapes.is_empty() {
            let kinds: Vec<String> = ignored.iter().map(|(kind, n)| format!("{n} {kind}")).collect();
            return Err(Error::input(match kinds.is_empty() {
                true => "expected faces, found none".to_owned(),
                false => format!("expected faces, found only {}", kinds.join(", ")),
            }));
        }
        let size = extent_of(&shapes);
        Ok(Self { shapes, unit, size, length: bytes.len() as u64, ignored })
    }

    /// Triangulates all faces.
    ///
    /// # Errors
    /// As [`ParametricShape::triangles`](planish_solid::parametric::ParametricShape::triangles);
    /// `Input` if no face can be triangulated.
    pub fn triangles(&self, fineness: &Fineness) -> Result<StepMesh> {
        let mut mesh = StepMesh::default();
        let budget = Budget::of_compressed(self.length, TRIANGLE_RATIO);
        for placed in &self.shapes {
            let shape = &placed.read.shape;
            let made = match shape.faces.is_empty() {
                true => Meshed::default(),
                false => shape.triangles_within(fineness, &budget)?,
            };
            let failed = made.skipped.iter().map(|l| {
                let face = &shape.faces[l.face];
                format!("face {} ({}): {}", face.name, face.surface.kind(), l.reason)
            });
            mesh.unreadable
                .extend(placed.read.unreadable.iter().map(|(name, reason)| format!("face {name}: {reason}")));
            // Once, however often the shape is placed.
            mesh.unreadable.extend(failed);
            for motion in &placed.motions {
                for part in &made.parts {
                    let bytes = (size_of::<DVec3>() + 2 * size_of::<[u32; 3]>()) as u64;
                    budget.take_elements(part.positions.len() as u64, bytes, "points of placed parts")?;
                    mesh.faces += part.faces.len();
                    // Placements share the triangulation, which is the expensive part.
                    let mut triangles = part.triangles.clone();
                    // A mirror would turn the triangles inside out.
                    if motion.is_mirror() {
                        triangles.iter_mut().for_each(|t| t.swap(1, 2));
                    }
                    mesh.parts.push(PolygonMesh {
                        points: part.positions.iter().map(|p| motion.apply(*p)).collect(),
                        triangles,
                        columns: Vec::new(),
                        unit: self.unit,
                    });
                }
            }
        }
        match (mesh.parts.is_empty(), mesh.unreadable.first()) {
            (false, _) => Ok(mesh),
            (true, Some(first)) => Err(Error::input(format!(
                "none of the {} faces can be read; the first is {first}",
                mesh.unreadable.len()
            ))),
            (true, None) => Err(Error::input("expected faces in the assembly, found none")),
        }
    }
}

/// Unit of a given length in millimetres; millimetres for other lengths.
fn named_unit(mm: f64) -> Unit {
    [Unit::Millimetre, Unit::Metre, Unit::Inch, Unit::Foot]
        .into_iter()
        .find(|u| (u.millimetres() / mm - 1.0).abs() < 1e-9)
        .unwrap_or(Unit::Millimetre)
}

/// Shapes of a representation: one per body, and one of all other faces.
///
/// Bodies are kept apart, so that vertices of touching bodies are not merged.
fn shapes_of(
    geometry: Geometry,
    items: &[u64],
    uncertainty: Option<f64>,
    ignored: &mut Ignored,
) -> Result<Vec<ReadShape>> {
    let mut found = Vec::new();
    let mut sheets = Builder::new(geometry);
    for item in items {
        let records = geometry.index.records(*item)?;
        let keyword = records.first().map_or("", |r| r.keyword);
        if matches!(keyword, "MANIFOLD_SOLID_BREP" | "BREP_WITH_VOIDS" | "FACETED_BREP") {
            let mut body = Builder::new(geometry);
            body.add_item(*item)?;
            found.push(body.finish());
        } else if !matches!(keyword, "AXIS2_PLACEMENT_3D" | "MAPPED_ITEM") && !sheets.add_item(*item)? {
            *ignored.entry(keyword.to_owned()).or_default() += 1;
        }
    }
    if !sheets.is_empty() {
        found.push(sheets.finish());
    }
    // Some files contain a shared edge once per face, so coincident vertices and edges are
    // merged.
    for read in &mut found {
        let size = extent(read);
        let tolerance =
            uncertainty.unwrap_or(0.0).clamp(MIN_TOLERANCE_SHARE * size, MAX_TOLERANCE_SHARE * size);
        read.shape.weld(tolerance);
    }
    Ok(found)
}

/// Shells of a file without representations, or its faces if it has no shells.
fn loose_shells(geometry: Geometry) -> Result<Vec<ReadShape>> {
    let instances_of = |keyword: &str| geometry.index.of_keyword(keyword).to_vec();
    let mut items = [instances_of("CLOSED_SHELL"), instances_of("OPEN_SHELL")].concat();
    if items.is_empty() {
        items = instances_of("ADVANCED_FACE");
    }
    shapes_of(geometry, &items, None, &mut Ignored::new())
}

fn extent(read: &ReadShape) -> f64 {
    read.shape.bounds().map_or(0.0, |b| b.diagonal())
}

/// Diagonal of the bounding box of all placed shapes; their own boxes are enough, because only an order of
/// size is required.
fn extent_of(shapes: &[Placed]) -> f64 {
    let corners = shapes.iter().flat_map(|placed| {
        let own = placed.read.shape.bounds();
        let moved = placed.motions.iter().flat_map(move |m| own.map(|b| b.corners().map(|p| m.apply(p))));
        moved.flatten()
    });
    BoundingBox::around(corners).map_or(0.0, |b| b.diagonal())
}
