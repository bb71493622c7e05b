//! Coloured meshes as files.
//!
//! Input: a mesh with colours of its vertices, or with a texture. Output: PLY with colours, GLB with
//! either, OBJ with its material and picture.

use super::Coloured;
use super::painted::Texture;
use crate::shell::appearance::{Known, PoseAnimation, normals_of, write_glb, write_obj};
use planish_estimate::Result;
use planish_exchange::extension;
use planish_exchange::glb::{PosedMesh, write_posed};
use planish_exchange::mesh::{Column, MeshColumns, write_mesh};
use planish_exchange::textured::TexturedMesh;
use planish_report::colour::linear_light;
use std::path::{Path, PathBuf};

/// Writes one file and its companion files.
pub(super) fn write(
    path: &Path,
    file: &TexturedMesh,
    coloured: &Coloured,
    texture: Option<&Texture>,
) -> Result<Vec<PathBuf>> {
    let stated = |name: &str| file.columns.iter().find(|(n, _)| n == name).map(|(_, c)| &c[..]);
    let sigma = stated("sigma").unwrap_or_default();
    let observed: Vec<u8> =
        (stated("observed").unwrap_or_default().iter()).map(|mark| mark.clamp(0.0, 255.0) as u8).collect();
    let known = Known { sigma, observed: &observed };
    let normals = normals_of(&file.points, &file.triangles);
    match (extension(path).as_str(), texture) {
        // PLY has colours of vertices only, also if a texture was painted.
        ("ply", _) => {
            let channel =
                |c: usize| -> Vec<u8> { coloured.colours.iter().map(|v| v[c].round() as u8).collect() };
            let [red, green, blue] = [0, 1, 2].map(channel);
            let mut columns = Vec::new();
            if !sigma.is_empty() {
                columns.push(("sigma", Column::F64(sigma)));
            }
            if !observed.is_empty() {
                columns.push(("observed", Column::U8(&observed)));
            }
            columns
                .extend([("red", &red), ("green", &green), ("blue", &blue)].map(|(n, c)| (n, Column::U8(c))));
            // Zero marks colours that were filled.
            columns.push(("views", Column::U8(&coloured.views)));
            write_mesh(
                path,
                &MeshColumns {
                    points: &file.points,
                    normals: Some(&normals),
                    columns,
                    triangles: &file.triangles,
                    unit: file.unit,
                },
            )?;
        }
        // Only GLB remains here, because a job with an OBJ output always has a texture.
        (_, None) => {
            // glTF has linear light from 0 to 1.
            let linear = |value: f64| linear_light((value / 255.0).clamp(0.0, 1.0));
            let colours: Vec<[f64; 3]> = coloured.colours.iter().map(|c| c.map(linear)).collect();
            write_posed(
                path,
                &PosedMesh {
                    points: &file.points,
                    normals: &normals,
                    triangles: &file.triangles,
                    colours: &colours,
                    sigma,
                    observed: &observed,
                    unit: file.unit,
                    ..PosedMesh::default()
                },
            )?;
        }
        (ending, Some(texture)) => {
            let painted = TexturedMesh {
                uv: texture.chart.uv.clone(),
                uv_triangles: texture.chart.triangles.clone(),
                ..file.clone()
            };
            let png = texture.png()?;
            if ending == "obj" {
                return write_obj(path, &painted, &file.points, Some(&png));
            }
            write_glb(path, &painted, &file.points, PoseAnimation::default(), known, Some(&png))?;
        }
    }
    Ok(vec![path.to_owned()])
}
