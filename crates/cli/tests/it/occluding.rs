//! `planish sense contours` and `planish simulate scene contours`.

use crate::support::planish;

/// The commands that the scene prints run unchanged and reconstruct the object.
#[test]
fn commands_printed_by_the_scene_reconstruct_the_object() {
    let folder = tempfile::tempdir().expect("a folder");
    let result =
        planish(folder.path(), &["simulate", "scene", "contours", "--views", "21", "--out", "scene"]).ok();
    let commands: Vec<&str> =
        (result.stdout.lines()).filter_map(|line| line.strip_prefix("  planish ")).collect();
    assert_eq!(commands.len(), 4, "{}", result.stdout);
    let mut last = None;
    for command in commands {
        let mut args: Vec<&str> = command.split(' ').collect();
        args.push("--json");
        let found = planish(folder.path(), &args).ok().json();
        if args[..2] == ["sense", "contours"] {
            assert_eq!(found["patches"].as_array().map(Vec::len), Some(2), "{found:#}");
            assert!((found["chi2"].as_f64().expect("a number") - 1.0).abs() < 0.1, "{found:#}");
            let left_out: u64 = (found["left_out"].as_object().expect("causes").values())
                .map(|n| n.as_u64().expect("a count"))
                .sum();
            assert_eq!(
                found["observations"].as_u64().expect("a count") + left_out,
                found["contour_points"].as_u64().expect("a count")
            );
        }
        if args[0] == "merge" {
            assert_eq!(
                (&found["nonmanifold_edges"], found["patches"].as_array().map(Vec::len)),
                (&0.into(), Some(4)),
                "{found:#}"
            );
        }
        last = Some(found);
    }
    let compared = last.expect("a comparison");
    let rms = compared["forward"]["rms"].as_f64().expect("a number");
    assert!(rms < 0.1, "{compared:#}");
}

/// Missing data of a view are reported with the file and the view.
#[test]
fn insufficient_views_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |text: &str| std::fs::write(folder.path().join("views.toml"), text).expect("a file");
    let view = |k: i32| {
        format!(
            "[[view]]\nname = \"v{k}\"\nK = [[900, 0, 320], [0, 900, 240], [0, 0, 1]]\n\
             R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nt = [{k}, 0, 5]\n"
        )
    };
    write(&(0..3).map(view).collect::<String>());
    let result = planish(folder.path(), &["sense", "contours", "views.toml", "-o", "points.ply"]);
    assert!(
        result.stderr.contains("view `v0`") && result.stderr.contains("expected a mask"),
        "{}",
        result.stderr
    );
    let result = planish(folder.path(), &["sense", "contours", "views.toml", "-o", "points.las"]);
    assert!(result.stderr.contains(".ply"), "{}", result.stderr);
    std::fs::write(folder.path().join("few.csv"), "x,y\n1,2\n3,4\n").expect("a file");
    write(&(0..2).map(|k| view(k) + "contours = \"few.csv\"\n").collect::<String>());
    let result = planish(folder.path(), &["sense", "contours", "views.toml", "-o", "points.ply"]);
    assert!(result.stderr.contains("three views"), "{}", result.stderr);
    assert!(!folder.path().join("points.ply").exists());
}
