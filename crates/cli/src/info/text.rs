//! The summary of `planish info`.

use crate::lines::{Align, Lines, sensor_cells};
use crate::numbers::{count, counted, percent, significant};
use planish::info::{BoxInfo, Contents, FacesInfo, FileInfo, MeshInfo, ModelInfo, ScanInfo, ScanListInfo};
use planish::{DVec3, Unit};
use std::path::Path;

/// Formats lengths and boxes in the unit of the file.
struct Lengths(Option<Unit>);

impl Lengths {
    fn name(&self) -> &'static str {
        self.0.map_or("", Unit::name)
    }

    // Without a unit in the file, no default is added: it would look like a statement of the file.
    fn length(&self, value: f64) -> String {
        format!("{} {}", significant(value, 4), self.name()).trim_end().to_owned()
    }

    /// An area or a volume: `power` is the exponent of the unit.
    fn power(&self, value: f64, power: char) -> String {
        // Without a unit, an exponent would look like one of the number.
        self.0
            .map_or_else(|| significant(value, 4), |unit| format!("{} {unit}{power}", significant(value, 4)))
    }

    fn bounds(&self, found: &Option<BoxInfo>) -> String {
        let Some(BoxInfo { min, max }) = found else {
            return String::new();
        };
        let size = [0, 1, 2].map(|d| significant(max[d] - min[d], 4)).join(" × ");
        let corner = |p: &DVec3| p.to_array().map(|c| significant(c, 4)).join(", ");
        // A file without a unit leaves two blanks in its place.
        format!("{size} {} from ({}) to ({})", self.name(), corner(min), corner(max)).replace("  ", " ")
    }
}

/// The summary of a file.
pub fn text(file: &Path, found: &FileInfo) -> String {
    let mut lines = Lines::default();
    let lengths = Lengths(found.unit);
    let file = file.display();
    match &found.contents {
        Contents::Scan(scan) => {
            lines.line(format!("{file}: a scan of {}.", counted(scan.points, "point")));
            lines.gap();
            scan_text(&mut lines, scan, &lengths);
        }
        Contents::Scans(list) => {
            lines.line(format!(
                "{file}: a list of {} with {}.",
                counted(list.scans.len(), "scan"),
                counted(list.points, "point")
            ));
            lines.gap();
            list_text(&mut lines, list, &lengths);
        }
        Contents::Mesh(mesh) => {
            lines.line(format!(
                "{file}: a mesh of {} and {} vertices.",
                counted(mesh.triangles, "triangle"),
                count(mesh.vertices)
            ));
            lines.gap();
            mesh_text(&mut lines, mesh, &lengths);
        }
        Contents::Model(model) => {
            lines.line(format!(
                "{file}: a model of a {} with {} control vertices.",
                model.topology,
                count(model.coefficients)
            ));
            lines.gap();
            model_text(&mut lines, model, &lengths);
        }
    }
    lines.into_text()
}

fn unit_or_unknown(lengths: &Lengths) -> String {
    lengths.0.map_or("not specified in the file".to_owned(), |u| u.name().to_owned())
}

fn scan_text(lines: &mut Lines, scan: &ScanInfo, lengths: &Lengths) {
    lines.facts([
        ("unit", unit_or_unknown(lengths)),
        ("columns", scan.columns.join(" ")),
        ("box", lengths.bounds(&scan.bounds)),
        ("grid", grid(scan)),
        ("viewing direction", scan.viewing.clone()),
        (
            "not finite",
            match scan.dropped_not_finite {
                0 => String::new(),
                n => counted(n, "record"),
            },
        ),
    ]);
}

fn grid(scan: &ScanInfo) -> String {
    scan.grid.map_or("none".to_owned(), |grid| {
        // An empty grid has no cells to divide by.
        let cells = (grid.columns * grid.rows).max(1) as f64;
        format!("{} × {}, {} filled", grid.columns, grid.rows, percent(grid.filled as f64 / cells))
    })
}

fn list_text(lines: &mut Lines, list: &ScanListInfo, lengths: &Lengths) {
    lines.facts([("unit", unit_or_unknown(lengths)), ("box", lengths.bounds(&list.bounds))]);
    lines.gap();
    let sigma = |value: Option<f64>, of_points: bool| match value {
        // A σ per point overrides that of the sensor, so it comes first.
        _ if of_points => "per point".to_owned(),
        None => "estimated by fit".to_owned(),
        Some(value) => lengths.length(value),
    };
    let rows: Vec<Vec<String>> = list
        .sensors
        .iter()
        .map(|s| {
            vec![
                s.name.clone(),
                s.kind.clone(),
                sigma(s.sigma_along, s.sigma_of_points),
                sigma(s.sigma_across, s.sigma_of_points),
                count(s.scans),
            ]
        })
        .collect();
    lines.table(
        &[
            ("sensor", Align::Left),
            ("kind", Align::Left),
            ("σ along", Align::Right),
            ("across", Align::Right),
            ("scans", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    let rows: Vec<Vec<String>> = list
        .scans
        .iter()
        .map(|s| {
            vec![
                s.scan.name.clone(),
                s.sensor.clone(),
                count(s.scan.points),
                grid(&s.scan),
                s.translation.to_array().map(|c| significant(c, 4)).join(", "),
                s.sigma_translation.map_or("exact".to_owned(), |s| lengths.length(s)),
            ]
        })
        .collect();
    lines.table(
        &[
            ("scan", Align::Left),
            ("sensor", Align::Left),
            ("points", Align::Right),
            ("grid", Align::Left),
            ("position", Align::Left),
            ("σ of pose", Align::Right),
        ],
        &rows,
    );
}

fn mesh_text(lines: &mut Lines, mesh: &MeshInfo, lengths: &Lengths) {
    let kind = if mesh.watertight {
        "watertight".to_owned()
    } else {
        format!("open, {}", counted(mesh.boundary_edges, "boundary edge"))
    };
    lines.facts([
        ("unit", unit_or_unknown(lengths)),
        ("faces", mesh.faces.as_ref().map_or(String::new(), faces)),
        ("columns", mesh.columns.join(" ")),
        ("box", lengths.bounds(&mesh.bounds)),
        (
            "topology",
            format!(
                "{kind}, {}, {}",
                if mesh.manifold { "manifold" } else { "not manifold" },
                counted(mesh.components, "part")
            ),
        ),
        ("area", lengths.power(mesh.area, '²')),
        // Only a closed and consistently oriented mesh has a volume.
        ("volume", mesh.volume.map_or(String::new(), |v| lengths.power(v, '³'))),
        (
            "σ",
            mesh.sigma.map_or(String::new(), |s| {
                format!(
                    "median {}, 95 % below {}, largest {}",
                    lengths.length(s.median),
                    lengths.length(s.p95),
                    lengths.length(s.max)
                )
            }),
        ),
        (
            "measured",
            // Meshes of other programs lack the column `observed`.
            mesh.observed_vertex_fraction
                .map_or(String::new(), |f| format!("{} of the vertices", percent(f))),
        ),
    ]);
}

/// Numbers of faces by kind; the triangles follow from them.
fn faces(found: &FacesInfo) -> String {
    let kinds: Vec<String> = found.kinds.iter().map(|(kind, n)| format!("{} {kind}", count(*n))).collect();
    kinds.join(", ")
}

fn model_text(lines: &mut Lines, model: &ModelInfo, lengths: &Lengths) {
    lines.facts([
        ("unit", unit_or_unknown(lengths)),
        (
            "grid",
            format!(
                "{} × {} cells, refined to {} in {}",
                model.base[0],
                model.base[1],
                count(model.cells),
                counted(model.levels, "level")
            ),
        ),
        ("box", lengths.bounds(&model.bounds)),
        ("area", lengths.power(model.area, '²')),
        ("measured", format!("{} of the area", percent(model.observed_area_fraction))),
        (
            "completed",
            match model.inferred_area_fraction {
                // Exactly 0 if nothing was completed, so the comparison needs no tolerance.
                0.0 => String::new(),
                share => format!("{} of the area, inferred from other parts", percent(share)),
            },
        ),
        (
            "σ",
            format!(
                "median {}, 95 % below {}, largest {}",
                lengths.length(model.sigma.median),
                lengths.length(model.sigma.p95),
                lengths.length(model.sigma.max)
            ),
        ),
        ("readings", count(model.observations)),
    ]);
    lines.gap();
    // The cells are those of the summary of `fit`, so that both can be compared.
    let rows: Vec<Vec<String>> = model.sensors.iter().map(|sensor| sensor_cells(sensor).to_vec()).collect();
    lines.table(
        &[
            ("sensor", Align::Left),
            ("readings", Align::Right),
            ("σ stated", Align::Right),
            ("estimated", Align::Right),
            ("used", Align::Left),
        ],
        &rows,
    );
    for (k, session) in model.sessions.iter().enumerate() {
        lines.gap();
        lines.line(format!(
            "Session {}: planish {} (version {}, seed {})",
            k + 1,
            session.arguments.join(" "),
            session.version,
            session.seed
        ));
        // Lists of files have no points of their own.
        for input in session.inputs.iter().filter(|input| input.points > 0) {
            lines.line(format!("  {}: {}", input.name, counted(input.points, "point")));
        }
    }
}
