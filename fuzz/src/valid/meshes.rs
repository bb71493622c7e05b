//! Valid meshes, solids and saved models.

use super::{points, written};
use flate2::read::GzDecoder;
use planish::fit::{FitOptions, fit};
use planish::progress::Silent;
use planish::saved::save;
use planish_core::{DVec3, vector3::from_arrays};
use planish_estimate::{Error, Result};
use planish_exchange::glb::{PosedMesh, write_posed};
use planish_exchange::mesh::{Column, MeshColumns};
use planish_exchange::ply::{write_mesh, write_scan};
use planish_exchange::{Unit, read_inputs};
use planish_sense::Scan;
use std::io::Read as _;

/// Meshes of triangles and polygons.
pub fn ply_meshes() -> Result<Vec<Vec<u8>>> {
    let points = points(3);
    let normals = vec![DVec3::Z; 9];
    let mesh = MeshColumns {
        points: from_arrays(&points),
        normals: Some(&normals),
        columns: vec![
            ("sigma", Column::F64(&[0.1; 9])),
            ("observed", Column::U8(&[1, 1, 0, 2, 1, 1, 1, 1, 1])),
        ],
        triangles: &[[0, 1, 3], [1, 4, 3], [1, 2, 4], [4, 2, 5], [3, 4, 6]],
        unit: Some(Unit::Metre),
    };
    // What our writer never writes: polygons, text, properties of faces, and NaN.
    let text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float \
        z\nproperty float quality\n\
                element face 2\nproperty list uchar int vertex_index\nproperty uchar flags\nend_header\n\
                0 0 0 1\n1 0 0 2\n1 1 0 3\n0 1 0 nan\n0 0 1 5\n4 0 1 2 3 0\n3 0 4 1 7\n";
    Ok(vec![written(|path| write_mesh(path, &mesh), "a.ply")?, text.as_bytes().to_vec()])
}

/// Eight triangles over a square, in the format that the extension of `name` selects.
fn square(name: &str) -> Result<Vec<u8>> {
    let points = points(3);
    let normals = vec![DVec3::Z; 9];
    let mesh = MeshColumns {
        points: from_arrays(&points),
        normals: Some(&normals),
        columns: vec![("sigma", Column::F64(&[0.1; 9]))],
        triangles: &[[0, 1, 3], [1, 4, 3], [1, 2, 4], [4, 2, 5], [3, 4, 6], [4, 7, 6], [4, 5, 7], [5, 8, 7]],
        unit: Some(Unit::Metre),
    };
    written(|path| planish_exchange::mesh::write_mesh(path, &mesh), name)
}

/// OBJ from our writer, and one with features that it does not write.
pub fn objs() -> Result<Vec<Vec<u8>>> {
    // Polygons, colours after coordinates, negative indices and a continued line, as other programs write
    // them.
    let other = "# made elsewhere\nmtllib a.mtl\no thing\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 1 1 0\nv 0 1 \
        0.5\nvt 0 0\nvn 0 0 1\n\
                 f 1/1/1 2/1/1 3/1/1 4/1/1\nf -4//-1 -3//-1 \\\n-1//-1\nl 1 2\ns off\n";
    Ok(vec![square("a.obj")?, other.as_bytes().to_vec()])
}

/// Material files.
pub fn mtls() -> Result<Vec<Vec<u8>>> {
    Ok(vec![b"newmtl a\nKd 1 1 1\nmap_Kd a.png\nnewmtl b\nmap_Kd -s 1 1 1 b.png\n".to_vec()])
}

/// OFF from our writer, and one with polygons and colours.
pub fn offs() -> Result<Vec<Vec<u8>>> {
    let other = "COFF\n# four\n4 1 0\n0 0 0 1 0 0 1\n1 0 0 1 0 0 1\n1 1 0 1 0 0 1\n0 1 0 1 0 0 1\n4 0 1 2 3 \
        0.5 0.5 0.5\n";
    Ok(vec![square("a.off")?, other.as_bytes().to_vec()])
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

/// GLB from our writer.
pub fn glbs() -> Result<Vec<Vec<u8>>> {
    Ok(vec![square("a.glb")?])
}

/// A mesh with texture coordinates and a picture.
pub fn posed() -> Result<Vec<Vec<u8>>> {
    let mesh = PosedMesh {
        points: &[DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X],
        normals: &[DVec3::Z; 4],
        triangles: &[[0, 1, 2], [0, 2, 3]],
        uv: &[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5]],
        sigma: &[0.1; 4],
        observed: &[1; 4],
        picture: Some(b"\x89PNG nobody looks into it"),
        ..PosedMesh::default()
    };
    Ok(vec![written(|path| write_posed(path, &mesh), "a.glb")?])
}

/// Faces on planes, cylinders, cones, spheres and splines, in inches and
/// millimetres, and an assembly of parts.
pub fn steps() -> Result<Vec<Vec<u8>>> {
    // The files of the reader's own tests, which cover its kinds of surfaces.
    let files: [&[u8]; 5] = [
        include_bytes!("../../../crates/exchange/tests/data/assembly.step.gz"),
        include_bytes!("../../../crates/exchange/tests/data/rounded_box.step.gz"),
        include_bytes!("../../../crates/exchange/tests/data/swept.step.gz"),
        include_bytes!("../../../crates/exchange/tests/data/turned.step.gz"),
        include_bytes!("../../../crates/exchange/tests/data/sheet.step.gz"),
    ];
    let unpacked = |packed: &[u8]| {
        let mut bytes = Vec::new();
        let read = GzDecoder::new(packed).read_to_end(&mut bytes);
        read.map(|_| bytes).map_err(|e| Error::io("not unpacked").with_source(e))
    };
    files.into_iter().map(unpacked).collect()
}

/// Models of a sheet and a ball.
pub fn models() -> Result<Vec<Vec<u8>>> {
    use planish::Shape;
    [Shape::Sheet, Shape::Ball].into_iter().map(model).collect()
}

/// A model of the wavy surface.
pub fn sheets() -> Result<Vec<Vec<u8>>> {
    Ok(vec![model(planish::Shape::Sheet)?])
}

/// A small saved model of a sheet or a ball.
fn model(shape: planish::Shape) -> Result<Vec<u8>> {
    let folder = tempfile::tempdir().map_err(|e| Error::io("no folder").with_source(e))?;
    let (scan, model) = (folder.path().join("a.ply"), folder.path().join("a.planish"));
    let round = |[u, v, _]: [f64; 3]| {
        let (longitude, z) = (std::f64::consts::TAU * u, 2.0 * v - 1.0);
        // Equal steps of z spread points evenly over a sphere (Archimedes).
        let radius = (1.0 - z * z).max(0.0).sqrt();
        [radius * longitude.cos(), radius * longitude.sin(), z]
    };
    let points = match shape {
        planish::Shape::Sheet => points(6),
        _ => points(9).into_iter().map(round).collect(),
    };
    write_scan(
        &scan,
        &Scan { points: from_arrays(&points).to_vec(), ..Scan::default() },
        Some(Unit::Millimetre),
    )?;
    // Few coefficients: in a small file, much of the damage hits the header, which the reader checks.
    let options = FitOptions { shape: Some(shape), max_coefficients: 64, ..FitOptions::default() };
    // No provenance: it would contain the name of the temporary folder.
    save(&fit(&read_inputs(&[scan], None)?, &options, &Silent)?.model, &[], &model)?;
    std::fs::read(&model).map_err(|e| Error::io("no model").with_source(e))
}
