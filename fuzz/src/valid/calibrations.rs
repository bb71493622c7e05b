//! Valid calibrations, views, poses and lights (TOML).

use planish_estimate::Result;

/// Calibrations of a depth camera.
pub fn cameras() -> Result<Vec<Vec<u8>>> {
    // A file with every key and one with the required keys only: damage can then remove and add keys.
    let full =
        "unit = \"m\"\nfx = 2\nfy = 2.5\ncx = 1\ncy = 0.5\nscale = 0.001\nsigma_a = 0.001\nsigma_b = 0.002\n";
    Ok(vec![full.as_bytes().to_vec(), b"fx = 500\nfy = 500\ncx = 2\ncy = 1\n".to_vec()])
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

/// Cameras with masks. The named files need not exist.
pub fn mask_views() -> Result<Vec<Vec<u8>>> {
    let k = "K = [[900.0, 0.0, 320.0], [0.0, 900.0, 240.0], [0.0, 0.0, 1.0]]\n";
    // An exact rotation (0.28, 0.96): readers reject matrices that are not orthogonal.
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

/// A camera and a projector of crossed stripe patterns.
pub fn grids() -> Result<Vec<Vec<u8>>> {
    // Integers and decimals are mixed, as people write them; TOML distinguishes both.
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
