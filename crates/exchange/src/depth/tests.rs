use std::fs;
use std::io::Cursor;

use planish_estimate::ErrorKind;
use planish_sense::RangeGrid;
use proptest::prelude::*;
use tiff::encoder::{TiffEncoder, colortype};

use super::*;
use crate::read_inputs;

const CAMERA: &str =
    "unit = \"m\"\nfx = 2\nfy = 2\ncx = 1\ncy = 0.5\nscale = 0.001\nsigma_a = 0.001\nsigma_b = 0.002\n";
/// Three columns and two rows, in millimetres; one pixel has no reading.
const DEPTHS: [u16; 6] = [1000, 2000, 0, 1500, 65535, 1000];

fn png(colour: png::ColorType, depth: png::BitDepth, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 3, 2);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(body).unwrap();
    writer.finish().unwrap();
    bytes
}

fn png16() -> Vec<u8> {
    let body: Vec<u8> = DEPTHS.iter().flat_map(|d| d.to_be_bytes()).collect();
    png(png::ColorType::Grayscale, png::BitDepth::Sixteen, &body)
}

fn tiff32() -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let depths = DEPTHS.map(|d| if d == 0 { f32::NAN } else { f32::from(d) });
    TiffEncoder::new(&mut bytes).unwrap().write_image::<colortype::Gray32Float>(3, 2, &depths).unwrap();
    bytes.into_inner()
}

fn npy() -> Vec<u8> {
    let header = "{'descr': '<u2', 'fortran_order': False, 'shape': (2, 3)}\n";
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend(DEPTHS.iter().flat_map(|d| d.to_le_bytes()));
    bytes
}

#[test]
fn every_format_gives_the_same_organised_scan() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("camera.toml"), CAMERA).unwrap();
    for (name, bytes) in [("a.png", png16()), ("b.tif", tiff32()), ("c.npy", npy())] {
        fs::write(at(name), bytes).unwrap();
        let job = format!("[[scan]]\nfile = \"{name}\"\ncalibration = \"camera.toml\"\n");
        fs::write(at("job.toml"), job).unwrap();
        let set = read_inputs(&[at("job.toml")], None).unwrap();
        assert_eq!(set.unit, Some(Unit::Metre), "{name}");
        let inputs: Vec<_> = set.inputs.iter().map(|i| i.path.file_name().unwrap()).collect();
        assert_eq!(inputs, ["job.toml", "camera.toml", name]);
        let scan = &set.scans[0].scan;
        assert_eq!((scan.points.len(), scan.dropped_not_finite), (5, 1), "{name}");
        assert_eq!(scan.viewing, Viewing::Origin(DVec3::ZERO));
        let grid = scan.grid.as_ref().unwrap();
        assert_eq!((grid.columns, grid.rows), (3, 2));
        assert_eq!(grid.cells, [0, 1, RangeGrid::EMPTY, 2, 3, 4]);
        // Column 0, row 1: half a unit left of the axis and a quarter below it, at 1.5 m.
        let p = scan.points[2];
        assert!(
            p.to_array().iter().zip([-0.75, 0.375, 1.5]).all(|(a, b)| (a - b).abs() < 1e-12),
            "{name} {p:?}"
        );
        let ray = DVec3::from_array([-0.75, 0.375, 1.5].map(|c| c / 2.953_125_f64.sqrt()));
        let sigma = scan.covariance.as_ref().unwrap()[2].along(ray).sqrt();
        assert!((sigma - 0.0055 * 1.3125_f64.sqrt()).abs() < 1e-12, "{name} {sigma}");
    }
}

#[test]
fn the_calibration_may_be_beside_the_image() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.png");
    fs::write(&path, png16()).unwrap();
    let e = read_inputs(&[&path], None).unwrap_err().to_string();
    assert!(
        e.contains("depth.png: expected the calibration") && e.contains("depth.toml with fx fy cx cy"),
        "{e}"
    );
    fs::write(folder.path().join("depth.toml"), CAMERA).unwrap();
    assert_eq!(read_inputs(&[&path], None).unwrap().scans[0].scan.points.len(), 5);
    let e = read_inputs(&[folder.path().join("gone.png")], None).unwrap_err();
    assert!(e.kind() == ErrorKind::Io && e.to_string().contains("does not exist"), "{e}");
    let job = folder.path().join("job.toml");
    fs::write(&job, "[[scan]]\nfile = \"depth.png\"\ncalibration = \"gone.toml\"\n").unwrap();
    let e = read_inputs(&[&job], None).unwrap_err().to_string();
    assert!(e.contains("the calibration") && e.contains("gone.toml"), "{e}");
    fs::write(&job, "[[scan]]\nfile = \"a.xyz\"\ncalibration = \"depth.toml\"\n").unwrap();
    fs::write(folder.path().join("a.xyz"), "1 2 3\n").unwrap();
    let e = read_inputs(&[&job], None).unwrap_err().to_string();
    assert!(e.contains("expected a depth image") && e.contains("`xyz`"), "{e}");
}

#[test]
fn files_of_points_are_refused_before_a_camera_is_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["x.pcd", "x.ply", "x.XYZ", "x.las", "x.jpg", "x"] {
        let path = folder.path().join(name);
        let missing = find_calibration(&path, None).unwrap_err();
        assert_eq!(missing.kind(), ErrorKind::Io, "{missing}");
        std::fs::write(&path, "1 2 3\n").unwrap();
        std::fs::write(folder.path().join("camera.toml"), CAMERA).unwrap();
        let with_camera = read_depth(&path, &folder.path().join("camera.toml")).map(|_| ());
        for error in [find_calibration(&path, None).map(|_| ()), with_camera].map(Result::unwrap_err) {
            let text = error.to_string();
            assert_eq!(error.kind(), ErrorKind::Unsupported, "{text}");
            assert!(
                text.contains(name) && text.contains("expected a depth image") && !text.contains("fx"),
                "{text}"
            );
        }
    }
}

fn image(name: &str, bytes: &[u8]) -> Result<Image> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    read_image(&path)
}

#[test]
fn colour_images_and_damaged_files_are_rejected() {
    let picture = png(png::ColorType::Rgb, png::BitDepth::Eight, &[0; 18]);
    let e = image("a.png", &picture).err().unwrap();
    assert!(e.kind() == ErrorKind::Unsupported && e.to_string().contains("Rgb"), "{e}");
    let eight = png(png::ColorType::Grayscale, png::BitDepth::Eight, &[1, 2, 3, 4, 5, 6]);
    assert_eq!(image("a.png", &eight).unwrap().readings, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    assert!(image("a.tif", b"II*\0").is_err() && image("a.png", b"no image").is_err());
    // The image data end before the last chunk, so a file cut off there is still complete.
    let complete = png16();
    for end in 0..complete.len() {
        if let Ok(found) = image("a.png", &complete[..end]) {
            assert_eq!(found.readings, DEPTHS.map(f64::from), "{end}");
        }
    }
    let complete = tiff32();
    for end in 0..complete.len() {
        if let Ok(found) = image("a.tif", &complete[..end]) {
            assert_eq!(found.readings.len(), 6, "{end}");
        }
    }
    let complete = npy();
    for end in 0..complete.len() {
        assert!(image("a.npy", &complete[..end]).is_err(), "{end}");
    }
    // Width and height of the PNG header.
    let mut bomb = png16();
    bomb[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
    assert!(image("a.png", &bomb).is_err());
    assert!(take_pixels(1 << 31, 1 << 31, Some(1000), 8, &Budget::of_process()).is_err());
}

proptest! {
    #[test]
    fn no_changed_byte_causes_a_panic(at in 0_usize..300, value in any::<u8>()) {
        for (name, mut bytes) in [("a.png", png16()), ("a.tif", tiff32()), ("a.npy", npy())] {
            let at = at % bytes.len();
            bytes[at] = value;
            let _ = image(name, &bytes);
        }
    }
}

#[test]
fn impossible_tags_and_sizes_are_rejected_before_memory_is_allocated() {
    let complete = tiff32();
    let read = |bytes: &[u8]| read_tiff(Cursor::new(bytes.to_vec()), Some(bytes.len() as u64));
    assert_eq!(read(&complete).unwrap().readings.len(), 6);
    let number = |at: usize| u32::from_le_bytes(complete[at..at + 4].try_into().unwrap()) as usize;
    let first = number(4);
    let tags = usize::from(complete[first]);
    // A tag of two bytes, a type of two, a count, a value.
    for at in (0..tags).map(|k| first + 2 + 12 * k) {
        let mut bomb = complete.clone();
        bomb[at + 4..at + 8].copy_from_slice(&8_000_000_u32.to_le_bytes());
        let e = read(&bomb).err().expect("a damaged tag");
        assert!(e.kind() == ErrorKind::Input && e.to_string().contains("declares 8000000 values"), "{e}");
    }
    let mut bomb = complete.clone();
    let rows = (0..tags).map(|k| first + 2 + 12 * k).find(|&at| complete[at..at + 2] == [1, 1]).unwrap();
    bomb[rows + 8..rows + 12].copy_from_slice(&80_000_u32.to_le_bytes());
    assert!(read(&bomb).is_err());
}
