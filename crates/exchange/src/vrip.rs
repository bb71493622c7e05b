//! VRIP `.conf`: a list of scans with their poses, as in the Stanford 3D Scanning Repository.
//!
//! **Input.** Lines `bmesh FILE tx ty tz qx qy qz qw`, or with `mesh` in place of `bmesh`. Lines `camera …`,
//! `#` comments and blank lines are ignored.
//!
//! **Output.** The path of each file (relative paths start at the folder of the list) and its [`Pose`].
//!
//! The quaternion is the inverse of the usual convention: `p_world = R(q)ᵀ p + t`. With it, the Stanford
//! scans agree to 0.14 mm; with every other convention they differ by 3 mm or more (guarded by the test
//! `poses_align_the_scans` in `tests/bunny.rs`).
//!
//! **Limits.** The listed files are not opened here.

use planish_core::DVec3;
use std::path::{Path, PathBuf};

use planish_estimate::{Error, Result};
use planish_sense::Pose;

use crate::source::{no_file, parse_number, read_text, shown};

/// Tolerance of the length of a quaternion. It accepts rounded numbers and rejects columns in another order.
pub(crate) const QUATERNION_TOLERANCE: f64 = 1e-3;

/// A scan of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedScan {
    /// Path of the file.
    pub path: PathBuf,
    /// Pose: maps the frame of the scanner to the world.
    pub world_from_scanner: Pose,
    /// Line of the list, from 1.
    pub line: usize,
}

/// Reads a list of scans.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the list or a file that it names is missing,
/// [`Input`](planish_estimate::ErrorKind::Input) for a line of another form, a bad number, a quaternion that
/// has not unit length, or a list without scans: with file and line.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// std::fs::write(folder.path().join("a.xyz"), "1 2 3\n")?;
/// let path = folder.path().join("list.conf");
/// std::fs::write(&path, "bmesh a.xyz 10 20 30 0 0 0 1\n")?;
/// let scans = planish_exchange::vrip::read_conf(&path)?;
/// assert_eq!(scans[0].world_from_scanner.translation.to_array(), [10.0, 20.0, 30.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_conf(path: &Path) -> Result<Vec<ListedScan>> {
    let listed = read_text(path).and_then(|text| {
        let scans = parse(&text, path.parent().unwrap_or(Path::new("")))?;
        for scan in &scans {
            if !scan.path.is_file() {
                return Err(Error::io(format!(
                    "line {}: lists {}, which {}",
                    scan.line,
                    scan.path.display(),
                    no_file(&scan.path)
                )));
            }
        }
        Ok(scans)
    });
    listed.map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str, folder: &Path) -> Result<Vec<ListedScan>> {
    let mut scans = Vec::new();
    for (line, text) in (1..).zip(text.lines()) {
        let words: Vec<&str> = text.split_whitespace().collect();
        match words[..] {
            [] | ["camera", ..] => {}
            [first, ..] if first.starts_with('#') => {}
            // File names may contain blanks, so the numbers are the last seven words.
            ["bmesh" | "mesh", _, .., _, _, _, _, _, _, _] => {
                let (name, numbers) = words[1..].split_at(words.len() - 8);
                let mut values = [0.0; 7];
                for (value, word) in values.iter_mut().zip(numbers) {
                    *value = parse_number(word.as_bytes()).filter(|v| v.is_finite()).ok_or_else(|| {
                        Error::input(format!(
                            "line {line}: expected a finite number, found {}",
                            shown(word.as_bytes())
                        ))
                    })?;
                }
                let [tx, ty, tz, qx, qy, qz, qw] = values;
                // Checked below, because `Pose` normalises any length, and columns in another order would
                // pass unnoticed.
                let length = [qx, qy, qz, qw].iter().map(|c| c * c).sum::<f64>().sqrt();
                // The conjugate of a unit quaternion is its inverse.
                let pose = Pose::from_quaternion_xyzw([-qx, -qy, -qz, qw], DVec3::new(tx, ty, tz))
                    .filter(|_| (length - 1.0).abs() <= QUATERNION_TOLERANCE)
                    .ok_or_else(|| {
                        Error::input(format!(
                            "line {line}: expected a quaternion (the last four numbers) of length 1, found \
                             length {length}"
                        ))
                    })?;
                scans.push(ListedScan { path: folder.join(name.join(" ")), world_from_scanner: pose, line });
            }
            ["bmesh", ..] => {
                return Err(Error::input(format!(
                    "line {line}: expected `bmesh FILE tx ty tz qx qy qz qw`, found {} words after `bmesh`",
                    words.len() - 1
                )));
            }
            // Older lists have other numbers after `mesh`, whose meaning is not documented.
            ["mesh", ..] => {
                return Err(Error::input(format!(
                    "line {line}: expected `bmesh` or `mesh` with FILE tx ty tz qx qy qz qw, found {} words \
                     after `mesh`",
                    words.len() - 1
                )));
            }
            _ => {
                return Err(Error::input(format!(
                    "line {line}: expected `bmesh`, `mesh` or `camera`, found {}",
                    shown(text.as_bytes())
                )));
            }
        }
    }
    if scans.is_empty() {
        return Err(Error::input("expected lines `bmesh FILE tx ty tz qx qy qz qw`, found none"));
    }
    Ok(scans)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_estimate::ErrorKind;
    use proptest::prelude::*;

    fn message(text: &str) -> String {
        parse(text, Path::new("d")).unwrap_err().to_string()
    }

    #[test]
    fn the_quaternion_is_conjugated() {
        // The stated quarter turn about +z maps x to −y, because the quaternion is inverted.
        let h = 0.5_f64.sqrt();
        let text = format!("camera 1 2 3\r\n\r\n# a comment\nbmesh my scan.ply 10 20 30 0 0 {h} {h}\r\n");
        let scans = parse(&text, Path::new("d")).unwrap();
        assert_eq!((scans.len(), scans[0].line), (1, 4));
        assert_eq!(scans[0].path, Path::new("d/my scan.ply"));
        let p = scans[0].world_from_scanner.apply(DVec3::X);
        assert!(p.to_array().iter().zip([10.0, 19.0, 30.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{p:?}");
    }

    #[test]
    fn mesh_lines_are_scans_like_bmesh_lines() {
        let numbers = "10 20 30 0 0 0.6 0.8";
        let list = |words: [&str; 2]| {
            let text = words.map(|word| format!("{word} a {word}.ply {numbers}\n")).concat();
            parse(&text, Path::new("d")).unwrap()
        };
        let scans = list(["mesh", "bmesh"]);
        assert_eq!(
            (&*scans[0].path, &*scans[1].path),
            (Path::new("d/a mesh.ply"), Path::new("d/a bmesh.ply"))
        );
        assert_eq!(scans[0].world_from_scanner, scans[1].world_from_scanner);
        assert!(message("mesh a.ply 1 2 3 90\n").contains("line 1: expected `bmesh` or `mesh` with FILE"));
        assert!(message("mesh a.ply 0 0 0 0 0 0 2\n").contains("found length 2"));
        assert!(message("meshes a.ply 0 0 0 0 0 0 1\n").contains("expected `bmesh`, `mesh` or `camera`"));
    }

    #[test]
    fn errors_name_the_line() {
        assert!(message("camera 0\nbmesh a.ply 0 0 0 0 0 0 0\n").contains("line 2: expected a quaternion"));
        assert!(message("bmesh a.ply 0 0 0 0 0 0 2\n").contains("found length 2"));
        assert!(
            message("bmesh a.ply 0 0 x 0 0 0 1\n").contains("line 1: expected a finite number, found `x`")
        );
        assert!(message("bmesh a.ply 0 0 nan 0 0 0 1\n").contains("found `nan`"));
        assert!(message("bmesh a.ply 0 0\n").contains("found 3 words"));
        assert!(message("\nmesh a.ply\n").contains("line 2: expected `bmesh`"));
        assert!(message("camera 0 0 0\n").contains("qw`, found none"));
    }

    #[test]
    fn a_missing_file_is_an_io_error_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.conf");
        std::fs::write(&path, "\nbmesh gone.ply 0 0 0 0 0 0 1\n").unwrap();
        let e = read_conf(&path).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Io);
        assert!(e.to_string().contains("line 2") && e.to_string().contains("gone.ply"), "{e}");
    }

    proptest! {
        #[test]
        fn no_text_causes_a_panic(text in "(bmesh|mesh|camera|[a-z0-9 .\n-]){0,60}") {
            let _ = parse(&text, Path::new("d"));
        }
    }
}
