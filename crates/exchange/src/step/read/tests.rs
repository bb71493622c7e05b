//! Reads files of Open Cascade 7.9 (`tests/data`, created by `benches/peers/step_files.py`, which prints area
//! and volume), and small files that are written here.

use super::*;
use planish_core::DVec3;
use planish_mesh::{MeshCheck, TriangleMesh};
use std::path::PathBuf;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(format!("{name}.step.gz"))
}

fn triangles(faces: &StepFaces, share: f64) -> StepMesh {
    let fineness = Fineness { chord: share * faces.size(), longest: f64::INFINITY };
    faces.triangles(&fineness).unwrap()
}

/// Area, volume and check of a part.
fn measured(part: &PolygonMesh) -> (f64, f64, MeshCheck) {
    let mesh = TriangleMesh::try_new(part.points.clone(), part.triangles.clone()).unwrap();
    let (mut area, mut volume) = (0.0, 0.0);
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        let n = (b - a).cross(c - a);
        area += 0.5 * n.length();
        volume += a.dot(n) / 6.0;
    }
    (area, volume, mesh.check())
}

fn near(found: f64, truth: f64, share: f64) {
    assert!((found / truth - 1.0).abs() < share, "{found} is not {truth}");
}

#[test]
fn a_rounded_box_in_inches_is_closed_and_has_the_right_volume() {
    let faces = read_step(&data("rounded_box")).unwrap();
    assert_eq!(faces.unit(), Some(Unit::Inch));
    let mesh = triangles(&faces, 1e-4);
    assert_eq!((mesh.parts.len(), mesh.faces, mesh.unreadable.len()), (1, 27, 0));
    let (area, volume, check) = measured(&mesh.parts[0]);
    assert!(check.watertight && check.manifold && check.oriented, "{check:?}");
    near(area, 5091.61042 / 25.4_f64.powi(2), 1e-3);
    near(volume, 20587.6577 / 25.4_f64.powi(3), 1e-3);
}

#[test]
fn bodies_of_revolution_are_closed_and_have_the_right_volumes() {
    let faces = read_step(&data("turned")).unwrap();
    let mesh = triangles(&faces, 3e-5);
    let truth = [
        (1256.63706, 4188.7902),
        (1462.59569, 3746.61538),
        (563.531479, 804.247719),
        (1184.35253, 1776.52879),
        (306.195228, 349.572805),
        (564.0, 776.0),
        (245.044227, 282.743339),
        (1314.10348, 2330.61531),
    ];
    assert_eq!((mesh.parts.len(), mesh.unreadable.len()), (truth.len(), 0));
    for (part, (area, volume)) in mesh.parts.iter().zip(truth) {
        let (a, v, check) = measured(part);
        assert!(check.watertight && check.manifold && check.oriented, "{check:?}");
        near(a, area, 4e-3);
        near(v, volume, 4e-3);
    }
}

#[test]
fn trimmed_splines_and_swept_surfaces_have_the_right_areas() {
    let sheet = triangles(&read_step(&data("sheet")).unwrap(), 1e-4);
    let (area, _, check) = measured(&sheet.parts[0]);
    near(area, 2076.9474, 1e-3);
    assert_eq!((sheet.faces, check.boundary_loops, check.euler_characteristic), (1, 2, 0));
    let swept = triangles(&read_step(&data("swept")).unwrap(), 1e-4);
    assert_eq!((swept.parts.len(), swept.unreadable.len()), (3, 0));
    for (part, truth) in swept.parts.iter().zip([1541.09833, 606.299149, 359.826064]) {
        near(measured(part).0, truth, 2e-3);
    }
}

#[test]
fn parts_of_an_assembly_are_placed() {
    let faces = read_step(&data("assembly")).unwrap();
    let mesh = triangles(&faces, 1e-4);
    assert_eq!((mesh.parts.len(), mesh.faces), (4, 24));
    let mut middles: Vec<[i64; 3]> = mesh
        .parts
        .iter()
        .map(|part| {
            near(measured(part).1, 6000.0, 1e-12);
            let n = part.points.len() as f64;
            [0, 1, 2].map(|c| (part.points.iter().map(|p| p[c]).sum::<f64>() / n).round() as i64)
        })
        .collect();
    middles.sort_unstable();
    assert_eq!(middles, [[5, -15, 510], [5, 10, 15], [90, -15, 505], [90, 5, 15]]);
}

/// A file in the given units, with a representation of some items.
fn file(length: &str, angle: &str, items: &str, lines: &str) -> String {
    format!(
        "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n\
         #1=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));\n\
         #2=(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.));\n\
         #3=DIMENSIONAL_EXPONENTS(0.,0.,0.,0.,0.,0.,0.);\n\
         #4=PLANE_ANGLE_MEASURE_WITH_UNIT(PLANE_ANGLE_MEASURE(0.017453292519943295),#2);\n\
         #5=(CONVERSION_BASED_UNIT('DEGREE',#4)NAMED_UNIT(#3)PLANE_ANGLE_UNIT());\n\
         #6=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#1);\n\
         #7=(CONVERSION_BASED_UNIT('INCH',#6)LENGTH_UNIT()NAMED_UNIT(#3));\n\
         #8=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.CENTI.,.METRE.));\n\
         #9=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},\
         {angle}))REPRESENTATION_CONTEXT('',''));\n\
         #10=CARTESIAN_POINT('',(0.,0.,0.));\n#11=DIRECTION('',(0.,0.,1.));\n#12=DIRECTION('',(1.,0.,0.));\n\
         #13=AXIS2_PLACEMENT_3D('',#10,#11,#12);\n\
         #14=SHAPE_REPRESENTATION('',(#13,{items}),#9);\n{lines}ENDSEC;\nEND-ISO-10303-21;\n"
    )
}

/// A cone from radius 1 to its tip as one face, with the given half angle.
fn cone(half_angle: &str) -> String {
    format!(
        "#20=CONICAL_SURFACE('',#13,1.,{half_angle});\n#21=CIRCLE('',#13,1.);\n#22=CARTESIAN_POINT('',(1.,\
         0.,0.));\n\
         #23=VERTEX_POINT('',#22);\n#24=EDGE_CURVE('',#23,#23,#21,.T.);\n#25=ORIENTED_EDGE('',*,*,#24,.F.);\n\
         #26=EDGE_LOOP('',(#25));\n#27=FACE_OUTER_BOUND('',#26,.T.);\n#28=ADVANCED_FACE('',(#27),#20,.T.);\n\
         #29=OPEN_SHELL('',(#28));\n#30=SHELL_BASED_SURFACE_MODEL('',(#29));\n"
    )
}

#[test]
fn lengths_and_angles_are_in_the_units_of_the_file() {
    use std::f64::consts::PI;
    for (length, angle, half, unit, factor) in [
        ("#1", "#2", "0.78539816339744831", Unit::Millimetre, 1.0),
        ("#7", "#5", "45.", Unit::Inch, 1.0),
        ("#8", "#5", "45.", Unit::Millimetre, 10.0),
    ] {
        let text = file(length, angle, "#30", &cone(half));
        let faces = StepFaces::from_bytes(text.as_bytes()).unwrap();
        assert_eq!(faces.unit(), Some(unit));
        let mesh = triangles(&faces, 1e-5);
        near(measured(&mesh.parts[0]).0, PI * 2_f64.sqrt() * factor * factor, 1e-3);
    }
}

#[test]
fn polygonal_loops_and_bare_surfaces_are_read() {
    // A tetrahedron of polygonal loops with outward faces, and a bilinear surface without a face.
    let corners = [(20, "0.,0.,0."), (21, "1.,0.,0."), (22, "0.,1.,0."), (23, "0.,0.,1.")];
    let mut lines: String = corners.map(|(id, at)| format!("#{id}=CARTESIAN_POINT('',({at}));\n")).concat();
    let planes = [
        ("0.,0.,-1.", "1.,0.,0.", [20, 22, 21], 20),
        ("0.,-1.,0.", "1.,0.,0.", [20, 21, 23], 20),
        ("-1.,0.,0.", "0.,1.,0.", [20, 23, 22], 20),
        ("1.,1.,1.", "1.,-1.,0.", [21, 22, 23], 21),
    ];
    for (k, (normal, x, [a, b, c], at)) in planes.into_iter().enumerate() {
        let id = 30 + 10 * k;
        lines += &format!(
            "#{}=DIRECTION('',({normal}));\n#{}=DIRECTION('',({x}));\n#{}=AXIS2_PLACEMENT_3D('',#{at},#{},\
             #{});\n#{}=PLANE('',#{});\n\
             #{}=POLY_LOOP('',(#{a},#{b},#{c}));\n#{}=FACE_OUTER_BOUND('',#{},.T.);\n#{}=FACE_SURFACE('',\
             (#{}),#{},.T.);\n",
            id,
            id + 1,
            id + 2,
            id,
            id + 1,
            id + 3,
            id + 2,
            id + 4,
            id + 5,
            id + 4,
            id + 6,
            id + 5,
            id + 3
        );
    }
    lines += "#80=CLOSED_SHELL('',(#36,#46,#56,#66));\n#81=FACETED_BREP('',#80);\n\
        #82=(BEZIER_SURFACE()BOUNDED_SURFACE()B_SPLINE_SURFACE(1,1,((#20,#21),(#22,#23)),.UNSPECIFIED.,.F.,\
        .F.,.F.)GEOMETRIC_REPRESENTATION_ITEM()REPRESENTATION_ITEM('')SURFACE());\n\
        #83=GEOMETRIC_SET('',(#82));\n";
    let faces = StepFaces::from_bytes(file("#1", "#2", "#81,#83", &lines).as_bytes()).unwrap();
    let mesh = triangles(&faces, 1e-4);
    assert_eq!((mesh.parts.len(), mesh.faces, mesh.unreadable.len()), (2, 5, 0));
    let (area, volume, check) = measured(&mesh.parts[0]);
    assert!(check.watertight && check.oriented);
    near(area, 1.5 + 0.75_f64.sqrt(), 1e-12);
    near(volume, 1.0 / 6.0, 1e-12);
    assert_eq!(measured(&mesh.parts[1]).2.boundary_loops, 1);
}

#[test]
fn mapped_items_are_scaled_and_mirrored() {
    let lines = cone("0.5")
        + "#40=REPRESENTATION_MAP(#13,#41);\n#41=SHAPE_REPRESENTATION('',(#13,#30),#9);\n\
            #42=CARTESIAN_POINT('',(5.,0.,0.));\n\
           #43=DIRECTION('',(0.,-1.,0.));\n\
           #44=CARTESIAN_TRANSFORMATION_OPERATOR_3D('','',$,#12,#43,#42,2.,#11);\n#45=MAPPED_ITEM('',#40,\
           #44);\n";
    let faces = StepFaces::from_bytes(file("#1", "#2", "#45", &lines).as_bytes()).unwrap();
    let mesh = triangles(&faces, 1e-4);
    assert_eq!(mesh.parts.len(), 1);
    let part = &mesh.parts[0];
    let reach = |c: usize, way: f64| part.points.iter().map(|p| way * p[c]).fold(f64::MIN, f64::max);
    assert!((reach(0, 1.0) - 7.0).abs() < 1e-9 && (reach(0, -1.0) + 3.0).abs() < 1e-2);
    // The normals still point away from the axis.
    for t in &part.triangles {
        let [a, b, c] = t.map(|v| part.points[v as usize]);
        let n = (b - a).cross(c - a);
        let out = DVec3::new(a[0] + b[0] + c[0] - 15.0, a[1] + b[1] + c[1], 0.0);
        assert!(n.dot(out) > 0.0);
    }
}

#[test]
fn unreadable_faces_are_reported_and_the_rest_is_kept() {
    // A second face whose surface does not exist, and one whose kind is unknown.
    let lines = cone("0.5").replace("(#28)", "(#28,#50,#52)")
        + "#50=ADVANCED_FACE('',(#27),#99,.T.);\n#51=HELIX_SURFACE('',#13);\n#52=ADVANCED_FACE('',(#27),#51,\
            .T.);\n";
    let faces = StepFaces::from_bytes(file("#1", "#2", "#30", &lines).as_bytes()).unwrap();
    let mesh = triangles(&faces, 1e-3);
    assert_eq!((mesh.faces, mesh.unreadable.len()), (1, 2));
    assert_eq!(mesh.unreadable[0], "face #50: expected the instance #99, found none");
    assert!(mesh.unreadable[1].contains("#51 HELIX_SURFACE: this kind of surface is not supported"));

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part.stp");
    let error = |text: &str| {
        std::fs::write(&path, text).unwrap();
        read_mesh(&path).unwrap_err().to_string()
    };
    for (text, words) in [
        (file("#1", "#2", "#30", &lines), "part.stp: 2 of 3 faces cannot be read; the first is face #50"),
        (file("#1", "#2", "#13", ""), "part.stp: expected faces, found none"),
        (
            file("#1", "#2", "#16", "#16=GEOMETRIC_CURVE_SET('',(#10));\n"),
            "expected faces, found only 1 GEOMETRIC_CURVE_SET",
        ),
        (
            file("#1", "#2", "#30", &cone("2.")),
            "none of the 1 faces can be read; the first is face #28: #20 CONICAL_SURFACE in line",
        ),
        (
            file("#1", "#2", "#30", &cone("0.5").replace("#21,.T.", "#21,$")),
            "#24 EDGE_CURVE in line 23: attribute 5: expected .T. or .F., found $",
        ),
        (
            file(
                "#1",
                "#2",
                "#30",
                &cone("0.5").replace("CIRCLE('',#13,1.)", "TRIMMED_CURVE('',#21,(),(),.T.,.PARAMETER.)"),
            ),
            "refers to itself",
        ),
        (
            file("#1", "#2", "#30", &cone("0.5").replace("(#28)", "(#29)")),
            "expected ADVANCED_FACE or FACE_SURFACE",
        ),
        (
            file("#1", "#2", "#45", "#45=MAPPED_ITEM('',#46,#13);\n#46=REPRESENTATION_MAP(#13,#14);\n"),
            "an assembly that contains itself",
        ),
        ("solid\n".to_owned(), "not a STEP file"),
    ] {
        let e = error(&text);
        assert!(e.contains(words), "{e}");
    }
}

#[test]
fn huge_multiplicities_do_not_allocate_memory() {
    let knots = "#60=B_SPLINE_CURVE_WITH_KNOTS('',3,(#10,#22,#10,#22),.UNSPECIFIED.,.F.,.F.,(900000000,4),\
        (0.,1.),.UNSPECIFIED.);\n";
    let lines = cone("0.5").replace("#23,#23,#21", "#23,#23,#60") + knots;
    let faces = StepFaces::from_bytes(file("#1", "#2", "#30", &lines).as_bytes()).unwrap();
    let e = faces.triangles(&faces.fineness(None)).unwrap_err().to_string();
    assert!(e.contains("multiplicities that sum to 900000004"), "{e}");
}
