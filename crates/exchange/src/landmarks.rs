//! Landmarks: places of a mesh whose positions were measured.
//!
//! In: a CSV file with a header. `x`, `y` and `z` are the measured position. The place is a vertex, counted
//! from zero, or a position near the surface of the mesh:
//!
//! ```csv
//! name,mesh_x,mesh_y,mesh_z,x,y,z,sigma
//! nose,0.0,12.5,40.1,1.2,13.0,41.7,0.5
//! ```
//!
//! ```csv
//! vertex,x,y,z
//! 1207,1.2,13.0,41.7
//! ```
//!
//! `sigma` is the σ of the position along each axis. It and `name` are optional.

use crate::columns::{number, read_columns};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use std::path::Path;

const COLUMNS: [&str; 9] = ["x", "y", "z", "vertex", "mesh_x", "mesh_y", "mesh_z", "sigma", "name"];

/// A place of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LandmarkPlace {
    /// A vertex, counted from zero.
    Vertex(u32),
    /// The point of the surface nearest to a position.
    Near(DVec3),
}

/// A place of a mesh and its measured position.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// Its name, or `line N` without one.
    pub name: String,
    /// The place on the mesh.
    pub place: LandmarkPlace,
    /// The measured position of this place.
    pub at: DVec3,
    /// σ of the position along each axis, if stated.
    pub sigma: Option<f64>,
}

/// Reads landmarks.
///
/// # Errors
/// `Io` for a file that cannot be read; `Input` for a missing column, a word that is no finite number, a σ
/// that is not positive, or no landmark: with file and line.
pub fn read_landmarks(path: &Path) -> Result<Vec<Landmark>> {
    let rows = read_columns(path, &COLUMNS, 3)?;
    let landmarks: Result<Vec<Landmark>> = rows.iter().map(|(line, words)| landmark(*line, words)).collect();
    match landmarks {
        Ok(found) if found.is_empty() => {
            Err(Error::input(format!("{}: expected landmarks, found none", path.display())))
        }
        found => found.map_err(|e| e.in_context(path.display())),
    }
}

fn landmark(line: u64, words: &[Option<String>]) -> Result<Landmark> {
    let at = |k: usize| number(line, words[k].as_deref(), 0.0, false);
    let vector = |first: usize| Ok(DVec3::new(at(first)?, at(first + 1)?, at(first + 2)?));
    let place = match (&words[3], &words[4..7]) {
        (Some(word), _) => LandmarkPlace::Vertex(word.parse().map_err(|_| {
            Error::input(format!("line {line}: expected the number of a vertex from 0, found `{word}`"))
        })?),
        (None, [Some(_), Some(_), Some(_)]) => LandmarkPlace::Near(vector(4)?),
        _ => {
            return Err(Error::input(
                "expected a header with the columns vertex or mesh_x,mesh_y,mesh_z in addition to x,y,z",
            ));
        }
    };
    Ok(Landmark {
        name: words[8].clone().unwrap_or_else(|| format!("line {line}")),
        place,
        at: vector(0)?,
        sigma: words[7].as_ref().map(|word| number(line, Some(word), 0.0, true)).transpose()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Landmark>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("landmarks.csv");
        std::fs::write(&path, text).unwrap();
        read_landmarks(&path)
    }

    #[test]
    fn landmarks_are_read_by_the_names_of_columns() {
        let found = read("name,sigma,x,y,z,mesh_x,mesh_y,mesh_z\n# comment\nnose,0.5,1,2,3,4,5,6\n").unwrap();
        let place = LandmarkPlace::Near(DVec3::new(4.0, 5.0, 6.0));
        let nose =
            Landmark { name: "nose".to_owned(), place, at: DVec3::new(1.0, 2.0, 3.0), sigma: Some(0.5) };
        assert_eq!(found, [nose]);
        let found = read("vertex,x,y,z\n7,1,2,3\n").unwrap();
        assert_eq!((found[0].place, found[0].sigma), (LandmarkPlace::Vertex(7), None));
        assert_eq!(found[0].name, "line 2");
    }

    #[test]
    fn errors_name_the_line() {
        for (text, expected) in [
            ("vertex,x,y,z\n-1,1,2,3\n", "line 2: expected the number of a vertex"),
            ("vertex,x,y,z\n1,1,nan,3\n", "line 2: expected a finite number"),
            ("vertex,x,y,z,sigma\n1,1,2,3,0\n", "line 2: expected a finite positive number"),
            ("x,y,z\n1,2,3\n", "vertex or mesh_x"),
            ("vertex,x,y,z\n", "found none"),
            ("vertex,x,y\n1,2,3\n", "line 1: expected a header with x,y,z"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
