//! Reads the faces of STEP files as triangles: bodies, shells and single surfaces of AP203, AP214 and AP242,
//! at their positions in assemblies.
//!
//! **Input.** A file.
//!
//! **Output.** One mesh for each set of faces that share edges, and the faces that could not be read or
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

use planish_estimate::vector3::distance;
use planish_estimate::{Error, Result};
use planish_solid::parametric::{Fineness, Meshed};

use crate::Unit;
use crate::mesh_data::PolygonMesh;
use crate::source::open;
use geometry::Geometry;
use product::{Motion, Products, Units};
use syntax::Index;
use topology::{Builder, Read as ReadShape};

/// Parts of an assembly beyond this are refused.
const MOST_PARTS: usize = 100_000;
/// Points nearer than this, of the size, are one where a file says nothing.
const SAME: f64 = 1e-7;
/// A file's uncertainty is taken up to this share of its size.
const MOST_UNCERTAIN: f64 = 1e-4;

/// A shape, and where it stands.
struct Placed {
    read: ReadShape,
    motions: Vec<Motion>,
}

/// The faces of a file, exact.
pub struct StepFaces {
    shapes: Vec<Placed>,
    unit: Option<Unit>,
    size: f64,
}

/// The faces of a file as triangles.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StepMesh {
    /// A mesh for every set of faces that share edges.
    pub parts: Vec<PolygonMesh>,
    /// Faces that have triangles; one that an assembly holds several times counts as often.
    pub faces: usize,
    /// What could not be read or filled: a face's number in the file and the reason.
    pub left_out: Vec<String>,
}

/// Reads the faces of a STEP file, maybe behind gzip.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input), naming file, line and instance, for what is no STEP file or
/// is damaged where a shape is described, and for one without faces; [`Io`](planish_estimate::ErrorKind::Io)
/// when it cannot be read. A face that is not as it must be is no error: [`StepMesh::left_out`] names it.
pub fn read_step(path: &Path) -> Result<StepFaces> {
    let read = || -> Result<StepFaces> {
        let bytes = open(path)?.rest()?;
        StepFaces::of_bytes(&bytes)
    };
    read().map_err(|e| e.in_context(path.display()))
}

/// The chord error of triangles, of the size, where nothing else is wanted.
const CHORD: f64 = 1e-4;
/// Their longest side.
const LONGEST: f64 = 1.0 / 64.0;

/// The triangles of all faces as one mesh.
///
/// # Errors
/// As [`read_step`]; `Unsupported` where a face cannot be read or filled: a mesh that lacks faces would be
/// taken for the whole.
pub(crate) fn read_mesh(path: &Path) -> Result<PolygonMesh> {
    let faces = read_step(path)?;
    let named = |e: Error| e.in_context(path.display());
    let mesh = faces.triangles(&faces.fineness(None)).map_err(named)?;
    if let Some(first) = mesh.left_out.first() {
        return Err(named(Error::unsupported(format!(
            "{} of its {} faces cannot be read, the first: {first}",
            mesh.left_out.len(),
            mesh.left_out.len() + mesh.faces
        ))));
    }
    let mut whole = PolygonMesh { unit: faces.unit(), ..PolygonMesh::default() };
    for part in mesh.parts {
        let first = whole.points.len() as u32;
        whole.points.extend(part.points);
        whole.triangles.extend(part.triangles.iter().map(|t| t.map(|v| first + v)));
    }
    Ok(whole)
}

/// What a file holds beside faces.
type PassedOver = BTreeMap<String, usize>;

impl StepFaces {
    /// The unit of every length, where the file names one; one that is none of ours is turned into
    /// millimetres.
    #[must_use]
    pub fn unit(&self) -> Option<Unit> {
        self.unit
    }

    /// The diagonal of a box around everything, in the unit.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Triangles that miss the faces by `chord` at most, or a ten thousandth of the size, with sides of a
    /// sixty-fourth of the size at most.
    #[must_use]
    pub fn fineness(&self, chord: Option<f64>) -> Fineness {
        Fineness { chord: chord.unwrap_or(CHORD * self.size), longest: LONGEST * self.size }
    }

    fn of_bytes(bytes: &[u8]) -> Result<Self> {
        let index = Index::new(bytes)?;
        let products = Products::find(&index)?;
        let with_unit = products.representations.values().find_map(|r| r.units.length_mm);
        let unit = with_unit.map(named_unit);
        let length = |units: &Units| match (units.length_mm, unit) {
            (Some(mm), Some(unit)) => mm / unit.millimetres(),
            _ => 1.0,
        };
        let places = products.places(&index, &length, MOST_PARTS)?;
        let mut shapes = Vec::new();
        let mut passed_over = PassedOver::new();
        let mut is_taken: HashSet<u64> = HashSet::new();
        for (id, representation) in products.most_special_first() {
            let items: Vec<u64> =
                representation.items.iter().copied().filter(|i| is_taken.insert(*i)).collect();
            let geometry = Geometry {
                index: &index,
                length: length(&representation.units),
                angle: representation.units.angle,
            };
            let uncertainty = representation.units.uncertainty.map(|u| u * geometry.length);
            let motions = places.get(id).cloned().unwrap_or_default();
            for read in shapes_of(geometry, &items, uncertainty, &mut passed_over)? {
                let motions = motions.clone();
                shapes.push(Placed { read, motions });
            }
        }
        if shapes.is_empty() {
            let geometry = Geometry { index: &index, length: 1.0, angle: 1.0 };
            for read in loose_shells(geometry)? {
                let motions = vec![Motion::NONE];
                shapes.push(Placed { read, motions });
            }
        }
        if shapes.is_empty() {
            let kinds: Vec<String> = passed_over.iter().map(|(kind, n)| format!("{n} {kind}")).collect();
            return Err(Error::input(match kinds.is_empty() {
                true => "it holds no faces".to_owned(),
                false => format!("it holds no faces, only {}", kinds.join(", ")),
            }));
        }
        let size = size_of(&shapes);
        Ok(Self { shapes, unit, size })
    }

    /// Cuts all faces into triangles.
    ///
    /// # Errors
    /// As [`ParametricShape::triangles`](planish_solid::parametric::ParametricShape::triangles);
    /// `Input` if no face can be filled.
    pub fn triangles(&self, fineness: &Fineness) -> Result<StepMesh> {
        let mut mesh = StepMesh::default();
        for placed in &self.shapes {
            let shape = &placed.read.shape;
            let made = match shape.faces.is_empty() {
                true => Meshed::default(),
                false => shape.triangles(fineness)?,
            };
            let failed = made.skipped.iter().map(|l| {
                let face = &shape.faces[l.face];
                format!("face {} ({}): {}", face.name, face.surface.kind(), l.reason)
            });
            mesh.left_out
                .extend(placed.read.left_out.iter().map(|(name, reason)| format!("face {name}: {reason}")));
            mesh.left_out.extend(failed);
            for motion in &placed.motions {
                for part in &made.parts {
                    mesh.faces += part.faces.len();
                    let mut triangles = part.triangles.clone();
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
        match (mesh.parts.is_empty(), mesh.left_out.first()) {
            (false, _) => Ok(mesh),
            (true, Some(first)) => {
                Err(Error::input(format!("none of its {} faces could be read: {first}", mesh.left_out.len())))
            }
            (true, None) => Err(Error::input("its assembly places no faces")),
        }
    }
}

/// The unit that has so many millimetres.
fn named_unit(mm: f64) -> Unit {
    [Unit::Millimetre, Unit::Metre, Unit::Inch, Unit::Foot]
        .into_iter()
        .find(|u| (u.millimetres() / mm - 1.0).abs() < 1e-9)
        .unwrap_or(Unit::Millimetre)
}

/// The shapes of a representation: each body by itself, and all that is no body together.
fn shapes_of(
    geometry: Geometry,
    items: &[u64],
    uncertainty: Option<f64>,
    passed_over: &mut PassedOver,
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
            *passed_over.entry(keyword.to_owned()).or_default() += 1;
        }
    }
    if !sheets.is_empty() {
        found.push(sheets.finish());
    }
    for read in &mut found {
        let size = extent(read);
        let tolerance = uncertainty.unwrap_or(0.0).clamp(SAME * size, MOST_UNCERTAIN * size);
        read.shape.weld(tolerance);
    }
    Ok(found)
}

/// Shells of a file that has no representations.
fn loose_shells(geometry: Geometry) -> Result<Vec<ReadShape>> {
    let of = |keyword: &str| geometry.index.of_keyword(keyword).to_vec();
    let mut items = [of("CLOSED_SHELL"), of("OPEN_SHELL")].concat();
    if items.is_empty() {
        items = of("ADVANCED_FACE");
    }
    shapes_of(geometry, &items, None, &mut PassedOver::new())
}

fn extent(read: &ReadShape) -> f64 {
    let [lo, hi] = read.shape.bounds();
    if lo[0] <= hi[0] { distance(lo, hi) } else { 0.0 }
}

fn size_of(shapes: &[Placed]) -> f64 {
    let mut bounds = [[f64::MAX; 3], [f64::MIN; 3]];
    for placed in shapes {
        let [lo, hi] = placed.read.shape.bounds();
        for motion in placed.motions.iter().filter(|_| lo[0] <= hi[0]) {
            for corner in 0..8 {
                let p = motion.apply([0, 1, 2].map(|c| if corner >> c & 1 == 0 { lo[c] } else { hi[c] }));
                for c in 0..3 {
                    bounds[0][c] = bounds[0][c].min(p[c]);
                    bounds[1][c] = bounds[1][c].max(p[c]);
                }
            }
        }
    }
    if bounds[0][0] <= bounds[1][0] { distance(bounds[0], bounds[1]) } else { 0.0 }
}
