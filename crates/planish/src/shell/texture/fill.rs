//! Fills colours that no view sees, smoothly from their surroundings.
//!
//! On a mesh, each colour is the mean of its neighbours (the discrete Laplace equation, solved by conjugate
//! gradients). In a picture, the pixels between the charts are filled as well, because viewers average
//! neighbouring pixels (push-pull: S. Gortler et al., *The lumigraph*, SIGGRAPH 1996, section 3.4).

use planish_mesh::{Neighbours, TriangleMesh};

/// Maximum residual of the Laplace equation, of 255: far below one step of an 8-bit colour.
const MAX_RESIDUAL: f64 = 0.01;
/// Maximum number of conjugate-gradient steps. More steps make no visible difference.
const MAX_STEPS: usize = 2000;
/// Colour if no view sees any part.
const GREY: [f64; 3] = [128.0; 3];

/// Extends the colours of some vertices to all.
pub(super) fn on_mesh(mesh: &TriangleMesh, known: &[Option<[f64; 3]>]) -> Vec<[f64; 3]> {
    let seen: Vec<[f64; 3]> = known.iter().flatten().copied().collect();
    // Parts that no known vertex reaches have no boundary values, so the equation has no unique solution
    // there.
    let mean = match seen.len() {
        0 => GREY,
        n => [0, 1, 2].map(|c| seen.iter().map(|v| v[c]).sum::<f64>() / n as f64),
    };
    let neighbours = Neighbours::from_mesh(mesh);
    let mut colours: Vec<[f64; 3]> = known.iter().map(|c| c.unwrap_or(mean)).collect();
    // Start: each vertex gets the colour of the known vertex that reaches it first. Unconnected parts keep
    // the mean.
    let mut reached: Vec<u32> = (0..known.len() as u32).filter(|v| known[*v as usize].is_some()).collect();
    let mut is_reached: Vec<bool> = known.iter().map(Option::is_some).collect();
    let start = reached.len();
    let mut next = 0;
    while let Some(&v) = reached.get(next) {
        next += 1;
        for &other in neighbours.of_vertex(v) {
            if !std::mem::replace(&mut is_reached[other as usize], true) {
                colours[other as usize] = colours[v as usize];
                reached.push(other);
            }
        }
    }
    // Only vertices that are connected to a known one: the system is then positive definite.
    let unknown = &reached[start..];
    for channel in 0..3 {
        laplace(&neighbours, unknown, &mut colours, channel);
    }
    colours
}

/// Solves `Σ_j (x_i − x_j) = 0` over the neighbours of each unknown vertex by conjugate gradients.
fn laplace(neighbours: &Neighbours, unknown: &[u32], colours: &mut [[f64; 3]], channel: usize) {
    let mut place = vec![usize::MAX; colours.len()];
    for (k, v) in unknown.iter().enumerate() {
        place[*v as usize] = k;
    }
    let degree = |v: u32| neighbours.of_vertex(v).len().max(1) as f64;
    let multiply = |p: &[f64]| -> Vec<f64> {
        (unknown.iter().zip(p))
            .map(|(v, own)| {
                let others = neighbours.of_vertex(*v).iter().map(|o| place[*o as usize]);
                degree(*v) * own - others.filter(|o| *o != usize::MAX).map(|o| p[o]).sum::<f64>()
            })
            .collect()
    };
    let inner = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut r: Vec<f64> = (unknown.iter())
        .map(|v| {
            let own = colours[*v as usize][channel];
            (neighbours.of_vertex(*v).iter()).map(|o| colours[*o as usize][channel] - own).sum()
        })
        .collect();
    // Jacobi preconditioner: valences differ where meshes are refined.
    let scaled = |r: &[f64]| -> Vec<f64> { unknown.iter().zip(r).map(|(v, r)| r / degree(*v)).collect() };
    let mut z = scaled(&r);
    let mut p = z.clone();
    let mut rz = inner(&r, &z);
    for _ in 0..MAX_STEPS {
        if r.iter().all(|r| r.abs() < MAX_RESIDUAL) {
            break;
        }
        let product = multiply(&p);
        let step = rz / inner(&p, &product);
        for (k, v) in unknown.iter().enumerate() {
            colours[*v as usize][channel] += step * p[k];
            r[k] -= step * product[k];
        }
        z = scaled(&r);
        let new = inner(&r, &z);
        let share = new / rz;
        rz = new;
        p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + share * *p);
    }
}

/// Fills the empty pixels of a picture from means of its filled pixels, at ever coarser resolution.
pub(super) fn in_picture(columns: usize, rows: usize, pixels: &mut [Option<[f32; 3]>]) {
    if columns <= 1 && rows <= 1 || pixels.iter().all(Option::is_some) {
        return;
    }
    let (half_columns, half_rows) = (columns.div_ceil(2), rows.div_ceil(2));
    let mut half: Vec<Option<[f32; 3]>> = (0..half_columns * half_rows)
        .map(|k| {
            let (x, y) = (2 * (k % half_columns), 2 * (k / half_columns));
            let (mut sum, mut count) = ([0.0; 3], 0.0);
            for row in y..(y + 2).min(rows) {
                for column in x..(x + 2).min(columns) {
                    if let Some(colour) = pixels[row * columns + column] {
                        sum = [0, 1, 2].map(|c| sum[c] + colour[c]);
                        count += 1.0;
                    }
                }
            }
            (count > 0.0).then(|| sum.map(|s| s / count))
        })
        .collect();
    // Without any colour, the recursion would never find one.
    if half.iter().all(Option::is_none) {
        return;
    }
    in_picture(half_columns, half_rows, &mut half);
    for (k, pixel) in pixels.iter_mut().enumerate() {
        if pixel.is_none() {
            *pixel = half[(k / columns / 2) * half_columns + k % columns / 2];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::DVec3;
    use planish_mesh::grid_sheet;

    /// Between two known sides of a sheet, every colour is the mean of its neighbours. An unconnected part
    /// gets the mean of all known colours.
    #[test]
    fn unknown_colours_are_the_means_of_their_neighbours() {
        let mut mesh = grid_sheet(10.0, 4.0, 10, 4);
        let first = mesh.positions.len() as u32;
        (mesh.positions).extend([[50.0, 0.0, 0.0], [51.0, 0.0, 0.0], [50.0, 1.0, 0.0]].map(DVec3::from));
        mesh.triangles.push([first, first + 1, first + 2]);
        let known: Vec<Option<[f64; 3]>> = (mesh.positions.iter())
            .map(|p| match p[0] {
                x if x < -4.5 => Some([0.0, 200.0, 7.0]),
                x if (4.5..20.0).contains(&x) => Some([100.0, 0.0, 7.0]),
                _ => None,
            })
            .collect();
        let found = on_mesh(&mesh, &known);
        let neighbours = Neighbours::from_mesh(&mesh);
        for (v, colour) in found.iter().enumerate() {
            if v as u32 >= first {
                assert_eq!(*colour, [50.0, 100.0, 7.0]);
            } else if known[v].is_none() {
                let around = neighbours.of_vertex(v as u32);
                for c in 0..3 {
                    let mean =
                        around.iter().map(|o| found[*o as usize][c]).sum::<f64>() / around.len() as f64;
                    assert!((colour[c] - mean).abs() < 0.02, "{v}: {} {mean}", colour[c]);
                }
                assert!(colour[0] > 1.0 && colour[0] < 99.0, "{colour:?}");
            } else {
                assert_eq!(Some(*colour), known[v]);
            }
        }
    }

    #[test]
    fn empty_pixels_get_the_colour_of_their_neighbours() {
        let mut pixels = vec![None; 7 * 5];
        pixels[0] = Some([10.0; 3]);
        pixels[34] = Some([20.0; 3]);
        in_picture(7, 5, &mut pixels);
        assert_eq!((pixels[1], pixels[33]), (Some([10.0; 3]), Some([20.0; 3])));
        assert!(pixels.iter().all(|p| p.is_some_and(|c| (10.0..=20.0).contains(&c[0]))));
        let mut empty = vec![None; 6];
        in_picture(3, 2, &mut empty);
        assert!(empty.iter().all(Option::is_none));
    }
}
