//! Small files that describe something huge: each is rejected with a message that names the place, before it
//! takes more memory than its budget.

use crate::source::{DATA_RATIO, Source};
use planish_core::{Budget, ErrorKind, Result, Setting};
use std::io::Write;
use std::path::{Path, PathBuf};

fn file(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// The message of a rejected file; the error must name the setting that allows it.
fn over_budget<T>(result: Result<T>, words: &str) {
    let error = result.err().expect("more than the budget");
    assert_eq!(
        (error.kind(), error.settings()),
        (ErrorKind::Unsupported, &[Setting::MaxMemory][..]),
        "{error}"
    );
    assert!(error.to_string().contains(words), "{error}");
}

/// A chunk of a PNG file with its checksum.
fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut crc = flate2::Crc::new();
    crc.update(kind);
    crc.update(data);
    let length = (data.len() as u32).to_be_bytes();
    [&length[..], kind, data, &crc.sum().to_be_bytes()].concat()
}

/// A PNG file of a declared size whose data are padded to `length` bytes.
fn png(columns: u32, rows: u32, colour: u8, length: usize) -> Vec<u8> {
    let mut header = [columns.to_be_bytes(), rows.to_be_bytes()].concat();
    header.extend([8, colour, 0, 0, 0]);
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(&[0; 1 << 16]).unwrap();
    let mut data = packed.finish().unwrap();
    data.resize(length, 0);
    let magic = b"\x89PNG\r\n\x1a\n".to_vec();
    [magic, chunk(b"IHDR", &header), chunk(b"IDAT", &data), chunk(b"IEND", b"")].concat()
}

#[test]
fn pictures_larger_than_the_budget_are_rejected_by_their_header() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in [
        ("a.png", png(40_000, 38_000, 0, 1_500_000)),
        ("b.png", png(20_000, 20_000, 6, 1_500_000)),
        (
            "c.tga",
            [&[0, 0, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255, 24, 0][..], &[0; 34_000_000]]
                .concat(),
        ),
    ] {
        let path = file(folder.path(), name, &bytes);
        if name != "c.tga" {
            over_budget(crate::picture::read_picture(&path), " × ");
            file(folder.path(), &name.replace("png", "toml"), b"fx = 1\nfy = 1\ncx = 0\ncy = 0\n");
        } else {
            over_budget(crate::picture::read_picture(&path), "65535 × 65535");
        }
    }
    let depth = folder.path().join("a.png");
    over_budget(crate::depth::read_depth(&depth, &folder.path().join("a.toml")), "40000 × 38000");
}

#[test]
fn points_and_triangles_end_with_the_budget() {
    let budget = || Budget::with_max(100_000, 1000);
    let source = |bytes: Vec<u8>| Source::new(std::io::Cursor::new(bytes), None).with_budget(budget());
    let header = "ply\nformat binary_little_endian 1.0\nelement vertex 100000\nproperty uchar x\nproperty \
                  uchar y\n\
        property uchar z\n";
    let scan = [format!("{header}end_header\n").into_bytes(), vec![0; 300_000]].concat();
    over_budget(crate::ply::scan_from(&mut source(scan), "a"), "point 4166");
    let faces = "element face 100000\nproperty list uchar uchar vertex_indices\nend_header\n";
    let mesh = [
        format!("{}{faces}", header.replace("100000", "100")).into_bytes(),
        vec![0; 300],
        [3, 0, 1, 2].repeat(100_000),
    ];
    over_budget(crate::ply::mesh_from(&mut source(mesh.concat())), "face 8133");
    let text = "1 2 3\n".repeat(100_000).into_bytes();
    over_budget(crate::xyz::points_from(&mut source(text), "a"), "line 4167");
    // A line or a list of any length takes memory, too.
    over_budget(source(vec![b'x'; 1 << 20]).line().map(drop), "text at byte");
}

#[test]
fn an_array_that_unpacks_to_gigabytes_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let points = 20_000_000_usize;
    let header = crate::npy::npy_header("'|i1'", false, &format!("({points}, 3)"));
    let path = folder.path().join("a.npz");
    let mut archive = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    let options =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    archive.start_file("points.npy", options).unwrap();
    archive.write_all(&header).unwrap();
    let zeros = vec![0; 3 * 1_000_000];
    for _ in 0..points / 1_000_000 {
        archive.write_all(&zeros).unwrap();
    }
    archive.finish().unwrap();
    // The archive has some 60 kB, far below what 384 MiB of points need.
    assert!(std::fs::metadata(&path).unwrap().len() * DATA_RATIO < 384 << 20);
    over_budget(crate::npy::read_npz(&path), "array `points`");
}

#[test]
fn pictures_of_materials_are_regular_files() {
    let error = crate::textured::read_bytes(Path::new("/dev/zero")).unwrap_err();
    assert!(error.to_string().contains("/dev/zero: expected a regular file"), "{error}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    std::fs::File::create(&path).unwrap().set_len(1 << 40).unwrap();
    assert!(crate::textured::read_bytes(&path).unwrap_err().to_string().contains("at most"));
    // Not a regular file, but a picture may come through a pipe: up to a limit.
    let error = crate::source::read_limited(Path::new("/dev/zero"), 1000, "a picture").unwrap_err();
    assert_eq!(error.to_string(), "expected a picture of at most 1000 bytes, found more");
}
