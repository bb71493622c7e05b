//! Valid scans and lists of scans, in every format of points.

use super::{points, written};
use las::point::{Classification, Format};
use planish_core::{DVec3, SymmetricMatrix3, vector3::from_arrays};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::ply::write_scan;
use planish_sense::{RangeGrid, Scan};
use std::fmt::Write as _;
use std::io::Cursor;
use std::path::Path;

/// Scans with σ, covariances, normals and grids, in all three encodings.
pub fn ply_scans() -> Result<Vec<Vec<u8>>> {
    let points = from_arrays(&points(4)).to_vec();
    let count = points.len();
    let full = Scan {
        covariance: Some(vec![SymmetricMatrix3::from_array([0.4, 0.1, 0.0, 0.5, 0.0, 0.6]); count]),
        normals: Some(vec![DVec3::new(0.0, 0.6, 0.8); count]),
        sigma_normal_deg: Some(vec![2.0; count]),
        grid: Some(RangeGrid {
            columns: 4,
            rows: 5,
            // The last row is empty, as where a scanner sees nothing.
            cells: (0..20).map(|k| if k < 16 { k } else { RangeGrid::EMPTY }).collect(),
        }),
        points: points.clone(),
        ..Scan::default()
    };
    let plain = Scan { sigma: Some(vec![0.1; count]), points, ..Scan::default() };
    // What our writer never writes: text, an unknown element with a list, and a missing coordinate.
    let text = "ply\nformat ascii 1.0\ncomment unit mm\nobj_info num_cols 2\nobj_info num_rows 2\nobj_info \
        is_cyberware_data 1\n\
                element vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float \
                sigma\nelement other 1\n\
                property list uchar short list\nelement range_grid 4\nproperty list uchar int \
                vertex_indices\nend_header\n\
                0 0 0.5 0.1\n1 0 nan 0.2\n0 1 0.25 0.1\n2 -7 8\n1 0\n1 1\n0\n1 2\n";
    // Another byte order, mixed types and line ends of Windows, which our writer never writes.
    let mut big = b"ply\r\nformat binary_big_endian 1.0\r\nelement vertex 2\r\nproperty float x\r\nproperty \
        double y\r\nproperty int z\r\n\
                    property uchar red\r\nend_header\r\n"
        .to_vec();
    for k in 0..2_u8 {
        big.extend(f32::from(k).to_be_bytes());
        big.extend(0.5_f64.to_be_bytes());
        big.extend(i32::from(k).to_be_bytes());
        big.push(k);
    }
    Ok(vec![
        written(|path| write_scan(path, &full, Some(Unit::Inch)), "a.ply")?,
        written(|path| write_scan(path, &plain, None), "a.ply")?,
        text.as_bytes().to_vec(),
        big,
    ])
}

/// Points as text, with and without column names.
pub fn texts() -> Result<Vec<Vec<u8>>> {
    let plain = points(4).iter().fold(String::new(), |mut text, [x, y, z]| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{x} {y} {z}");
        text
    });
    let texts = [
        plain.as_str(),
        // A count, then intensity and colour, as in PTS files of Leica.
        "3\n0 0 0 17 255 0 0\n1 0 0 17 255 0 0\n0 1 0 17 255 0 0\n",
        "0 0 0 0 0 1\n1 0 0 0.6 0 0.8\n0 1 0 0 0 1\n",
        "# x y z cxx cxy cxz cyy cyz czz\n1 2 3 4 0 0 5 0 6\n1 2 4 4 0 0 5 0 6\n",
        "\u{feff}\"x\",\"y\",\"z\",\"sigma\",\"nx\",\"ny\",\"nz\",\"sigma_n_deg\"\r\n\
         \"1\",2,3,0.5,0,0,1,2\r\n1,2,,0.5,0,0,1,2\r\n",
        // Semicolons, and NaN of older C libraries of Windows.
        "x;y;z\n1;2;3\n4;5;1.#QNAN\n",
        "// made by hand\n1\t2\t3\n\n4\t5\t-6e-3\n",
    ];
    Ok(texts.map(|text| text.as_bytes().to_vec()).to_vec())
}

/// Organised and plain clouds in the three encodings.
pub fn pcds() -> Result<Vec<Vec<u8>>> {
    let head = |data: &str| {
        format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z normal_x normal_y normal_z sigma extra\nSIZE 8 8 8 4 4 \
             4 4 2\nTYPE F F F F F F F U\n\
             COUNT 1 1 1 1 1 1 1 3\nWIDTH 3\nHEIGHT 3\nVIEWPOINT 0 0 5 1 0 0 0\nPOINTS 9\nDATA {data}\n"
        )
        .into_bytes()
    };
    let records: Vec<Vec<Vec<u8>>> = points(3)
        .iter()
        .map(|point| {
            let mut fields: Vec<Vec<u8>> = point.iter().map(|c| c.to_le_bytes().to_vec()).collect();
            fields.extend([0.0_f32, 0.0, 1.0, 0.1].map(|n| n.to_le_bytes().to_vec()));
            fields.push(vec![1, 0, 2, 0, 3, 0]);
            fields
        })
        .collect();
    let binary: Vec<u8> = records.iter().flatten().flatten().copied().collect();
    // The compressed form holds one field after the other, not one point after the other.
    let columns: Vec<u8> =
        (0..8).flat_map(|field| records.iter().flat_map(move |r| r[field].clone())).collect();
    let mut compressed = Vec::new();
    for (k, run) in columns.chunks(32).enumerate() {
        // A run that repeats the one before it becomes an LZF back reference, so that both kinds occur.
        if k > 0 && run.len() == 32 && run == &columns[32 * (k - 1)..32 * k] {
            compressed.extend([0b1110_0000, 23, 31]);
        } else {
            compressed.push(run.len() as u8 - 1);
            compressed.extend_from_slice(run);
        }
    }
    let sizes = [compressed.len() as u32, columns.len() as u32].map(u32::to_le_bytes).concat();
    let text: String = points(3).iter().map(|[x, y, z]| format!("{x} {y} {z} 0 0 1 0.1 1 2 3\n")).collect();
    let plain = b"VERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 2\nHEIGHT 1\nPOINTS \
        2\nDATA ascii\n1 2 3 4.2e+06\nnan nan nan 0\n";
    Ok(vec![
        [head("binary"), binary].concat(),
        [head("binary_compressed"), sizes, compressed].concat(),
        [head("ascii"), text.into_bytes()].concat(),
        plain.to_vec(),
    ])
}

/// LAS files of old and new point formats.
pub fn las() -> Result<Vec<Vec<u8>>> {
    // Formats from 6 on have other records than those before, and need version 1.4.
    [(2, 1), (2, 3), (4, 6), (4, 8)].into_iter().map(|(minor, format)| lidar(minor, format, false)).collect()
}

/// LAZ files, compressed point by point and in layers.
pub fn laz() -> Result<Vec<Vec<u8>>> {
    [(2, 1), (2, 3), (4, 6), (4, 7)].into_iter().map(|(minor, format)| lidar(minor, format, true)).collect()
}

/// A small LAS or LAZ file of the given version and point format.
fn lidar(minor: u8, format: u8, compressed: bool) -> Result<Vec<u8>> {
    let failed = |e: las::Error| Error::io("no lidar").with_source(e);
    let mut builder = las::Builder::from((1, minor));
    builder.point_format = Format::new(format).map_err(failed)?;
    builder.point_format.extra_bytes = u16::from(format == 3 || format == 7);
    builder.point_format.is_compressed = compressed;
    let point_format = builder.point_format;
    let header = builder.into_header().map_err(failed)?;
    let mut writer = las::Writer::new(Cursor::new(Vec::new()), header).map_err(failed)?;
    for (k, [x, y, z]) in points(5).into_iter().enumerate() {
        let point = las::Point {
            x,
            y,
            z,
            classification: if k % 3 == 0 { Classification::Ground } else { Classification::Unclassified },
            // Withheld points and other classes, so that the filters of the reader have something to do.
            is_withheld: k == 7,
            gps_time: point_format.has_gps_time.then_some(k as f64),
            color: point_format.has_color.then(|| las::Color::new(1, 2, k as u16)),
            nir: point_format.has_nir.then_some(9),
            extra_bytes: vec![k as u8; usize::from(point_format.extra_bytes)],
            ..las::Point::default()
        };
        writer.write_point(point).map_err(failed)?;
    }
    Ok(writer.into_inner().map_err(failed)?.into_inner())
}

/// Lists of scans as VRIP writes them; they name `good.xyz` in the same folder.
pub fn lists() -> Result<Vec<Vec<u8>>> {
    Ok(vec![
        b"camera 0 0 0 0 0 0 1\n# by hand\nbmesh good.xyz 1 2 -3e-2 0 0 0.70710678 0.70710678\n".to_vec(),
        b"bmesh good.xyz 0 0 0 0 0 0 1\r\nbmesh ./a scan.xyz 0 0 0 1 0 0 0\r\n".to_vec(),
    ])
}

/// Job files; they name `good.xyz` in the same folder.
pub fn jobs() -> Result<Vec<Vec<u8>>> {
    let job = "unit = \"mm\"\n[sensor.laser]\nkind = \"range\"\nsigma_along = 0.05\nsigma_across = \
        0.02\n[sensor.probe]\nkind = \"touch\"\n\
               sigma = 0.004\n[[scan]]\nsensor = \"laser\"\nfile = \"good.xyz\"\npose = { translation = [1, \
               2, 3], quaternion_xyzw = [0, 0, \
               0.70710678, 0.70710678], sigma_translation = 0.1, sigma_rotation_deg = 0.05 }\nviewpoint = \
               [0, 0, 300]\n[[scan]]\nsensor = \
               \"probe\"\nfile = \"a scan.xyz\"\ndirection = [0, 0, -1]\n";
    Ok(vec![job.as_bytes().to_vec(), b"[[scan]]\nfile = \"good.xyz\"\n".to_vec()])
}

/// An array in the NPY format of NumPy.
fn array(number: &str, columns_first: &str, shape: &str, body: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{number}', 'fortran_order': {columns_first}, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(body);
    bytes
}

/// Arrays of points, plain and organised.
pub fn npys() -> Result<Vec<Vec<u8>>> {
    let rows: Vec<u8> = points(4).iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    let single: Vec<u8> = points(2).iter().flatten().flat_map(|c| (*c as f32).to_be_bytes()).collect();
    Ok(vec![
        array("<f8", "False", "(16, 3)", &rows),
        array("<f8", "False", "(4, 4, 3)", &rows),
        // Differs from the first array in type, byte order and order of the numbers.
        array(">f4", "True", "(4, 3)", &single),
    ])
}

/// An E57 file of two clouds: one Cartesian with a pose, one spherical with a grid.
pub fn e57s() -> Result<Vec<Vec<u8>>> {
    use e57::{
        E57Writer, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform, Translation,
    };
    let failed = |e: e57::Error| Error::io("no E57").with_source(e);
    let double = |name| Record { name, data_type: RecordDataType::F64 };
    let integer = |name, max| Record { name, data_type: RecordDataType::Integer { min: 0, max } };
    let write = |path: &Path| -> e57::Result<()> {
        let mut writer = E57Writer::from_file(path, "file")?;
        let cartesian = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
        let mut records: Vec<Record> = cartesian.map(double).into();
        records.push(integer(RecordName::CartesianInvalidState, 2));
        let mut cloud = writer.add_pointcloud("first", records)?;
        cloud.set_transform(Some(Transform {
            rotation: Quaternion { w: 0.6, x: 0.0, y: 0.0, z: 0.8 },
            translation: Translation { x: 10.0, y: 20.0, z: 30.0 },
        }));
        for point in points(3) {
            let mut values: Vec<RecordValue> = point.map(RecordValue::Double).into();
            values.push(RecordValue::Integer(0));
            cloud.add_point(values)?;
        }
        cloud.finalize()?;
        let spherical =
            [RecordName::SphericalRange, RecordName::SphericalAzimuth, RecordName::SphericalElevation];
        let mut records: Vec<Record> = spherical.map(double).into();
        records.extend([integer(RecordName::RowIndex, 1), integer(RecordName::ColumnIndex, 2)]);
        let mut cloud = writer.add_pointcloud("second", records)?;
        for k in 0..5_i64 {
            let mut values: Vec<RecordValue> = [2.0, 0.1 * k as f64, 0.2].map(RecordValue::Double).into();
            values.extend([k / 3, k % 3].map(RecordValue::Integer));
            cloud.add_point(values)?;
        }
        cloud.finalize()?;
        writer.finalize()
    };
    Ok(vec![written(|path| write(path).map_err(failed), "a.e57")?])
}
