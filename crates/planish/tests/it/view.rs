//! Pictures: objects appear at the right place, in the colour of their values.

use planish::ErrorKind;
use planish::Job;
use planish::progress::Silent;
use planish::view::{CameraAngles, ColourBy, PictureJob, PictureOptions, PictureReport, ViewedFile};
use planish_core::DVec3;
use planish_exchange::mesh::{Column, MeshColumns, write_mesh};
use planish_exchange::picture::{Picture, read_picture};
use planish_mesh::{TriangleMesh, icosphere, parallelepiped};
use std::path::{Path, PathBuf};

const SIZE: [usize; 2] = [320, 240];

fn seen(
    file: &Path,
    reference: Option<PathBuf>,
    camera: &str,
    colour: Option<ColourBy>,
) -> planish::Result<(PictureReport, Picture)> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("seen.png");
    let viewed = ViewedFile { file: file.to_path_buf(), reference, ..ViewedFile::default() };
    let options = PictureOptions {
        camera: Some(camera.parse::<CameraAngles>().expect("a camera")),
        colour,
        size: SIZE,
        ..PictureOptions::default()
    };
    let report = PictureJob { viewed, options, output: path.clone() }.run(&Silent)?;
    Ok((report, read_picture(&path).expect("a picture")))
}

fn pixel(picture: &Picture, [column, row]: [usize; 2]) -> [f32; 3] {
    let at = 3 * (row * picture.columns + column);
    [0, 1, 2].map(|c| picture.values[at + c])
}

fn write(folder: &Path, name: &str, mesh: &TriangleMesh, columns: &[(&str, Vec<f64>)]) -> PathBuf {
    let path = folder.join(name);
    let columns = columns.iter().map(|(name, values)| (*name, Column::F64(values))).collect();
    let file = MeshColumns {
        points: &mesh.positions,
        triangles: &mesh.triangles,
        columns,
        ..MeshColumns::default()
    };
    write_mesh(&path, &file).expect("a mesh");
    path
}

/// Columns of the pixels in a row that are neither paper nor letters.
fn covered(picture: &Picture, row: usize) -> Vec<usize> {
    let is_paper = |[r, g, b]: [f32; 3]| (r - g).abs() < 3.0 && (g - b).abs() < 3.0 && r > 225.0;
    (0..picture.columns).filter(|column| !is_paper(pixel(picture, [*column, row]))).collect()
}

#[test]
fn values_have_their_colours_at_their_positions() {
    let folder = tempfile::tempdir().unwrap();
    let ball = icosphere(1.0, 4);
    // σ grows along x: dark violet on the left of who looks from the front, yellow on the right.
    let sigma = ball.positions.iter().map(|p| 2.0 + 0.5 * p[0]).collect();
    let path = write(folder.path(), "ball.ply", &ball, &[("sigma", sigma)]);
    let (report, front) = seen(&path, None, "front", None).unwrap();
    assert_eq!(report.color, "sigma");
    let [low, high] = report.color_range.unwrap();
    assert!((1.5..1.6).contains(&low) && (2.4..2.5).contains(&high));
    let row = 105;
    let columns = covered(&front, row);
    let [left, right] = [columns[columns.len() / 10], columns[9 * columns.len() / 10]];
    let [dark, bright] = [left, right].map(|column| pixel(&front, [column, row]));
    assert!(dark[2] > 1.3 * dark[1], "{dark:?} is no violet");
    assert!(bright[1] > 2.0 * bright[2] && bright[0] > bright[2], "{bright:?} is no yellow");
    // From the back the sides are exchanged.
    let (_, back) = seen(&path, None, "back", None).unwrap();
    let mirrored = pixel(&back, [right, row]);
    assert!(mirrored[2] > 1.3 * mirrored[1], "{mirrored:?}");
    // A disc as high as the room that the legend leaves: (240 − 12 − 5.6 · 9) pixels of 240 · 320, less the
    // shares of perspective.
    let height = 240.0 - 12.0 - 5.6 * 9.0;
    let disc = std::f64::consts::PI * 0.25 * height * height / (240.0 * 320.0);
    assert!((report.covered / disc - 1.0).abs() < 0.02, "{} {disc}", report.covered);
    // Zoom enlarges.
    let (near, _) = seen(&path, None, "front,0.5", None).unwrap();
    assert!((near.covered / report.covered - 0.25).abs() < 0.01);
}

#[test]
fn named_cameras_show_the_named_sides() {
    let folder = tempfile::tempdir().unwrap();
    let ball = icosphere(1.0, 4);
    let observed = ball.positions.iter().map(|p| f64::from(u8::from(p[0] > 0.0))).collect();
    let path = write(folder.path(), "ball.ply", &ball, &[("observed", observed)]);
    let middle = [160, 105];
    let colour_of = |camera: &str| {
        let (_, picture) = seen(&path, None, camera, Some(ColourBy::Field("observed"))).unwrap();
        pixel(&picture, middle)
    };
    let [right, left] = ["right", "left"].map(colour_of);
    assert!(right[2] > 2.0 * right[0], "the right side was measured: blue, found {right:?}");
    assert!((left[2] - left[0]).abs() < 12.0, "the left side was not: grey, found {left:?}");
    // Normals towards the camera are blue, with equal parts of red and green.
    let (_, normals) = seen(&path, None, "iso", Some(ColourBy::Normal)).unwrap();
    let [r, g, b] = pixel(&normals, middle);
    assert!(b > 240.0 && (r - 127.0).abs() < 25.0 && (g - 127.0).abs() < 25.0, "{r} {g} {b}");
}

#[test]
fn deviations_are_red_outside_and_blue_inside() {
    let folder = tempfile::tempdir().unwrap();
    let sphere = write(folder.path(), "truth.ply", &icosphere(1.0, 4), &[]);
    let mut model = icosphere(1.0, 4);
    for p in &mut model.positions {
        let factor = if p[0] > 0.0 { 1.02 } else { 0.98 };
        *p = p.map(|c| factor * c);
    }
    let model = write(folder.path(), "model.ply", &model, &[]);
    let (report, picture) = seen(&model, Some(sphere.clone()), "front", None).unwrap();
    assert_eq!(report.color, "deviation");
    let columns = covered(&picture, 105);
    let [left, right] =
        [columns[columns.len() / 4], columns[3 * columns.len() / 4]].map(|c| pixel(&picture, [c, 105]));
    assert!(left[2] > 1.5 * left[0] && right[0] > 1.5 * right[2], "{left:?} {right:?}");
}

#[test]
fn points_are_drawn_and_edges_stay_sharp() {
    let folder = tempfile::tempdir().unwrap();
    let points = folder.path().join("points.xyz");
    let text: String =
        icosphere(1.0, 4).positions.iter().map(|DVec3 { x, y, z }| format!("{x} {y} {z}\n")).collect();
    std::fs::write(&points, text).unwrap();
    let (report, picture) = seen(&points, None, "20,10", None).unwrap();
    assert_eq!(report.color, "height");
    assert!(report.covered > 0.15, "{}", report.covered);
    assert!(covered(&picture, 105).len() > 60);
    // A cube that has each corner once: its faces are of one brightness each, up to their edges.
    let cube = parallelepiped(DVec3::splat(0.5), [DVec3::X, DVec3::Y, DVec3::Z]);
    let path = write(folder.path(), "cube.stl", &cube, &[]);
    let (_, picture) = seen(&path, None, "top", Some(ColourBy::Plain)).unwrap();
    let columns = covered(&picture, 100);
    let brightness: Vec<f32> =
        columns[4..columns.len() - 4].iter().map(|c| pixel(&picture, [*c, 100])[1]).collect();
    let [min, max] =
        [brightness.iter().copied().fold(255.0, f32::min), brightness.iter().copied().fold(0.0, f32::max)];
    assert!(max - min <= 2.0, "{min} {max}");
}

#[test]
fn input_that_cannot_be_drawn_is_rejected_with_advice() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = write(folder.path(), "ball.ply", &icosphere(1.0, 1), &[]);
    let points = folder.path().join("points.xyz");
    std::fs::write(&points, "0 0 0\n1 0 0\n0 1 0\n").unwrap();
    let message = |file: &Path, reference: Option<PathBuf>, colour: ColourBy| {
        let e = seen(file, reference, "front", Some(colour)).map(|_| ()).unwrap_err();
        (e.kind(), e.to_string())
    };
    let (kind, text) = message(&mesh, None, ColourBy::Field("sigma"));
    assert!(kind == ErrorKind::Input && text.contains("ball.ply") && text.contains("found plain"), "{text}");
    let (_, text) = message(&mesh, None, ColourBy::Field("deviation"));
    assert!(text.contains("expected the field deviation to colour by"), "{text}");
    let (_, text) = message(&points, None, ColourBy::Normal);
    assert!(text.contains("normals"), "{text}");
    let (kind, text) = message(&points, Some(mesh), ColourBy::Plain);
    assert!(kind == ErrorKind::Unsupported && text.contains("points only"), "{text}");
    let iges = folder.path().join("part.iges");
    std::fs::write(&iges, format!("{:72}S      1\n", "")).unwrap();
    let (kind, text) = message(&iges, None, ColourBy::Plain);
    assert!(kind == ErrorKind::Unsupported && text.contains("IGES, which is not supported"), "{text}");
}

#[test]
fn a_picture_larger_than_memory_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = write(folder.path(), "ball.ply", &icosphere(1.0, 1), &[]);
    let options = PictureOptions { size: [16_384, 16_384], ..PictureOptions::default() };
    let viewed = ViewedFile { file: mesh, ..ViewedFile::default() };
    let job = PictureJob { viewed, options, output: folder.path().join("a.png") };
    let e = job.run(&Silent).unwrap_err();
    assert!(e.kind() == ErrorKind::Input && e.to_string().contains("64 million"), "{e}");
}

#[test]
fn a_picture_does_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = write(folder.path(), "ball.ply", &icosphere(1.0, 3), &[]);
    let made = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| seen(&mesh, None, "iso", None).unwrap().1.values)
    });
    assert!(made[0] == made[1]);
}
