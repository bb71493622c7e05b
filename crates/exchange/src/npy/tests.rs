use planish_core::DVec3;
use planish_core::vector3::coordinates;
use std::io::{Cursor, Write};

use planish_estimate::ErrorKind;
use planish_sense::{RangeGrid, Viewing};
use proptest::prelude::*;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::*;

fn read(bytes: &[u8]) -> Result<Scan> {
    scan_from(Source::new(bytes, Some(bytes.len() as u64)), "a.npy")
}

fn message(bytes: &[u8]) -> String {
    read(bytes).unwrap_err().to_string()
}

/// A file as NumPy writes it.
fn file(descr: &str, columns_first: bool, shape: &str, body: &[u8]) -> Vec<u8> {
    let mut bytes = npy_header(descr, columns_first, shape);
    bytes.extend_from_slice(body);
    bytes
}

fn doubles(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|n| n.to_le_bytes()).collect()
}

const TWO: [DVec3; 2] = [DVec3::new(1.0, 2.0, -3.0), DVec3::new(4.0, 5.0, 6.0)];

#[test]
fn all_number_types_and_orders_give_the_same_points() {
    let rows = [1.0, 2.0, -3.0, 4.0, 5.0, 6.0];
    let columns = [1.0, 4.0, 2.0, 5.0, -3.0, 6.0];
    macro_rules! body {
        ($type:ty, $to:ident, $numbers:expr) => {
            $numbers.iter().flat_map(|&n| (n as $type).$to()).collect::<Vec<u8>>()
        };
    }
    let files = [
        file("'<f8'", false, "(2, 3)", &doubles(&rows)),
        file("'=f8'", false, "(2, 3)", &doubles(&rows)),
        file("'<f4'", false, "(2, 3)", &body!(f32, to_le_bytes, rows)),
        file("'>f4'", false, "(2, 3)", &body!(f32, to_be_bytes, rows)),
        file("'>f8'", true, "(2, 3)", &body!(f64, to_be_bytes, columns)),
        file("'<i2'", false, "(2, 3)", &body!(i16, to_le_bytes, rows)),
        file("'>i8'", true, "(2, 3)", &body!(i64, to_be_bytes, columns)),
        file("'|i1'", false, "(2L, 3L)", &body!(i8, to_le_bytes, rows)),
        file("\"<f8\"", false, "(2,3)", &doubles(&rows)),
    ];
    for bytes in &files {
        let scan = read(bytes).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(scan.points, TWO);
        assert!(scan.normals.is_none() && scan.sigma.is_none() && scan.grid.is_none());
    }
    // Versions 2 and 3 store the length of the header in four bytes.
    let mut second = files[0].clone();
    second[6] = 2;
    second.splice(10..10, [0, 0]);
    assert_eq!(read(&second).unwrap().points, TWO);
}

#[test]
fn fields_of_structured_arrays_are_columns() {
    let descr = "[('sigma', '<f4'), ('name', '|S3'), ('xyz', '<f8', (3,)), ('t', '<M8[ns]'), ('Nx', '>f4'), \
        ('ny', '<f4'), \
                 (('a title', 'nz'), '<f4'), ('rgb', '|u1', (3,)), ('', '|V1')]";
    let record = |sigma: f32, p: DVec3, n: [f32; 3]| {
        let mut bytes = sigma.to_le_bytes().to_vec();
        bytes.extend_from_slice(b"abc");
        bytes.extend(doubles(p.as_ref()));
        bytes.extend_from_slice(&[0; 8]);
        bytes.extend_from_slice(&n[0].to_be_bytes());
        bytes.extend_from_slice(&n[1].to_le_bytes());
        bytes.extend_from_slice(&n[2].to_le_bytes());
        bytes.extend_from_slice(&[1, 2, 3, 0]);
        bytes
    };
    let body = [
        record(0.5, TWO[0], [0.0, 0.0, 1.0]),
        record(0.25, DVec3::new(f64::NAN, 0.0, 0.0), [0.0; 3]),
        record(0.125, TWO[1], [0.5, 0.0, 0.0]),
    ]
    .concat();
    let scan = read(&file(descr, false, "(3,)", &body)).unwrap();
    assert_eq!((&scan.points[..], scan.dropped_not_finite), (&TWO[..], 1));
    assert_eq!(scan.sigma.unwrap(), [0.5, 0.125]);
    assert_eq!(scan.normals.unwrap(), [DVec3::Z, DVec3::new(0.5, 0.0, 0.0)]);
    // With one axis, Fortran order makes no difference.
    assert_eq!(read(&file(descr, true, "(3,)", &body)).unwrap().points, TWO);
}

#[test]
fn six_columns_are_normals_only_when_all_have_unit_length() {
    let with = |n: DVec3| {
        read(&file("'<f8'", false, "(1, 6)", &doubles(&[1.0, 2.0, 3.0, n[0], n[1], n[2]]))).unwrap()
    };
    assert_eq!(with(DVec3::new(0.6, 0.0, 0.8)).normals.unwrap(), [DVec3::new(0.6, 0.0, 0.8)]);
    assert!(with(DVec3::new(255.0, 0.0, 8.0)).normals.is_none());
    let four = read(&file("'<f8'", false, "(1, 4)", &doubles(&[1.0, 2.0, 3.0, 0.5]))).unwrap();
    assert!(four.sigma.is_none(), "a number without a name is not σ");
}

#[test]
fn organised_arrays_give_a_grid() {
    // Two rows of three, one of them empty; the same with columns first.
    let cell = |row: usize, column: usize| {
        [column as f64, row as f64, if (row, column) == (0, 1) { f64::NAN } else { 9.0 }]
    };
    let rows: Vec<f64> = (0..6).flat_map(|k| cell(k / 3, k % 3)).collect();
    let columns: Vec<f64> = (0..3)
        .flat_map(|c| (0..3).flat_map(move |column| (0..2).map(move |row| cell(row, column)[c])))
        .collect();
    for (columns_first, numbers) in [(false, &rows), (true, &columns)] {
        let scan = read(&file("'<f8'", columns_first, "(2, 3, 3)", &doubles(numbers))).unwrap();
        assert_eq!(
            scan.points,
            [
                9.0 * DVec3::Z,
                DVec3::new(2.0, 0.0, 9.0),
                DVec3::new(0.0, 1.0, 9.0),
                DVec3::new(1.0, 1.0, 9.0),
                DVec3::new(2.0, 1.0, 9.0)
            ]
        );
        let grid = scan.grid.unwrap();
        assert_eq!((grid.columns, grid.rows), (3, 2));
        assert_eq!(grid.cells, [0, RangeGrid::EMPTY, 1, 2, 3, 4]);
        assert_eq!(scan.viewing, Viewing::Unknown);
    }
}

#[test]
fn invalid_headers_are_reported() {
    let numbers = doubles(&[1.0; 6]);
    for (bytes, words) in [
        (file("'<f8'", false, "(1000000000, 3)", &numbers), "declares 3000000000 elements"),
        (file("'<f8'", true, "(1000000000, 3)", &numbers), "declares 3000000000 elements"),
        (file("'<f8'", false, "(18446744073709551615, 3)", &numbers), "declares"),
        (file("'<f8'", false, "(99999999999999999999, 3)", &numbers), "a smaller number"),
        (file("'<f8'", false, "(3, 2)", &numbers), "found a shape (3, 2)"),
        (file("'<f8'", false, "(6,)", &numbers), "expected an array (n, 3)"),
        (file("'<f8'", false, "()", &numbers), "found a shape ()"),
        (file("'<f8'", false, "(1, 1, 2, 3)", &numbers), "found a shape (1, 1, 2, 3)"),
        (file("'<f8'", false, "(-2, 3)", &numbers), "header"),
        (file("'<f2'", false, "(2, 3)", &numbers), "found the type '<f2'"),
        (file("'|O'", false, "(2, 3)", &numbers), "found the type '|O'"),
        (file("'<c16'", false, "(1, 3)", &numbers), "found the type '<c16'"),
        (file("[('x', '<f8'), ('y', '<f8')]", false, "(3,)", &numbers), "found no z"),
        (file("[('x', '<f8'), ('y', '<f8'), ('z', '|S8')]", false, "(2,)", &numbers), "found the type '|S8'"),
        (file("[('x', '<f8'), ('y', '<f8'), ('x', '<f8')]", false, "(2,)", &numbers), "`x` is named twice"),
        (file("[('p', [('x', '<f8')])]", false, "(2,)", &numbers), "found nested fields"),
        (file("[('x', '<f8', (99999999999,))]", false, "(2,)", &numbers), "at most 65536 numbers"),
        (file("[]", false, "(2,)", &numbers), "at least one byte"),
        (file("7", false, "(2,)", &numbers), "'descr'"),
        (b"\x93NUMPY\x01\x00\x04\x00{}\n ".to_vec(), "expected a key"),
        (b"\x93NUMPY\x09\x00\x04\x00{}\n ".to_vec(), "expected version 1, 2 or 3"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff{}".to_vec(), "found 4294967295"),
        (b"PK\x03\x04 an archive".to_vec(), "not an NPY file"),
        ([&b"\x93NUMPY\x01\x00\xe8\x03"[..], &[b'['; 1000]].concat(), "fewer nested lists"),
    ] {
        let found = message(&bytes);
        assert!(found.contains(words), "{words}: {found}");
    }
}

#[test]
fn truncated_files_are_rejected() {
    for columns_first in [false, true] {
        let complete = file("'<f4'", columns_first, "(2, 3)", &[0; 24]);
        for end in 0..complete.len() {
            assert!(read(&complete[..end]).is_err(), "{end}");
            assert!(scan_from(Source::new(&complete[..end], None), "a").is_err(), "{end}, of unknown length");
        }
    }
}

#[test]
fn images_have_two_axes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    let body: Vec<u8> = (0..40_u16).flat_map(u16::to_le_bytes).collect();
    std::fs::write(&path, file("'<u2'", false, "(2, 20)", &body)).unwrap();
    assert!(is_image(&path));
    let (columns, rows, numbers) = super::read_image(&path).unwrap();
    assert_eq!((columns, rows, numbers[21]), (20, 2, 21.0));
    let e = read_npy(&path).unwrap_err().to_string();
    assert!(e.contains("a.npy: expected an array") && e.contains("(2, 20)"), "{e}");
}

/// An archive of arrays, stored or packed.
fn archive(arrays: &[(&str, Vec<u8>)], method: CompressionMethod) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in arrays {
        let options = SimpleFileOptions::default().compression_method(method);
        writer.start_file(format!("{name}.npy"), options).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn read_archive(bytes: &[u8]) -> Result<Scan> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    std::fs::write(&path, bytes).unwrap();
    read_npz(&path)
}

fn points() -> Vec<u8> {
    file("'<f8'", false, "(2, 3)", &doubles(coordinates(&TWO)))
}

#[test]
fn arrays_of_an_archive_are_combined() {
    let arrays = [
        ("sigma", file("'<f4'", false, "(2,)", &[0.5_f32, 0.25].map(f32::to_le_bytes).concat())),
        ("colours", file("'|u1'", false, "(7, 3)", &[0; 21])),
        // Columns first, beside rows first.
        ("normals", file("'<f8'", true, "(2, 3)", &doubles(&[0.0, 0.6, 0.0, 0.8, 1.0, 0.0]))),
        ("points", points()),
        ("viewpoint", file("'<f8'", false, "(3,)", &doubles(&[0.0, 0.0, 5.0]))),
    ];
    for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        let scan = read_archive(&archive(&arrays, method)).unwrap();
        assert_eq!(scan.points, TWO);
        assert_eq!(scan.sigma.unwrap(), [0.5, 0.25]);
        assert_eq!(scan.normals.unwrap(), [DVec3::Z, DVec3::new(0.6, 0.8, 0.0)]);
        assert_eq!(scan.viewing, Viewing::Origin(DVec3::new(0.0, 0.0, 5.0)));
        let single = read_archive(&archive(&[("arr_0", points())], method)).unwrap();
        assert_eq!(single.points, TWO);
        let axis = |k: usize| file("'<f8'", false, "(2,)", &doubles(&[TWO[0][k], TWO[1][k]]));
        let apart =
            read_archive(&archive(&[("z", axis(2)), ("x", axis(0)), ("y", axis(1))], method)).unwrap();
        assert_eq!(apart.points, TWO);
    }
}

#[test]
fn invalid_archives_are_reported() {
    let stored = |arrays: &[(&str, Vec<u8>)]| {
        let e = read_archive(&archive(arrays, CompressionMethod::Stored)).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Input, "{e}");
        e.to_string()
    };
    let three = file("'<f8'", false, "(3,)", &doubles(&[1.0; 3]));
    assert!(stored(&[("a", points()), ("b", points())]).contains("expected an array `points`, found [a, b]"));
    assert!(stored(&[]).contains("expected an array `points`"));
    assert!(stored(&[("points", points()), ("sigma", three.clone())]).contains("`points` and `sigma`"));
    assert!(
        stored(&[("points", three.clone()), ("sigma", three.clone())])
            .contains("array `points`: expected an array (n, 3)")
    );
    assert!(stored(&[("points", points()), ("x", three.clone())]).contains("`x` is named twice"));
    assert!(
        stored(&[("points", points()), ("viewpoint", points()), ("b", three)])
            .contains("three finite numbers")
    );
    assert!(read_archive(b"PK\x03\x04 no more").unwrap_err().to_string().contains("not an NPZ archive"));
}

#[test]
fn truncated_archives_are_rejected() {
    let complete = archive(&[("points", points()), ("sigma", points())], CompressionMethod::Deflated);
    for end in 0..complete.len() {
        assert!(read_archive(&complete[..end]).is_err(), "{end}");
    }
}

proptest! {
    #[test]
    fn no_header_causes_a_panic(text in "[\\[\\](){}:,'\"a-z0-9<>|TrueFalse ]{0,120}") {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend_from_slice(&(text.len() as u16).to_le_bytes());
        bytes.extend_from_slice(text.as_bytes());
        let _ = read(&bytes);
    }

    #[test]
    fn no_changed_byte_causes_a_panic(at in 0_usize..400, value in any::<u8>()) {
        let mut bytes = file("[('x', '<f8'), ('y', '<f8'), ('z', \
            '<f8')]", false, "(2,)", &doubles(coordinates(&TWO)));
        let at = at % bytes.len();
        bytes[at] = value;
        let _ = read(&bytes);
        let mut bytes = archive(&[("points", points())], CompressionMethod::Deflated);
        let at = at % bytes.len();
        bytes[at] = value;
        let _ = read_archive(&bytes);
    }
}
