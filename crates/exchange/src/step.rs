//! STEP (ISO 10303-21): writes boundary representations, and reads faces of any kind as triangles
//! ([`read_step`]).
//!
//! **Input.** A [`Brep`] of B-spline faces ([`write_step`]) or a [`Solid`] on analytic surfaces
//! ([`write_solid`]).
//!
//! **Output.** `ADVANCED_FACE`s over `B_SPLINE_SURFACE_WITH_KNOTS`, bounded by edges with
//! `B_SPLINE_CURVE_WITH_KNOTS`, in an AP214 or AP242 file. Faces that share edges form a shell. If all shells
//! are closed, each is a solid, else all form a surface model. The surface is exact: every number is the
//! shortest text that reads back as the same `f64`. The file is streamed; the same input gives the same bytes
//! (no clock time, host or user in the header).
//!
//! A side of a face whose control points coincide (the pole of a ball) is not part of the loop of the face:
//! the edges of the loop meet in the vertex of the pole, and readers add the degenerate edge themselves.
//!
//! **Limits.** It is not checked that the curve of an edge lies on its faces, or that faces do not intersect.
//! Parameter curves are not written, because readers can project the edges.
//!
//! # References
//! ISO 10303-21:2016 (encoding), ISO 10303-42 (geometry and topology), ISO 10303-214 and 10303-242 (schemas).

mod brep;
mod part21;
mod read;
mod solid;
#[cfg(test)]
mod tests;

use planish_core::DVec3;
use std::io::{self, Write};
use std::path::Path;

use planish_estimate::{Error, Result};
use planish_solid::brep::Solid;

pub use brep::{Brep, BrepEdge, BrepFace, BsplineCurve, BsplineSurface};
use part21::{Id, Part21, integers, reals, text};
pub(crate) use read::read_mesh;
pub use read::{StepFaces, StepMesh, read_step};

use crate::Unit;
use crate::atomic::write_packed;

/// The application protocol that a file follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Schema {
    /// AP214, automotive design, which all common CAD programs read.
    #[default]
    Ap214,
    /// AP242, managed model-based 3D engineering.
    Ap242,
}

/// Options of a STEP file.
#[derive(Debug, Clone, PartialEq)]
pub struct StepOptions {
    /// Name of the product, which viewers display.
    pub name: String,
    /// The unit of every length.
    pub unit: Unit,
    /// Maximum gap between vertices, edges and faces that meet, in the unit; positive.
    pub uncertainty: f64,
    /// The application protocol.
    pub schema: Schema,
}

impl Default for StepOptions {
    fn default() -> Self {
        Self { name: "part".to_owned(), unit: Unit::Millimetre, uncertainty: 1e-6, schema: Schema::default() }
    }
}

/// Writes a boundary representation.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) if [`Brep::check`] rejects the representation;
/// [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left half-written.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_exchange::step::{Brep, BrepEdge, BrepFace, BsplineCurve, BsplineSurface};
/// use planish_exchange::step::{StepOptions, write_step};
/// # let folder = tempfile::tempdir()?;
/// // A flat square as one bilinear face.
/// let corners = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
/// let knots = vec![(0.0, 2), (1.0, 2)];
/// let edge = |start: usize, end: usize| BrepEdge {
///     curve: BsplineCurve { degree: 1, knots: knots.clone(), poles: vec![corners[start], corners[end]] },
///     start,
///     end,
/// };
/// let surface = BsplineSurface {
///     degree_u: 1,
///     degree_v: 1,
///     knots_u: knots.clone(),
///     knots_v: knots.clone(),
///     n_u: 2,
///     n_v: 2,
///     poles: vec![corners[0], corners[3], corners[1], corners[2]],
/// };
/// let square = Brep {
///     vertices: corners.to_vec(),
///     edges: vec![edge(0, 1), edge(1, 2), edge(2, 3), edge(3, 0)],
///     faces: vec![BrepFace {
///         surface,
///         edges: (0..4).map(|e| (e, true)).collect(),
///         holes: Vec::new(),
///         same_sense: true,
///     }],
///     closed: false,
/// };
/// let path = folder.path().join("square.step");
/// write_step(&path, &square, &StepOptions::default())?;
/// assert!(std::fs::read_to_string(&path)?.starts_with("ISO-10303-21;"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_step(path: &Path, brep: &Brep, options: &StepOptions) -> Result<()> {
    if !(options.uncertainty > 0.0 && options.uncertainty.is_finite()) {
        let message = format!("expected a STEP uncertainty > 0, found {}", options.uncertainty);
        return Err(Error::input(message));
    }
    brep.check(options.uncertainty).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| write_to(&mut writer, Shape::Splines(brep), options))
}

/// Writes a solid on analytic surfaces.
///
/// # Errors
/// [`Input`](planish_estimate::ErrorKind::Input) if [`Solid::check`] rejects it with a tolerance of 100 times
/// the uncertainty; [`Io`](planish_estimate::ErrorKind::Io) when the file cannot be written; nothing is left
/// half-written.
pub fn write_solid(path: &Path, solid: &Solid, options: &StepOptions) -> Result<()> {
    if !(options.uncertainty > 0.0 && options.uncertainty.is_finite()) {
        let message = format!("expected a STEP uncertainty > 0, found {}", options.uncertainty);
        return Err(Error::input(message));
    }
    solid.check(100.0 * options.uncertainty).map_err(|e| e.in_context(path.display()))?;
    write_packed(path, |mut writer| write_to(&mut writer, Shape::Solid(solid), options))
}

/// Shape of a file.
#[derive(Clone, Copy)]
enum Shape<'a> {
    Splines(&'a Brep),
    Solid(&'a Solid),
}

fn write_to(writer: &mut impl Write, what: Shape, options: &StepOptions) -> io::Result<()> {
    let (schema, protocol, year, context) = match options.schema {
        Schema::Ap214 => (
            "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }",
            "automotive_design",
            2000,
            "core data for automotive mechanical design processes",
        ),
        Schema::Ap242 => (
            "AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF { 1 0 10303 442 1 1 4 }",
            "ap242_managed_model_based_3d_engineering",
            2014,
            "managed model based 3d engineering",
        ),
    };
    let name = text(&options.name);
    writeln!(writer, "ISO-10303-21;\nHEADER;")?;
    // Implementation level: edition 2 of Part 21, conformance class 1.
    writeln!(writer, "FILE_DESCRIPTION((''),'2;1');")?;
    // A fixed time, so that the same shape gives the same bytes.
    writeln!(writer, "FILE_NAME({name},'1970-01-01T00:00:00',(''),(''),'Planish','Planish','');")?;
    writeln!(writer, "FILE_SCHEMA(('{schema}'));\nENDSEC;\nDATA;")?;
    let mut out = Part21::new(writer);

    let application = out.add(format_args!("APPLICATION_CONTEXT('{context}')"))?;
    out.add(format_args!(
        "APPLICATION_PROTOCOL_DEFINITION('international standard','{protocol}',{year},{application})"
    ))?;
    let product_context = out.add(format_args!("PRODUCT_CONTEXT('',{application},'mechanical')"))?;
    let product = out.add(format_args!("PRODUCT({name},{name},'',({product_context}))"))?;
    out.add(format_args!("PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,({product}))"))?;
    let formation = out.add(format_args!("PRODUCT_DEFINITION_FORMATION('','',{product})"))?;
    let definition_context =
        out.add(format_args!("PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')"))?;
    let definition =
        out.add(format_args!("PRODUCT_DEFINITION('design','',{formation},{definition_context})"))?;
    let shape = out.add(format_args!("PRODUCT_DEFINITION_SHAPE('','',{definition})"))?;

    // The chain above names the product; the representation below holds its shape.
    let geometry_context = write_context(&mut out, options)?;
    let placement = write_placement(&mut out)?;
    // The kind of representation depends on whether the items are solids.
    let (items, is_solid) = write_items(&mut out, what, &name)?;
    let kind = match is_solid {
        true => "ADVANCED_BREP_SHAPE_REPRESENTATION",
        false => "MANIFOLD_SURFACE_SHAPE_REPRESENTATION",
    };
    let listed: String = items.iter().map(|item| format!(",{item}")).collect();
    let representation = out.add(format_args!("{kind}({name},({placement}{listed}),{geometry_context})"))?;
    out.add(format_args!("SHAPE_DEFINITION_REPRESENTATION({shape},{representation})"))?;
    writeln!(writer, "ENDSEC;\nEND-ISO-10303-21;")
}

/// Writes the shape; returns one item per body, and whether they are solids.
fn write_items<W: Write>(out: &mut Part21<W>, what: Shape, name: &str) -> io::Result<(Vec<Id>, bool)> {
    let solid = match what {
        Shape::Splines(brep) => {
            let shells = write_shells(out, brep)?;
            if !brep.closed {
                let model = out.add_list(&format!("SHELL_BASED_SURFACE_MODEL({name},"), &shells)?;
                return Ok((vec![model], false));
            }
            let solids: io::Result<Vec<Id>> = shells
                .iter()
                .map(|shell| out.add(format_args!("MANIFOLD_SOLID_BREP({name},{shell})")))
                .collect();
            return Ok((solids?, true));
        }
        Shape::Solid(solid) => solid,
    };
    let mut items = Vec::new();
    for shells in solid::write_bodies(out, solid)? {
        let Some((outer, voids)) = shells.split_first() else {
            continue;
        };
        if voids.is_empty() {
            items.push(out.add(format_args!("MANIFOLD_SOLID_BREP({name},{outer})"))?);
            continue;
        }
        let mut oriented = Vec::with_capacity(voids.len());
        for void in voids {
            // The faces of voids already point out of the material, so their shells are not reversed.
            oriented.push(out.add(format_args!("ORIENTED_CLOSED_SHELL('',*,{void},.T.)"))?);
        }
        items.push(out.add_list(&format!("BREP_WITH_VOIDS({name},{outer},"), &oriented)?);
    }
    match items.is_empty() {
        true => Err(io::Error::other("expected a solid with faces, found none")),
        false => Ok((items, true)),
    }
}

/// Writes the context: units and uncertainty.
fn write_context<W: Write>(out: &mut Part21<W>, options: &StepOptions) -> io::Result<Id> {
    // `NAMED_UNIT(*)`: the dimensions of an SI unit are derived from its name.
    let length = match options.unit {
        Unit::Millimetre => out.add(format_args!("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))"))?,
        Unit::Metre => out.add(format_args!("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT($,.METRE.))"))?,
        // STEP has only SI units; others are defined by a conversion.
        Unit::Inch | Unit::Foot => {
            let millimetre = out.add(format_args!("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))"))?;
            let (name, length) = match options.unit {
                Unit::Foot => ("FOOT", "304.8"),
                _ => ("INCH", "25.4"),
            };
            let measure =
                out.add(format_args!("LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE({length}),{millimetre})"))?;
            let dimensions = out.add(format_args!("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)"))?;
            out.add(format_args!(
                "(CONVERSION_BASED_UNIT('{name}',{measure})LENGTH_UNIT()NAMED_UNIT({dimensions}))"
            ))?
        }
    };
    let angle = out.add(format_args!("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))"))?;
    // No solid angle occurs, but application protocols require its unit.
    let solid_angle = out.add(format_args!("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())"))?;
    let uncertainty = out.add(format_args!(
        "UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE({}),{length},'distance_accuracy_value','')",
        reals(&[options.uncertainty])
    ))?;
    out.add(format_args!(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({uncertainty}))\
         GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid_angle}))REPRESENTATION_CONTEXT('',''))"
    ))
}

/// Writes the frame of the part, which is that of the world.
fn write_placement<W: Write>(out: &mut Part21<W>) -> io::Result<Id> {
    let origin = write_point(out, DVec3::ZERO)?;
    let z = out.add(format_args!("DIRECTION('',(0.,0.,1.))"))?;
    let x = out.add(format_args!("DIRECTION('',(1.,0.,0.))"))?;
    out.add(format_args!("AXIS2_PLACEMENT_3D('',{origin},{z},{x})"))
}

fn write_point<W: Write>(out: &mut Part21<W>, point: DVec3) -> io::Result<Id> {
    out.add(format_args!("CARTESIAN_POINT('',({}))", reals(point.as_ref())))
}

/// Writes control points as consecutive instances; returns the first.
fn write_poles<W: Write>(out: &mut Part21<W>, poles: &[DVec3]) -> io::Result<Id> {
    let first = out.next_id();
    for pole in poles {
        write_point(out, *pole)?;
    }
    Ok(first)
}

fn multiplicities(knots: &[(f64, usize)]) -> Vec<usize> {
    knots.iter().map(|k| k.1).collect()
}

fn values(knots: &[(f64, usize)]) -> Vec<f64> {
    knots.iter().map(|k| k.0).collect()
}

fn write_curve<W: Write>(out: &mut Part21<W>, curve: &BsplineCurve) -> io::Result<Id> {
    // The form and the two flags (closed, self-intersecting) are for information only in ISO 10303-42, so
    // fixed values are valid for any curve.
    let first = write_poles(out, &curve.poles)?;
    out.add(format_args!(
        "B_SPLINE_CURVE_WITH_KNOTS('',{},({}),.UNSPECIFIED.,.F.,.F.,({}),({}),.UNSPECIFIED.)",
        curve.degree,
        first.run(curve.poles.len()),
        integers(&multiplicities(&curve.knots)),
        reals(&values(&curve.knots))
    ))
}

fn write_surface<W: Write>(out: &mut Part21<W>, surface: &BsplineSurface) -> io::Result<Id> {
    let first = write_poles(out, &surface.poles)?;
    let id = out.begin()?;
    let to = out.writer();
    write!(to, "B_SPLINE_SURFACE_WITH_KNOTS('',{},{},(", surface.degree_u, surface.degree_v)?;
    for row in 0..surface.n_u {
        // One line per row: a whole net in one line is too long for text editors.
        let comma = if row > 0 { ",\n" } else { "" };
        write!(to, "{comma}({})", first.after(row * surface.n_v).run(surface.n_v))?;
    }
    write!(
        to,
        "),.UNSPECIFIED.,.F.,.F.,.F.,({}),({}),({}),({}),.UNSPECIFIED.)",
        integers(&multiplicities(&surface.knots_u)),
        integers(&multiplicities(&surface.knots_v)),
        reals(&values(&surface.knots_u)),
        reals(&values(&surface.knots_v))
    )?;
    out.end()?;
    Ok(id)
}

/// Writes a shell for each set of faces that share edges.
fn write_shells<W: Write>(out: &mut Part21<W>, brep: &Brep) -> io::Result<Vec<Id>> {
    // Vertices and edges are written once and shared, by which readers recognise a closed shell.
    let mut vertices = Vec::with_capacity(brep.vertices.len());
    for vertex in &brep.vertices {
        let point = write_point(out, *vertex)?;
        vertices.push(out.add(format_args!("VERTEX_POINT('',{point})"))?);
    }
    let mut edges = Vec::with_capacity(brep.edges.len());
    for edge in &brep.edges {
        let curve = write_curve(out, &edge.curve)?;
        let (start, end) = (vertices[edge.start], vertices[edge.end]);
        edges.push(out.add(format_args!("EDGE_CURVE('',{start},{end},{curve},.T.)"))?);
    }
    let mut faces = Vec::with_capacity(brep.faces.len());
    for face in &brep.faces {
        let surface = write_surface(out, &face.surface)?;
        let mut bounds = vec![write_bound(out, "FACE_OUTER_BOUND", &face.edges, &edges)?];
        for hole in &face.holes {
            bounds.push(write_bound(out, "FACE_BOUND", hole, &edges)?);
        }
        let bounds: Vec<String> = bounds.iter().map(Id::to_string).collect();
        let sense = if face.same_sense { "T" } else { "F" };
        faces.push(out.add(format_args!("ADVANCED_FACE('',({}),{surface},.{sense}.)", bounds.join(",")))?);
    }
    let shells = brep.shells().into_iter().map(|shell| {
        let kind = if brep.is_closed(&shell) { "CLOSED_SHELL(''," } else { "OPEN_SHELL(''," };
        let own: Vec<Id> = shell.into_iter().map(|face| faces[face]).collect();
        out.add_list(kind, &own)
    });
    shells.collect()
}

/// Writes one loop of a face over edges that were written.
fn write_bound<W: Write>(
    out: &mut Part21<W>,
    kind: &str,
    ring: &[(usize, bool)],
    edges: &[Id],
) -> io::Result<Id> {
    // Each face refers to the shared edge with its own direction.
    let mut oriented = Vec::with_capacity(ring.len());
    for &(edge, forward) in ring {
        // The two `*` are the ends, which are derived from the edge.
        let sense = if forward { "T" } else { "F" };
        oriented.push(out.add(format_args!("ORIENTED_EDGE('',*,*,{},.{sense}.)", edges[edge]))?);
    }
    let ring = out.add_list("EDGE_LOOP('',", &oriented)?;
    out.add(format_args!("{kind}('',{ring},.T.)"))
}
