//! The table of honesty: objects with a known true surface × defects of the readings.
//!
//! Every fit must end in one of two ways: σ is true where the model says that it measured, and large enough
//! elsewhere; or the fit is refused with the right reason. The readings come from generators of these tests
//! ([`truth`], [`readings`]), not from `planish::simulate`, so that the two do not share a mistake.
//!
//! ```text
//! cargo test --release -p planish --test honesty                            # few cells and seeds
//! cargo test --release -p planish --test honesty -- --ignored --nocapture   # the whole table
//! ```
//!
//! Variables of the environment select a part of the whole table:
//!
//! | variable | meaning | default |
//! |---|---|---|
//! | `PLANISH_HONESTY_CELLS` | names of cells or parts of them, with commas: `ball clean,torus` | all |
//! | `PLANISH_HONESTY_SEEDS` | number of seeds of each cell | 200 |
//! | `PLANISH_HONESTY_FIRST` | first seed | 0 |
//! | `PLANISH_HONESTY_READINGS` | number of readings of cells that do not fix it | 3000 |
//! | `PLANISH_HONESTY_SECONDS` | time limit of a fit | 300 |
//! | `PLANISH_HONESTY_CSV` | file for one line per fit; fits that it holds already are not repeated | none |
//! | `PLANISH_HONESTY_READINGS_FOLDER` | folder for the readings of each fit, as PLY files | none |

// Helpers of tests may unwrap and print as tests do.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod cells;
mod measure;
mod readings;
mod settings;
mod solids;
mod table;
mod topology;
mod truth;

use cells::Cell;
use readings::Condition;
use settings::TableSettings;
use std::time::Duration;
use table::{assert_cells_hold, run_table};
use truth::Topology;

/// Cells that run with every test: quick ones of each kind of outcome.
const QUICK: [(Topology, Condition); 10] = [
    (Topology::Sheet, Condition::Clean),
    (Topology::Sheet, Condition::UniformOutliers(15)),
    (Topology::Sheet, Condition::OneSidedOutliers(30)),
    (Topology::Sheet, Condition::TwoLayers),
    (Topology::Sheet, Condition::Readings(12)),
    (Topology::Sheet, Condition::Hole),
    (Topology::Tube, Condition::Clean),
    (Topology::Ball, Condition::Clean),
    (Topology::Ball, Condition::UniformOutliers(5)),
    (Topology::Torus, Condition::Clean),
];

#[test]
fn quick_cells_are_honest() {
    let settings = TableSettings {
        cells: Vec::new(),
        seeds: 0..2,
        readings: 800,
        time_limit: Duration::from_secs(60),
        csv: None,
        readings_folder: None,
    };
    let cells = QUICK.map(|(topology, condition)| Cell { topology, condition });
    assert_cells_hold(&run_table(&settings, &cells));
}

#[test]
#[ignore = "two hundred fits of each of 88 cells: run by `just nightly`"]
fn every_cell_is_honest() {
    let settings = TableSettings::from_environment();
    let cells: Vec<Cell> = Cell::all().filter(|cell| settings.selects(&cell.name())).collect();
    assert_cells_hold(&run_table(&settings, &cells));
}
