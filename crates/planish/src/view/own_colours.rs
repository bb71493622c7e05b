//! The colours that a file states for its surface: those of its vertices, or a texture.
//!
//! Input: columns of a mesh, or a mesh with texture coordinates and a picture. Output: colours as numbers for
//! a field ([`FieldKind::Colours`](planish_report::FieldKind)), and the colour at a place of a triangle.
//!
//! Of several pictures, that of the material with the most triangles is used. Between pixels, colours are
//! interpolated; a picture is repeated beyond its sides.

use planish_core::Finding;
use planish_core::FindingCode;
use planish_estimate::Result;
use planish_exchange::mesh::PolygonMesh;
use planish_exchange::picture::{Picture, decode_picture, read_picture};
use planish_exchange::textured::{NO_UV, read_textured};
use planish_report::colour::{Colour, number_of_colour};
use std::path::Path;

/// Names of columns with red, green and blue.
const NAMES: [[&str; 3]; 2] = [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];

/// The colours of vertices from their columns, if there are any. Integers count to 255 or 65535, other
/// numbers to 1, as the largest value shows.
pub(super) fn vertex_colours(columns: &[(String, Vec<f64>)]) -> Option<Vec<f64>> {
    let of = |name: &str| columns.iter().find(|(own, _)| own == name).map(|(_, values)| values.as_slice());
    let [r, g, b] = NAMES.iter().find_map(|names| {
        let [r, g, b] = names.map(of);
        Some([r?, g?, b?])
    })?;
    let largest = [r, g, b].into_iter().flatten().fold(0.0, |most: f64, value| most.max(*value));
    let white = match largest {
        x if x <= 1.0 => 1.0,
        x if x <= 255.0 => 255.0,
        _ => 65535.0,
    };
    let byte = |value: f64| (255.0 * (value / white).clamp(0.0, 1.0)).round() as u8;
    Some((0..r.len()).map(|k| number_of_colour([r[k], g[k], b[k]].map(byte))).collect())
}

/// A picture on the triangles of a mesh.
pub(super) struct Texture {
    picture: Picture,
    triangles: Vec<[u32; 3]>,
    /// Texture coordinates of the corners of each triangle, from the lower left; none without.
    uv: Vec<Option<[[f64; 2]; 3]>>,
}

impl Texture {
    /// Reads the texture of a mesh file; `mesh` is the same file without it. A picture that cannot be read is
    /// a finding.
    ///
    /// # Errors
    /// As [`read_textured`].
    pub(super) fn read(path: &Path, mesh: &PolygonMesh) -> Result<(Option<Self>, Vec<Finding>)> {
        let file = read_textured(path)?;
        if file.uv_triangles.len() != mesh.triangles.len() {
            return Ok((None, file.findings));
        }
        let picture = match (&file.picture, &file.texture) {
            (Some(bytes), _) => decode_picture(bytes),
            (None, Some(path)) => read_picture(path),
            (None, None) => return Ok((None, file.findings)),
        };
        let picture = match picture {
            Ok(picture) => picture,
            Err(error) => {
                let text = format!("the texture cannot be shown: {error}");
                let findings = file.findings.into_iter();
                return Ok((
                    None,
                    findings.chain([Finding::new(FindingCode::TextureUnreadable, text)]).collect(),
                ));
            }
        };
        let of = |corners: &[u32; 3]| -> Option<[[f64; 2]; 3]> {
            (!corners.contains(&NO_UV)).then(|| corners.map(|k| file.uv[k as usize]))
        };
        let uv = file.uv_triangles.iter().map(of).collect();
        Ok((Some(Self { picture, triangles: mesh.triangles.clone(), uv }), file.findings))
    }

    /// The colour at a place of a triangle, given by weights of its corners; none without texture
    /// coordinates.
    pub(super) fn colour(&self, triangle: usize, weights: [f64; 3]) -> Option<Colour> {
        let corners = self.uv[triangle]?;
        let at = |axis: usize| (0..3).map(|k| weights[k] * corners[k][axis]).sum::<f64>();
        Some(self.at([at(0), at(1)]))
    }

    /// The colours at the vertices, not finite where a vertex has no texture coordinates.
    pub(super) fn at_vertices(&self, count: usize) -> Vec<f64> {
        let mut colours = vec![f64::NAN; count];
        for (corners, uv) in self.triangles.iter().zip(&self.uv) {
            for (k, place) in (0..3).filter_map(|k| Some((corners[k] as usize, uv.as_ref()?[k]))) {
                // A vertex on a seam has the colour of its first triangle.
                if colours[k].is_nan() {
                    colours[k] = number_of_colour(self.at(place).map(|c| (255.0 * c).round() as u8));
                }
            }
        }
        colours
    }

    /// The colour at texture coordinates.
    fn at(&self, [u, v]: [f64; 2]) -> Colour {
        let Picture { columns, rows, channels, values, white } = &self.picture;
        // Pixels have their colours at their centres; the first row is the uppermost.
        let x = u.rem_euclid(1.0) * *columns as f64 - 0.5;
        let y = (1.0 - v).rem_euclid(1.0) * *rows as f64 - 0.5;
        let wrapped = |k: f64, n: usize| k.rem_euclid(n as f64) as usize % n;
        let (columns_at, rows_at) = (
            [0.0, 1.0].map(|step| wrapped(x.floor() + step, *columns)),
            [0.0, 1.0].map(|step| wrapped(y.floor() + step, *rows)),
        );
        let (s, t) = (x - x.floor(), y - y.floor());
        std::array::from_fn(|c| {
            let channel = c.min(channels - 1);
            let value = |column: usize, row: usize| {
                f64::from(values[channels * (row * columns + column) + channel] / white)
            };
            let [lower, upper] =
                rows_at.map(|row| (1.0 - s) * value(columns_at[0], row) + s * value(columns_at[1], row));
            ((1.0 - t) * lower + t * upper).clamp(0.0, 1.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_bytes_or_shares() {
        let column = |name: &str, value: f64| (name.to_owned(), vec![value, 0.0]);
        let bytes = [column("red", 255.0), column("green", 128.0), column("blue", 0.0)];
        assert_eq!(vertex_colours(&bytes), Some(vec![f64::from(0x00FF_8000), 0.0]));
        let shares = [column("red", 1.0), column("green", 0.5), column("blue", 0.0)];
        assert_eq!(vertex_colours(&shares), vertex_colours(&bytes));
        assert_eq!(vertex_colours(&bytes[..2]), None);
    }

    #[test]
    fn a_texture_has_its_origin_at_the_lower_left() {
        // Red and green above, blue and white below.
        let values = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]];
        let values = values.as_flattened().iter().map(|&v| v as f32).collect();
        let texture = Texture {
            picture: Picture { columns: 2, rows: 2, channels: 3, values, white: 255.0 },
            triangles: vec![[0, 1, 2]],
            uv: vec![Some([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75]])],
        };
        assert_eq!(texture.colour(0, [1.0, 0.0, 0.0]), Some([0.0, 0.0, 1.0]));
        assert_eq!(texture.colour(0, [0.0, 1.0, 0.0]), Some([1.0, 1.0, 1.0]));
        assert_eq!(texture.colour(0, [0.0, 0.0, 1.0]), Some([0.0, 1.0, 0.0]));
        assert_eq!(texture.colour(0, [0.5, 0.5, 0.0]), Some([0.5, 0.5, 1.0]));
        assert_eq!(texture.at_vertices(4)[..3], [255.0, f64::from(0x00FF_FFFF), f64::from(0x0000_FF00)]);
    }
}
