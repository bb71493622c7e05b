//! The report of a comparison.

use crate::compare::{CompareOptions, Compared, ComparedMesh, ComparisonReport, ShownReference};
use crate::report::scenes::{MAX_TRIANGLES, curvature_fields, model_scene_of, numbers, observed_field};
use crate::report::words::SmallUnit;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_report::numbers::{count, percent, significant};
use planish_report::{
    Block, Cloud, Field, FieldKind, Figure, Page, Scene, Section, SurfaceShown, Table, plot,
};
use planish_surface::model::Observed;
use std::path::Path;

/// Maximum number of points of the reference that are drawn.
const MAX_POINTS: usize = 20_000;

/// The page of a comparison of a model with a reference, by their names.
pub(crate) fn compare_page(
    model: &Compared,
    report: &ComparisonReport,
    shown: ShownReference,
    options: &CompareOptions,
    [model_name, reference_name]: [&Path; 2],
) -> Result<Page> {
    let names = [model_name, reference_name].map(crate::report::file_name);
    let model_unit = report.unit.name();
    // Forward deviations exist only if the reference has faces.
    let main = report.forward.or(report.backward);
    let unit = SmallUnit::for_length(model_unit, main.map_or(1.0, |d| d.rms));
    let normalised = shown.normalised.clone();
    let scene = compared_scene(model, report, shown, options, MAX_TRIANGLES)?;
    let mut figures = Vec::new();
    if let Some(d) = main {
        figures.push(Figure::new(
            "deviations, rms",
            unit.text(d.rms),
            format!("95 % below {}", unit.text(d.p95)),
        ));
        figures.push(Figure::new("mean", unit.text(d.mean), "0 without bias"));
        figures.push(Figure::new("largest", unit.text(d.max), format!("of {} points", count(d.n))));
    }
    if let Some(share) = report.coverage95 {
        figures.push(Figure::new("within 1.96 σ", percent(share), "95 % if σ is correct"));
    }
    Ok(Page {
        job: "compare".to_owned(),
        title: names[0].clone(),
        headline: format!(
            "Deviations from {}; positive on the side that the normals of {} point to.",
            names[1], names[1]
        ),
        findings: report.findings.clone(),
        figures,
        scene: Some(scene),
        drawings: Vec::new(),
        sections: vec![
            distance_section(report, unit),
            coverage_section(&normalised, report),
            section_of_skipped(report),
        ],
    })
}

/// A model coloured by its deviations from a reference, with the reference's points and mesh. The model is
/// meshed with at most about `triangles` triangles.
pub(crate) fn compared_scene(
    model: &Compared,
    report: &ComparisonReport,
    shown: ShownReference,
    options: &CompareOptions,
    triangles: u64,
) -> Result<Scene> {
    let model_unit = report.unit.name();
    let mut scene = match model {
        Compared::Surface(model) => model_scene_of(model, &model.posterior()?, None, None, triangles)?.0,
        Compared::Mesh(mesh) => known_mesh_scene(mesh, model_unit),
    };
    // Cells and control vertices are about the model itself and would hide deviations.
    scene.lines.clear();
    scene.clouds.clear();
    if let (Some(reference), Some(surface)) = (&shown.mesh, scene.surfaces.first_mut()) {
        let observed: Option<Vec<u8>> = match model {
            Compared::Mesh(mesh) => (mesh.observed.as_ref()).map(|o| o.iter().map(|o| o.mark()).collect()),
            Compared::Surface(_) => marks_of(surface),
        };
        let field = deviation_field(reference, &surface.positions, observed.as_deref(), options, model_unit)?;
        // The first field colours the initial view.
        surface.fields.insert(0, field);
    }
    scene.clouds.push(reference_cloud(&shown, model_unit));
    // The deviations are shown on the points of a reference without faces.
    if shown.mesh.is_none() {
        scene.clouds[0].hidden = false;
    }
    if let Some(mesh) = shown.mesh {
        scene.surfaces.push(SurfaceShown {
            name: "reference".to_owned(),
            positions: mesh.positions,
            triangles: mesh.triangles,
            hidden: true,
            translucent: true,
            ..SurfaceShown::default()
        });
    }
    Ok(scene)
}

/// The marks of `observed` that a surface is coloured by.
fn marks_of(surface: &SurfaceShown) -> Option<Vec<u8>> {
    let field = surface.fields.iter().find(|field| field.key == "observed")?;
    match &field.values {
        planish_report::Values::Kinds(kinds) => Some(kinds.iter().map(|k| *k as u8).collect()),
        planish_report::Values::Numbers(_) => None,
    }
}

/// A mesh with the fields of its vertices.
pub(crate) fn known_mesh_scene(mesh: &ComparedMesh, unit: &str) -> Scene {
    let mut fields = Vec::new();
    if let Some(sigma) = &mesh.sigma {
        fields.push(numbers("sigma", "σ along the normal", unit, FieldKind::Sequential, sigma.clone()));
    }
    if let Some(observed) = &mesh.observed {
        fields.push(observed_field(&observed.iter().map(|o| o.mark()).collect::<Vec<u8>>()));
    }
    fields.extend(curvature_fields(mesh.curvature.clone(), unit));
    Scene {
        unit: unit.to_owned(),
        surfaces: vec![SurfaceShown {
            name: "model".to_owned(),
            positions: mesh.mesh.positions.clone(),
            triangles: mesh.mesh.triangles.clone(),
            fields,
            ..SurfaceShown::default()
        }],
        ..Scene::default()
    }
}

/// Signed distances of vertices from the reference; not finite where they are not compared.
fn deviation_field(
    reference: &TriangleMesh,
    vertices: &[DVec3],
    observed: Option<&[u8]>,
    options: &CompareOptions,
    unit: &str,
) -> Result<Field> {
    let feet = MeshSearch::try_new(reference)?.closest_all(vertices);
    let is_compared = |k: usize| {
        let known = observed.map_or(Some(Observed::Measured), |marks| Observed::from_mark(marks[k]));
        options.part.holds(known.unwrap_or_default())
    };
    let deviations = (feet.into_iter().enumerate())
        .map(|(k, foot)| match foot {
            Some(foot) if !foot.on_boundary && is_compared(k) => foot.signed_distance,
            // The same rules as for the figures, so that colours and numbers agree.
            _ => f64::NAN,
        })
        .collect();
    Ok(numbers("deviation", "deviation", unit, FieldKind::Signed(None), deviations))
}

fn reference_cloud(shown: &ShownReference, unit: &str) -> Cloud {
    // Every nth point, so that the selection is the same in every run.
    let step = shown.points.len().div_ceil(MAX_POINTS).max(1);
    let some = |values: &[f64]| values.iter().copied().step_by(step).collect::<Vec<f64>>();
    let mut fields = vec![numbers(
        "deviation",
        "deviation of the model",
        unit,
        FieldKind::Signed(None),
        some(&shown.deviations),
    )];
    // A field without any value would be an empty choice.
    if shown.normalised.iter().any(|v| v.is_finite()) {
        fields.push(numbers(
            "normalised",
            "normalised deviation",
            "",
            FieldKind::Signed(Some(4.0)),
            some(&shown.normalised),
        ));
    }
    Cloud {
        name: "reference points".to_owned(),
        positions: shown.points.iter().copied().step_by(step).collect(),
        fields,
        hidden: true,
        width: 3,
    }
}

fn distance_section(report: &ComparisonReport, unit: SmallUnit<'_>) -> Section {
    let rms = unit.head("rms");
    let mut table = Table::new(["", &rms, "mean", "median |d|", "95 % |d|", "largest |d|", "points"]);
    for (name, found) in [("model to reference", &report.forward), ("reference to model", &report.backward)] {
        let Some(d) = found else { continue };
        let [a, b, c, e, f] = [d.rms, d.mean, d.p50, d.p95, d.max].map(|v| unit.number(v, 3));
        table.row([name.to_owned(), a, b, c, e, f, count(d.n)], false);
    }
    Section::new("Deviations", vec![Block::Table(table)])
}

fn coverage_section(normalised: &[f64], report: &ComparisonReport) -> Section {
    // The plot is empty if no deviation has a σ.
    let svg = plot::normalised_residuals(normalised);
    let blocks = if svg.is_empty() {
        vec![Block::Text("The model has no σ.".to_owned())]
    } else {
        let mean_square = {
            // Points without σ are marked by NaN.
            let known: Vec<f64> = normalised.iter().copied().filter(|v| v.is_finite()).collect();
            known.iter().map(|v| v * v).sum::<f64>() / known.len().max(1) as f64
        };
        vec![
            Block::Drawing {
                svg,
                caption: "Normalised deviations of the reference points (bars) and the normal \
                    distribution, which they follow if σ is correct (line)."
                    .to_owned(),
            },
            Block::Text(format!(
                "Normalised rms of the deviations: {}; {} of them lie within 1.96 σ.",
                significant(mean_square.sqrt(), 3),
                percent(report.coverage95.unwrap_or(f64::NAN))
            )),
        ]
    };
    Section::new("Consistency of σ", blocks)
}

fn section_of_skipped(report: &ComparisonReport) -> Section {
    let skipped = report.skipped;
    let causes = [
        (skipped.model_not_observed, "points of the model that were not measured or belong to another part"),
        (skipped.model_beyond_border, "points of the model beyond a boundary of the reference"),
        (skipped.reference_not_observed, "points of the reference nearest to such a part of the model"),
        (skipped.reference_beyond_border, "points of the reference beyond a boundary of the model"),
    ];
    let lines: Vec<Block> = (causes.into_iter())
        // Causes that did not occur are not listed.
        .filter(|(n, _)| *n > 0)
        .map(|(n, what)| Block::Text(format!("{} {what}.", count(n))))
        .collect();
    Section::new(
        "Points that were not compared",
        if lines.is_empty() { vec![Block::Text("None.".to_owned())] } else { lines },
    )
}
