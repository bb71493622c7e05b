//! Content of a viewed file: its surfaces or points as a scene, with the fields that can colour it.

use super::own_colours::{Texture, vertex_colours};
use crate::compare::page::{compared_scene, known_mesh_scene};
use crate::compare::{CompareOptions, Compared, ComparedMesh, Reference, compared};
use crate::report::scenes::{kinds, model_scene_of, numbers};
use planish_core::Progress;
use planish_core::{DVec3, Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::{has_faces, read_mesh};
use planish_exchange::{Unit, extension, read_inputs};
use planish_mesh::BoundingBox;
use planish_report::numbers::{count, counted, significant};
use planish_report::{Cloud, Field, FieldKind, Scene};
use planish_surface::model::SurfaceTopology;
use std::path::{Path, PathBuf};

/// Maximum number of points that are drawn. It bounds memory; a picture has fewer pixels anyway.
const MAX_POINTS: usize = 3_000_000;

/// A file to view and, optionally, the reference that it is compared with.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ViewedFile {
    /// A saved model, a mesh, points or scans.
    pub file: PathBuf,
    /// A mesh or points: the model is coloured by its deviations from them.
    pub reference: Option<PathBuf>,
    /// Comparison options, and the unit of files that name none.
    pub compare: CompareOptions,
}

/// A file as a scene.
pub(super) struct ViewedContent {
    pub scene: Scene,
    /// Normals of the points of the first cloud, if all are known.
    pub normals: Option<Vec<DVec3>>,
    /// The texture of the first surface, if its field `rgb` comes from one.
    pub texture: Option<Texture>,
    /// One sentence that describes the content.
    pub headline: String,
    /// Every file that was read.
    pub inputs: Vec<(PathBuf, String)>,
    pub unit: Option<Unit>,
    pub findings: Vec<Finding>,
}

impl ViewedContent {
    /// Reads a file. Models become about `triangles` triangles; clouds keep at most `points` points.
    pub(super) fn read(
        viewed: &ViewedFile,
        triangles: u64,
        points: usize,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let path = &viewed.file;
        progress.check("reading", 0.0)?;
        let ending = extension(path);
        let (mut colours, mut texture, mut findings) = (None, None, Vec::new());
        let model = if ending == "planish" {
            Compared::read(path)?.with_unit_if_unstated(viewed.compare.unit)
        } else if has_faces(path) {
            let file = read_mesh(path)?;
            colours = vertex_colours(&file.columns);
            // Formats of meshes can contain points only.
            if file.triangles.is_empty() {
                return Self::from_points(viewed, points.min(MAX_POINTS), colours);
            }
            if ["obj", "glb"].contains(&ending.as_str()) {
                // A second reading, because other readers need no texture.
                (texture, findings) = Texture::read(path, &file)?;
                colours = texture.as_ref().map(|texture| texture.at_vertices(file.points.len()));
            }
            Compared::Mesh(ComparedMesh::from_file(file, path)?)
        } else {
            return Self::from_points(viewed, points.min(MAX_POINTS), None);
        };
        let mut made = match &viewed.reference {
            Some(reference) => Self::compared(&model, reference, viewed, triangles, progress)?,
            None => Self { scene: model_or_mesh(&model, viewed.compare.unit, triangles)?, ..Self::empty() },
        };
        if let (Some(colours), [surface, ..]) = (colours, &mut made.scene.surfaces[..])
            && colours.len() == surface.positions.len()
        {
            surface.fields.push(rgb(colours));
            made.texture = texture;
        }
        made.findings.append(&mut findings);
        made.unit = model.unit().or(viewed.compare.unit);
        made.headline = match &model {
            Compared::Surface(model) => format!(
                "A {} of {}.",
                SurfaceTopology::of(model.surface.space()),
                counted(model.surface.vertices().len(), "control vertex")
            ),
            Compared::Mesh(mesh) => format!(
                "A mesh of {} and {} vertices.",
                counted(mesh.mesh.triangles.len(), "triangle"),
                count(mesh.mesh.positions.len())
            ),
        };
        made.inputs.insert(0, (path.clone(), "what is shown".to_owned()));
        Ok(made)
    }

    fn empty() -> Self {
        Self {
            scene: Scene::default(),
            normals: None,
            texture: None,
            headline: String::new(),
            inputs: Vec::new(),
            unit: None,
            findings: Vec::new(),
        }
    }

    /// A model with its deviations from a reference.
    fn compared(
        model: &Compared,
        reference: &Path,
        viewed: &ViewedFile,
        triangles: u64,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let (report, shown) = compared(model, Reference::read(reference)?, &viewed.compare, progress)?;
        // The same scene as in the report of a comparison.
        let scene = compared_scene(model, &report, shown, &viewed.compare, triangles)?;
        Ok(Self {
            scene,
            inputs: vec![(reference.to_path_buf(), "the reference".to_owned())],
            findings: report.findings,
            ..Self::empty()
        })
    }

    /// Points of scans. `colours` are those of the points of the file, in its order.
    fn from_points(viewed: &ViewedFile, max_points: usize, colours: Option<Vec<f64>>) -> Result<Self> {
        let path = &viewed.file;
        // An error, because a picture without the requested deviations would look complete.
        if viewed.reference.is_some() {
            return Err(Error::unsupported(format!(
                "{}: expected a model with a surface, found points only: deviations are those of a surface \
                 from a reference",
                path.display()
            )));
        }
        let set = read_inputs(&[path], viewed.compare.unit)?;
        let unit = set.unit.or(viewed.compare.unit);
        let name = unit.map_or("", Unit::name);
        let all = Reference::from_scans(&set);
        if all.points.is_empty() {
            return Err(Error::input(format!("{}: expected points, found none", path.display())));
        }
        let step = all.points.len().div_ceil(max_points);
        // Every nth point: deterministic, and even along the path of a scanner.
        let kept = || (0..all.points.len()).step_by(step);
        let mut fields = Vec::new();
        // All or none: a mixture of lit and unlit dots would look like shape.
        let normals = (all.normals.as_ref()).filter(|normals| normals.iter().all(|n| n.length() > 0.0));
        if let Some(covariance) = &all.covariance {
            let (label, sigma): (_, Vec<f64>) = match normals {
                Some(normals) => {
                    ("σ along the normal", kept().map(|k| covariance[k].along(normals[k]).sqrt()).collect())
                }
                None => (
                    "σ, mean over directions",
                    kept().map(|k| (covariance[k].trace() / 3.0).sqrt()).collect(),
                ),
            };
            // σ = 0 stands for unknown. As a value, it would fix the lower end of the colour scale.
            let known = sigma.iter().map(|s| if *s > 0.0 { *s } else { f64::NAN }).collect();
            fields.push(numbers("sigma", label, name, FieldKind::Sequential, known));
        }
        if set.scans.len() > 1 {
            let names = set.scans.iter().enumerate();
            let of_point: Vec<u16> = (names.clone())
                // Points are in the order of the scans.
                .flat_map(|(k, posed)| std::iter::repeat_n(k as u16, posed.scan.points.len()))
                .collect();
            fields.push(kinds(
                "scan",
                "scan",
                FieldKind::Categories(names.map(|(k, posed)| (k as u16, posed.scan.name.clone())).collect()),
                kept().map(|k| of_point[k]).collect(),
            ));
        }
        // A reader may have dropped points, whose colours would then belong to others.
        if let Some(colours) = colours.filter(|colours| colours.len() == all.points.len()) {
            fields.push(rgb(kept().map(|k| colours[k]).collect()));
        }
        // Always there, so that a plain cloud is readable, too.
        let heights = kept().map(|k| all.points[k][2]).collect();
        fields.push(numbers("height", "z", name, FieldKind::Sequential, heights));
        let mut findings = Vec::new();
        if step > 1 {
            findings.push(Finding::new(
                FindingCode::PointsThinned,
                format!(
                    "of {} points {} are shown, evenly sampled",
                    count(all.points.len()),
                    count(kept().count())
                ),
            ));
        }
        let scene = Scene {
            unit: name.to_owned(),
            clouds: vec![Cloud {
                name: "points".to_owned(),
                positions: kept().map(|k| all.points[k]).collect(),
                fields,
                width: 2,
                ..Cloud::default()
            }],
            ..Scene::default()
        };
        Ok(Self {
            normals: normals.map(|normals| kept().map(|k| normals[k]).collect()),
            texture: None,
            scene,
            headline: format!(
                "{} of {}.",
                counted(all.points.len(), "point"),
                counted(set.scans.len(), "scan")
            ),
            inputs: (set.inputs.iter())
                .map(|input| (input.path.clone(), counted(input.points, "point")))
                .collect(),
            unit,
            findings,
        })
    }

    /// Positions of everything that is visible initially.
    pub(super) fn places(&self) -> Vec<DVec3> {
        let surfaces = self.scene.surfaces.iter().filter(|s| !s.hidden);
        let clouds = self.scene.clouds.iter().filter(|c| !c.hidden);
        (surfaces.flat_map(|s| &s.positions)).chain(clouds.flat_map(|c| &c.positions)).copied().collect()
    }

    /// Size of the bounding box, with the unit.
    pub(super) fn size(&self) -> String {
        BoundingBox::from_points(&self.places()).map_or(String::new(), |b| {
            let size = [0, 1, 2].map(|d| significant(b.max[d] - b.min[d], 3)).join(" × ");
            format!("{size} {}", self.scene.unit).trim_end().to_owned()
        })
    }
}

/// The field of the colours of a file.
fn rgb(colours: Vec<f64>) -> Field {
    numbers("rgb", "colour of the file", "", FieldKind::Colours, colours)
}

fn model_or_mesh(model: &Compared, unit: Option<Unit>, triangles: u64) -> Result<Scene> {
    match model {
        Compared::Surface(model) => Ok(model_scene_of(model, &model.posterior()?, None, None, triangles)?.0),
        Compared::Mesh(mesh) => Ok(known_mesh_scene(mesh, mesh.unit.or(unit).map_or("", Unit::name))),
    }
}
