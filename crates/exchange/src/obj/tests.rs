use planish_estimate::ErrorKind;
use proptest::prelude::*;

use super::*;

fn source(text: &[u8]) -> Source<&[u8]> {
    Source::new(text, Some(text.len() as u64))
}

fn mesh(text: &str) -> Result<PolygonMesh> {
    mesh_from(&mut source(text.as_bytes()))
}

fn scan(text: &str) -> Result<Scan> {
    scan_from(&mut source(text.as_bytes()), "a.obj").map(|(scan, _)| scan)
}

fn message(text: &str) -> String {
    let e = mesh(text).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Input, "{e}");
    e.to_string()
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
const FAN: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

#[test]
fn all_spellings_of_a_square_give_the_same_mesh() {
    let files = [
        format!("{SQUARE}f 1 2 3 4\n"),
        format!("{SQUARE}f 1 2 3 4"),
        format!("{SQUARE}f 1/1 2/2 3/3 4/4\n"),
        format!("{SQUARE}f 1/1/ 2/2/ 3/3/ 4/4/\n"),
        format!("{SQUARE}f -4 -3 -2 -1\n"),
        format!("{SQUARE}f -4/-1 -3/-1 -2/-1 -1/-1\n"),
        format!("{SQUARE}f 1 2 3\nf 1 3 4\n"),
        format!("{SQUARE}f 1 2 \\\n3 4\n"),
        format!("{SQUARE}f 1 \\  \n 2 \\\r\n 3 4\n"),
        format!("{SQUARE}f 1 2 3 4 \\"),
        format!("{SQUARE}f 1 2 3 4 # the only one\n"),
        format!("{SQUARE}fo 1 2 3 4\n"),
        format!("\u{feff}{SQUARE}f 1 2 3 4\n"),
        format!("{SQUARE}f 1 2 3 4\n").replace('\n', "\r\n"),
        format!("{SQUARE}f 1 2 3 4\n").replace('\n', "\r"),
        format!("{SQUARE}f 1 2 3 4\n").replace(' ', "\t  "),
        format!("{SQUARE}f 1 2 3 4\n").replace("\nv", "\n  v"),
        format!("{SQUARE}f 1 2 3 4\n").replace('\n', "\n\n\n"),
        format!(
            "# a comment\nmtllib a.mtl\no thing\n{SQUARE}vt 0 0\nvt 1\ng a b\nusemtl red\ns off\nf 1 2 3 \
             4\nl 1 2\np 1\n"
        ),
        format!("f 1 2 3 4\n{SQUARE}"),
        "v 0 0 0 1\nv 1 0 0 1.0\nv 1 1 0 2\nv 0 1 0 1\nf 1 2 3 4\n".to_owned(),
        "v 0 0 0 1 1 0 0\nv 1 0 0 1 1 0 0\nv 1 1 0 1 1 0 0\nv 0 1 0 1 1 0 0\nf 1 2 3 4\n".to_owned(),
        "v 0e0 -0.0 +0\nv 1.E+0 0 0.\nv 1 1 0\nv .0 1 0\nf 1 2 3 4\n".to_owned(),
        format!("{SQUARE}cstype bezier\ndeg 3\ncurv 0 1 1 2 3 4\nparm u 0 1\nend\nf 1 2 3 4\n"),
    ];
    for text in &files {
        let mesh = mesh(text).unwrap_or_else(|e| panic!("{e} in {text:?}"));
        assert_eq!((mesh.points.len(), &mesh.triangles[..]), (4, &FAN[..]), "{text:?}");
        assert_eq!(mesh.points[2], DVec3::new(1.0, 1.0, 0.0), "{text:?}");
        assert!(mesh.columns.is_empty(), "{text:?}");
    }
}

#[test]
fn normals_are_assigned_by_faces() {
    // Normals come before, between and after the faces; one vertex has two of them, one has none.
    let text = format!("vn 0 0 2\nf 1//1 2//1 3//2\nf 1//1 3//3 4\n{SQUARE}vn 0 1 0\nvn 1 0 0\n");
    let found = scan(&text).unwrap().normals.unwrap();
    assert_eq!(found, [2.0 * DVec3::Z, 2.0 * DVec3::Z, DVec3::new(1.0, 1.0, 0.0), DVec3::ZERO]);
    assert_eq!(mesh(&text).unwrap().column("nz").unwrap(), [2.0, 2.0, 0.0, 0.0]);
    // A cloud: as many normals as vertices.
    let cloud = "vn 0 0 1\nv 1 2 3\nvn 0 1 0\nv 4 5 6\n";
    assert_eq!(scan(cloud).unwrap().normals.unwrap(), [DVec3::Z, DVec3::Y]);
    assert!(scan("v 1 2 3\nvn 0 1 0\nv 4 5 6\n").unwrap().normals.is_none());
}

#[test]
fn colours_of_all_vertices_become_columns() {
    let coloured = mesh("v 0 0 0 1 0 0\nv 1 0 0 0 0.5 0\nv 0 1 0 0 0 0.25\nf 1 2 3\n").unwrap();
    let column = |name: &str| coloured.column(name).unwrap().to_vec();
    assert_eq!(["red", "green", "blue"].map(column), [[1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.25]]);
    // A vertex without a colour; a weight; further numbers.
    for line in ["v 0 0 0", "v 0 0 0 1", "v 0 0 0 1 2", "v 0 0 0 1 2 3 4"] {
        let mesh = mesh(&format!("v 0 0 0 1 0 0\n{line}\nv 0 1 0 0 0 0.25\nf 1 2 3\n")).unwrap();
        assert!(mesh.columns.is_empty(), "{line}");
    }
}

#[test]
fn vertices_that_are_not_finite_are_dropped_from_scans_and_rejected_in_meshes() {
    let text = "v 0 0 0\nv nan 0 0\nv 1 1 0\nvn 0 0 1\nvn 0 0 2\nvn 0 0 3\n";
    let found = scan(text).unwrap();
    assert_eq!((found.points.len(), found.dropped_not_finite), (2, 1));
    assert_eq!(found.normals.unwrap()[1], DVec3::new(0.0, 0.0, 3.0));
    assert_eq!(mesh(text).unwrap().column("nz").unwrap(), [1.0, 3.0]);
    let faced = format!("{text}f 1 1 3\n");
    assert!(message(&faced).contains("line 2: expected finite coordinates"));
}

#[test]
fn errors_name_the_line() {
    let after = |line: &str| message(&format!("{SQUARE}{line}\n"));
    assert!(after("f 1 2 5").contains("line 5: expected a vertex index from 1 to 4, found 5"));
    assert!(after("f 1 2 4000000000").contains("line 5"));
    assert!(after("f 1 2 99999999999").contains("line 5"));
    assert!(after("f 1 2 0").contains("line 5") && after("f 1 2 0").contains("found 0"));
    assert!(after("f 1 2 -5").contains("from -4 to -1, found -5"));
    assert!(after("f 1//1 2//1 3//1").contains("expected a normal index from 1 to 0, found 1"));
    assert!(after("f 1 2").contains("line 5: expected at least three corners, found 2"));
    assert!(after("f").contains("found 0"));
    assert!(after("f 1 2 x").contains("found `x`"));
    assert!(after("f 1/2/3/4 2 3").contains("expected a corner"));
    assert!(after("v 1 2").contains("line 5: expected 3 numbers, found 2"));
    assert!(after("v 1 2 z").contains("line 5: expected a number, found `z`"));
    assert!(after("v 1,5 2,5 3,5").contains("found `1,5`"));
    assert!(after("vn 1 2").contains("line 5"));
    assert!(message("# nothing\n").contains("expected vertices"));
}

#[test]
fn written_files_read_back_to_the_last_digit() {
    let points =
        [[0.1, 1e-300, 1e6 + 1.0 / 3.0], [-2.5e17, 0.0, 7.0], [1.0, 2.0, 3.0]].map(DVec3::from_array);
    let normals = [DVec3::new(0.6, 0.8, 0.0), DVec3::new(1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0), DVec3::Z];
    for (normals, unit) in [(Some(&normals[..]), Some(Unit::Inch)), (None, None)] {
        let written = MeshColumns {
            points: &points,
            normals,
            triangles: &[[0, 1, 2], [2, 1, 0]],
            unit,
            ..MeshColumns::default()
        };
        let mut bytes = Vec::new();
        write_to(&mut bytes, &written).unwrap();
        let read = mesh_from(&mut source(&bytes)).unwrap();
        assert_eq!(
            (&read.points[..], &read.triangles[..], read.unit),
            (&points[..], written.triangles, unit)
        );
        let columns: Vec<DVec3> = match read.columns.is_empty() {
            true => Vec::new(),
            false => (0..3).map(|v| DVec3::from_array([0, 1, 2].map(|k| read.columns[k].1[v]))).collect(),
        };
        assert_eq!(columns, normals.unwrap_or_default());
        let mut again = Vec::new();
        let normals = normals.map(|_| &columns[..]);
        let rewritten = MeshColumns {
            points: &read.points,
            normals,
            triangles: &read.triangles,
            unit: read.unit,
            ..MeshColumns::default()
        };
        write_to(&mut again, &rewritten).unwrap();
        assert_eq!(bytes, again);
    }
}

#[test]
fn a_truncated_file_gives_an_error_or_fewer_elements() {
    let text = format!("# unit mm\n{SQUARE}vn 0 0 1\nf 1//1 2//1 \\\n3//1 4//1\n");
    for end in 0..text.len() {
        if let Ok(mesh) = mesh(&text[..end]) {
            assert!(mesh.points.len() <= 4 && mesh.triangles.len() <= 2, "{end}");
        }
    }
}

proptest! {
    #[test]
    fn no_bytes_cause_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = mesh_from(&mut source(&bytes));
    }

    #[test]
    fn no_text_of_the_right_alphabet_causes_a_panic(text in "(v|vn|f|[0-9]|[ ./#\\\\\n\r-]){0,200}") {
        let _ = mesh(&text);
        let _ = scan(&text);
    }
}

#[test]
fn a_face_in_very_many_groups_is_rejected() {
    let budget = planish_core::Budget::with_max(10_000_000, 1000);
    let groups: String = (0..10_000).map(|k| format!(" g{k}")).collect();
    let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\ng{groups}\n{}", "f 1 2 3\n".repeat(10_000));
    let mut source = Source::new(std::io::Cursor::new(text), None).with_budget(budget);
    let error =
        Obj::read(&mut source, Some(AppearanceReader::default())).err().expect("too many").to_string();
    assert!(error.contains("triangles (line"), "{error}");
}
