//! Valid files of every format, small: what the damage begins with.
//!
//! Comes in: nothing. Goes out: bytes, from our own writers where there is one, else written by hand.

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use las::point::{Classification, Format};
use planish::fit::{FitOptions, fit};
use planish::progress::Silent;
use planish::saved::save;
use planish_estimate::{Error, Result};
use planish_exchange::glb::{PosedMesh, write_posed};
use planish_exchange::mesh::{Column, MeshColumns};
use planish_exchange::ply::{write_mesh, write_scan};
use planish_exchange::{Unit, read_inputs};
use planish_sense::{RangeGrid, Scan};
use std::fmt::Write as _;
use std::io::{Cursor, Read as _, Write as _};
use std::path::Path;

/// A wave over a square.
fn points(side: u32) -> Vec<[f64; 3]> {
    let height = |x: f64, y: f64| 0.1 * (7.0 * x * x + 3.0 * y).sin();
    (0..side * side)
        .map(|k| [k % side, k / side].map(|c| f64::from(c) / f64::from(side - 1)))
        .map(|[x, y]| [x, y, height(x, y)])
        .collect()
}

/// What a writer of files puts into one.
fn written(write: impl FnOnce(&Path) -> Result<()>, name: &str) -> Result<Vec<u8>> {
    let folder = tempfile::tempdir().map_err(|e| Error::io("no folder").with_source(e))?;
    let path = folder.path().join(name);
    write(&path)?;
    std::fs::read(&path).map_err(|e| Error::io("no file").with_source(e))
}

/// Scans with σ, covariances, normals and grids, in all three encodings.
pub fn ply_scans() -> Result<Vec<Vec<u8>>> {
    let points = points(4);
    let count = points.len();
    let full = Scan {
        covariance: Some(vec![[0.4, 0.1, 0.0, 0.5, 0.0, 0.6]; count]),
        normals: Some(vec![[0.0, 0.6, 0.8]; count]),
        sigma_normal_deg: Some(vec![2.0; count]),
        grid: Some(RangeGrid {
            columns: 4,
            rows: 5,
            cells: (0..20).map(|k| if k < 16 { k } else { RangeGrid::EMPTY }).collect(),
        }),
        points: points.clone(),
        ..Scan::default()
    };
    let plain = Scan { sigma: Some(vec![0.1; count]), points, ..Scan::default() };
    let text = "ply\nformat ascii 1.0\ncomment unit mm\nobj_info num_cols 2\nobj_info num_rows 2\nobj_info \
        is_cyberware_data 1\n\
                element vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float \
                sigma\nelement other 1\n\
                property list uchar short list\nelement range_grid 4\nproperty list uchar int \
                vertex_indices\nend_header\n\
                0 0 0.5 0.1\n1 0 nan 0.2\n0 1 0.25 0.1\n2 -7 8\n1 0\n1 1\n0\n1 2\n";
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

/// Meshes of triangles and polygons.
pub fn ply_meshes() -> Result<Vec<Vec<u8>>> {
    let points = points(3);
    let normals = vec![[0.0, 0.0, 1.0]; 9];
    let mesh = MeshColumns {
        points: &points,
        normals: Some(&normals),
        columns: vec![
            ("sigma", Column::F64(&[0.1; 9])),
            ("observed", Column::U8(&[1, 1, 0, 2, 1, 1, 1, 1, 1])),
        ],
        triangles: &[[0, 1, 3], [1, 4, 3], [1, 2, 4], [4, 2, 5], [3, 4, 6]],
        unit: Some(Unit::Metre),
    };
    let text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float \
        z\nproperty float quality\n\
                element face 2\nproperty list uchar int vertex_index\nproperty uchar flags\nend_header\n\
                0 0 0 1\n1 0 0 2\n1 1 0 3\n0 1 0 nan\n0 0 1 5\n4 0 1 2 3 0\n3 0 4 1 7\n";
    Ok(vec![written(|path| write_mesh(path, &mesh), "a.ply")?, text.as_bytes().to_vec()])
}

/// Plain points: columns with and without names.
pub fn texts() -> Result<Vec<Vec<u8>>> {
    let plain = points(4).iter().fold(String::new(), |mut text, [x, y, z]| {
        // Writing to a string does not fail.
        let _ = writeln!(text, "{x} {y} {z}");
        text
    });
    let texts = [
        plain.as_str(),
        "3\n0 0 0 17 255 0 0\n1 0 0 17 255 0 0\n0 1 0 17 255 0 0\n",
        "0 0 0 0 0 1\n1 0 0 0.6 0 0.8\n0 1 0 0 0 1\n",
        "# x y z cxx cxy cxz cyy cyz czz\n1 2 3 4 0 0 5 0 6\n1 2 4 4 0 0 5 0 6\n",
        "\u{feff}\"x\",\"y\",\"z\",\"sigma\",\"nx\",\"ny\",\"nz\",\"sigma_n_deg\"\r\n\"1\",2,3,0.5,0,0,1,2\r\n1,2,,0.5,0,0,1,2\r\n",
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
    let columns: Vec<u8> =
        (0..8).flat_map(|field| records.iter().flat_map(move |r| r[field].clone())).collect();
    let mut compressed = Vec::new();
    for (k, run) in columns.chunks(32).enumerate() {
        // Copies among the runs: the whole of the run before, which is as long.
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

/// LAS of old and new point formats.
pub fn las() -> Result<Vec<Vec<u8>>> {
    [(2, 1), (2, 3), (4, 6), (4, 8)].into_iter().map(|(minor, format)| lidar(minor, format, false)).collect()
}

/// The same, compressed point by point and in layers.
pub fn laz() -> Result<Vec<Vec<u8>>> {
    [(2, 1), (2, 3), (4, 6), (4, 7)].into_iter().map(|(minor, format)| lidar(minor, format, true)).collect()
}

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

/// Lists of scans as VRIP writes them; `good.xyz` lies beside them.
pub fn lists() -> Result<Vec<Vec<u8>>> {
    Ok(vec![
        b"camera 0 0 0 0 0 0 1\n# by hand\nbmesh good.xyz 1 2 -3e-2 0 0 0.70710678 0.70710678\n".to_vec(),
        b"bmesh good.xyz 0 0 0 0 0 0 1\r\nbmesh ./a scan.xyz 0 0 0 1 0 0 0\r\n".to_vec(),
    ])
}

/// Jobs; `good.xyz` lies beside them.
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

/// Models of a sheet and a ball.
pub fn models() -> Result<Vec<Vec<u8>>> {
    use planish::Shape;
    [Shape::Sheet, Shape::Ball].into_iter().map(model).collect()
}

fn model(shape: planish::Shape) -> Result<Vec<u8>> {
    let folder = tempfile::tempdir().map_err(|e| Error::io("no folder").with_source(e))?;
    let (scan, model) = (folder.path().join("a.ply"), folder.path().join("a.planish"));
    let round = |[u, v, _]: [f64; 3]| {
        let (longitude, z) = (std::f64::consts::TAU * u, 2.0 * v - 1.0);
        let radius = (1.0 - z * z).max(0.0).sqrt();
        [radius * longitude.cos(), radius * longitude.sin(), z]
    };
    let points = match shape {
        planish::Shape::Sheet => points(6),
        _ => points(9).into_iter().map(round).collect(),
    };
    write_scan(&scan, &Scan { points, ..Scan::default() }, Some(Unit::Millimetre))?;
    let options = FitOptions { shape: Some(shape), max_coefficients: 64, ..FitOptions::default() };
    // Without the sessions, which name the folder.
    save(&fit(&read_inputs(&[scan], None)?, &options, &Silent)?.model, &[], &model)?;
    std::fs::read(&model).map_err(|e| Error::io("no model").with_source(e))
}

/// What gzip makes of bytes.
pub fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    // Neither fails in memory.
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

/// What lists, jobs and cameras name: files beside the one that is read.
pub fn neighbours() -> Result<Vec<(&'static str, Vec<u8>)>> {
    let points = b"0 0 0\n1 0 0\n0 1 0\n".to_vec();
    Ok(vec![
        ("good.xyz", points.clone()),
        ("a scan.xyz", points),
        ("a.png", pngs()?.swap_remove(0)),
        ("a.toml", cameras()?.swap_remove(0)),
    ])
}

/// Four triangles over a square, as a format writes them.
fn square(name: &str) -> Result<Vec<u8>> {
    let points = points(3);
    let normals = vec![[0.0, 0.0, 1.0]; 9];
    let mesh = MeshColumns {
        points: &points,
        normals: Some(&normals),
        columns: vec![("sigma", Column::F64(&[0.1; 9]))],
        triangles: &[[0, 1, 3], [1, 4, 3], [1, 2, 4], [4, 2, 5], [3, 4, 6], [4, 7, 6], [4, 5, 7], [5, 8, 7]],
        unit: Some(Unit::Metre),
    };
    written(|path| planish_exchange::mesh::write_mesh(path, &mesh), name)
}

/// OBJ of ours and of others.
pub fn objs() -> Result<Vec<Vec<u8>>> {
    let other = "# made elsewhere\nmtllib a.mtl\no thing\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 1 1 0\nv 0 1 \
        0.5\nvt 0 0\nvn 0 0 1\n\
                 f 1/1/1 2/1/1 3/1/1 4/1/1\nf -4//-1 -3//-1 \\\n-1//-1\nl 1 2\ns off\n";
    Ok(vec![square("a.obj")?, other.as_bytes().to_vec()])
}

/// OFF as we write it and with polygons and colours. Faces on planes, cylinders, cones, spheres and splines,
/// in inches and millimetres, and parts in an assembly.
pub fn steps() -> Result<Vec<Vec<u8>>> {
    let files: [&[u8]; 5] = [
        include_bytes!("../../crates/exchange/tests/data/assembly.step.gz"),
        include_bytes!("../../crates/exchange/tests/data/rounded_box.step.gz"),
        include_bytes!("../../crates/exchange/tests/data/swept.step.gz"),
        include_bytes!("../../crates/exchange/tests/data/turned.step.gz"),
        include_bytes!("../../crates/exchange/tests/data/sheet.step.gz"),
    ];
    let unpacked = |packed: &[u8]| {
        let mut bytes = Vec::new();
        let read = GzDecoder::new(packed).read_to_end(&mut bytes);
        read.map(|_| bytes).map_err(|e| Error::io("not unpacked").with_source(e))
    };
    files.into_iter().map(unpacked).collect()
}

pub fn offs() -> Result<Vec<Vec<u8>>> {
    let other = "COFF\n# four\n4 1 0\n0 0 0 1 0 0 1\n1 0 0 1 0 0 1\n1 1 0 1 0 0 1\n0 1 0 1 0 0 1\n4 0 1 2 3 \
        0.5 0.5 0.5\n";
    Ok(vec![square("a.off")?, other.as_bytes().to_vec()])
}

/// Material files.
pub fn mtls() -> Result<Vec<Vec<u8>>> {
    Ok(vec![b"newmtl a\nKd 1 1 1\nmap_Kd a.png\nnewmtl b\nmap_Kd -s 1 1 1 b.png\n".to_vec()])
}

/// STL in binary and text.
pub fn stls() -> Result<Vec<Vec<u8>>> {
    let facet = |z: f64| {
        format!(
            "facet normal 0 0 1\n outer loop\n  vertex 0 0 {z}\n  vertex 1 0 {z}\n  vertex 0 1e0 {z}\n \
             endloop\nendfacet\n"
        )
    };
    let text = format!("solid thing\n{}{}endsolid thing\n", facet(0.0), facet(1.5));
    Ok(vec![square("a.stl")?, text.into_bytes()])
}

/// GLB as we write it.
pub fn glbs() -> Result<Vec<Vec<u8>>> {
    Ok(vec![square("a.glb")?])
}

/// A mesh with texture coordinates and a picture.
pub fn posed() -> Result<Vec<Vec<u8>>> {
    let mesh = PosedMesh {
        points: &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
        normals: &[[0.0, 0.0, 1.0]; 4],
        triangles: &[[0, 1, 2], [0, 2, 3]],
        uv: &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5]],
        sigma: &[0.1; 4],
        observed: &[1; 4],
        picture: Some(b"\x89PNG nobody looks into it"),
        ..PosedMesh::default()
    };
    Ok(vec![written(|path| write_posed(path, &mesh), "a.glb")?])
}

/// An array as NumPy writes it.
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
        array(">f4", "True", "(4, 3)", &single),
    ])
}

/// An array in an archive, beside another.
pub fn archive(array: &[u8], packed: bool) -> Vec<u8> {
    use zip::write::SimpleFileOptions;
    use zip::{CompressionMethod, ZipWriter};
    let method = if packed { CompressionMethod::Deflated } else { CompressionMethod::Stored };
    let options = SimpleFileOptions::default().compression_method(method);
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for name in ["points.npy", "normals.npy"] {
        // Neither fails in memory.
        let _ = writer.start_file(name, options);
        let _ = writer.write_all(array);
    }
    writer.finish().map(Cursor::into_inner).unwrap_or_default()
}

/// A file of two clouds, Cartesian with a pose and spherical with a grid.
pub fn e57s() -> Result<Vec<Vec<u8>>> {
    use e57::{
        E57Writer, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform, Translation,
    };
    let failed = |e: e57::Error| Error::io("no E57").with_source(e);
    let double = |name| Record { name, data_type: RecordDataType::F64 };
    let whole = |name, max| Record { name, data_type: RecordDataType::Integer { min: 0, max } };
    let write = |path: &Path| -> e57::Result<()> {
        let mut writer = E57Writer::from_file(path, "file")?;
        let cartesian = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
        let mut records: Vec<Record> = cartesian.map(double).into();
        records.push(whole(RecordName::CartesianInvalidState, 2));
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
        records.extend([whole(RecordName::RowIndex, 1), whole(RecordName::ColumnIndex, 2)]);
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

/// Depth images of 16 and 8 bits.
pub fn pngs() -> Result<Vec<Vec<u8>>> {
    let image = |depth, body: &[u8]| -> std::result::Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 4, 3);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(depth);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(body)?;
        writer.finish()?;
        Ok(bytes)
    };
    let failed = |e: png::EncodingError| Error::io("no PNG").with_source(e);
    let wide: Vec<u8> = (0..12_u16).flat_map(|k| (900 * k).to_be_bytes()).collect();
    let narrow: Vec<u8> = (0..12).collect();
    Ok(vec![
        image(png::BitDepth::Sixteen, &wide).map_err(failed)?,
        image(png::BitDepth::Eight, &narrow).map_err(failed)?,
    ])
}

/// Depth images of 16 bits and of floating point.
pub fn tiffs() -> Result<Vec<Vec<u8>>> {
    use tiff::encoder::{TiffEncoder, colortype};
    let failed = |e: tiff::TiffError| Error::io("no TIFF").with_source(e);
    let (mut wide, mut floating) = (Cursor::new(Vec::new()), Cursor::new(Vec::new()));
    let depths: Vec<u16> = (0..12).map(|k| 900 * k).collect();
    let mut encoder = TiffEncoder::new(&mut wide).map_err(failed)?;
    encoder.write_image::<colortype::Gray16>(4, 3, &depths).map_err(failed)?;
    let depths: Vec<f32> = depths.iter().map(|&d| f32::from(d) + 0.5).collect();
    let mut encoder = TiffEncoder::new(&mut floating).map_err(failed)?;
    encoder.write_image::<colortype::Gray32Float>(4, 3, &depths).map_err(failed)?;
    Ok(vec![wide.into_inner(), floating.into_inner()])
}

/// Calibrations of a depth camera.
pub fn cameras() -> Result<Vec<Vec<u8>>> {
    let full =
        "unit = \"m\"\nfx = 2\nfy = 2.5\ncx = 1\ncy = 0.5\nscale = 0.001\nsigma_a = 0.001\nsigma_b = 0.002\n";
    Ok(vec![full.as_bytes().to_vec(), b"fx = 500\nfy = 500\ncx = 2\ncy = 1\n".to_vec()])
}

/// Grey and coloured JPEG images, one of them progressive.
pub fn jpegs() -> Result<Vec<Vec<u8>>> {
    Ok(vec![include_bytes!("../data/grey.jpg").to_vec(), include_bytes!("../data/colour.jpg").to_vec()])
}

/// Grey and coloured TGA images, plain and run by run.
pub fn tgas() -> Result<Vec<Vec<u8>>> {
    let header =
        |kind: u8, bits: u8| [0, 0, kind, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 3, 0, bits, 0x20].to_vec();
    let mut grey = header(3, 8);
    grey.extend(0..12);
    let mut colour = header(2, 24);
    colour.extend(0..36);
    let mut runs = header(10, 24);
    // Six pixels of one colour, then six of their own.
    runs.extend([0x85, 1, 2, 3, 0x05]);
    runs.extend(0..18);
    Ok(vec![grey, colour, runs])
}

/// Grey and coloured images of the Netpbm family, as text and as bytes.
pub fn pgms() -> Result<Vec<Vec<u8>>> {
    let mut bytes = b"P5\n# a comment\n4 3\n255\n".to_vec();
    bytes.extend(0..12);
    let mut wide = b"P6 2 2 65535\n".to_vec();
    wide.extend(0..24);
    Ok(vec![bytes, wide, b"P2\n2 2 255\n0 1 2 255\n".to_vec()])
}

/// Calibrations of two cameras.
pub fn stereos() -> Result<Vec<Vec<u8>>> {
    let full =
        "unit = \"mm\"\nf = 500\ncx = 2\ncy = 1\nbaseline = 60\ndoffs = 1.5\nsigma_disparity_px = 0.1\n";
    Ok(vec![
        full.as_bytes().to_vec(),
        b"f = 500.0\ncx = 2\ncy = 1\nbaseline = 0.06\n".to_vec(),
        b"[[view]]\nK = [[90, 0, 32], [0, 90, 24], [0, 0, 1]]\ndistortion = [-0.2, 0.05, 1e-3, -2e-3, \
            0.0]\n[[view]]\nK = [[90, 0, 32], [0, 90, 24], [0, 0, 1]]\nt = [-150.0, 0.0, 20.0]\n"
            .to_vec(),
    ])
}

/// Range sensors with a field of view.
pub fn views() -> Result<Vec<Vec<u8>>> {
    let ranges = "near = 200\nfar = 800.0\nsigma_along = 0.05\n";
    Ok(vec![
        format!(
            "unit = \"mm\"\nfov_deg = [40, 30]\nrays = [640, 480]\nmax_incidence_deg = \
            50\nsigma_over_cos = true\n{ranges}"
        )
        .into_bytes(),
        format!(
            "fx = 500\nfy = 500\ncx = 2\ncy = 1\nsize = [5, 3]\nsigma_across = 0.1\nsigma_per_range2 = \
            1e-7\n{ranges}"
        )
        .into_bytes(),
    ])
}

/// Cameras with masks; no files beside them are named that would have to be there.
pub fn mask_views() -> Result<Vec<Vec<u8>>> {
    let k = "K = [[900.0, 0.0, 320.0], [0.0, 900.0, 240.0], [0.0, 0.0, 1.0]]\n";
    let posed = "R = [[0.96, 0.0, 0.28], [0.0, 1.0, 0.0], [-0.28, 0.0, 0.96]]\nt = [-150.0, 0.0, 900.0]\n";
    let projection = "P = [[900, 0, 320, 1000], [0, 900, 240, 2000], [0, 0, 1, 800]]\n";
    Ok(vec![
        format!(
            "unit = \"mm\"\nmask_threshold = 40\nsigma_rotation_deg = 1.0\nsigma_translation = \
             2\n[[view]]\nmask = \"a.png\"\n{k}{posed}[[view]]\nname = \"b\"\nheld_out = true\n{projection}"
        )
        .into_bytes(),
    ])
}

/// Poses of a mesh with keyframes.
pub fn poses() -> Result<Vec<Vec<u8>>> {
    let pose = "[[pose]]\nname = \"up\"\nmove = [{ near = [10, 0, 2], by = [0, 3, 0] }, { near = [0, 0, 0], \
        within = 6, by = [0, 1, 0] }, { control = 7, by = [0, 3, 0] }]\n";
    let frames = "[[keyframe]]\nseconds = 0\nweights = { up = 0 }\n[[keyframe]]\nseconds = 1.5\nweights = { \
        up = 1 }\n";
    Ok(vec![
        format!("controls = 60\nblend = 2.0\n[[rigid]]\npart = \"head\"\nmotion = \"held\"\n{pose}{frames}")
            .into_bytes(),
        format!("controls = [[0, 0, 0], [1.0, 2.0, 3.0]]\n{pose}").into_bytes(),
    ])
}

/// A camera and a projector of crossed stripes.
pub fn grids() -> Result<Vec<Vec<u8>>> {
    let k = "K = [[900.0, 0.0, 320.0], [0.0, 900.0, 240.0], [0.0, 0.0, 1.0]]\n";
    let stripes = "[stripes]\ndirections_deg = [30, 120]\nspacing = 20\norigin = [320, 240]\nrange = [[-20, \
        20], [-20, 20]]\n";
    let posed = "R = [[0.96, 0.0, 0.28], [0.0, 1.0, 0.0], [-0.28, 0.0, 0.96]]\nt = [-150.0, 0.0, 20.0]\n";
    Ok(vec![
        format!("unit = \"mm\"\nsigma_px = 0.02\n[camera]\n{k}[projector]\n{k}{posed}{stripes}").into_bytes(),
    ])
}

/// Lights of photometric stereo.
pub fn lights() -> Result<Vec<Vec<u8>>> {
    let stated = "unit = \"mm\"\nframe = \"viewer\"\nlights = [[0.4, 0.5, 0.8], [-0.3, 0.5, 0.8], [0.0, \
        0.3, 0.9]]\npixel_size = 0.2\nsigma_brightness = 1.5\n";
    let ball =
        "sigma_light_deg = 1.0\n[ball]\nimages = [\"a.tga\", \"b.tga\", \"c.tga\"]\nmask = \"m.tga\"\n";
    Ok(vec![stated.as_bytes().to_vec(), ball.as_bytes().to_vec()])
}

/// A drawing with layers, a block that is inserted, an old polyline, a dimension; one of every curve.
pub fn dxfs() -> Result<Vec<Vec<u8>>> {
    let lines = |text: &str| text.split(' ').collect::<Vec<_>>().join("\n") + "\n";
    let head =
        "0 SECTION 2 HEADER 9 $INSUNITS 70 4 0 ENDSEC 0 SECTION 2 TABLES 0 LAYER 2 INNER 6 HIDDEN 0 ENDSEC";
    let blocks = "0 SECTION 2 BLOCKS 0 BLOCK 2 part 10 1 20 0 0 LINE 8 0 10 1 20 0 11 3 21 0 0 ARC 8 0 10 1 \
        20 0 40 2 50 0 51 90 0 ENDBLK 0 ENDSEC";
    let placed = "0 INSERT 2 part 10 5 20 5 41 2 42 2 50 30 70 2 71 2 44 10 45 10";
    let curves = "0 LINE 5 2A 8 INNER 10 0 20 0 11 40 21 0 0 CIRCLE 8 0 10 20 20 10 40 6 0 ELLIPSE 10 0 20 \
        0 11 4 21 0 40 0.5 41 0 42 6.28 \
                  0 LWPOLYLINE 90 3 70 1 10 0 20 0 42 0.5 10 4 20 0 10 4 20 3";
    let others = "0 POLYLINE 70 1 0 VERTEX 10 0 20 0 0 VERTEX 10 4 20 0 42 1 0 SEQEND \
                  0 SPLINE 70 8 71 2 72 6 73 3 40 0 40 0 40 0 40 1 40 1 40 1 10 0 20 0 10 1 20 2 10 2 20 0";
    let dimension = "0 DIMENSION 5 D1 70 32 13 0 23 0 14 40 24 0 1 40 0 TEXT 1 hello";
    let end = "0 ENDSEC 0 EOF";
    let entities = "0 SECTION 2 ENTITIES";
    Ok(vec![
        lines(&format!("{head} {blocks} {entities} {placed} {curves} {others} {dimension} {end}"))
            .into_bytes(),
        lines(&format!("{entities} {curves} {end}")).into_bytes(),
    ])
}

/// Drawings with groups, transforms, styles, and every shape.
pub fn svgs() -> Result<Vec<Vec<u8>>> {
    let shapes = "<g id='HIDDEN' transform='translate(3 4) rotate(30)'><line x1='1' x2='5'/><circle r='4' \
        cx='2'/></g><rect width='9' height='5' rx='1'/>\
                  <polygon points='0,0 1,0 1,1'/><ellipse rx='3' ry='2' class='d'/><path d='M0 0h3v2l-1-1A2 \
                  2 0 0 1 5 5C1 2 3 4 5 6S1 1 0 0Q1 2 3 4T5 5z'/>";
    let sheet = "<?xml version='1.0'?><!DOCTYPE svg [<!ENTITY w '20'>]><svg \
        xmlns='http://www.w3.org/2000/svg' width='100mm' viewBox='0 0 100 50'>\
                 <style>.d { stroke-dasharray: 3 2 }</style><text>40</text>";
    Ok(vec![
        format!("{sheet}{shapes}<line x2='&w;'/></svg>").into_bytes(),
        format!("<svg>{shapes}</svg>").into_bytes(),
    ])
}

/// Planar readings and overhead points.
pub fn readings() -> Result<Vec<Vec<u8>>> {
    let poses = "x,y,heading_deg,range,sigma_x,sigma_y,sigma_heading_deg,sigma_range,pose_id,time,level\n";
    let rows: String = (0..12)
        .map(|k| format!("{k},0,{},5.5,0.1,0.1,0.5,0.05,{},{}.5,{}\n", 30 * k, k / 2, k, k / 6))
        .collect();
    Ok(vec![format!("{poses}{rows}").into_bytes(), b"x,y,sigma\n0,0,0.1\n1,0,0.1\n1,1,0.2\n".to_vec()])
}

/// Lines of a planar laser's log.
pub fn carmen_logs() -> Result<Vec<Vec<u8>>> {
    let ranges = |n: usize| (0..n).map(|k| format!("{:.2} ", 2.0 + 0.01 * k as f64)).collect::<String>();
    let line =
        |n: usize, t: usize| format!("FLASER {n} {}1.0 2.0 0.5 1.1 2.1 0.4 {t}.5 host {t}.5\n", ranges(n));
    Ok(vec![
        format!("# a log\nPARAM robot 1\n{}{}", line(5, 1), line(5, 2)).into_bytes(),
        line(180, 1).into_bytes(),
    ])
}

/// Ranges and points in space.
pub fn rays() -> Result<Vec<Vec<u8>>> {
    let ranges = "x,y,z,azimuth_deg,elevation_deg,range,sigma_x,sigma_range\n0,0,1,10,20,5,0.1,0.1\n1,0,1,-10,2e1,4.5,0.1,0.1\n";
    Ok(vec![ranges.as_bytes().to_vec(), b"x,y,z,sigma\n0,0,0,0.1\n1,2,3,0.1\n".to_vec()])
}

/// Contours with their covariance.
pub fn contours() -> Result<Vec<Vec<u8>>> {
    let circle = r#""kind":"circle","parameters":{"center_x":{"value":1,"sigma":0.1},"center_y":{"value":2,"sigma":0.1},"radius":{"value":3,"sigma":0.1}},"order":["center_x","center_y","radius"],"covariance":[[0.01,0,0],[0,0.01,0],[0,0,0.01]]"#;
    let constrained = r#""constrained":{"constraints":[{"from":"given","kind":"horizontal","bar":0}]}"#;
    Ok(vec![
        format!("{{{circle},\"unit\":\"mm\",\"level\":1.5}}").into_bytes(),
        format!("{{\"contours\":[{{{circle}}},{{{circle},\"hole_of\":0}}],{constrained}}}").into_bytes(),
    ])
}
