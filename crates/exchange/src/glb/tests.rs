use planish_core::DVec3;
use planish_estimate::{ErrorKind, Result};
use proptest::prelude::*;

use super::read::mesh_from;
use super::write::{Layout, write_to};
use crate::Unit;
use crate::mesh_data::{Column, MeshColumns, PolygonMesh};
use crate::source::Source;

fn read(bytes: &[u8]) -> Result<PolygonMesh> {
    mesh_from(&mut Source::new(bytes, Some(bytes.len() as u64)))
}

fn written(mesh: &MeshColumns) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_to(&mut bytes, mesh, &Layout::new(mesh).unwrap()).unwrap();
    bytes
}

const FAR: DVec3 = DVec3::new(4_000_000.0, -1_000_000.0, 250.0);
const CORNERS: [DVec3; 4] =
    [DVec3::ZERO, DVec3::new(1.5, 0.0, 0.0), DVec3::new(0.0, 2.5, 0.0), DVec3::new(0.0, 0.0, 3.25)];
const NORMALS: [DVec3; 4] = [DVec3::new(-1.0, 0.0, 0.0), DVec3::X, DVec3::Y, DVec3::new(0.0, 0.6, 0.8)];

fn tetrahedron(points: &[DVec3], unit: Unit) -> MeshColumns<'_> {
    MeshColumns {
        points,
        normals: Some(&NORMALS),
        columns: vec![
            ("sigma", Column::F64(&[0.5, 0.25, 0.125, 1.0])),
            ("observed", Column::U8(&[1, 1, 0, 2])),
        ],
        triangles: &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        unit: Some(unit),
    }
}

#[test]
fn far_coordinates_and_sigma_are_read_in_metres() {
    let points = CORNERS.map(|p| p + FAR);
    for unit in [Unit::Millimetre, Unit::Metre, Unit::Inch] {
        let mesh = tetrahedron(&points, unit);
        let read = read(&written(&mesh)).unwrap();
        let metres = unit.millimetres() / 1000.0;
        assert_eq!((read.unit, &read.triangles[..]), (Some(Unit::Metre), mesh.triangles));
        for (found, expected) in read.points.iter().zip(&points) {
            for k in 0..3 {
                // A millionth of the mesh's size, not of its distance.
                assert!((found[k] / metres - expected[k]).abs() < 3e-6, "{found:?} {expected:?}");
            }
        }
        for (found, expected) in read.column("sigma").unwrap().iter().zip([0.5, 0.25, 0.125, 1.0]) {
            assert!((found / metres - expected).abs() < 1e-12);
        }
        assert_eq!(read.column("observed").unwrap(), [1.0, 1.0, 0.0, 2.0]);
        assert!((read.column("nz").unwrap()[3] - 0.8).abs() < 1e-7);
    }
}

#[test]
fn a_read_mesh_is_written_to_the_same_bytes() {
    let first = written(&tetrahedron(&CORNERS, Unit::Metre));
    let mesh = read(&first).unwrap();
    let normals: Vec<DVec3> =
        (0..4).map(|v| DVec3::from_array([0, 1, 2].map(|k| mesh.columns[k].1[v]))).collect();
    let again = MeshColumns {
        points: &mesh.points,
        normals: Some(&normals),
        columns: ["sigma", "observed"].map(|name| (name, Column::F64(mesh.column(name).unwrap()))).to_vec(),
        triangles: &mesh.triangles,
        unit: mesh.unit,
    };
    assert_eq!(written(&again), first);
}

/// A file with the JSON and the numbers of a scene.
fn glb(json: &str, numbers: &[f32]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary: Vec<u8> = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend_from_slice(&((28 + json.len() + binary.len()) as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &binary)] {
        bytes.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
        bytes.extend_from_slice(kind);
        bytes.extend_from_slice(chunk);
    }
    bytes
}

const SCENE: &str = r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],
    "nodes":[{"children":[1,2],"translation":[10,0,0],
     "rotation":[0,0,0.70710678118654752,0.70710678118654752]},
             {"mesh":0},{"mesh":0,"scale":[-2,2,2]}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0,"NORMAL":1}},
     {"mode":1,"attributes":{"POSITION":0}}]}],
    "accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":3},
                 {"bufferView":0,"byteOffset":12,"componentType":5126,"type":"VEC3","count":3}],
    "bufferViews":[{"buffer":0,"byteLength":72,"byteStride":24}],"buffers":[{"byteLength":72}]}"#;
const NUMBERS: [f32; 18] = [0., 0., 0., 0., 0., 1., 1., 0., 0., 0., 0., 1., 0., 1., 0., 0., 0., 1.];

#[test]
fn transforms_of_nodes_are_applied() {
    let mesh = read(&glb(SCENE, &NUMBERS)).unwrap();
    let near = |v: usize, expected: DVec3| (0..3).all(|k| (mesh.points[v][k] - expected[k]).abs() < 1e-9);
    assert!(near(1, DVec3::new(10.0, 1.0, 0.0)) && near(2, DVec3::new(9.0, 0.0, 0.0)), "{:?}", mesh.points);
    assert!(near(4, DVec3::new(10.0, -2.0, 0.0)) && near(5, DVec3::new(8.0, 0.0, 0.0)), "{:?}", mesh.points);
    // The corners of the mirrored triangle are swapped, so that they agree with its normal.
    assert_eq!(mesh.triangles, [[0, 1, 2], [3, 5, 4]]);
    assert!(mesh.column("nz").unwrap().iter().all(|&z| (z - 1.0).abs() < 1e-12));
}

#[test]
fn colours_are_read_as_display_values() {
    let json = r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0,"COLOR_0":1}}]}],
    "accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":3},
                 {"bufferView":0,"byteOffset":12,"componentType":5126,"type":"VEC4","count":3}],
    "bufferViews":[{"buffer":0,"byteLength":84,"byteStride":28}],"buffers":[{"byteLength":84}]}"#;
    let vertex = |x, y, red, blue| [x, y, 0.0, red, 0.0, blue, 1.0];
    let numbers = [vertex(0., 0., 1., 0.), vertex(1., 0., 0.5, 0.), vertex(0., 1., 0., 0.001)];
    let mesh = read(&glb(json, numbers.as_flattened())).unwrap();
    // Half of the light is 0.735 of the display's range.
    assert!((mesh.column("red").unwrap()[1] - 0.735_357).abs() < 1e-5);
    assert!((mesh.column("blue").unwrap()[2] - 0.012_92).abs() < 1e-6);
    assert!((mesh.column("red").unwrap()[0] - 1.0).abs() < 1e-12);
    assert_eq!(mesh.column("green").unwrap(), [0.0; 3]);
}

#[test]
fn invalid_and_unsupported_files_are_reported() {
    let failed = |json: &str| read(&glb(json, &NUMBERS)).unwrap_err();
    let with = |from: &str, to: &str| failed(&SCENE.replacen(from, to, 1));
    for (from, to, kind, words) in [
        ("\"count\":3", "\"count\":1000000000", ErrorKind::Input, "accessor 0"),
        ("\"count\":3", "\"count\":-3", ErrorKind::Input, "accessor 0"),
        ("\"count\":3", "\"count\":2", ErrorKind::Input, "NORMAL: expected 2"),
        ("\"byteLength\":72", "\"byteLength\":9e9", ErrorKind::Input, "accessor 0"),
        (
            "\"byteLength\":72",
            "\"byteOffset\":18446744073709551615,\"byteLength\":72",
            ErrorKind::Input,
            "accessor 0",
        ),
        ("\"byteStride\":24", "\"byteStride\":18446744073709551615", ErrorKind::Input, "accessor 0"),
        ("\"byteStride\":24", "\"byteStride\":0", ErrorKind::Input, "accessor 0"),
        ("5126", "5121", ErrorKind::Unsupported, "accessor 0: expected VEC3"),
        ("\"mesh\":0", "\"mesh\":7", ErrorKind::Input, "mesh 7"),
        ("[1,2]", "[1,0]", ErrorKind::Input, "found a cycle"),
        ("[1,2]", "[1,9]", ErrorKind::Input, "expected the node 9"),
        ("[10,0,0]", "[10,0]", ErrorKind::Input, "node 0: expected 3 finite numbers for its translation"),
        (
            "{\"asset\"",
            "{\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],\"asset\"",
            ErrorKind::Unsupported,
            "draco",
        ),
        (
            "{\"byteLength\":72}]}",
            "{\"uri\":\"a.bin\",\"byteLength\":72}]}",
            ErrorKind::Unsupported,
            "all data in one file",
        ),
        ("{\"asset\"", "{asset", ErrorKind::Input, "JSON chunk is malformed"),
        ("\"scenes\"", "\"scene\":3,\"scenes\"", ErrorKind::Input, "scene 3"),
    ] {
        let e = with(from, to);
        assert_eq!(e.kind(), kind, "{to}: {e}");
        assert!(e.to_string().contains(words), "{to}: {e}");
    }
    assert!(read(b"glTF").is_err() && read(b"ply\n").unwrap_err().to_string().contains("not a GLB file"));
    let points = [DVec3::new(f64::NAN, 0.0, 0.0); 3];
    assert!(Layout::new(&tetrahedron(&points, Unit::Metre)).is_err());
}

#[test]
fn endless_copies_are_rejected() {
    // Forty nodes, each of which holds the next twice.
    let nodes: String = (0..40).map(|k| format!("{{\"children\":[{0},{0}]}},", k + 1)).collect();
    let start = SCENE.find("\"nodes\":[{\"children").unwrap();
    let end = SCENE.find("\"meshes\"").unwrap();
    let json = format!("{}\"nodes\":[{nodes}{{\"mesh\":0}}],{}", &SCENE[..start], &SCENE[end..]);
    let e = read(&glb(&json, &NUMBERS)).unwrap_err().to_string();
    assert!(e.contains("too many nodes"), "{e}");
    let file = super::read::mesh_from(&mut Source::new(
        &glb(&SCENE.replace("[1,2]", "[1,1,2]"), &NUMBERS)[..],
        None,
    ));
    assert_eq!(file.unwrap().triangles.len(), 3);
}

#[test]
fn truncated_files_are_rejected() {
    let bytes = written(&tetrahedron(&CORNERS, Unit::Metre));
    for end in 0..bytes.len() {
        assert!(read(&bytes[..end]).is_err(), "{end}");
    }
}

proptest! {
    #[test]
    fn no_changed_byte_causes_a_panic(at in 0_usize..2000, value in any::<u8>()) {
        let mut bytes = glb(SCENE, &NUMBERS);
        let at = at % bytes.len();
        bytes[at] = value;
        let _ = read(&bytes);
    }
}
