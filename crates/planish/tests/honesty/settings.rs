//! Settings of a run, from the environment.

use planish_core::DVec3;
use planish_exchange::ScanSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What of the table is run.
#[derive(Debug, Clone)]
pub struct TableSettings {
    /// Parts of names of cells; empty for all.
    pub cells: Vec<String>,
    pub seeds: std::ops::Range<u64>,
    /// Number of readings of cells that do not fix it.
    pub readings: usize,
    pub time_limit: Duration,
    pub csv: Option<PathBuf>,
    pub readings_folder: Option<PathBuf>,
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{name}: {e}")))
}

impl TableSettings {
    pub fn from_environment() -> Self {
        let first = number("PLANISH_HONESTY_FIRST", 0);
        let path = |name| std::env::var_os(name).map(PathBuf::from);
        Self {
            cells: std::env::var("PLANISH_HONESTY_CELLS")
                .map(|text| text.split(',').map(|part| part.trim().to_owned()).collect())
                .unwrap_or_default(),
            seeds: first..first + number("PLANISH_HONESTY_SEEDS", 200),
            readings: number("PLANISH_HONESTY_READINGS", 3000) as usize,
            time_limit: Duration::from_secs(number("PLANISH_HONESTY_SECONDS", 300)),
            csv: path("PLANISH_HONESTY_CSV"),
            readings_folder: path("PLANISH_HONESTY_READINGS_FOLDER"),
        }
    }

    pub fn selects(&self, cell: &str) -> bool {
        self.cells.is_empty() || self.cells.iter().any(|part| cell.contains(part.as_str()))
    }
}

/// Writes the readings of a set as a PLY file that `planish fit` reads.
pub fn write_readings(folder: &Path, name: &str, set: &ScanSet) {
    let scan = &set.scans[0].scan;
    let stated = set.sensors[0].noise.map(|noise| vec![noise.sigma(); scan.points.len()]);
    let sigma = scan.sigma.clone().or(stated);
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", scan.points.len());
    let columns = [("x y z", true), ("nx ny nz", scan.normals.is_some()), ("sigma", sigma.is_some())];
    for column in columns.iter().filter(|(_, is_present)| *is_present).flat_map(|(n, _)| n.split(' ')) {
        writeln!(text, "property double {column}").unwrap();
    }
    text += "end_header\n";
    for (i, p) in scan.points.iter().enumerate() {
        let vector = |v: DVec3| format!("{} {} {}", v.x, v.y, v.z);
        let normal = scan.normals.as_ref().map(|n| vector(n[i]));
        let sigma = sigma.as_ref().map(|s| s[i].to_string());
        let row: Vec<String> = [Some(vector(*p)), normal, sigma].into_iter().flatten().collect();
        writeln!(text, "{}", row.join(" ")).unwrap();
    }
    std::fs::create_dir_all(folder).unwrap();
    std::fs::write(folder.join(format!("{}.ply", name.replace(' ', "_"))), text).unwrap();
}
