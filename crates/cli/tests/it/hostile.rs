//! Damaged and extreme inputs: each gives a message and an exit code, and leaves every file unchanged.
//!
//! The messages are listed in `docs/hostile-inputs.md`.
//! `PLANISH_WRITE_DOCS=1 cargo test -p planish-cli --test it hostile` rewrites that page.

#![cfg(target_os = "linux")]

use crate::support::{command, names, pebble, planish, repository};
use std::ffi::{OsStr, OsString};
use std::fmt::Write as _;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Description, command line and exit code. `%` is replaced by a byte that is not valid UTF-8. A command
/// after `limit` can write at most two blocks to a file.
const INPUTS: &[(&str, &str, i32)] = &[
    ("A PLY header that declares a billion vertices", "fit bomb.ply -o old.ply", 2),
    ("A PCD header that declares a billion points", "fit bomb.pcd -o old.ply", 2),
    ("A small compressed file that expands to gigabytes", "fit bomb.xyz.gz -o old.ply", 2),
    ("A truncated compressed file", "fit cut.xyz.gz -o old.ply", 2),
    ("A truncated scan", "fit half.ply -o old.ply", 2),
    ("A header that declares fewer points than the file contains", "fit more.ply -o old.ply", 2),
    ("An empty file", "fit empty.xyz -o old.ply", 2),
    ("A folder", "fit folder.ply -o old.ply", 3),
    ("Random bytes", "fit garbage.las -o old.ply", 2),
    ("An endless line", "fit endless.xyz -o old.ply", 2),
    ("A PLY file with the extension .pcd", "fit named.pcd -o old.ply", 2),
    ("Decimal commas, separated by semicolons", "fit semicolons.csv -o old.ply", 2),
    ("Decimal commas, separated by spaces", "fit blanks.txt -o old.ply", 2),
    ("CR LF line ends, after a byte order mark", "fit crlf.csv -o old.ply", 0),
    ("File names that are not valid UTF-8", "fit caf%.xyz -o caf%.ply --json", 0),
    ("A covariance that is not positive definite", "fit covariance.csv -o old.ply", 2),
    ("A reading with σ = 0", "fit zero.csv -o old.ply", 2),
    ("A reading with σ = NaN", "fit nan_sigma.csv -o old.ply", 2),
    ("A sensor with a negative σ", "fit negative.toml -o old.ply", 2),
    ("A sensor with σ = 1e300", "fit enormous.toml -o old.ply", 2),
    ("A quaternion that is not normalised", "fit quaternion.toml -o old.ply", 2),
    ("An infinite pose in a job", "fit infinite.toml -o old.ply", 2),
    ("An infinite pose in a list of scans", "fit infinite.conf -o old.ply", 2),
    ("A pose at a distance of 1e19", "fit away.toml -o old.ply", 2),
    ("An unknown key in a job", "fit unknown.toml -o old.ply", 2),
    ("Deeply nested brackets", "fit deep.toml -o old.ply", 2),
    ("A list that contains itself", "fit itself.conf -o old.ply", 2),
    ("A list that contains a device", "fit device.conf -o old.ply", 3),
    ("One coordinate of 1e200", "fit coordinate.xyz -o old.ply", 2),
    ("Coordinates of 1e-12", "fit tiny.xyz -o old.ply --unit mm", 0),
    ("Coordinates of 1e12", "fit huge.xyz -o old.ply --unit mm", 0),
    ("NaN coordinates", "fit nan.xyz -o old.ply --unit mm", 0),
    ("Every point repeated fifty times", "fit repeated.xyz -o old.ply --unit mm", 0),
    ("One point repeated five thousand times", "fit same.xyz -o old.ply", 1),
    ("Points on a line", "fit line.xyz -o old.ply", 1),
    ("`--shape ball` for points in a plane", "fit plane.xyz --shape ball -o old.ply", 1),
    ("Two points", "fit two.xyz -o old.ply", 1),
    ("Scans that are far apart", "fit good.xyz far.xyz --shape sheet -o old.ply --unit mm", 0),
    ("A full disk", "fit good.xyz -o full.ply", 3),
    ("A disk that becomes full while files are written", "limit fit good.xyz -o old.ply -o old.planish", 3),
    ("A folder that does not exist", "fit good.xyz -o gone/new.ply", 3),
    ("A folder that is not writable", "fit good.xyz -o /sys/new.ply", 3),
    ("A read-only output file", "fit good.xyz -o protected.ply", 3),
    ("The input as output", "fit half.ply -o half.ply", 2),
    ("A truncated STEP file", "compare half.step good.xyz", 2),
    ("A STEP face whose bound refers to itself", "view itself.step -o old.png", 2),
    ("A STEP spline that declares a billion knots", "merge knots.step knots.step -o old.ply", 2),
    ("STEP assemblies nested ten deep, with ten parts each", "info parts.step", 2),
    ("DXF blocks nested ten deep, with ten inserts each", "solid blocks.dxf top.dxf -o old.step", 2),
    ("A missing block", "solid gone_block.dxf top.dxf -o old.step", 2),
    ("An SVG file with recursively expanding entities", "solid laughs.svg top.dxf -o old.step", 2),
    ("Deeply nested SVG groups", "solid groups.svg top.dxf -o old.step", 2),
    ("An SVG path that ends within a number", "solid path.svg top.dxf -o old.step", 2),
    ("An encrypted PDF file", "solid locked.pdf top.dxf -o old.step", 2),
    ("A PDF page that is a picture", "solid scanned.pdf top.dxf -o old.step", 2),
    ("A damaged picture of a drawing", "solid drawing.png top.dxf -o old.step", 2),
    ("A picture with the extension .dxf", "solid picture.dxf top.dxf -o old.step", 2),
    ("A missing view", "solid front.dxf gone.dxf -o old.step", 3),
    ("A single view", "solid front.dxf -o old.step", 2),
    ("Views with different scales", "solid double.dxf top.dxf side.dxf -o old.step", 2),
    ("An outline with a gap", "solid open.dxf top.dxf side.dxf -o old.step", 1),
    (
        "Duplicate lines, lines of length zero, texts, hatches, and a dimension with a wrong number",
        "solid messy.dxf top.dxf side.dxf",
        0,
    ),
    ("Truncated JSON contours", "solid cut.json cut.json -o old.step", 2),
    ("A mesh tolerance of zero", "solid front.dxf top.dxf side.dxf --mesh-tolerance 0 -o old.ply", 2),
    ("A camera with a focal length of zero", "shell fit ball.obj --silhouettes flat.toml -o old.ply", 2),
    ("A mirrored camera", "shell fit ball.obj --silhouettes mirrored.toml -o old.ply", 2),
    ("An unknown key in a view", "shell fit ball.obj --silhouettes unknown_view.toml -o old.ply", 2),
    ("Two views with the same name", "shell fit ball.obj --silhouettes twice.toml -o old.ply", 2),
    ("A pose with a σ for rotation only", "shell fit ball.obj --silhouettes half_sigma.toml -o old.ply", 2),
    ("A feature in an unknown view", "shell fit ball.obj --silhouettes tracks.toml -o old.ply", 2),
    ("A missing mask", "shell fit ball.obj --silhouettes no_mask.toml -o old.ply", 3),
    ("A mask of one colour", "shell fit ball.obj --silhouettes white.toml -o old.ply", 1),
    ("A view without a mask or picture", "shell fit ball.obj --silhouettes nothing.toml -o old.ply", 1),
    ("Pictures that do not show the object", "shell texture ball.obj --views away_view.toml -o old.ply", 1),
    ("An unknown control", "shell pose ball.obj --poses control.toml -o old.ply", 2),
    ("Keyframes with decreasing times", "shell pose ball.obj --poses back.toml -o old.ply", 2),
    ("A keyframe with an unknown pose", "shell pose ball.obj --poses gone_pose.toml -o old.ply", 2),
    ("An infinite displacement", "shell pose ball.obj --poses infinite_move.toml -o old.ply", 2),
    ("A hundred million controls", "shell pose ball.obj --poses many.toml -o old.ply", 2),
    ("A picture of 1520 megapixels in 1.5 MB", "fit pixels.png -o old.ply", 2),
    ("A long SVG entity that is used very often", "solid entities.svg top.dxf -o old.step", 2),
    ("A hundred thousand copies of a STEP face", "view copies.step -o copies.png", 0),
    ("A material whose picture is a device", "shell pose device.obj --poses up.toml -o posed.glb", 0),
    ("Fifty thousand views", "shell fit ball.obj --silhouettes many_views.toml -o old.ply", 2),
    ("A maximum memory without its unit", "fit good.xyz --max-memory 8", 2),
    ("A wrong option with `--json`", "fit good.xyz --gate 0 --json", 2),
];

/// 200 points of a rough plane, one on each line.
fn plane(point: impl Fn(f64, f64, f64) -> String) -> String {
    let number = |k: u32| (f64::from(k % 20), f64::from(k / 20), 0.01 * f64::from((7 * k) % 10));
    (0..200).map(number).map(|(x, y, z)| point(x, y, z) + "\n").collect()
}

fn fill(folder: &Path) {
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a file");
    let text = |name: &str, text: &str| write(name, text.as_bytes());
    let job = |name: &str, sensor: &str, scan: &str| {
        text(
            name,
            &format!(
                "unit = \"mm\"\n[sensor.a]\nkind = \"range\"\n{sensor}\n[[scan]]\nfile \
                 = \"good.xyz\"\n{scan}\n"
            ),
        );
    };
    let spaced = |scale: f64| plane(|x, y, z| format!("{:e} {:e} {:e}", scale * x, scale * y, scale * z));
    let ply = |vertices: u64, body: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty \
             float z\nend_header\n{body}"
        )
    };
    let good = spaced(1.0);
    let laser = std::fs::read(pebble("laser-1.ply")).expect("a scan");
    text("good.xyz", &good);
    text("bomb.ply", &ply(1_000_000_000, "0 0 0\n").replace("ascii", "binary_little_endian"));
    text(
        "bomb.pcd",
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1000000000\nHEIGHT 1\nPOINTS \
         1000000000\nDATA binary\nabc",
    );
    // As `cat` joins compressed files.
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    std::io::Write::write_all(&mut encoder, &b"0 0 0\n".repeat(1 << 18)).expect("memory");
    let packed = encoder.finish().expect("memory");
    write("bomb.xyz.gz", &packed.repeat(80));
    write("cut.xyz.gz", &packed[..1000]);
    write("half.ply", &laser[..laser.len() / 2]);
    text("more.ply", &ply(2, "0 0 0\n1 0 0\n0 1 0\n"));
    text("empty.xyz", "");
    std::fs::create_dir(folder.join("folder.ply")).expect("a folder");
    write(
        "garbage.las",
        &(0..4000_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect::<Vec<_>>(),
    );
    std::os::unix::fs::symlink("/dev/zero", folder.join("endless.xyz")).expect("a link");
    text("named.pcd", &ply(1, "0 0 0\n"));
    text("semicolons.csv", "x;y;z\n1,5;2,5;3,5\n");
    text("blanks.txt", "1,5 2,5 3,5\n2,5 2,5 3,5\n");
    text("crlf.csv", &format!("\u{feff}x,y,z\n{}", good.replace(' ', ",")).replace('\n', "\r\n"));
    std::fs::write(folder.join(OsStr::from_bytes(b"caf\xe9.xyz")), &good).expect("a file");
    let with_covariance =
        plane(|x, y, _| format!("{x},{y},0,1,{},0,1,0,1", if (x, y) == (3.0, 2.0) { 2 } else { 0 }));
    text("covariance.csv", &format!("x,y,z,cxx,cxy,cxz,cyy,cyz,czz\n{with_covariance}"));
    let with_sigma = |value: &str| {
        let sigma = |x: f64, y: f64| {
            if (x, y) == (3.0, 2.0) { value.to_owned() } else { "0.1".to_owned() }
        };
        format!("x,y,z,sigma\n{}", plane(|x, y, z| format!("{x},{y},{z},{}", sigma(x, y))))
    };
    text("zero.csv", &with_sigma("0"));
    text("nan_sigma.csv", &with_sigma("nan"));
    job("negative.toml", "sigma = -0.1", "");
    job("enormous.toml", "sigma = 1e300", "");
    job("quaternion.toml", "", "pose = { quaternion_xyzw = [0, 0, 0.5, 0.5] }");
    job("infinite.toml", "", "pose = { translation = [0, inf, 0] }");
    text("infinite.conf", "bmesh good.xyz 0 inf 0 0 0 0 1\n");
    job("away.toml", "", "pose = { translation = [1e19, 0, 0] }");
    job("unknown.toml", "sigma_mm = 0.1", "");
    text("deep.toml", &format!("unit = {}\n", "[".repeat(100_000)));
    text("itself.conf", "bmesh itself.conf 0 0 0 0 0 0 1\n");
    text("device.conf", "bmesh /dev/zero 0 0 0 0 0 0 1\n");
    text("coordinate.xyz", &format!("{good}1e200 0 0\n"));
    text("tiny.xyz", &spaced(1e-12));
    text("huge.xyz", &spaced(1e12));
    text("nan.xyz", &good.replacen("e1 5e0 ", "e1 nan ", 3));
    text("repeated.xyz", &good.repeat(50));
    text("same.xyz", &"1 2 3\n".repeat(5000));
    text("line.xyz", &plane(|x, y, _| format!("{0} {0} {0}", x + 20.0 * y)));
    text("plane.xyz", &plane(|x, y, _| format!("{x} {y} 0")));
    text("two.xyz", "0 0 0\n1 1 1\n");
    text("far.xyz", &plane(|x, y, z| format!("{} {y} {z}", x + 1000.0)));
    std::os::unix::fs::symlink("/dev/full", folder.join("full.ply")).expect("a link");
    text("protected.ply", OLD);
    let mut permissions = std::fs::metadata(folder.join("protected.ply")).expect("a file").permissions();
    permissions.set_readonly(true);
    std::fs::set_permissions(folder.join("protected.ply"), permissions).expect("permissions");
}

/// An octahedron, with invalid views and poses of it.
fn fill_shells(folder: &Path) {
    let text = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("a file");
    text(
        "ball.obj",
        "v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\nf 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 \
         6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n",
    );
    let row = |values: [&str; 4]| format!("P2 4 4 255\n{}\n", values.join("\n"));
    text("mask.pgm", &row(["0 0 0 0", "0 255 255 0", "0 255 255 0", "0 0 0 0"]));
    text("white.pgm", &row(["255 255 255 255"; 4]));
    let camera =
        |more: &str, k: &str, r: &str, t: &str| format!("[[view]]\n{more}\nK = {k}\nR = {r}\nt = {t}\n");
    let k = "[[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]";
    let r = "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]";
    let valid_camera = |more: &str| camera(more, k, r, "[0, 0, 5]");
    let mask = "mask = \"mask.pgm\"";
    text("flat.toml", &camera(mask, "[[0, 0, 1.5], [0, 4, 1.5], [0, 0, 1]]", r, "[0, 0, 5]"));
    text("mirrored.toml", &camera(mask, k, "[[-1, 0, 0], [0, 1, 0], [0, 0, 1]]", "[0, 0, 5]"));
    text("unknown_view.toml", &valid_camera("mask = \"mask.pgm\"\nlens = 3"));
    text("twice.toml", &(valid_camera(mask) + &valid_camera(mask)));
    text("half_sigma.toml", &valid_camera("mask = \"mask.pgm\"\nsigma_rotation_deg = 1"));
    text("tracks.toml", &format!("tracks = \"tracks.csv\"\n{}", valid_camera(mask)));
    text("tracks.csv", "track,view,x,y\n1,mask,1,2\n1,other,1,2\n");
    text("no_mask.toml", &valid_camera("mask = \"gone.pgm\""));
    text("white.toml", &valid_camera("mask = \"white.pgm\""));
    text("nothing.toml", &valid_camera("name = \"a\""));
    text("away_view.toml", &camera("image = \"mask.pgm\"", k, r, "[100, 0, 5]"));
    let pose = |head: &str, by: &str, rest: &str| {
        format!("{head}\n[[pose]]\nname = \"up\"\nmove = [{{ control = 0, by = {by} }}]\n{rest}\n")
    };
    let frame =
        |seconds: u32, name: &str| format!("[[keyframe]]\nseconds = {seconds}\nweights = {{ {name} = 1 }}\n");
    let up = "[0, 0, 1]";
    text("control.toml", &pose("controls = 4", up, "").replace("control = 0", "control = 4"));
    text("back.toml", &pose("controls = 4", up, &(frame(2, "up") + &frame(1, "up"))));
    text("gone_pose.toml", &pose("controls = 4", up, &frame(0, "down")));
    text("infinite_move.toml", &pose("controls = 4", "[0, 0, inf]", ""));
    text("many.toml", &pose("controls = 100000000", up, ""));
}

/// Damaged drawings, with valid ones for comparison.
fn fill_drawings(folder: &Path) {
    let text = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("a file");
    // Codes and values, separated by blanks.
    let dxf = |name: &str, blocks: &str, entities: &str| {
        let all =
            format!("0 SECTION 2 BLOCKS {blocks} 0 ENDSEC 0 SECTION 2 ENTITIES {entities} 0 ENDSEC 0 EOF");
        text(name, &all.split_whitespace().map(|word| format!("{word}\n")).collect::<String>());
    };
    let line = |[a, b, c, d]: [f64; 4]| format!("0 LINE 8 VISIBLE 10 {a} 20 {b} 11 {c} 21 {d} ");
    let sides =
        |w: f64, h: f64| [[0.0, 0.0, w, 0.0], [w, 0.0, w, h], [w, h, 0.0, h], [0.0, h, 0.0, 0.0]].map(line);
    let rectangle = |w: f64, h: f64| sides(w, h).concat();
    dxf("front.dxf", "", &rectangle(40.0, 20.0));
    dxf("top.dxf", "", &rectangle(40.0, 30.0));
    dxf("side.dxf", "", &rectangle(30.0, 20.0));
    dxf("double.dxf", "", &rectangle(80.0, 40.0));
    dxf("open.dxf", "", &sides(40.0, 20.0)[..3].concat());
    let with_other_entities = format!(
        "{}{}0 LINE 5 7A 10 5 20 20 11 5 21 20 0 TEXT 5 7B 1 hello 0 HATCH 5 7C 0 DIMENSION 5 7D 70 32 13 0 \
         23 0 14 40 24 0 1 45 ",
        rectangle(40.0, 20.0),
        line([0.0, 0.0, 40.0, 0.0])
    );
    dxf("messy.dxf", "", &with_other_entities);
    let mut nested = "0 BLOCK 2 b0 10 0 20 0 0 LINE 10 0 20 0 11 1 21 1 0 ENDBLK ".to_owned();
    for k in 1..10 {
        let inserts = format!("0 INSERT 2 b{} 10 0 20 0 ", k - 1).repeat(10);
        nested += &format!("0 BLOCK 2 b{k} 10 0 20 0 {inserts} 0 ENDBLK ");
    }
    dxf("blocks.dxf", &nested, "0 INSERT 5 1F 2 b9 10 0 20 0");
    dxf("gone_block.dxf", "", "0 INSERT 5 1F 2 bolt 10 0 20 0");
    let mut entity_bomb = "<!DOCTYPE svg [<!ENTITY a0 'M0 0'>".to_owned();
    for k in 1..12 {
        entity_bomb += &format!("<!ENTITY a{k} '{}'>", format!("&a{};", k - 1).repeat(10));
    }
    text("laughs.svg", &format!("{entity_bomb}]><svg><text>&a11;</text></svg>"));
    text("groups.svg", &format!("<svg>{}{}</svg>", "<g>".repeat(1000), "</g>".repeat(1000)));
    text("path.svg", "<svg>\n<path id='rim' d='M0 0 L 3 4e'/></svg>");
    let head = "%PDF-1.4\n1 0 obj <</Pages 2 0 R>> endobj trailer <</Root 1 0 R";
    text("locked.pdf", &format!("{head} /Encrypt 3 0 R>>"));
    let page = "2 0 obj <</MediaBox [0 0 9 9] /Contents 3 0 R>> endobj 3 0 obj <</Length 12>> stream\n\
        BI ID x EI  \nendstream endobj";
    text("scanned.pdf", &format!("{head}>> {page}"));
    text("drawing.png", "P");
    std::fs::write(folder.join("picture.dxf"), b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR").expect("a file");
    steps(folder);
    text("cut.json", "{\"kind\": \"circle\", \"parameters\": {");
}

/// STEP files with content that no real part has.
fn steps(folder: &Path) {
    let step = |name: &str, lines: &str| {
        let text = format!(
            "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n\
             ENDSEC;\nDATA;\n{lines}ENDSEC;\nEND-ISO-10303-21;\n"
        );
        std::fs::write(folder.join(name), text).expect("a file");
    };
    let head = "#1=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));
#2=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT((#1))REPRESENTATION_CONTEXT('',''));
#3=CARTESIAN_POINT('',(0.,0.,0.));
#4=AXIS2_PLACEMENT_3D('',#3,$,$);
#5=SHELL_BASED_SURFACE_MODEL('',(#6));
#6=OPEN_SHELL('',(#7));
";
    let shape = "#8=SHAPE_REPRESENTATION('',(#5),#2);\n";
    step(
        "itself.step",
        &format!(
            "{head}{shape}#7=ADVANCED_FACE('',(#9),#10,.T.);\n#9=FACE_BOUND('',#9,.T.);\n#10=PLANE('',#4);\n"
        ),
    );
    step(
        "knots.step",
        &format!(
            "{head}{shape}#7=ADVANCED_FACE('',(),#10,.T.);\n\
             #10=B_SPLINE_SURFACE_WITH_KNOTS('',3,3,((#3,#3),(#3,#3)),.UNSPECIFIED.,\
             .F.,.F.,.F.,(1000000000,4),(4,4),(0.,1.),(0.,1.),.UNSPECIFIED.);\n"
        ),
    );
    let mut parts = format!(
        "{head}#7=ADVANCED_FACE('',(),#10,.T.);\n#10=PLANE('',#4);\n#20=SHAPE_REPRESENTATION('',(#5),#2);\n"
    );
    for k in 1..=10 {
        let (map, inner) = (100 * k, if k == 1 { 20 } else { 100 * k - 99 });
        let items: Vec<String> = (2..12).map(|i| format!("#{}", map + i)).collect();
        parts += &format!("#{map}=REPRESENTATION_MAP(#4,#{inner});\n");
        for item in &items {
            parts += &format!("{item}=MAPPED_ITEM('',#{map},#4);\n");
        }
        parts += &format!("#{}=SHAPE_REPRESENTATION('',({}),#2);\n", map + 1, items.join(","));
    }
    step("parts.step", &parts);
    let complete = std::fs::read(folder.join("parts.step")).expect("a file");
    std::fs::write(folder.join("half.step"), &complete[..complete.len() / 2]).expect("a file");
}

/// Small files that describe something huge.
fn fill_small_files(folder: &Path) {
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a file");
    let chunk = |kind: &[u8; 4], data: &[u8]| {
        let mut crc = flate2::Crc::new();
        crc.update(kind);
        crc.update(data);
        [&(data.len() as u32).to_be_bytes()[..], &kind[..], data, &crc.sum().to_be_bytes()].concat()
    };
    let header = [&40_000_u32.to_be_bytes()[..], &38_000_u32.to_be_bytes(), &[8, 0, 0, 0, 0]].concat();
    let png = [chunk(b"IHDR", &header), chunk(b"IDAT", &[0; 1_500_000]), chunk(b"IEND", b"")].concat();
    write("pixels.png", &[&b"\x89PNG\r\n\x1a\n"[..], &png[..]].concat());
    let view = |k: u32| format!("[[view]]\nname = \"{k}\"\nmask = \"mask.pgm\"\n");
    write("many_views.toml", (0..50_000).map(view).collect::<String>().as_bytes());
    write("pixels.toml", b"fx = 1\nfy = 1\ncx = 0\ncy = 0\nscale = 0.001\n");
    let uses = "<path d='&long;'/>\n".repeat(27_000);
    let long = "M0 0L1 1".repeat(50_000);
    write("entities.svg", format!("<!DOCTYPE svg [<!ENTITY long '{long}'>]>\n<svg>{uses}</svg>").as_bytes());
    write(
        "device.obj",
        b"mtllib device.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nusemtl skin\n\
        f 1/1 3/1 2/1\nf 1/1 2/1 4/1\nf 2/1 3/1 4/1\nf 1/1 4/1 3/1\n",
    );
    write("device.mtl", b"newmtl skin\nmap_Kd /dev/zero\n");
    write("up.toml", b"controls = 4\n[[pose]]\nname = \"up\"\nmove = [{ control = 0, by = [0, 0, 0.1] }]\n");
    let step = |name: &str, lines: &str| {
        write(name, format!("ISO-10303-21;\nDATA;\n{lines}ENDSEC;\nEND-ISO-10303-21;\n").as_bytes());
    };
    let plane = "#1=CARTESIAN_POINT('',(0.,0.,0.));\n#2=CARTESIAN_POINT('',(10.,0.,0.));\n\
        #3=CARTESIAN_POINT('',(0.,10.,0.));\n#4=AXIS2_PLACEMENT_3D('',#1,$,$);\n#5=PLANE('',#4);\n\
        #6=POLY_LOOP('',(#1,#2,#3));\n#7=FACE_BOUND('',#6,.T.);\n";
    let face = |k: u32| format!("#{k}=FACE_SURFACE('',(#7),#5,.T.);\n");
    let faces: String = (100..100_100).map(face).collect();
    let names: Vec<String> = (100..100_100).map(|k| format!("#{k}")).collect();
    step("copies.step", &format!("{plane}{faces}#8=OPEN_SHELL('',({}));\n", names.join(",")));
}

/// The content of an existing file.
const OLD: &str = "old";

/// Runs a line of the table; returns the command line, the exit code, stdout and stderr.
fn run_line(folder: &Path, line: &str) -> (String, i32, String, String) {
    let words: Vec<OsString> = line
        .split(' ')
        .map(|word| {
            OsStr::from_bytes(&word.bytes().map(|b| if b == b'%' { 0xe9 } else { b }).collect::<Vec<u8>>())
                .to_owned()
        })
        .collect();
    let (shown, output) = match words.split_first() {
        Some((first, rest)) if first == "limit" => {
            // Signal 25 (SIGXFSZ) would end the process before the write returns an error. Most programs that
            // start others ignore it, too.
            let mut shell = Command::new("sh");
            shell.args(["-c", "trap '' 25; ulimit -f 2; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_planish")]);
            let output = shell.args(rest).current_dir(folder).env("COLUMNS", "100").output();
            (format!("ulimit -f 2; planish {}", &line[6..]), output)
        }
        _ => (format!("planish {line}"), command(folder, &words).output()),
    };
    let output = output.expect("planish runs");
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("text");
    let code = output.status.code().expect("an exit code");
    (shown.replace('%', "\u{fffd}"), code, text(&output.stdout), text(&output.stderr))
}

#[test]
fn hostile_inputs_give_messages_and_leave_files_unchanged() {
    let folder = tempfile::tempdir().expect("a folder");
    fill(folder.path());
    fill_shells(folder.path());
    fill_drawings(folder.path());
    fill_small_files(folder.path());
    let kept: Vec<_> = ["old.ply", "old.planish", "old.step"].map(|name| folder.path().join(name)).to_vec();
    let mut page = String::from(
        "# Errors on damaged input\n\n\
         This page lists damaged and unusual inputs, the messages that `planish` prints for them, and its \
         exit code.\n\
         If a command fails, it writes no output, and existing files stay unchanged. The test\n\
         `crates/cli/tests/it/hostile.rs` runs every command of this page.\n\n\
         | Exit code | Meaning |\n|---|---|\n| 0 | success |\n| 1 | the data do not determine the answer |\n\
         | 2 | wrong use or wrong input |\n| 3 | a file cannot be read or written |\n",
    );
    for &(what, line, expected) in INPUTS {
        for path in &kept {
            std::fs::write(path, OLD).expect("a file");
        }
        let before = names(folder.path());
        let (shown, code, stdout, stderr) = run_line(folder.path(), line);
        assert_eq!(code, expected, "{line}: {stdout}{stderr}");
        if code != 0 {
            assert_eq!(names(folder.path()), before, "{line}");
            for path in &kept {
                assert_eq!(std::fs::read_to_string(path).expect("a file"), OLD, "{line}: {}", path.display());
            }
        }
        let _ = write!(page, "\n## {what}\n\n    $ {shown}\n");
        // The last digits of a fit differ between machines, so only the fact that there is one is compared.
        let summary = match stdout.starts_with('{') {
            true if code != 0 => {
                stdout.replace(&format!("\"threads\": {}", threads(&stdout)), "\"threads\": 2")
            }
            true => "{ …\n".to_owned(),
            false => stdout.split_once(" of ").map_or(String::new(), |(fitted, _)| format!("{fitted} …\n")),
        };
        // On some systems /sys is mounted read-only; on others, only its permissions forbid writing.
        let stderr = stderr.replace("read-only filesystem or storage medium", "permission denied");
        for line in stderr.lines().chain(summary.lines()) {
            let _ = writeln!(page, "    {line}");
        }
        let _ = writeln!(page, "    [exit {code}]");
    }
    let path = repository().join("docs/hostile-inputs.md");
    if std::env::var_os("PLANISH_WRITE_DOCS").is_some() {
        std::fs::write(&path, &page).expect("the page");
    }
    let written = std::fs::read_to_string(&path).unwrap_or_default();
    for (now, then) in page.lines().zip(written.lines()) {
        assert_eq!(now, then, "docs/hostile-inputs.md says otherwise: see the head of this file");
    }
    assert_eq!(page.lines().count(), written.lines().count());
}

/// The number of threads in a JSON summary.
fn threads(json: &str) -> u64 {
    let object: serde_json::Value = serde_json::from_str(json).expect("JSON");
    object["threads"].as_u64().expect("a count")
}

/// After an interruption or a kill at any moment, every output is the complete old file or the complete new
/// one.
#[test]
fn interrupted_runs_leave_complete_old_or_new_files() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("a.xyz"), plane(|x, y, z| format!("{x} {y} {z}"))).expect("a file");
    let args = ["fit", "a.xyz", "-o", "a.planish", "-o", "a.ply", "-o", "a.step", "--quiet"];
    let outputs = ["a.planish", "a.ply", "a.step"].map(|name| folder.path().join(name));
    let begun = Instant::now();
    planish(folder.path(), &args).ok();
    let total = begun.elapsed();
    let new = outputs.clone().map(|path| std::fs::read(path).expect("an output"));
    let mut state = 7_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as u32
    };
    for run in 0..24 {
        for path in &outputs {
            std::fs::write(path, OLD).expect("a file");
        }
        let before = names(folder.path());
        let mut child = command(folder.path(), &args).stderr(Stdio::null()).spawn().expect("planish runs");
        // Files are written near the end.
        std::thread::sleep(
            total.mul_f64(0.5 + 0.6 * f64::from(random() % 1000) / 1000.0) - Duration::from_millis(1),
        );
        let interrupted = run % 2 == 0;
        if interrupted {
            let sent =
                Command::new("kill").args(["-INT", &child.id().to_string()]).stderr(Stdio::null()).status();
            // A process that has ended already cannot be interrupted.
            assert!(sent.is_ok());
        } else {
            child.kill().expect("it can be ended");
        }
        let code = child.wait().expect("it ends").code();
        for (path, new) in outputs.iter().zip(&new) {
            let found = std::fs::read(path).expect("a file");
            assert!(found == OLD.as_bytes() || found == *new, "run {run}: {} is half", path.display());
        }
        if interrupted {
            // No code: the signal came before the handler was installed.
            assert!(matches!(code, None | Some(0 | 130)), "run {run}: {code:?}");
            assert_eq!(names(folder.path()), before, "run {run}");
        } else {
            // A killed process cannot clean up. The next command in this folder does, and completes the set.
            planish(folder.path(), &["info", "a.ply"]);
            assert_eq!(names(folder.path()), before, "run {run}");
            let found = outputs.clone().map(|path| std::fs::read(path).expect("a file"));
            assert!(found == new || found.iter().all(|bytes| bytes == OLD.as_bytes()), "run {run}: mixed");
        }
    }
}
