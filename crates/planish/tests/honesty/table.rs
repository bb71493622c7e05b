//! The table: runs cells, keeps a line per fit, and judges each cell by its means.

use crate::cells::Cell;
use crate::measure::{Measures, Outcome};
use crate::settings::TableSettings;
use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

/// Cells that do not hold yet. Remove a line when its cell holds; add none.
const FAILING: &[&str] = &[];

/// Standard deviation of the coverage of one seed that is assumed at least. With few seeds the sample's own
/// is no estimate.
const MIN_COVERAGE_DEVIATION: f64 = 0.05;

/// What remains of one fit.
#[derive(Debug, Clone)]
struct Entry {
    outcome: Outcome,
    defect: Option<String>,
}

/// The figures of a cell.
#[derive(Debug, Default)]
struct Judgement {
    line: String,
    failures: Vec<String>,
}

/// Runs the selected cells, seed after seed, prints progress, and returns the failures of each cell.
pub fn run_table(settings: &TableSettings, cells: &[Cell]) -> BTreeMap<String, Vec<String>> {
    let done = settings.csv.as_deref().map(read_done).unwrap_or_default();
    let mut entries: HashMap<String, Vec<Entry>> = HashMap::new();
    let started = Instant::now();
    let total = cells.len() as u64 * (settings.seeds.end - settings.seeds.start);
    let mut count = 0_u64;
    // Seeds outside, so that a partial run has figures of every cell.
    for seed in settings.seeds.clone() {
        for cell in cells {
            count += 1;
            let key = (cell.name(), seed, cell.readings(settings.readings));
            let entry_of = |outcome: Outcome| Entry { defect: cell.defect(&outcome), outcome };
            let entry = done.get(&key).cloned().map(entry_of).unwrap_or_else(|| {
                let start = Instant::now();
                let entry = entry_of(cell.run(seed, settings));
                let seconds = start.elapsed().as_secs_f64();
                if let Some(csv) = &settings.csv {
                    append(csv, &key, &entry, seconds);
                }
                let summary = summary(&entry);
                let all = started.elapsed().as_secs();
                println!("[{count}/{total}, {all} s] {} seed {seed} ({seconds:.1} s): {summary}", key.0);
                entry
            });
            entries.entry(key.0).or_default().push(entry);
        }
    }
    println!(
        "\n{:28} fits refused defects | cover 1    cover 0,2   rms/σ   error/noise | marked 0    1    2    3 \
         | missed",
        "cell"
    );
    let mut failures = BTreeMap::new();
    for cell in cells {
        let judgement = judge(cell, &entries[&cell.name()]);
        println!("{}", judgement.line);
        failures.insert(cell.name(), judgement.failures);
    }
    let held = failures.values().filter(|f| f.is_empty()).count();
    println!("{held} of {} cells hold", cells.len());
    failures
}

/// Asserts that every cell holds that is not listed as failing.
pub fn assert_cells_hold(failures: &BTreeMap<String, Vec<String>>) {
    let broken: Vec<String> = (failures.iter())
        .filter(|(name, failures)| !failures.is_empty() && !FAILING.contains(&name.as_str()))
        .map(|(name, failures)| format!("{name}: {}", failures.join("; ")))
        .collect();
    assert!(broken.is_empty(), "cells that do not hold:\n{}", broken.join("\n"));
}

fn summary(entry: &Entry) -> String {
    let text = match &entry.outcome {
        Outcome::Fitted(m) => format!(
            "{}, covered {:.3} and {:.3}, rms/σ {:.2}, marked {:.2?}",
            m.shape, m.coverage_measured, m.coverage_unmeasured, m.rms_normalised, m.shares
        ),
        Outcome::Refused(text) => format!("refused: {text}"),
        Outcome::Failed(_) => String::new(),
    };
    entry.defect.as_ref().map_or(text.clone(), |defect| format!("{text} ✗ {defect}"))
}

/// Mean and its standard error.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance.sqrt().max(MIN_COVERAGE_DEVIATION) / n.sqrt())
}

/// Judges a cell: every outcome is honest, and the mean coverages are in their bands.
fn judge(cell: &Cell, entries: &[Entry]) -> Judgement {
    let fits: Vec<&Measures> = (entries.iter())
        .filter_map(|entry| if let Outcome::Fitted(found) = &entry.outcome { Some(found) } else { None })
        .collect();
    let refused = entries.iter().filter(|e| matches!(e.outcome, Outcome::Refused(_))).count();
    let defects: Vec<&str> = entries.iter().filter_map(|e| e.defect.as_deref()).collect();
    let mut failures = Vec::new();
    if let Some(first) = defects.first() {
        failures.push(format!("{} of {}: {first}", defects.len(), entries.len()));
    }
    let values = |value: fn(&Measures) -> f64| -> Vec<f64> {
        fits.iter().map(|m| value(m)).filter(|v| v.is_finite()).collect()
    };
    let measured = values(|m| m.coverage_measured);
    let unmeasured = values(|m| m.coverage_unmeasured);
    // Two standard errors: of the means of eighty-eight honest cells, four are farther off on either side.
    let (mean, error) = mean_and_error(&measured);
    let [low, high] = cell.coverage_band();
    if mean < low - 2.0 * error || mean > high + 2.0 * error {
        failures.push(format!("coverage {mean:.3} ± {error:.3} where measured"));
    }
    let (mean_unmeasured, error_unmeasured) = mean_and_error(&unmeasured);
    if mean_unmeasured < 0.9 - 2.0 * error_unmeasured {
        failures.push(format!("coverage {mean_unmeasured:.3} ± {error_unmeasured:.3} where not measured"));
    }
    let average = |value: fn(&Measures) -> f64| mean_and_error(&values(value)).0;
    let mut line = format!(
        "{:28} {:4} {refused:7} {:7} | {mean:.3} ±{error:.3} {mean_unmeasured:.3} ±{error_unmeasured:.3} \
         {:7.2} {:9.3} | {:.2} {:.2} {:.2} {:.2} | {:.2}",
        cell.name(),
        fits.len(),
        defects.len(),
        average(|m| m.rms_normalised),
        average(|m| m.rms),
        average(|m| m.shares[0]),
        average(|m| m.shares[1]),
        average(|m| m.shares[2]),
        average(|m| m.shares[3]),
        average(|m| m.missed),
    );
    if !failures.is_empty() {
        write!(line, " ✗ {}", failures.join("; ")).unwrap();
    }
    Judgement { line, failures }
}

type Key = (String, u64, usize);

const COLUMNS: &str = "cell\tseed\treadings\toutcome\tshape\tshare0\tshare1\tshare2\tshare3\tcoverage1\t\
    coverage02\trms_normalised\trms\toverhang\tmissed\tblames\tseconds\tdefect\tmessage";

/// Appends a line, so that an interrupted run loses one fit at most. Texts contain commas: columns are
/// separated by tabs.
fn append(path: &Path, (cell, seed, readings): &Key, entry: &Entry, seconds: f64) {
    let is_new = path.metadata().map_or(true, |file| file.len() == 0);
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path).unwrap();
    let (kind, found, message) = match &entry.outcome {
        Outcome::Fitted(m) => ("fitted", m.clone(), m.texts.join(" | ")),
        Outcome::Refused(text) => ("refused", Measures::default(), text.clone()),
        Outcome::Failed(text) => ("failed", Measures::default(), text.clone()),
    };
    let clean = |text: &str| text.replace(['\t', '\n'], " ");
    let Measures { shares: [s0, s1, s2, s3], coverage_measured, coverage_unmeasured, .. } = found;
    let line = format!(
        "{cell}\t{seed}\t{readings}\t{kind}\t{}\t{s0:.4}\t{s1:.4}\t{s2:.4}\t{s3:.4}\t{coverage_measured:.4}\t\
         {coverage_unmeasured:.4}\t{:.4}\t{:.4}\t{:.4}\t{:.4}\t{}\t{seconds:.2}\t{}\t{}\n",
        found.shape,
        found.rms_normalised,
        found.rms,
        found.overhang,
        found.missed,
        found.blames_sensor,
        clean(entry.defect.as_deref().unwrap_or("")),
        clean(&message)
    );
    let head = if is_new { format!("{COLUMNS}\n") } else { String::new() };
    file.write_all((head + &line).as_bytes()).unwrap();
}

/// The fits that a file of an earlier run holds. A line that was cut off by an interruption is removed.
fn read_done(path: &Path) -> HashMap<Key, Outcome> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let complete = text.rfind('\n').map_or("", |end| &text[..=end]);
    if complete.len() < text.len() {
        std::fs::write(path, complete).unwrap();
    }
    complete.lines().skip(1).filter_map(parse_line).collect()
}

fn parse_line(line: &str) -> Option<(Key, Outcome)> {
    let columns: Vec<&str> = line.split('\t').collect();
    let [cell, seed, readings, kind, shape] = columns.get(..5)?.try_into().ok()?;
    let number = |k: usize| columns.get(k).and_then(|text| text.parse::<f64>().ok());
    let message = columns.get(18)?.to_string();
    let outcome = match kind {
        "fitted" => Outcome::Fitted(Measures {
            shape: shape.to_owned(),
            shares: [number(5)?, number(6)?, number(7)?, number(8)?],
            coverage_measured: number(9)?,
            coverage_unmeasured: number(10)?,
            rms_normalised: number(11)?,
            rms: number(12)?,
            overhang: number(13)?,
            missed: number(14)?,
            blames_sensor: columns[15] == "true",
            ..Measures::default()
        }),
        "refused" => Outcome::Refused(message),
        _ => Outcome::Failed(message),
    };
    Some(((cell.to_owned(), seed.parse().ok()?, readings.parse().ok()?), outcome))
}
