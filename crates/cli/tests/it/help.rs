//! Help, version and the examples in the help.

use crate::support::planish;

fn help(args: &[&str]) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    planish(folder.path(), args).ok().stdout
}

#[test]
fn help_of_every_command() {
    for (name, args) in [
        ("planish", &["--help"][..]),
        ("fit_short", &["fit", "-h"]),
        ("fit", &["fit", "--help"]),
        ("compare", &["compare", "--help"]),
        ("contour", &["contour", "--help"]),
        ("info", &["info", "--help"]),
        ("verify", &["verify", "--help"]),
        ("merge", &["merge", "--help"]),
        ("next", &["next", "--help"]),
        ("shell", &["shell", "--help"]),
        ("shell_fit", &["shell", "fit", "--help"]),
        ("shell_mesh", &["shell", "mesh", "--help"]),
        ("shell_pose", &["shell", "pose", "--help"]),
        ("shell_texture", &["shell", "texture", "--help"]),
        ("solid", &["solid", "--help"]),
        ("sense", &["sense", "--help"]),
        ("sense_stereo", &["sense", "stereo", "--help"]),
        ("sense_grid", &["sense", "grid", "--help"]),
        ("sense_photometric", &["sense", "photometric", "--help"]),
        ("sense_depth", &["sense", "depth", "--help"]),
        ("sense_contours", &["sense", "contours", "--help"]),
        ("simulate", &["simulate", "--help"]),
        ("simulate_scene", &["simulate", "scene", "--help"]),
        ("simulate_sphere", &["simulate", "sphere", "--help"]),
        ("simulate_scene_scans", &["simulate", "scene", "scans", "--help"]),
        ("simulate_scene_stereo", &["simulate", "scene", "stereo", "--help"]),
        ("simulate_scene_grid", &["simulate", "scene", "grid", "--help"]),
        ("simulate_scene_vessel", &["simulate", "scene", "vessel", "--help"]),
        ("simulate_scene_handles", &["simulate", "scene", "handles", "--help"]),
        ("simulate_scene_plate", &["simulate", "scene", "plate", "--help"]),
        ("simulate_scene_cup", &["simulate", "scene", "cup", "--help"]),
        ("simulate_scene_bracket", &["simulate", "scene", "bracket", "--help"]),
        ("simulate_scene_readings", &["simulate", "scene", "readings", "--help"]),
        ("simulate_scene_views", &["simulate", "scene", "views", "--help"]),
        ("simulate_scene_contours", &["simulate", "scene", "contours", "--help"]),
        ("simulate_scene_shell", &["simulate", "scene", "shell", "--help"]),
        ("simulate_scene_turning", &["simulate", "scene", "turning", "--help"]),
        ("simulate_scene_bending", &["simulate", "scene", "bending", "--help"]),
        ("view", &["view", "--help"]),
        ("completions", &["completions", "--help"]),
        ("man", &["man", "--help"]),
    ] {
        insta::assert_snapshot!(format!("help_{name}"), help(args));
    }
}

#[test]
fn version_is_the_version_of_the_package() {
    assert_eq!(help(&["--version"]), format!("planish {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn examples_in_help_parse() {
    // A missing input or a blocked output gives exit code 3, a command line that does not parse gives 2. So
    // all outputs are blocked, and no example does any work.
    for command in [
        "fit",
        "compare",
        "contour",
        "info",
        "sense stereo",
        "sense grid",
        "sense photometric",
        "sense depth",
        "sense contours",
        "merge",
        "next",
        "shell fit",
        "shell mesh",
        "shell pose",
        "shell texture",
        "solid",
        "simulate scene scans",
        "simulate scene stereo",
        "simulate scene vessel",
        "simulate scene handles",
        "simulate scene plate",
        "simulate scene cup",
        "simulate scene bracket",
        "simulate scene readings",
        "simulate scene views",
        "simulate scene contours",
        "simulate scene turning",
        "simulate scene bending",
        "simulate sphere",
        "verify",
        "view",
    ] {
        let words: Vec<&str> = command.split(' ').collect();
        let [long, short] = ["--help", "-h"].map(|flag| help(&[&words[..], &[flag]].concat()));
        let mut examples: Vec<&str> =
            long.lines().filter_map(|line| line.strip_prefix("  planish ")).collect();
        assert!(!examples.is_empty(), "{command} --help shows no example");
        examples.push(short.lines().find_map(|line| line.strip_prefix("Example: planish ")).expect(command));
        for example in examples {
            let folder = tempfile::tempdir().expect("a folder");
            let args: Vec<&str> = example.split(' ').chain(["--quiet"]).collect();
            for pair in args.windows(2) {
                let in_the_way = folder.path().join(pair[1]);
                match pair[0] {
                    "--out" => std::fs::write(in_the_way, "no folder").expect("a file"),
                    "-o" => std::fs::create_dir_all(in_the_way).expect("a folder"),
                    _ => {}
                }
            }
            let result = planish(folder.path(), &args);
            assert_eq!(result.code, 3, "{example}: {}", result.stderr);
        }
    }
}
