use planish_core::DVec3;
use std::path::Path;

use planish_estimate::{ErrorKind, Result};
use planish_sense::{RangeGrid, Scan, Viewing};
use proptest::prelude::*;

use super::read::{mesh_from, scan_from};
use super::*;
use crate::Unit;
use crate::source::Source;

fn scan(bytes: &[u8]) -> Result<Scan> {
    scan_from(&mut Source::new(bytes, Some(bytes.len() as u64)), "a.ply").map(|(scan, _)| scan)
}

fn mesh(bytes: &[u8]) -> Result<PolygonMesh> {
    mesh_from(&mut Source::new(bytes, Some(bytes.len() as u64)))
}

fn scan_message(bytes: &[u8]) -> String {
    let e = scan(bytes).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Input, "{e}");
    e.to_string()
}

fn mesh_message(bytes: &[u8]) -> String {
    let e = mesh(bytes).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Input, "{e}");
    e.to_string()
}

/// A header for the format, then the body.
fn file(format: &str, lines: &str, body: &[u8]) -> Vec<u8> {
    [format!("ply\nformat {format} 1.0\n{lines}\nend_header\n").as_bytes(), body].concat()
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z";

fn ascii(elements: &str, body: &str) -> Vec<u8> {
    file("ascii", elements, body.as_bytes())
}

/// A scan with a grid, as Cyberware scanners write it.
fn range_scan() -> Vec<u8> {
    ascii(
        &format!(
            "obj_info is_cyberware_data 1\nobj_info num_cols 3\nobj_info num_rows 2\nelement vertex \
             3\n{XYZ}\n\
             element range_grid 6\nproperty list uchar int vertex_indices"
        ),
        "0.1 0.2 0.3 \nnan 0 0 \n-1 -2 -3.5e-2 \n0 \n1 2 \n1 1 \n1 0 \n0 \n0 \n",
    )
}

#[test]
fn a_range_scan_has_its_grid_and_viewing_direction() {
    for bytes in [
        range_scan(),
        String::from_utf8(range_scan()).unwrap().replace('\n', "\r\n").into_bytes(),
        range_scan().strip_suffix(b"\n").unwrap().to_vec(),
    ] {
        let scan = scan(&bytes).unwrap();
        assert_eq!(scan.points, [DVec3::new(0.1, 0.2, 0.3), DVec3::new(-1.0, -2.0, -0.035)]);
        assert_eq!(scan.dropped_not_finite, 1);
        assert_eq!(scan.viewing, Viewing::Direction(DVec3::new(0.0, 0.0, -1.0)));
        let no = RangeGrid::EMPTY;
        // The vertex that is not finite is removed from its cell, and the next index decreases by one.
        assert_eq!(scan.grid, Some(RangeGrid { columns: 3, rows: 2, cells: vec![no, 1, no, 0, no, no] }));
    }
}

#[test]
fn every_type_reads_the_same_in_every_encoding() {
    let elements = "element junk 2\nproperty list uint16 double weights\nproperty char c\nelement vertex 1\n\
        property int8 a\nproperty uint8 b\nproperty int16 c\nproperty uint16 d\nproperty int32 e\nproperty \
        uint32 f\n\
        property float32 x\nproperty float64 y\nproperty list uchar short l\nproperty double z\nelement \
        face 1\n\
        property uchar flag\nproperty list uint uint vertex_index\nelement after 1\nproperty short s";
    let invalid_elements: [(&[f64], i8); 2] = [(&[1.0, 2.0], -3), (&[], 4)];
    let body = |big: bool| {
        let mut out = Vec::new();
        macro_rules! put {
            ($v:expr) => {{
                let mut bytes = $v.to_le_bytes();
                if big {
                    bytes.reverse();
                }
                out.extend_from_slice(&bytes);
            }};
        }
        for (weights, c) in invalid_elements {
            put!(weights.len() as u16);
            for w in weights {
                put!(w);
            }
            put!(c);
        }
        put!(-1_i8);
        put!(200_u8);
        put!(-300_i16);
        put!(60_000_u16);
        put!(-70_000_i32);
        put!(4_000_000_000_u32);
        put!(0.5_f32);
        put!(0.1_f64);
        put!(2_u8);
        put!(7_i16);
        put!(-8_i16);
        put!(1e-300_f64);
        put!(9_u8);
        put!(4_u32);
        for _ in 0..4 {
            put!(0_u32);
        }
        put!(5_i16);
        out
    };
    let text = "2 1 2 -3\n0 4\n-1 200 -300 60000 -70000 4000000000 0.5 0.1 2 7 -8 1e-300\n9 4 0 0 0 0\n5\n";
    let expected = mesh(&ascii(elements, text)).unwrap();
    assert_eq!(expected.points, [DVec3::new(0.5, 0.1, 1e-300)]);
    assert_eq!(expected.triangles, [[0, 0, 0]; 2]);
    let columns: Vec<_> = expected.columns.iter().map(|(n, c)| (n.as_str(), c[0])).collect();
    let numbers = [("a", -1.0), ("b", 200.0), ("c", -300.0), ("d", 6e4), ("e", -7e4), ("f", 4e9)];
    assert_eq!(columns, numbers);
    assert_eq!(mesh(&file("binary_little_endian", elements, &body(false))).unwrap(), expected);
    assert_eq!(mesh(&file("binary_big_endian", elements, &body(true))).unwrap(), expected);
    assert_eq!(scan(&file("binary_big_endian", elements, &body(true))).unwrap().points, expected.points);
}

#[test]
fn truncated_binary_files_are_rejected() {
    for format in ["binary_little_endian", "binary_big_endian"] {
        let one = |v: f64| {
            if format == "binary_big_endian" { v.to_be_bytes() } else { v.to_le_bytes() }
        };
        let vertices: Vec<u8> = (0..30).flat_map(|k| one(f64::from(k))).collect();
        let faces = vec![3_u8, 0, 1, 2, 4, 9, 8, 7, 6];
        let elements = "element vertex 10\nproperty double x\nproperty double y\nproperty double z\nelement \
            face 2\n\
                        property list uchar uchar vertex_indices";
        let bytes = file(format, elements, &[vertices, faces].concat());
        assert_eq!(mesh(&bytes).unwrap().triangles, [[0, 1, 2], [9, 8, 7], [9, 7, 6]]);
        for end in 0..bytes.len() {
            assert_eq!(mesh(&bytes[..end]).unwrap_err().kind(), ErrorKind::Input);
            assert_eq!(scan(&bytes[..end]).unwrap_err().kind(), ErrorKind::Input);
            // The length of a pipe is unknown, so only the end of the data shows the truncation.
            let e = mesh_from(&mut Source::new(&bytes[..end], None)).unwrap_err();
            assert_eq!(e.kind(), ErrorKind::Input);
        }
    }
}

#[test]
fn truncated_ascii_files_are_rejected() {
    let bytes = range_scan();
    // Of the last line, `0 `, the digit is enough.
    for end in 0..bytes.len() - 2 {
        let e = scan(&bytes[..end]).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Input, "{end}: {e}");
    }
    assert!(scan(&bytes[..bytes.len() - 2]).is_ok());
}

#[test]
fn the_error_of_a_truncated_file_states_place_and_counts() {
    let bytes = ascii(&format!("element vertex 3\n{XYZ}"), "1.25 2.25 3.25\n1.25 2.25 3.25\n");
    let message = scan_message(&bytes);
    assert!(
        message.contains("line 10 (vertex 2)") && message.contains("3 records of `vertex` declared, 2 found"),
        "{message}"
    );
    let message = scan_message(b"ply\nformat ascii 1.0\n");
    assert!(message.contains("line 3: the file ends before `end_header`"), "{message}");
    assert!(scan_message(b"").contains("empty"));
}

#[test]
fn counts_smaller_than_the_file_are_an_error() {
    let more = ascii("element vertex 1\nproperty float x\nproperty float y\nproperty float z", "0 0 0\n");
    let at = more.len();
    for (end, bytes) in [("\n \r\n", None), ("1 0 0\n", Some(6)), ("\n\nx", Some(1))] {
        let bytes_left = bytes;
        let file = [&more[..], end.as_bytes()].concat();
        match bytes_left {
            None => assert_eq!(scan(&file).unwrap().points.len(), 1),
            Some(left) => {
                let place = at + end.len() - left;
                let words = format!("byte {place}: expected the end of the file, found {left} more bytes");
                assert!(scan_message(&file).contains(&words), "{}", scan_message(&file));
                assert!(mesh_message(&file).contains(&words));
            }
        }
    }
}

#[test]
fn headers_of_a_million_names_are_rejected_at_once() {
    let properties: String = (0..1_000_000).map(|k| format!("property float p{k}\n")).collect();
    let elements: String = (0..1_000_000).map(|k| format!("element e{k} 0\n")).collect();
    assert!(
        scan_message(&ascii(&format!("element vertex 1\n{properties}"), ""))
            .contains("at most 4096 properties")
    );
    assert!(scan_message(&ascii(&elements, "")).contains("at most 4096 elements"));
}

#[test]
fn declared_counts_are_checked_before_memory_is_reserved() {
    for count in ["1000000000", "18446744073709551615"] {
        for format in ["ascii", "binary_little_endian"] {
            for elements in [
                format!("element vertex {count}\n{XYZ}"),
                format!(
                    "element vertex 1\n{XYZ}\nelement face {count}\nproperty list uchar int vertex_indices"
                ),
            ] {
                let bytes = file(format, &elements, b"1 2 3 4 5 6 7 8\n");
                let wrong = mesh_message(&bytes);
                assert!(wrong.contains(count) || wrong.contains("more"), "{wrong}");
            }
        }
        let grid = format!(
            "obj_info num_cols {count}\nobj_info num_rows 1\nelement vertex 1\n{XYZ}\nelement range_grid \
             {count}\n\
             property list uchar int vertex_indices"
        );
        assert!(scan_message(&ascii(&grid, "1 2 3\n")).contains(count));
    }
    // A list that declares 2³² − 1 corners.
    let elements = format!("element vertex 1\n{XYZ}\nelement face 1\nproperty list uint int vertex_indices");
    let bytes = file("binary_little_endian", &elements, &[&[0; 12][..], &[255; 4], &[0; 64]].concat());
    assert!(mesh_message(&bytes).contains("cut off"));
}

#[test]
fn elements_and_properties_may_come_in_any_order() {
    let elements = "element face 1\nproperty list uchar int vertex_indices\nelement vertex 3\nproperty \
        float nz\n\
        property double sigma\nproperty float z\nproperty float y\nproperty float x\nproperty float \
        ny\nproperty float nx";
    let body = "3 0 1 2\n1 0.5 3 2 1 0 0\n1 0.5 3 2 4 0 0\n1 0.25 3 5 4 0 0\n";
    let mesh = mesh(&ascii(elements, body)).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    assert_eq!(mesh.column("sigma").unwrap(), [0.5, 0.5, 0.25]);
    let scan = scan(&ascii(elements, body)).unwrap();
    assert_eq!(
        scan.points,
        [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 3.0)]
    );
    assert_eq!(scan.sigma.unwrap(), [0.5, 0.5, 0.25]);
    assert_eq!(scan.normals.unwrap(), [DVec3::Z; 3]);
}

#[test]
fn headers_with_invalid_utf8_and_blank_lines_are_read() {
    let mut bytes =
        b"ply\nformat ascii 1.0\ncomment J\xf6rg, comment unit\nobj_info \xff\xfe\n\ncomment unit in\n"
            .to_vec();
    bytes.extend_from_slice(b"element \xff 1\nproperty int \xfe\nelement vertex 1\n");
    bytes.extend_from_slice(format!("{XYZ}\nend_header\n\n7\n\n 1\t2  3 \n").as_bytes());
    let mesh = mesh(&bytes).unwrap();
    assert_eq!(mesh.points, [DVec3::new(1.0, 2.0, 3.0)]);
    assert_eq!(mesh.unit, Some(Unit::Inch));
}

#[test]
fn errors_of_headers_name_the_line() {
    let vertex = format!("element vertex 1\n{XYZ}");
    for (header, words) in [
        ("element vertex -1", "line 3: expected a count that is not negative"),
        ("element vertex many", "line 3: expected a count"),
        ("property float x", "line 3: expected an `element` line"),
        ("element vertex 1\nproperty quaternion q", "line 4: expected a type among"),
        ("element vertex 1\nproperty list float int i", "line 4: expected a list length of an integer type"),
        ("element vertex 1\nproperty x", "line 4: expected `property TYPE NAME`"),
        ("element vertex 1\nelement vertex 2", "line 4: expected a name that no other element"),
        (
            "element vertex 1\nproperty int x\nproperty int x",
            "line 5: expected a name that no other property",
        ),
        ("element vertex 1\nproperty int x", "found no y z"),
        ("element face 1", "expected an element `vertex`, found [face]"),
        ("format ascii 1.0", "line 3: expected one `format`"),
        ("rubbish", "line 3: expected `format`, `comment`"),
    ] {
        let message = scan_message(&ascii(header, "1 2 3\n"));
        assert!(message.contains(words), "{message}");
    }
    assert!(scan_message(&file("utf8", &vertex, b"")).contains("line 2: expected `ascii`"));
    assert!(scan_message(b"ply\nend_header\n").contains("expected a `format` line"));
    assert!(scan_message(b"solid part\n").contains("line 1: expected `ply`, found `solid part`"));
    assert!(scan_message(b"ply\rformat ascii 1.0\r").contains("lone carriage return"));
    assert!(
        scan_message(&ascii(&format!("{vertex}\nproperty float sigma\nproperty float cxx"), ""))
            .contains("found no cxy")
    );
}

#[test]
fn errors_of_bodies_name_line_and_record() {
    let vertex = format!("element vertex 2\n{XYZ}\nproperty float sigma");
    let start = "1 2 3 0.5\n";
    for (row, words) in [
        ("1 2 3\n", "line 10 (vertex 1): the line ends before `sigma`"),
        ("1 2 three 1\n", "line 10 (vertex 1): expected a number for `z`, found `three`"),
        ("1 2 3 4 5\n", "line 10 (vertex 1): expected the end of the line, found `5`"),
        ("1 2 3 -0.5\n", "line 10 (vertex 1): expected sigma > 0, found -0.5 (point 1)"),
        ("1 2 3 nan\n", "expected sigma > 0, found NaN"),
    ] {
        let message = scan_message(&ascii(&vertex, &format!("{start}{row}")));
        assert!(message.contains(words), "{message}");
    }
    let faces = format!("element vertex 3\n{XYZ}\nelement face 1\nproperty list char int vertex_indices");
    let points = "0 0 0\n1 0 0\n0 1 0\n";
    for (row, words) in [
        ("2 0 1", "line 13 (face 0): expected at least three corners, found 2"),
        ("0", "found 0"),
        ("-3 0 1 2", "expected a length for `vertex_indices`, found `-3`"),
        ("3 0 1 3", "expected a vertex index below 3, found 3"),
        ("3 0 1 -1", "found -1"),
        ("3 0 1 0.5", "found 0.5"),
        ("3 0 1", "the line ends before `vertex_indices`"),
    ] {
        let message = mesh_message(&ascii(&faces, &format!("{points}{row}\n")));
        assert!(message.contains(words), "{message}");
    }
    assert!(
        mesh_message(&ascii(&faces, "0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n"))
            .contains("line 11 (vertex 1): expected finite")
    );
    let negative = file(
        "binary_little_endian",
        &format!("element vertex 1\n{XYZ}\nelement face 1\nproperty list char int vertex_indices"),
        &[&[0; 12][..], &[0xfd], &[0; 12]].concat(),
    );
    let message = mesh_message(&negative);
    assert!(message.contains("(face 0): expected a length for `vertex_indices`, found -3"), "{message}");
}

#[test]
fn invalid_range_grids_are_rejected() {
    let grid = |info: &str, count: usize, cells: &str| {
        let elements = format!(
            "{info}\nelement vertex 1\n{XYZ}\nelement range_grid {count}\nproperty list uchar int \
             vertex_indices"
        );
        scan_message(&ascii(&elements, &format!("0 0 0\n{cells}")))
    };
    let info = "obj_info num_cols 2\nobj_info num_rows 1";
    assert!(grid("obj_info num_cols 2", 2, "0\n0\n").contains("requires `obj_info num_cols`"));
    assert!(grid(info, 3, "0\n0\n0\n").contains("expected 2 x 1 cells in `range_grid`, found 3"));
    assert!(grid(info, 2, "0\n1 1\n").contains("expected a vertex index below 1, found 1"));
    assert!(grid(info, 2, "0\n2 0 0\n").contains("expected none or one vertex in a cell, found 2"));
    assert!(grid("obj_info num_cols two", 2, "").contains("line 3: expected a number of columns"));
}

#[test]
fn write_read_write_gives_the_same_numbers_and_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let points = [[0.1, -0.0, 1e-300], [1.0 / 3.0, f64::MAX, 3.0], [0.0, 1.0, 2.0]].map(DVec3::from_array);
    let normals = [DVec3::new(0.0, 0.6, 0.8); 3];
    let (sigma, observed, triangles) = ([0.5, 1e-9, f64::INFINITY], [1, 0, 2], [[0, 1, 2], [2, 1, 0]]);
    let first = MeshColumns {
        points: &points,
        normals: Some(&normals),
        columns: vec![("sigma", Column::F64(&sigma)), ("observed", Column::U8(&observed))],
        triangles: &triangles,
        unit: Some(Unit::Millimetre),
    };
    write_mesh(&path, &first).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let read = read_mesh(&path).unwrap();
    assert_eq!(read.points.as_slice(), points);
    assert_eq!(read.triangles.as_slice(), triangles);
    assert_eq!((read.column("sigma"), read.unit), (Some(&sigma[..]), Some(Unit::Millimetre)));
    let column = |name: &str| read.column(name).unwrap();
    let normals: Vec<DVec3> =
        (0..3).map(|i| DVec3::new(column("nx")[i], column("ny")[i], column("nz")[i])).collect();
    let observed: Vec<u8> = column("observed").iter().map(|&o| o as u8).collect();
    let again = MeshColumns {
        points: &read.points,
        normals: Some(&normals),
        columns: vec![("sigma", Column::F64(column("sigma"))), ("observed", Column::U8(&observed))],
        triangles: &read.triangles,
        unit: read.unit,
    };
    write_mesh(&path, &again).unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
    write_points(&path, &again).unwrap();
    let points_only = read_mesh(&path).unwrap();
    assert_eq!((points_only.points.len(), points_only.triangles.len()), (3, 0));
}

#[test]
fn inconsistent_meshes_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let points = [DVec3::ZERO; 3];
    let good = MeshColumns { points: &points, triangles: &[[0, 1, 2]], ..MeshColumns::default() };
    for (mesh, words) in [
        (
            MeshColumns { triangles: &[[0, 1, 2], [0, 1, 3]], ..good.clone() },
            "triangle 1: expected indices below 3",
        ),
        (
            MeshColumns { normals: Some(&[]), ..good.clone() },
            "expected 3 entries in the column `normals`, found 0",
        ),
        (MeshColumns { columns: vec![("x", Column::U8(&[0; 3]))], ..good.clone() }, "no other column"),
        (MeshColumns { columns: vec![("a b", Column::U8(&[0; 3]))], ..good.clone() }, "one word"),
        (MeshColumns { columns: vec![("a", Column::F64(&[0.0]))], ..good }, "column `a`, found 1"),
    ] {
        let e = write_mesh(&path, &mesh).unwrap_err();
        assert!(e.kind() == ErrorKind::Input && e.to_string().contains(words), "{e}");
        assert!(!path.exists());
    }
}

#[test]
fn io_errors_differ_from_malformed_files() {
    let folder = tempfile::tempdir().unwrap();
    let error = |path: &Path| read_scan(path).unwrap_err();
    let e = error(&folder.path().join("gone.ply"));
    assert!(e.kind() == ErrorKind::Io && e.to_string().contains("gone.ply: does not exist"), "{e}");
    let e = error(folder.path());
    assert!(e.kind() == ErrorKind::Io && e.to_string().contains("found a folder"), "{e}");
    let empty = folder.path().join("empty.ply");
    std::fs::write(&empty, "").unwrap();
    let e = error(&empty);
    assert!(e.kind() == ErrorKind::Input && e.to_string().contains("empty.ply: the file is empty"), "{e}");
}

proptest! {
    #[test]
    fn no_bytes_cause_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = scan(&bytes);
        let _ = mesh(&bytes);
    }

    #[test]
    fn no_header_causes_a_panic(
        lines in "((element (vertex|face|range_grid) [0-9]{1,3}|property (float|uchar|int) [xyz]|property \
            list (uchar|int) (int|short) vertex_indices|obj_info num_(cols|rows) [0-9]|comment a)\n){0,9}",
        format in 0_usize..3,
        body in proptest::collection::vec(any::<u8>(), 0..200),
        text in "[0-9 .e\n-]{0,100}",
    ) {
        let formats = ["ascii", "binary_little_endian", "binary_big_endian"];
        for body in [&body[..], text.as_bytes()] {
            let bytes = file(formats[format], lines.trim_end(), body);
            let _ = scan(&bytes);
            let _ = mesh(&bytes);
        }
    }

    #[test]
    fn no_changed_byte_causes_a_panic(at in any::<proptest::sample::Index>(), value in any::<u8>()) {
        let mut bytes = range_scan();
        let at = at.index(bytes.len());
        bytes[at] = value;
        let _ = scan(&bytes);
        let _ = mesh(&bytes);
    }
}
