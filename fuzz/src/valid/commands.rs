//! Valid inputs of whole commands, large enough for a result.

use super::points;
use planish_estimate::Result;
use std::fmt::Write as _;

/// Number of points of a side of the wavy surface: enough to fit it.
const SIDE: u32 = 11;

/// Points of the wavy surface with noise and, if given, σ.
fn wavy(sigma: Option<f64>) -> String {
    let mut text = String::new();
    for (k, [x, y, z]) in points(SIDE).into_iter().enumerate() {
        // Quadratic residues serve as noise: always the same, and without a visible period.
        let noise = 1e-3 * ((k * k) % 89) as f64 / 89.0;
        let z = z + noise;
        // Writing to a string cannot fail.
        let _ = match sigma {
            Some(sigma) => writeln!(text, "{x} {y} {z} {sigma}"),
            None => writeln!(text, "{x} {y} {z}"),
        };
    }
    text
}

/// Points that can be fitted, with and without σ.
pub fn fitted_texts() -> Result<Vec<Vec<u8>>> {
    let with_sigma = format!("# x y z sigma\n{}", wavy(Some(1e-3)));
    Ok(vec![wavy(None).into_bytes(), with_sigma.into_bytes()])
}

/// Jobs of scans that can be fitted.
pub fn fitted_jobs() -> Result<Vec<Vec<u8>>> {
    let sensor = "unit = \"mm\"\n[sensor.s]\nkind = \"range\"\nsigma = 0.001\n";
    let scan = "[[scan]]\nsensor = \"s\"\nfile = \"wavy.xyz\"\n";
    let posed = "pose = { translation = [0.1, 0.2, 0.3], quaternion_xyzw = [0, 0, 0.6, 0.8], \
        sigma_translation = 0.1, sigma_rotation_deg = 0.05 }\nviewpoint = [0, 0, 300]\n";
    Ok([format!("{sensor}{scan}"), format!("{sensor}{scan}{posed}")].map(String::into_bytes).into())
}

/// A mesh of the wavy surface, raised by `lift`, with σ.
fn mesh(lift: f64) -> String {
    let points = points(SIDE);
    let mut text = format!(
        "ply\nformat ascii 1.0\ncomment unit mm\nelement vertex {}\nproperty double x\nproperty double \
         y\nproperty double z\nproperty double sigma\nelement face {}\nproperty list uchar int \
         vertex_indices\nend_header\n",
        points.len(),
        2 * (SIDE - 1).pow(2)
    );
    for [x, y, z] in points {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{x} {y} {} 0.001", z + lift);
    }
    for k in (0..SIDE * (SIDE - 1)).filter(|k| k % SIDE != SIDE - 1) {
        let _ = writeln!(text, "3 {k} {} {}\n3 {} {} {}", k + 1, k + SIDE, k + 1, k + SIDE + 1, k + SIDE);
    }
    text
}

/// Meshes that can be compared and merged.
pub fn fitted_meshes() -> Result<Vec<Vec<u8>>> {
    Ok(vec![mesh(0.0).into_bytes()])
}

/// The front view of a bracket; the other views lie in the same folder.
pub fn front_views() -> Result<Vec<Vec<u8>>> {
    Ok(vec![include_bytes!("../../../examples/data/bracket/front.dxf").to_vec()])
}

/// Points on a circle and on a rectangle.
pub fn outlines() -> Result<Vec<Vec<u8>>> {
    let circle = (0..40).map(|k| {
        let (sin, cos) = (0.157 * f64::from(k)).sin_cos();
        let radius = 5.0 + 0.05 * f64::from((k * k) % 23) / 23.0;
        format!("{},{},0.05\n", radius * cos, radius * sin)
    });
    let rectangle = (0..48).map(|k| {
        let along = f64::from(k % 12) / 12.0;
        let [x, y] = match k / 12 {
            0 => [along, 0.0],
            1 => [1.0, along],
            2 => [1.0 - along, 1.0],
            _ => [0.0, 1.0 - along],
        };
        format!("{},{},0.05\n", 8.0 * x, 5.0 * y + 0.05 * f64::from((k * k) % 23) / 23.0)
    });
    let text = |rows: &mut dyn Iterator<Item = String>| {
        format!("x,y,sigma\n{}", rows.collect::<String>()).into_bytes()
    };
    Ok(vec![text(&mut circle.into_iter()), text(&mut rectangle.into_iter())])
}

/// Poses of the mesh of the wavy surface.
pub fn patch_poses() -> Result<Vec<Vec<u8>>> {
    let pose = "[[pose]]\nname = \"up\"\nmove = [{ near = [1, 0, 0], by = [0, 0.3, 0] }, { near = [0, 0, 0], \
        within = 0.5, by = [0, 0.1, 0] }]\n";
    let frames = "[[keyframe]]\nseconds = 0\nweights = { up = 0 }\n[[keyframe]]\nseconds = 1.5\nweights = { \
        up = 1 }\n";
    Ok(vec![format!("controls = 12\n{pose}{frames}").into_bytes()])
}

/// The other files of these commands; they lie in the same folder.
pub fn companions() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("wavy.xyz", wavy(None).into_bytes()),
        ("patch.ply", mesh(5e-4).into_bytes()),
        ("top.dxf", include_bytes!("../../../examples/data/bracket/top.dxf").to_vec()),
        ("side.dxf", include_bytes!("../../../examples/data/bracket/side.dxf").to_vec()),
    ]
}
