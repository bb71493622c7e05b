//! GLB, the binary form of glTF 2.0, which browsers and viewers display.
//!
//! **Input.** A file whose geometry is in its own binary chunk.
//!
//! **Output.** A [`PolygonMesh`](crate::mesh_data::PolygonMesh) of all meshes of the scene, in metres (the
//! unit of glTF). Normals are the columns `nx ny nz`; the attributes `_SIGMA` and `_OBSERVED` are the columns
//! `sigma` and `observed`. `COLOR_0` becomes `red green blue` (sRGB, up to 1) in files without `_SIGMA`.
//!
//! **Written files** hold one mesh with `float32` positions relative to its middle. The translation of the
//! node is that middle, so that coordinates far from the origin lose no digits; the scale of the node
//! converts the unit of the model to metres. Models without a unit are in millimetres, as for all commands.
//! `_SIGMA` is a length in the frame of the positions, before that scale. `COLOR_0` shows σ from dark violet
//! (small) to yellow (large) on a logarithmic scale, and grey for unmeasured parts. The same input gives the
//! same bytes.
//!
//! [`write_animation`] writes meshes that change in time as morph targets with an animation, [`write_posed`]
//! textured meshes with poses.
//!
//! **Limits.** The axes of the model are kept; viewers of glTF assume that y points up.
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

/// First bytes of a file (glTF 2.0, section 4.4.2).
const MAGIC: [u8; 4] = *b"glTF";
/// Types of chunks (section 4.4.3).
const JSON_CHUNK: [u8; 4] = *b"JSON";
const BINARY_CHUNK: [u8; 4] = *b"BIN\0";
/// Component types of accessors (section 3.6.2.2).
const BYTE: u64 = 5121;
const SHORT: u64 = 5123;
const INTEGER: u64 = 5125;
const FLOAT: u64 = 5126;
/// The primitive mode of separate triangles.
const TRIANGLES: u64 = 4;
