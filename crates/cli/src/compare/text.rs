//! The summary of `planish compare`.

use super::{CompareArgs, PartName};
use crate::lines::{Align, Lines};
use crate::numbers::{count, percent, significant};
use planish::FindingCode;
use planish::compare::{ComparisonReport, Deviations};

/// The summary of a comparison.
pub fn text(args: &CompareArgs, report: &ComparisonReport) -> String {
    let mut lines = Lines::default();
    let mut files = [&args.model, &args.reference].map(|path| path.display());
    if report.findings.iter().any(|finding| finding.code == FindingCode::FilesExchanged) {
        files.reverse();
    }
    let [model, reference] = files;
    lines.line(format!(
        "Deviations of {model} from {reference} in {}; positive on the side that the normals point to.",
        report.unit
    ));
    lines.gap();
    // A reference without faces has no forward direction; its row stays, so that the table has one form.
    let row = |name: &str, found: &Option<Deviations>| {
        let mut row = vec![name.to_owned()];
        match found {
            Some(d) => row.extend(
                [d.rms, d.mean, d.p50, d.p95, d.max]
                    .map(|value| significant(value, 3))
                    .into_iter()
                    .chain([count(d.n)]),
            ),
            None => row.extend(["–"; 6].map(str::to_owned)),
        }
        row
    };
    lines.table(
        &[
            ("", Align::Left),
            ("rms", Align::Right),
            ("mean", Align::Right),
            ("median |d|", Align::Right),
            ("95 % |d|", Align::Right),
            ("largest |d|", Align::Right),
            ("points", Align::Right),
        ],
        &[row("model to reference", &report.forward), row("reference to model", &report.backward)],
    );
    lines.gap();
    lines.line(match report.coverage95 {
        Some(share) => {
            format!("{} of the reference points lie within 1.96 σ (expected: 95 %).", percent(share))
        }
        None => "The model has no σ, so the coverage is unknown.".to_owned(),
    });
    // Skipped points are counted by cause: many of them mean that the figures above describe a small part
    // only.
    let skipped = report.skipped;
    // `measured` is the default, so its words say why points were not compared.
    let (of_model, of_reference) = match args.part {
        PartName::Measured => (
            "points of the model were not measured",
            "points of the reference are nearest to a part of the model that was not measured",
        ),
        PartName::Completed | PartName::Known | PartName::All => (
            "points of the model belong to another part",
            "points of the reference are nearest to another part of the model",
        ),
    };
    let causes = [
        (skipped.model_not_observed, of_model),
        (skipped.model_beyond_border, "points of the model lie beyond a boundary of the reference"),
        (skipped.reference_not_observed, of_reference),
        (skipped.reference_beyond_border, "points of the reference lie beyond a boundary of the model"),
    ];
    for (n, cause) in causes.into_iter().filter(|(n, _)| *n > 0) {
        lines.line(format!("Not compared: {} {cause}.", count(n)));
    }
    if let Some(written) = args.page.written() {
        lines.line(written);
    }
    lines.into_text()
}
