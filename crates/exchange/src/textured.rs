//! Meshes with texture coordinates, named parts and a texture.
//!
//! **Input.** Any mesh file. OBJ is read with texture coordinates, groups, objects, materials and their
//! pictures (`.mtl`, `map_Kd`); GLB with `TEXCOORD_0` and the picture of its base colour. Other formats give
//! a mesh without texture.
//!
//! **Output.** A [`TexturedMesh`], or an OBJ file with its materials and picture ([`write_textured_obj`]).
//!
//! **Limits.** Of a material, only the colour picture is used.

pub use crate::appearance::{
    MeshPart, NO_UV, PartKind, SplitMesh, TexturedMesh, is_jpeg, read_bytes, read_materials,
    read_vertex_list, write_textured_obj,
};
use crate::source::extension;
use planish_estimate::Result;
use std::path::Path;

/// Reads a mesh with its texture coordinates, parts and texture.
///
/// # Errors
/// As [`crate::mesh::read_mesh`]; also for invalid texture coordinates, with file and line or accessor. A
/// missing material file is a finding.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("hand.obj");
/// std::fs::write(&path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\ng palm\nf 1/1 2/2 3/3\n")?;
/// let mesh = planish_exchange::textured::read_textured(&path)?;
/// assert_eq!(mesh.uv_triangles, [[0, 1, 2]]);
/// assert_eq!(mesh.vertices_of("palm"), Some(vec![0, 1, 2]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_textured(path: &Path) -> Result<TexturedMesh> {
    if extension(path) == "obj" {
        return crate::obj::read_textured(path);
    }
    if extension(path) == "glb" {
        return crate::glb::read_textured(path);
    }
    let mesh = crate::mesh::read_mesh(path)?;
    Ok(TexturedMesh {
        points: mesh.points,
        triangles: mesh.triangles,
        columns: mesh.columns,
        unit: mesh.unit,
        ..TexturedMesh::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::DVec3;

    const OBJ: &str = "mtllib a.mtl none.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 \
        1\nvt 0 1\nvt 0.5 0.5\n\
        o left\nusemtl skin\nf 1/1 2/2 3/3\no right\ng hand arm\nusemtl cloth\nf 1/5 3/3 4/4\nf 1 2 3\n";

    #[test]
    fn parts_seams_and_pictures_survive_obj_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.obj");
        std::fs::write(&path, OBJ).unwrap();
        let material = "newmtl skin\nmap_Kd -s 1 1 1 skin.png\nnewmtl cloth\nmap_Kd my cloth.png # woven\n";
        std::fs::write(folder.path().join("a.mtl"), material).unwrap();
        let found = read_textured(&path).unwrap();
        assert_eq!(found.uv_triangles, [[0, 1, 2], [4, 2, 3], [NO_UV; 3]]);
        assert_eq!(found.vertices_of("left").unwrap(), [0, 1, 2]);
        assert_eq!(found.vertices_of("arm").unwrap(), [0, 1, 2, 3]);
        assert_eq!(found.vertices_of("skin").unwrap(), [0, 1, 2]);
        assert!(found.vertices_of("foot").is_none());
        assert_eq!(found.texture.as_deref(), Some(&*folder.path().join("my cloth.png")));
        assert!(found.findings.iter().any(|f| f.text.contains("none.mtl")));
        // Vertex 0 occurs with two pairs of texture coordinates, and without any.
        let split = found.split();
        assert_eq!(split.vertex_of.iter().filter(|v| **v == 0).count(), 3);
        assert_eq!(split.triangles.len(), 3);
        let out = folder.path().join("b.obj");
        let files = write_textured_obj(&out, &found, Some(b"\xff\xd8 a JPEG")).unwrap();
        assert_eq!(files[0], folder.path().join("b.jpg"));
        assert_eq!(read_textured(&out).unwrap().texture.as_deref(), Some(&*folder.path().join("b.jpg")));
        let files = write_textured_obj(&out, &found, Some(b"picture")).unwrap();
        assert_eq!(files.len(), 3);
        let again = read_textured(&out).unwrap();
        assert_eq!(
            (&again.points, &again.uv, &again.uv_triangles),
            (&found.points, &found.uv, &found.uv_triangles)
        );
        assert_eq!(again.texture.as_deref(), Some(&*folder.path().join("b.png")));
        // Parts keep their names, with and without a picture.
        assert_eq!(again.vertices_of("left"), found.vertices_of("left"));
        let parts = |mesh: &TexturedMesh| -> Vec<(String, Vec<u32>)> {
            let named = |part: &MeshPart| (format!("{:?} {}", part.kind, part.name), part.triangles.clone());
            mesh.parts.iter().map(named).collect()
        };
        assert_eq!(parts(&again), parts(&found));
        write_textured_obj(&out, &found, None).unwrap();
        assert_eq!(parts(&read_textured(&out).unwrap()), parts(&found));
    }

    /// A square with a seam between its triangles keeps its four vertices, texture coordinates, picture and
    /// σ.
    #[test]
    fn texture_and_sigma_survive_glb_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.glb");
        let square = TexturedMesh {
            points: vec![DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            uv: vec![[0.0, 0.0], [0.5, 0.0], [0.5, 1.0], [0.75, 0.25], [1.0, 0.5], [0.75, 1.0]],
            uv_triangles: vec![[0, 1, 2], [3, 4, 5]],
            ..TexturedMesh::default()
        };
        let split = square.split();
        let point_of = |v: &u32| square.points[*v as usize];
        let points: Vec<DVec3> = split.vertex_of.iter().map(point_of).collect();
        let sigma: Vec<f64> = split.vertex_of.iter().map(|v| f64::from(*v) + 1.0).collect();
        let picture = b"\xff\xd8 a JPEG".as_slice();
        let write = |picture: &[u8]| {
            crate::glb::write_posed(
                &path,
                &crate::glb::PosedMesh {
                    points: &points,
                    normals: &[DVec3::Z; 6],
                    triangles: &split.triangles,
                    uv: &split.uv,
                    sigma: &sigma,
                    picture: Some(picture),
                    unit: Some(crate::Unit::Metre),
                    ..crate::glb::PosedMesh::default()
                },
            )
            .unwrap();
        };
        write(picture);
        let found = read_textured(&path).unwrap();
        assert_eq!(found.points, square.points);
        assert_eq!(found.triangles, square.triangles);
        for (t, corners) in found.uv_triangles.iter().enumerate() {
            for (k, corner) in corners.iter().enumerate() {
                assert_eq!(found.uv[*corner as usize], square.uv[square.uv_triangles[t][k] as usize]);
            }
        }
        assert_eq!(found.picture.as_deref(), Some(picture));
        let column = |name: &str| found.columns.iter().find(|(n, _)| n == name).map(|(_, c)| c.clone());
        assert_eq!(column("sigma").unwrap(), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(found.columns.len(), 4, "nx ny nz sigma: {:?}", found.columns);
        // A picture that extends beyond the file is an error.
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 4]).unwrap();
        assert!(read_textured(&path).is_err());
    }

    #[test]
    fn errors_of_texture_coordinates_name_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.obj");
        for (text, wanted) in [
            (
                "v 0 0 0\nvt 0 0\nf 1/2 1/1 1/1\n",
                "line 3: expected a texture coordinate index from 1 to 1, found 2",
            ),
            ("v 0 0 0\nvt 0\nf 1 1 1\n", "line 2: expected 2 numbers"),
            ("v 0 0 0\nvt 0 inf\nf 1 1 1\n", "line 2"),
            ("v 0 0 0\nvt 0 0\nf 1/x 1/1 1/1\n", "line 3: expected a corner"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = read_textured(&path).unwrap_err().to_string();
            assert!(error.contains(wanted), "{error}");
        }
        let list = folder.path().join("a.txt");
        std::fs::write(&list, "7 3 # seven\n3\n").unwrap();
        assert_eq!(read_vertex_list(&list).unwrap(), [3, 7]);
        std::fs::write(&list, "7\n-3\n").unwrap();
        assert!(read_vertex_list(&list).unwrap_err().to_string().contains("line 2"));
        let materials = folder.path().join("a.mtl");
        std::fs::write(&materials, "map_Kd a.png\n").unwrap();
        assert!(
            read_materials(&materials).unwrap_err().to_string().contains("line 1: expected `newmtl NAME`")
        );
    }
}
