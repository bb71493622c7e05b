//! GLB, binary glTF 2.0: what browsers and viewers show; meshes in and out.
//!
//! **Input.** A file whose geometry is in its own binary chunk.
//!
//! **Output.** A [`PolygonMesh`](crate::mesh_data::PolygonMesh) of all meshes of the scene, in metres (the
//! unit of glTF). Normals are the columns `nx ny nz`; the attributes `_SIGMA` and `_OBSERVED` are the columns
//! `sigma` and `observed`.
//!
//! **Written files** hold one mesh: `float32` positions about the middle of the mesh, which is the
//! translation of its node, so that far coordinates lose no digits; the node's scale turns the model's unit
//! into metres. `_SIGMA` is a length in the frame of the positions, as they are before the node's scale.
//! `COLOR_0` shows σ from dark violet (small) to yellow (large, on a logarithmic scale), and grey where
//! nothing was measured. The same input gives the same bytes.
//!
//! Meshes that change in time are written with morph targets and an animation ([`write_animation`]); those
//! that can be posed, with a texture ([`write_posed`]).
//!
//! **Limits.** Axes are those of the model, whose z may point up, whereas viewers of glTF take y as up.
//! Skins, morph targets, animations, points and lines are ignored when a file is read. Textures are read only
//! by [`read_textured`](crate::textured::read_textured), which takes the base colour.
//!
//! # References
//! The Khronos Group, *glTF 2.0 Specification*, 2021 (ISO/IEC 12113:2022).

mod animate;
mod pose;
mod read;
#[cfg(test)]
mod tests;
mod write;

pub use animate::{MeshFrame, write_animation};
pub use pose::{Keyframe, MorphTarget, PosedMesh, write_posed};
pub use read::read_mesh;
pub(crate) use read::{read_scan, read_textured};
pub use write::{ramp, write_mesh};

/// What files begin with.
const MAGIC: [u8; 4] = *b"glTF";
/// Types of chunks.
const JSON_CHUNK: [u8; 4] = *b"JSON";
const BINARY_CHUNK: [u8; 4] = *b"BIN\0";
/// Types of numbers.
const BYTE: u64 = 5121;
const SHORT: u64 = 5123;
const INTEGER: u64 = 5125;
const FLOAT: u64 = 5126;
/// The primitive mode of separate triangles.
const TRIANGLES: u64 = 4;
