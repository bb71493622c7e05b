use std::fs;
use std::path::PathBuf;

use e57::{E57Writer, Quaternion, Transform, Translation};
use proptest::prelude::*;

use super::*;
use crate::{Unit, read_inputs};

fn double(name: RecordName) -> Record {
    Record { name, data_type: RecordDataType::F64 }
}

fn integer(name: RecordName, max: i64) -> Record {
    Record { name, data_type: RecordDataType::Integer { min: 0, max } }
}

/// A file with a Cartesian cloud that has a pose and an invalid point, an organised spherical cloud, and an
/// empty one.
fn file(folder: &Path) -> PathBuf {
    let path = folder.join("a.e57");
    let mut writer = E57Writer::from_file(&path, "file").unwrap();
    let cartesian = vec![
        double(RecordName::CartesianX),
        double(RecordName::CartesianY),
        double(RecordName::CartesianZ),
        integer(RecordName::CartesianInvalidState, 2),
    ];
    let mut cloud = writer.add_pointcloud("first", cartesian).unwrap();
    cloud.set_name(Some("door".to_owned()));
    // A quarter turn about z.
    let h = 0.5_f64.sqrt();
    cloud.set_transform(Some(Transform {
        rotation: Quaternion { w: h, x: 0.0, y: 0.0, z: h },
        translation: Translation { x: 10.0, y: 20.0, z: 30.0 },
    }));
    for (k, state) in [(0, 0), (1, 2), (2, 0)] {
        let [x, y, z] = [f64::from(k), 0.5, -1.0].map(RecordValue::Double);
        cloud.add_point(vec![x, y, z, RecordValue::Integer(state)]).unwrap();
    }
    cloud.finalize().unwrap();
    let spherical = vec![
        double(RecordName::SphericalRange),
        double(RecordName::SphericalAzimuth),
        double(RecordName::SphericalElevation),
        integer(RecordName::RowIndex, 1),
        integer(RecordName::ColumnIndex, 2),
    ];
    let mut cloud = writer.add_pointcloud("second", spherical).unwrap();
    for k in 0..5_i64 {
        let numbers = [2.0, 0.1 * k as f64, 0.2].map(RecordValue::Double);
        let indices = [k / 3, k % 3].map(RecordValue::Integer);
        cloud.add_point([&numbers[..], &indices[..]].concat()).unwrap();
    }
    cloud.finalize().unwrap();
    let empty =
        ["X", "Y", "Z"].iter().zip([RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ]);
    let mut cloud = writer.add_pointcloud("third", empty.map(|(_, name)| double(name)).collect()).unwrap();
    cloud.finalize().unwrap();
    writer.finalize().unwrap();
    path
}

#[test]
fn every_point_cloud_is_a_scan_with_its_pose() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(folder.path());
    let scans = read_e57(&path).unwrap();
    let [door, dome] = &scans[..] else { panic!("{}", scans.len()) };
    assert_eq!((door.name.as_str(), dome.name.as_str()), ("a.e57 1 (door)", "a.e57 2"));
    assert_eq!(
        (&door.points[..], door.dropped_not_finite),
        (&[DVec3::new(0.0, 0.5, -1.0), DVec3::new(2.0, 0.5, -1.0)][..], 1)
    );
    assert!(door.grid.is_none() && door.viewing == Viewing::Origin(DVec3::ZERO));
    let p = door.world_from_scanner.apply(door.points[1]);
    assert!(p.to_array().iter().zip([9.5, 22.0, 29.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{p:?}");
    let expected =
        [2.0 * 0.2_f64.cos() * 0.3_f64.cos(), 2.0 * 0.2_f64.cos() * 0.3_f64.sin(), 2.0 * 0.2_f64.sin()];
    assert!(dome.points[3].to_array().iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12));
    let grid = dome.grid.as_ref().unwrap();
    assert_eq!((grid.columns, grid.rows, &grid.cells[..]), (3, 2, &[0, 1, 2, 3, 4, RangeGrid::EMPTY][..]));
    assert_eq!(dome.viewing, Viewing::Origin(DVec3::ZERO));
}

#[test]
fn the_pose_of_a_job_applies_to_all_scans_of_a_file() {
    let folder = tempfile::tempdir().unwrap();
    file(folder.path());
    let job = folder.path().join("job.toml");
    fs::write(&job, "[[scan]]\nfile = \"a.e57\"\npose = { translation = [0, 0, 5] }\n").unwrap();
    let set = read_inputs(&[&job], None).unwrap();
    assert_eq!((set.unit, set.scans.len(), set.inputs.len()), (Some(Unit::Metre), 2, 2));
    assert_eq!((set.inputs[1].points, set.inputs[1].dropped_not_finite), (7, 1));
    assert_eq!(set.scans[0].scan.world_from_scanner.translation, DVec3::new(10.0, 20.0, 35.0));
    assert_eq!(set.scans[1].scan.world_from_scanner.translation, DVec3::new(0.0, 0.0, 5.0));
}

fn read(bytes: &[u8]) -> Result<Vec<Scan>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("b.e57");
    fs::write(&path, bytes).unwrap();
    read_e57(&path)
}

#[test]
fn truncated_files_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let complete = fs::read(file(folder.path())).unwrap();
    for end in 0..complete.len() {
        assert!(read(&complete[..end]).is_err(), "{end}");
    }
}

#[test]
fn shared_and_sparse_cells_give_no_grid() {
    assert!(grid(&[[0, 0], [1, 0], [0, 1], [0, 0]]).is_none());
    assert!(grid(&[[0, 0], [1, 0], [2, 0]]).is_none());
    assert!(grid(&[[i64::MIN, 0], [i64::MAX, 1]]).is_none());
    assert!(grid(&[[0, 0], [1_000_000, 1_000_000]]).is_none());
    assert!(grid(&[]).is_none());
}

/// Recomputes the checksums: the last four bytes of each page of 1024 are the CRC-32C of the others.
fn with_valid_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    for page in bytes.chunks_exact_mut(1024) {
        let (body, sum) = page.split_at_mut(1020);
        let crc = body.iter().fold(!0_u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |c, _| (c >> 1) ^ (0x82F6_3B78 * (c & 1)))
        });
        sum.copy_from_slice(&(!crc).to_be_bytes());
    }
    bytes
}

#[test]
fn a_declared_count_beyond_the_data_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let complete = fs::read(file(folder.path())).unwrap();
    let from = b"recordCount=\"5\"";
    let at = complete.windows(from.len()).position(|w| w == from).unwrap();
    let mut bomb = complete.clone();
    // The XML must keep its length, so the count can grow to one digit, 9.
    bomb[at + from.len() - 2] = b'9';
    assert_eq!(with_valid_checksums(complete.clone()), complete);
    let e = read(&with_valid_checksums(bomb)).unwrap_err().to_string();
    assert!(e.contains("point cloud 2: point 5 cannot be read"), "{e}");
}

proptest! {
    #[test]
    fn no_changed_byte_causes_a_panic(at in any::<usize>(), value in any::<u8>(), text in any::<bool>()) {
        let folder = tempfile::tempdir().unwrap();
        let mut bytes = fs::read(file(folder.path())).unwrap();
        let at = at % bytes.len();
        // In the XML at the end, changed digits are the interesting damage.
        bytes[at] = if text { b'0' + value % 10 } else { value };
        let _ = read(&with_valid_checksums(bytes));
    }
}
