use proptest::prelude::*;

use super::*;

fn source(bytes: &[u8]) -> Source<&[u8]> {
    Source::new(bytes, Some(bytes.len() as u64))
}

fn mesh(bytes: &[u8]) -> Result<PolygonMesh> {
    mesh_from(&mut source(bytes))
}

fn message(bytes: &[u8]) -> String {
    let e = mesh(bytes).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Input, "{e}");
    e.to_string()
}

const POINTS: [DVec3; 4] = [DVec3::ZERO, DVec3::X, DVec3::new(0.0, 1.5, 0.0), DVec3::new(0.0, 0.0, -2.25)];
const TRIANGLES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

fn tetrahedron() -> MeshColumns<'static> {
    MeshColumns { points: &POINTS, triangles: &TRIANGLES, unit: Some(Unit::Metre), ..MeshColumns::default() }
}

fn binary() -> Vec<u8> {
    let mut bytes = Vec::new();
    write_to(&mut bytes, &tetrahedron(), 4).unwrap();
    bytes
}

fn ascii() -> String {
    let facet = |t: &[u32; 3]| {
        let corners: String = t
            .iter()
            .map(|&v| POINTS[v as usize])
            .map(|DVec3 { x, y, z }| format!("      vertex {x} {y} {z}\n"))
            .collect();
        format!("  facet normal 0 0 1\n    outer loop\n{corners}    endloop\n  endfacet\n")
    };
    let facets: String = TRIANGLES.iter().map(facet).collect();
    format!("solid a thing\n{facets}endsolid a thing\n")
}

/// Corners of the triangles, independent of vertex indices.
fn corners(mesh: &PolygonMesh) -> Vec<[DVec3; 3]> {
    mesh.triangles.iter().map(|t| t.map(|v| mesh.points[v as usize])).collect()
}

#[test]
fn all_spellings_of_a_tetrahedron_give_the_same_mesh() {
    let mut solid = binary();
    solid[..80].fill(b' ');
    solid[..12].copy_from_slice(b"solid binary");
    let mut padded = binary();
    padded[..80].fill(0);
    padded.extend_from_slice(b"and data beyond the declared count");
    let text = ascii();
    let two = text.replacen("  facet", "endsolid\nsolid two\n  facet", 1);
    let files: [Vec<u8>; 10] = [
        binary(),
        solid,
        padded,
        text.clone().into_bytes(),
        text.replace('\n', "\r\n").into_bytes(),
        text.to_uppercase().into_bytes(),
        text.replace("solid a thing\n", "solid\n").into_bytes(),
        text.replace("vertex 0 0 0", "vertex\t-0.0e+00 0 -0").into_bytes(),
        format!("\n  {}", text.replace("normal 0 0 1", "normal nan -nan(ind) inf")).into_bytes(),
        two.into_bytes(),
    ];
    let expected = TRIANGLES.map(|t| t.map(|v| POINTS[v as usize]));
    for (k, bytes) in files.iter().enumerate() {
        let mesh = mesh(bytes).unwrap_or_else(|e| panic!("{k}: {e}"));
        assert_eq!(mesh.points.len(), 4, "{k}: equal corners are one vertex");
        assert_eq!(corners(&mesh), expected, "{k}");
    }
    let read = mesh(&binary()).unwrap();
    assert_eq!(read.unit, Some(Unit::Metre));
    let again = MeshColumns {
        points: &read.points,
        triangles: &read.triangles,
        unit: read.unit,
        ..MeshColumns::default()
    };
    let mut bytes = Vec::new();
    write_to(&mut bytes, &again, 4).unwrap();
    assert_eq!(bytes, binary());
}

#[test]
fn corners_that_are_not_finite_are_dropped_from_scans_and_rejected_in_meshes() {
    let mut bytes = binary();
    // The first coordinate of the first corner of the second triangle.
    let at = HEADER + 4 + RECORD + 12;
    bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let (scan, _) = scan_from(&mut source(&bytes), "a.stl").unwrap();
    assert_eq!((scan.points.len(), scan.dropped_not_finite), (4, 1));
    assert!(message(&bytes).contains("(triangle 1): expected finite coordinates"));
}

#[test]
fn errors_name_line_or_byte() {
    let text = ascii();
    assert!(message(text.replacen("vertex 0", "vortex 0", 1).as_bytes()).contains("line 4"));
    assert!(
        message(text.replacen("vertex 0 0 0", "vertex 0 0", 1).as_bytes())
            .contains("line 4: expected 3 numbers")
    );
    assert!(message(text.replacen("vertex 0 0 0", "vertex 0 0,5 0", 1).as_bytes()).contains("found `0,5`"));
    assert!(
        message(text.replacen("vertex 0 0 0\n", "\n", 1).as_bytes())
            .contains("line 7: expected three corners")
    );
    assert!(message(b"solid a\nendsolid a\n").contains("expected triangles, found none"));
    assert!(message(b"solid a\n").contains("cut off"));
    assert!(message(b"ply\n").contains("not an STL file"));
    let mut bomb = binary();
    bomb[HEADER..HEADER + 4].copy_from_slice(&4_000_000_000_u32.to_le_bytes());
    assert!(message(&bomb).contains("declares 4000000000 triangles"));
    assert!(mesh_from(&mut Source::new(&bomb[..], None)).is_err(), "also with unknown length, as from gzip");
    let far = [DVec3::new(1e300, 0.0, 0.0); 3];
    let mesh = MeshColumns { points: &far, triangles: &[[0, 1, 2]], ..MeshColumns::default() };
    assert!(check_size(&mesh).unwrap_err().to_string().contains("vertex 0"));
}

#[test]
fn truncated_files_are_rejected() {
    let text = ascii();
    // The last words may lack the name and the end of the line.
    let last = text.len() - " a thing\n".len();
    for end in 0..last {
        assert!(mesh(&text.as_bytes()[..end]).is_err(), "{end}");
    }
    let bytes = binary();
    for end in 0..bytes.len() {
        assert!(mesh(&bytes[..end]).is_err(), "{end}");
    }
}

#[test]
fn rounding_bounds_the_error_of_writing() {
    let points = [DVec3::new(1_234_567.891, -3.3, 0.07)];
    let moved = points[0].to_array().map(|c: f64| (f64::from(c as f32) - c).abs());
    assert!(moved[0] > 0.0 && moved.iter().all(|&m| m <= rounding(&points)));
}

proptest! {
    #[test]
    fn no_bytes_cause_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let _ = mesh(&bytes);
    }

    #[test]
    fn no_text_of_the_right_words_causes_a_panic(text in "solid\n((facet normal|outer \
        loop|vertex|endloop|endfacet|endsolid|[0-9]|-|[. \n])){0,60}") {
        let _ = mesh(text.as_bytes());
    }
}
