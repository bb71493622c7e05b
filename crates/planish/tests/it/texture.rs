//! `planish shell texture` from files to files: a simulated object with known colours, one view of another
//! object, and parts that no view sees.

use planish::Job;
use planish::progress::Silent;
use planish::shell::texture::{ColourPlace, ShellTextureJob, ShellTextureReport};
use planish_core::DVec3;
use planish_exchange::Unit;
use planish_exchange::mesh::{Column, MeshColumns, PolygonMesh, read_mesh, write_mesh};
use planish_exchange::picture::{read_picture, write_colour_png, write_grey_png};
use planish_exchange::textured::read_textured;
use planish_mesh::{TriangleMesh, icosphere};
use std::fmt::Write;
use std::path::{Path, PathBuf};

const SIZE: [usize; 2] = [400, 300];
const FOCAL: f64 = 400.0;
/// A ball of 50, and a ball of 12 that stands before it as seen from +x.
const SMALL: (DVec3, f64) = (DVec3::new(75.0, 0.0, 10.0), 12.0);
/// The view with the picture of another object.
const OUTLIER_VIEW: usize = 3;
const HELD_OUT: usize = 5;

/// The colour at a place of the large ball; the small one is blue.
fn colour(p: DVec3) -> DVec3 {
    if (p - SMALL.0).length() < SMALL.1 + 1.0 {
        return DVec3::new(20.0, 30.0, 220.0);
    }
    DVec3::new(128.0 + 90.0 * (p[0] / 20.0).sin(), 110.0 + 80.0 * (p[1] / 25.0).cos(), 60.0 + 0.8 * p[2])
}

/// Where a ray first meets one of the balls.
fn hit(from: DVec3, along: DVec3) -> Option<DVec3> {
    let of = |(center, radius): (DVec3, f64)| {
        let to = center - from;
        let middle = to.dot(along);
        let square = radius * radius - (to.length_squared() - middle * middle);
        (square > 0.0).then(|| middle - square.sqrt())
    };
    let near = [of((DVec3::ZERO, 50.0)), of(SMALL)].into_iter().flatten().reduce(f64::min)?;
    Some(from + near * along)
}

/// Both balls, eight pictures from above the equator, and views.toml: view 3 shows something green, view 5 is
/// held out.
fn scene(folder: &Path) -> ShellTextureJob {
    let mut mesh = icosphere(50.0, 5);
    let small = icosphere(SMALL.1, 3);
    let first = mesh.positions.len() as u32;
    mesh.positions.extend(small.positions.iter().map(|p| *p + 1.0 * SMALL.0));
    mesh.triangles.extend(small.triangles.iter().map(|t| t.map(|v| v + first)));
    write_mesh(
        &folder.join("balls.ply"),
        &MeshColumns {
            points: &mesh.positions,
            columns: vec![("sigma", Column::F64(&vec![0.25; mesh.positions.len()]))],
            triangles: &mesh.triangles,
            unit: Some(Unit::Millimetre),
            ..MeshColumns::default()
        },
    )
    .unwrap();
    let mut text = String::from("unit = \"mm\"\n");
    for view in 0..8 {
        let angle = std::f64::consts::TAU * f64::from(view) / 8.0;
        let from = DVec3::new(angle.cos(), angle.sin(), 0.3).try_normalize().unwrap();
        let eye = 220.0 * from;
        let forward = -from;
        let right = forward.cross(DVec3::Z).try_normalize().unwrap();
        let r = [right, forward.cross(right), forward];
        let [cx, cy] = SIZE.map(|n| 0.5 * (n as f64 - 1.0));
        let mut pixels = Vec::new();
        for k in 0..SIZE[0] * SIZE[1] {
            let (x, y) = ((k % SIZE[0]) as f64 - cx, (k / SIZE[0]) as f64 - cy);
            let along = forward + x / FOCAL * right + y / FOCAL * r[1];
            let seen = match hit(eye, along.try_normalize().unwrap()) {
                Some(_) if view as usize == OUTLIER_VIEW => [0.0, 255.0, 0.0],
                Some(place) => colour(place).to_array(),
                None => [255.0, 255.0, 255.0],
            };
            pixels.extend(seen.map(|v| v.round() as u8));
        }
        write_colour_png(&folder.join(format!("v{view}.png")), SIZE, &pixels).unwrap();
        let t = r.map(|row| -row.dot(eye));
        let r = r.map(|row| row.to_array());
        writeln!(
            text,
            "[[view]]\nimage = \"v{view}.png\"\nheld_out = {}\nK = [[{FOCAL:?}, 0, {cx}], [0, {FOCAL:?}, \
             {cy}], [0, 0, 1]]\nR = {r:?}\nt = {t:?}",
            view as usize == HELD_OUT
        )
        .unwrap();
    }
    std::fs::write(folder.join("views.toml"), text).unwrap();
    ShellTextureJob {
        mesh: folder.join("balls.ply"),
        views: folder.join("views.toml"),
        place: ColourPlace::Auto,
        texture_size: None,
        outputs: Vec::new(),
        unit: None,
    }
}

fn run(job: &ShellTextureJob, outputs: &[PathBuf], place: ColourPlace) -> ShellTextureReport {
    let job = ShellTextureJob { outputs: outputs.to_vec(), place, ..job.clone() };
    job.run(&Silent).unwrap()
}

fn colours_of(mesh: &PolygonMesh) -> Vec<DVec3> {
    let [r, g, b] = ["red", "green", "blue"].map(|name| mesh.column(name).unwrap());
    (0..r.len()).map(|v| DVec3::new(r[v], g[v], b[v])).collect()
}

fn largest(a: DVec3, b: DVec3) -> f64 {
    (a - b).abs().max_element()
}

#[test]
fn vertices_have_the_colours_of_the_object_and_their_number_of_views() {
    let folder = tempfile::tempdir().unwrap();
    let job = scene(folder.path());
    let out = ["c.ply", "c.glb"].map(|name| folder.path().join(name));
    let report = run(&job, &out, ColourPlace::Vertices);
    let mesh = read_mesh(&out[0]).unwrap();
    assert_eq!(mesh.column("sigma").unwrap()[7], 0.25);
    let (found, views) = (colours_of(&mesh), mesh.column("views").unwrap());
    let mut sum = 0.0;
    for ((p, c), n) in mesh.points.iter().zip(&found).zip(views) {
        if *n > 0.0 {
            // A pixel is half a unit wide, and colours change by five a unit at most. None is blue that was
            // hidden, and none green.
            let off = largest(*c, colour(*p));
            assert!(off < 9.0, "{p:?}: {c:?}, not {:?}, from {n} views", colour(*p));
            sum += off * off;
        } else if p.length() < 51.0 {
            // Filled from what is around: a smooth continuation.
            assert!(largest(*c, colour(*p)) < 90.0, "{p:?}: {c:?}");
        }
    }
    let rms = (sum / report.seen as f64).sqrt();
    println!("rms of the largest channel {rms}, σ {}", report.colour_sigma);
    assert!(rms < 2.0, "{rms}");
    // Nobody looks from below; everything above the equator is seen.
    let of = |low: f64, high: f64| {
        let within = |p: &DVec3| p.length() < 51.0 && (low..high).contains(&p[2]);
        let chosen: Vec<f64> =
            (mesh.points.iter().zip(views)).filter(|(p, _)| within(p)).map(|(_, n)| *n).collect();
        chosen.iter().filter(|n| **n > 0.0).count() as f64 / chosen.len() as f64
    };
    assert_eq!((of(-51.0, -40.0), of(0.0, 40.0)), (0.0, 1.0));
    assert_eq!(views.iter().filter(|n| **n > 0.0).count(), report.seen);
    assert_eq!(report.seen + report.filled, report.vertices);
    // The view of another object is told, and so is how far what was held out is met.
    for (k, view) in report.views.iter().enumerate() {
        let share = view.outlier_vertices as f64 / view.seen as f64;
        assert_eq!((share > 0.8, view.is_rejected), (k == OUTLIER_VIEW, k == OUTLIER_VIEW), "{view:?}");
        assert_eq!(view.held_out, k == HELD_OUT);
        assert!(view.seen > 1000 && (k == OUTLIER_VIEW) == (view.rms.unwrap() > 20.0), "{view:?}");
    }
    let [warning] = &report.findings[..] else { panic!("{:?}", report.findings) };
    assert!(warning.text.contains("`v3`"), "{warning}");
    // GLB is in metres, and views.toml in millimetres: the same colours.
    let again = ShellTextureJob { mesh: out[1].clone(), ..job.clone() };
    let last = folder.path().join("d.ply");
    run(&again, std::slice::from_ref(&last), ColourPlace::Vertices);
    for (a, b) in colours_of(&read_mesh(&last).unwrap()).iter().zip(&found) {
        assert!(largest(*a, *b) <= 2.0, "{a:?} {b:?}");
    }
}

#[test]
fn a_texture_on_an_atlas_shows_the_object() {
    let folder = tempfile::tempdir().unwrap();
    let job = scene(folder.path());
    let out = ["t.obj", "t.glb"].map(|name| folder.path().join(name));
    let report = run(&job, &out, ColourPlace::Auto);
    let texture = report.texture.as_ref().unwrap();
    assert!(
        texture.atlas && texture.seen < texture.texels && texture.seen > texture.texels / 2,
        "{texture:?}"
    );
    let mesh = read_textured(&out[0]).unwrap();
    let picture = read_picture(mesh.texture.as_ref().unwrap()).unwrap();
    assert_eq!((picture.columns, picture.rows), (texture.size, texture.size));
    let place = |of: &[DVec3], corners: [u32; 3]| {
        corners.iter().fold(DVec3::ZERO, |sum, v| sum + 1.0 / 3.0 * of[*v as usize])
    };
    let mut worst: f64 = 0.0;
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let at = place(&mesh.points, *corners);
        // What was seen, with a margin from where only grazing views see.
        if at[2] < -5.0 || at.length() > 51.0 {
            continue;
        }
        let uv = mesh.uv_triangles[t].map(|c| mesh.uv[c as usize]);
        let [u, v] = [0, 1].map(|k| uv.iter().map(|c| c[k]).sum::<f64>() / 3.0);
        let (column, row) =
            ((u * picture.columns as f64) as usize, ((1.0 - v) * picture.rows as f64) as usize);
        let pixel = &picture.values[3 * (row * picture.columns + column)..][..3];
        worst = worst.max(largest(DVec3::from_array([0, 1, 2].map(|c| f64::from(pixel[c]))), colour(at)));
    }
    println!("largest difference at the middle of a triangle {worst}");
    assert!(worst < 10.0, "{worst}");
    assert!(report.views[HELD_OUT].rms.unwrap() < 12.0, "{:?}", report.views[HELD_OUT]);
    // GLB holds the picture, and σ for each of its vertices, in metres.
    let glb = read_textured(&out[1]).unwrap();
    assert!(glb.picture.is_some_and(|bytes| bytes.starts_with(b"\x89PNG")));
    let sigma = glb.columns.iter().find(|(name, _)| name == "sigma").unwrap();
    assert!(sigma.1.iter().all(|s| (s / 0.25e-3 - 1.0).abs() < 1e-6));
    // Painted again on the coordinates that it has, which are no atlas of ours now.
    let again = ShellTextureJob { mesh: out[0].clone(), texture_size: Some(512), ..job };
    let last = folder.path().join("u.glb");
    let report = run(&again, &[last], ColourPlace::Auto);
    let texture = report.texture.unwrap();
    assert!(!texture.atlas && texture.size == 512);
}

#[test]
fn input_that_cannot_be_coloured_is_rejected_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let job = scene(folder.path());
    let refused = |job: &ShellTextureJob| job.run(&Silent).unwrap_err().to_string();
    let with = |from: &str, to: &str| {
        let text = std::fs::read_to_string(&job.views).unwrap().replace(from, to);
        let views = folder.path().join("w.toml");
        std::fs::write(&views, text).unwrap();
        ShellTextureJob { views, ..job.clone() }
    };
    assert!(
        refused(&with("held_out = false", "held_out = true")).contains("w.toml: expected a view with `image")
    );
    // From the other side of the world.
    assert!(refused(&with("t = [", "t = [1e6, 1e6, 1e6] #")).contains("expected cameras that see the mesh"));
    assert!(refused(&with("v2.png", "gone.png")).contains("gone.png"));
    write_grey_png(&folder.path().join("m.png"), 2, 2, &[0, 255, 0, 255]).unwrap();
    let message = refused(&with("image = \"v2.png\"", "image = \"v2.png\"\nmask = \"m.png\""));
    assert!(
        message.contains("m.png") || message.contains("400 × 300 pixels and a mask with 2 × 2"),
        "{message}"
    );
    let small = ShellTextureJob { place: ColourPlace::Texture, texture_size: Some(64), ..job.clone() };
    assert!(refused(&small).contains("expected a texture of 1050 to"), "{}", refused(&small));
    let obj = ShellTextureJob {
        place: ColourPlace::Vertices,
        outputs: vec![folder.path().join("a.obj")],
        ..job.clone()
    };
    assert!(refused(&obj).contains("a.obj"), "{}", refused(&obj));
    let cloud = TriangleMesh { positions: vec![DVec3::ZERO], triangles: Vec::new() };
    let points = folder.path().join("p.ply");
    write_mesh(&points, &MeshColumns { points: &cloud.positions, ..MeshColumns::default() }).unwrap();
    assert!(refused(&ShellTextureJob { mesh: points, ..job }).contains("expected a mesh with faces"));
}
