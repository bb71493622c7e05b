//! Appearance of a mesh that is moved: keeps the texture coordinates and texture of an OBJ or GLB.
//!
//! Input: a mesh with its appearance, and the new positions of its vertices. Output: OBJ with MTL and
//! picture, or GLB, of the mesh at those places.
//!
//! Not guaranteed: more of a material than the picture of its colour.

use planish_core::{DVec3, Finding, FindingCode};
use planish_estimate::Result;
use planish_exchange::extension;
use planish_exchange::glb::{Keyframe, MorphTarget, PosedMesh, write_posed};
use planish_exchange::textured::{TexturedMesh, is_jpeg, read_bytes, write_textured_obj};
use planish_mesh::TriangleMesh;
use std::path::{Path, PathBuf};

/// The name of a pose, and the positions of the vertices in it.
pub(super) type NamedPlaces<'a> = (&'a str, &'a [DVec3]);

/// The bytes of the texture; a finding if they cannot be read.
pub(super) fn picture_of(file: &TexturedMesh, findings: &mut Vec<Finding>) -> Option<Vec<u8>> {
    if file.picture.is_some() {
        return file.picture.clone();
    }
    // A warning, because the shape is the result and does not depend on the texture.
    let drop = |e| {
        findings.push(Finding::new(FindingCode::TextureDropped, format!("the texture is dropped: {e}")));
    };
    read_bytes(file.texture.as_ref()?).map_err(drop).ok()
}

/// Whether OBJ and GLB files can contain this texture.
fn can_be_kept(bytes: &&[u8]) -> bool {
    // glTF 2.0 permits only these two formats.
    bytes.starts_with(b"\x89PNG") || is_jpeg(bytes)
}

/// σ of vertices along normals, and their marks of `observed`. Both are empty if unknown.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Known<'a> {
    pub sigma: &'a [f64],
    pub observed: &'a [u8],
}

pub(super) fn normals_of(points: &[DVec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    TriangleMesh { positions: points.to_vec(), triangles: triangles.to_vec() }.vertex_normals()
}

/// Poses that a GLB file can show: a morph target for each, and the keyframes.
#[derive(Clone, Copy, Default)]
pub(super) struct PoseAnimation<'a> {
    pub poses: &'a [NamedPlaces<'a>],
    pub keyframes: &'a [Keyframe],
}

/// Writes GLB: the mesh at some places, a morph target for each pose, and the keyframes.
pub(super) fn write_glb(
    path: &Path,
    file: &TexturedMesh,
    points: &[DVec3],
    PoseAnimation { poses, keyframes }: PoseAnimation<'_>,
    known: Known<'_>,
    picture: Option<&[u8]>,
) -> Result<()> {
    // GLB has one texture coordinate per vertex, so vertices on seams are doubled.
    let split = file.split();
    let each = |v: &u32| *v as usize;
    // Absent columns stay absent: zeros would mean σ = 0.
    let kept = |count: usize| if count == 0 { &[][..] } else { &split.vertex_of[..] };
    let sigma: Vec<f64> = (kept(known.sigma.len()).iter()).map(|v| known.sigma[each(v)]).collect();
    let observed: Vec<u8> = (kept(known.observed.len()).iter()).map(|v| known.observed[each(v)]).collect();
    let of =
        |values: &[DVec3]| -> Vec<DVec3> { split.vertex_of.iter().map(|v| values[*v as usize]).collect() };
    let targets: Vec<MorphTarget> = (poses.iter())
        .map(|(name, places)| MorphTarget {
            name: (*name).to_owned(),
            points: of(places),
            // From the unsplit mesh, so that seams of the texture do not show in the shading.
            normals: of(&normals_of(places, &file.triangles)),
        })
        .collect();
    write_posed(
        path,
        &PosedMesh {
            points: &of(points),
            normals: &of(&normals_of(points, &file.triangles)),
            triangles: &split.triangles,
            uv: &split.uv,
            sigma: &sigma,
            observed: &observed,
            picture: picture.filter(can_be_kept),
            targets: &targets,
            keyframes,
            unit: file.unit,
            ..PosedMesh::default()
        },
    )
}

/// Writes an OBJ file with its material and texture files. Returns all of them.
pub(super) fn write_obj(
    path: &Path,
    file: &TexturedMesh,
    points: &[DVec3],
    picture: Option<&[u8]>,
) -> Result<Vec<PathBuf>> {
    let moved = TexturedMesh { points: points.to_vec(), ..file.clone() };
    write_textured_obj(path, &moved, picture.filter(can_be_kept))
}

/// Writes a mesh with its appearance. `None` if it has no texture coordinates, or if the format cannot store
/// them.
pub(super) fn write_moved(
    path: &Path,
    file: &TexturedMesh,
    points: &[DVec3],
    known: Known<'_>,
    picture: Option<&[u8]>,
) -> Result<Option<Vec<PathBuf>>> {
    if file.uv_triangles.is_empty() {
        return Ok(None);
    }
    match extension(path).as_str() {
        "glb" => write_glb(path, file, points, PoseAnimation::default(), known, picture)
            .map(|()| Some(vec![path.to_owned()])),
        "obj" => write_obj(path, file, points, picture).map(Some),
        _ => Ok(None),
    }
}
