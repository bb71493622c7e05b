//! Reads poses of a mesh for `planish shell pose`: displacements of control points, and keyframes.
//!
//! **Input.** A TOML file.
//!
//! **Output.** A [`PoseFile`].
//!
//! **Limits.** Indices of control points and names of parts are checked later, against the mesh.
//!
//! ```toml
//! controls = 60                       # number, placed on the mesh; or a list of positions [[x, y, z], ...]
//! blend = 2.0                         # length over which rigid parts blend into the rest
//! [[rigid]]
//! part = "head"                       # a group, object or material of the OBJ, or a file of vertex indices
//! motion = "follow"                   # or "held"
//! [[pose]]
//! name = "up"
//! move = [
//!     { near = [1, 0, 2], by = [0, 3, 0] },
//!     { control = 7, by = [0, 3, 0] },
//!     { near = [0, 0, 0], within = 6, by = [0, 3, 0] },
//! ]
//! [[keyframe]]
//! seconds = 1.5
//! weights = { "up" = 1 }              # other poses have weight 0
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use planish_estimate::{Error, Result};
use serde::Deserialize;

use crate::calibration::table;
use crate::source::read_text;

/// Maximum number of control points, which bounds the time and memory of a deformation.
const MAX_CONTROLS: usize = 20_000;

/// Control points of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub enum ControlsEntry {
    /// The default number.
    Default,
    /// A number of points, placed on the mesh.
    Count(usize),
    /// Given positions.
    Points(Vec<[f64; 3]>),
}

/// A rigid part of a mesh.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigidEntry {
    /// Name of the part.
    pub part: String,
    /// True if the part stays in place; false if it follows the control points around it.
    pub held: bool,
}

/// Selection of control points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PoseTarget {
    /// The control point with this index.
    Control(usize),
    /// The control point nearest to a position.
    Nearest([f64; 3]),
    /// All control points within a distance of a position.
    Within([f64; 3], f64),
}

/// A displacement of control points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoveEntry {
    /// Control points that are moved.
    pub target: PoseTarget,
    /// Displacement.
    pub by: [f64; 3],
}

/// A pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseEntry {
    /// Unique name.
    pub name: String,
    /// Displacements.
    pub moves: Vec<MoveEntry>,
}

/// Weights of all poses at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyframeEntry {
    /// Time in seconds.
    pub seconds: f64,
    /// One weight per pose.
    pub weights: Vec<f64>,
}

/// Content of a file of poses.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseFile {
    /// Control points.
    pub controls: ControlsEntry,
    /// Length over which rigid parts blend into the rest.
    pub blend: Option<f64>,
    /// Rigid parts.
    pub rigid: Vec<RigidEntry>,
    /// Poses, at least one.
    pub poses: Vec<PoseEntry>,
    /// Keyframes in order of time.
    pub keyframes: Vec<KeyframeEntry>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum ControlsTable {
    Count(usize),
    Points(Vec<[f64; 3]>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    controls: Option<ControlsTable>,
    blend: Option<f64>,
    #[serde(default)]
    rigid: Vec<RigidTable>,
    #[serde(default)]
    pose: Vec<PoseTable>,
    #[serde(default)]
    keyframe: Vec<KeyframeTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RigidTable {
    part: String,
    motion: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseTable {
    name: String,
    #[serde(rename = "move")]
    moves: Vec<MoveTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MoveTable {
    control: Option<usize>,
    near: Option<[f64; 3]>,
    within: Option<f64>,
    by: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyframeTable {
    seconds: f64,
    weights: BTreeMap<String, f64>,
}

/// Reads poses.
///
/// # Errors
/// `Io` if the file cannot be read; `Input` for unknown keys, numbers that are not finite, two poses of one
/// name, and keyframes that are not in order of time or name unknown poses: with the pose or keyframe.
///
/// # Examples
/// ```
/// use planish_exchange::poses::{PoseTarget, read_poses};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("poses.toml");
/// std::fs::write(&path, "[[pose]]\nname = \"up\"\nmove = [{ control = 7, by = [0, 3, 0] }]\n")?;
/// let pose = &read_poses(&path)?.poses[0];
/// assert_eq!((pose.moves[0].target, pose.moves[0].by), (PoseTarget::Control(7), [0.0, 3.0, 0.0]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_poses(path: &Path) -> Result<PoseFile> {
    let read = || parse(&read_text(path)?);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<PoseFile> {
    let t: Table = table(
        text,
        "expected [[pose]] with name and move = [{ near or control, by }], and optionally controls, blend, \
         [[rigid]] with part and motion, and [[keyframe]] with seconds and weights",
    )?;
    let finite = |p: &[f64; 3]| p.iter().all(|x| x.is_finite());
    let controls = match t.controls {
        None => ControlsEntry::Default,
        Some(ControlsTable::Count(count)) if (1..=MAX_CONTROLS).contains(&count) => {
            ControlsEntry::Count(count)
        }
        Some(ControlsTable::Points(points))
            if (1..=MAX_CONTROLS).contains(&points.len()) && points.iter().all(finite) =>
        {
            ControlsEntry::Points(points)
        }
        Some(_) => {
            return Err(Error::input(format!("expected 1 to {MAX_CONTROLS} controls at finite positions")));
        }
    };
    // 0 is valid: rigid parts then end without a transition.
    if let Some(blend) = t.blend.filter(|b| !(b.is_finite() && *b >= 0.0)) {
        return Err(Error::input(format!("expected a length of at least 0 for blend, found {blend}")));
    }
    let rigid = (t.rigid.into_iter())
        .map(|entry| match entry.motion.as_deref() {
            None | Some("follow") => Ok(RigidEntry { part: entry.part, held: false }),
            Some("held") => Ok(RigidEntry { part: entry.part, held: true }),
            Some(other) => Err(Error::input(format!(
                "rigid part `{}`: expected motion \"follow\" or \"held\", found \"{other}\"",
                entry.part
            ))),
        })
        .collect::<Result<Vec<_>>>()?;
    if t.pose.is_empty() {
        return Err(Error::input("expected at least one [[pose]], found none"));
    }
    let mut poses: Vec<PoseEntry> = Vec::new();
    for pose in t.pose {
        // Keyframes refer to poses by name.
        if poses.iter().any(|other| other.name == pose.name) {
            return Err(Error::input(format!(
                "expected poses of different names, found two named `{}`",
                pose.name
            )));
        }
        let moves = (pose.moves.iter())
            .map(one_move)
            .collect::<Result<Vec<_>>>()
            .map_err(|e| e.in_context(format!("pose `{}`", pose.name)))?;
        poses.push(PoseEntry { name: pose.name, moves });
    }
    let mut keyframes: Vec<KeyframeEntry> = Vec::new();
    for (index, frame) in t.keyframe.into_iter().enumerate() {
        let wrong = |what: String| Error::input(format!("keyframe {}: {what}", index + 1));
        let after = keyframes.last().map_or(f64::NEG_INFINITY, |last| last.seconds);
        // Times of a glTF animation must increase strictly.
        if !(frame.seconds.is_finite() && frame.seconds >= 0.0 && frame.seconds > after) {
            return Err(wrong(format!(
                "expected seconds of at least 0 and after {after}, found {}",
                frame.seconds
            )));
        }
        // Poses that a keyframe does not name have weight 0.
        let mut weights = vec![0.0; poses.len()];
        for (name, weight) in frame.weights {
            let Some(at) = poses.iter().position(|pose| pose.name == name) else {
                return Err(wrong(format!("expected the name of a pose, found `{name}`")));
            };
            if !weight.is_finite() {
                return Err(wrong(format!("expected a finite weight of `{name}`, found {weight}")));
            }
            weights[at] = weight;
        }
        keyframes.push(KeyframeEntry { seconds: frame.seconds, weights });
    }
    Ok(PoseFile { controls, blend: t.blend, rigid, poses, keyframes })
}

fn one_move(entry: &MoveTable) -> Result<MoveEntry> {
    let finite = |p: [f64; 3]| p.iter().all(|x| x.is_finite());
    let target = match (entry.control, entry.near, entry.within) {
        (Some(index), None, None) => PoseTarget::Control(index),
        (None, Some(at), None) if finite(at) => PoseTarget::Nearest(at),
        (None, Some(at), Some(reach)) if finite(at) && reach.is_finite() && reach > 0.0 => {
            PoseTarget::Within(at, reach)
        }
        _ => {
            return Err(Error::input(
                "expected moves with control = INDEX, or near = [x, y, z] and optionally within = LENGTH, \
                 and by = [x, y, z]",
            ));
        }
    };
    if !finite(entry.by) {
        return Err(Error::input(format!("expected a finite displacement, found {:?}", entry.by)));
    }
    Ok(MoveEntry { target, by: entry.by })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "controls = 12
blend = 1.5
[[rigid]]
part = \"head\"
motion = \"held\"
[[pose]]
name = \"up\"
move = [{ near = [1, 0, 2], by = [0, 3, 0] }, { control = 7, by = [0, 3, 0] }, { near = [0, 0, 0], within = \
6, by = [0, 3, 0] }]
[[pose]]
name = \"down\"
move = []
[[keyframe]]
seconds = 0
weights = {}
[[keyframe]]
seconds = 1.5
weights = { down = 0.5 }
";

    #[test]
    fn poses_and_keyframes_are_read() {
        let found = parse(GOOD).unwrap();
        assert_eq!(found.controls, ControlsEntry::Count(12));
        assert!(found.rigid[0].held);
        assert_eq!(found.poses[0].moves[2].target, PoseTarget::Within([0.0; 3], 6.0));
        assert_eq!(found.keyframes[1].weights, [0.0, 0.5]);
        let points = parse(&GOOD.replace("controls = 12", "controls = [[0, 0, 0], [1, 2, 3]]")).unwrap();
        assert_eq!(points.controls, ControlsEntry::Points(vec![[0.0; 3], [1.0, 2.0, 3.0]]));
    }

    #[test]
    fn errors_name_line_pose_or_keyframe() {
        let with = |from: &str, to: &str| {
            assert!(GOOD.contains(from), "{from}");
            parse(&GOOD.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert!(with("blend", "blends").contains("line 2"));
        assert!(with("controls = 12", "controls = 0").contains("expected 1 to"));
        assert!(with("\"held\"", "\"fixed\"").contains("found \"fixed\""));
        assert!(with("control = 7, ", "").contains("pose `up`: expected moves"));
        assert!(with("\"down\"", "\"up\"").contains("two named `up`"));
        assert!(with("seconds = 1.5", "seconds = 0").contains("keyframe 2"));
        assert!(
            with("down = 0.5", "left = 0.5")
                .contains("keyframe 2: expected the name of a pose, found `left`")
        );
        assert!(parse("controls = 3").unwrap_err().to_string().contains("at least one [[pose]]"));
    }
}
