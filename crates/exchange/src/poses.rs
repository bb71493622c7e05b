//! Poses of a mesh: how its controls are moved, and when. The format is that of `planish shell pose`.
//!
//! Comes in: TOML. Goes out: a [`PoseFile`], checked but for what only the mesh can tell.
//!
//! ```toml
//! controls = 60                       # chosen on the mesh; or a list of places [[x, y, z], ...]
//! blend = 2.0                         # over which length rigid parts fade into the rest
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
//! weights = { "up" = 1 }              # poses that are not named have weight 0
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use planish_estimate::{Error, Result};
use serde::Deserialize;

use crate::calibration::table;
use crate::source::read_text;

/// Most controls of a mesh.
const MAX_CONTROLS: usize = 20_000;

/// The controls of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub enum ControlsEntry {
    /// As many as is usual.
    Usual,
    /// So many, chosen on the mesh.
    Count(usize),
    /// These.
    Points(Vec<[f64; 3]>),
}

/// A part that stays rigid.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigidEntry {
    /// Its name.
    pub part: String,
    /// Whether it stays where it is, and does not follow the controls around it.
    pub held: bool,
}

/// Which controls are moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PoseTarget {
    /// The control of this index.
    Control(usize),
    /// The one nearest to a place.
    Nearest([f64; 3]),
    /// All within a length of a place.
    Within([f64; 3], f64),
}

/// Controls that are moved, and by how much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoveEntry {
    /// Which.
    pub target: PoseTarget,
    /// By how much.
    pub by: [f64; 3],
}

/// A pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseEntry {
    /// Its name, of which there is no other.
    pub name: String,
    /// What is moved.
    pub moves: Vec<MoveEntry>,
}

/// How much of each pose there is at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyframeEntry {
    /// When.
    pub seconds: f64,
    /// One weight for each pose.
    pub weights: Vec<f64>,
}

/// What a file of poses holds.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseFile {
    /// Controls.
    pub controls: ControlsEntry,
    /// Over which length rigid parts fade into the rest.
    pub blend: Option<f64>,
    /// Rigid parts.
    pub rigid: Vec<RigidEntry>,
    /// Poses, at least one.
    pub poses: Vec<PoseEntry>,
    /// Keyframes, in the order of their times.
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
/// `Io` where the file cannot be read; `Input` for keys that are not known, numbers that are not finite, two
/// poses of one name, keyframes that do not follow each other or name poses that are not there: with the pose
/// or keyframe.
pub fn read_poses(path: &Path) -> Result<PoseFile> {
    let read = || parse(&read_text(path)?);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<PoseFile> {
    let t: Table = table(
        text,
        "poses need [[pose]] with name and move = [{ near or control, by }], and may have controls, blend, \
         [[rigid]] with part and motion, and [[keyframe]] with seconds and weights",
    )?;
    let finite = |p: &[f64; 3]| p.iter().all(|x| x.is_finite());
    let controls = match t.controls {
        None => ControlsEntry::Usual,
        Some(ControlsTable::Count(count)) if (1..=MAX_CONTROLS).contains(&count) => {
            ControlsEntry::Count(count)
        }
        Some(ControlsTable::Points(points))
            if (1..=MAX_CONTROLS).contains(&points.len()) && points.iter().all(finite) =>
        {
            ControlsEntry::Points(points)
        }
        Some(_) => {
            return Err(Error::input(format!(
                "expected controls between 1 and {MAX_CONTROLS}, at finite places"
            )));
        }
    };
    if let Some(blend) = t.blend.filter(|b| !(b.is_finite() && *b >= 0.0)) {
        return Err(Error::input(format!("expected a length for blend, found {blend}")));
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
        return Err(Error::input("expected at least one [[pose]]"));
    }
    let mut poses: Vec<PoseEntry> = Vec::new();
    for pose in t.pose {
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
        if !(frame.seconds.is_finite() && frame.seconds >= 0.0 && frame.seconds > after) {
            return Err(wrong(format!(
                "expected seconds from 0 on and after {after}, found {}",
                frame.seconds
            )));
        }
        let mut weights = vec![0.0; poses.len()];
        for (name, weight) in frame.weights {
            let Some(at) = poses.iter().position(|pose| pose.name == name) else {
                return Err(wrong(format!("there is no pose named `{name}`")));
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
                "a move needs control = INDEX, or near = [x, y, z] and maybe within = LENGTH, and by = [x, \
                 y, z]",
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
    fn mistakes_are_named() {
        let with = |from: &str, to: &str| {
            assert!(GOOD.contains(from), "{from}");
            parse(&GOOD.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert!(with("blend", "blends").contains("line 2"));
        assert!(with("controls = 12", "controls = 0").contains("between 1 and"));
        assert!(with("\"held\"", "\"fixed\"").contains("found \"fixed\""));
        assert!(with("control = 7, ", "").contains("pose `up`: a move needs"));
        assert!(with("\"down\"", "\"up\"").contains("two named `up`"));
        assert!(with("seconds = 1.5", "seconds = 0").contains("keyframe 2"));
        assert!(with("down = 0.5", "left = 0.5").contains("keyframe 2: there is no pose named `left`"));
        assert!(parse("controls = 3").unwrap_err().to_string().contains("at least one [[pose]]"));
    }
}
