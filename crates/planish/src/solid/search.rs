//! The searches of the readings of a drawing, one after the other.

use super::sheet::{self, ReadDrawing};
use super::{ReportedEdit, line_of, nearest, relaxed, repaired};
use planish_core::{Finding, FindingCode, Progress};
use planish_estimate::{Error, ErrorKind, Result};
use planish_solid::reprojection::{Disagreement, ReprojectionOptions, disagreements};
use planish_solid::views::{Drawing, Solution, Solutions, solve};

/// How accurate a drawing is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Accuracy {
    /// Coordinates are consistent, because they were estimated or joined.
    Consistent,
    /// Coordinates are those of a file, and may be inexact.
    Drawn,
    /// Lines were traced in a picture: some may be missing, false, or in the wrong style.
    Traced,
}

/// What is tried if no solid explains a drawing as it is: other readings, then edits, which are returned as
/// well. With `is_repaired`, the solid of the edited drawing is the result.
pub(super) fn search_further(
    strict: Result<SearchedReading>,
    readings: &[ReadDrawing],
    accuracy: Accuracy,
    is_repaired: bool,
    progress: &dyn Progress,
) -> Result<(SearchedReading, Vec<ReportedEdit>)> {
    let (is_exact, is_traced) = (accuracy == Accuracy::Consistent, accuracy == Accuracy::Traced);
    match &strict {
        // A search that is cut off has many solids; a weaker reading has more.
        Ok(searched) if searched.is_solved() || !searched.found.complete && !is_traced => {
            return strict.map(|searched| (searched, Vec::new()));
        }
        // A drawing that is too large for the search stays so.
        Err(error) if error.kind() == ErrorKind::Unsupported && !is_traced => {
            return strict.map(|searched| (searched, Vec::new()));
        }
        _ => {}
    }
    let restyled = relaxed::search_restyled(readings, strict.as_ref().ok(), progress);
    let relaxed = restyled.or_else(|| relaxed::search_relaxed(readings, is_exact, progress));
    if let Some(relaxed) = relaxed {
        return Ok((relaxed, Vec::new()));
    }
    // A repair searches each view several times, which takes too long for most pictures.
    if is_traced
        && !is_repaired
        && let Some(nearest) = nearest::nearest(readings, progress)
    {
        return Ok((nearest, Vec::new()));
    }
    let Some(repaired) = repaired::repaired(readings, is_exact, progress)? else {
        return strict.map(|searched| (searched, Vec::new()));
    };
    let (edits, finding) = (repaired.edits(), repaired.finding(is_repaired));
    let mut searched = match (is_repaired, strict) {
        (true, _) => repaired.into_searched(),
        (false, Ok(searched)) => searched,
        (false, Err(_)) => SearchedReading::unsolved(repaired.reading),
    };
    searched.reading.findings.push(finding);
    Ok((searched, edits))
}

/// A reading of a drawing, and what was found for it.
pub(super) struct SearchedReading {
    pub reading: ReadDrawing,
    pub found: Solutions,
    /// The lines in which each solution differs from the drawing.
    pub differences: Vec<Vec<Disagreement>>,
    /// What the drawing leaves open, if its solids must not be written for that reason.
    pub undecided: Option<String>,
}

impl SearchedReading {
    /// A reading without a solid.
    fn unsolved(reading: ReadDrawing) -> Self {
        let found = Solutions { complete: true, ..Solutions::default() };
        Self { reading, found, differences: Vec::new(), undecided: None }
    }

    pub(super) fn is_solved(&self) -> bool {
        self.differences.iter().any(Vec::is_empty)
    }

    fn convention(&self) -> Option<&'static str> {
        self.reading.sheet.as_ref().map(|sheet| sheet.projection)
    }
}

/// Searches the readings of a drawing, and returns the first that has a solid, or else the first. If a solid
/// has the views in the other convention as well, this is a finding.
pub(super) fn search_readings(
    readings: Vec<ReadDrawing>,
    progress: &dyn Progress,
    explain: impl Fn(Error, &Drawing) -> Error,
) -> Result<SearchedReading> {
    let mut first: Option<Result<SearchedReading>> = None;
    let mut solved: Option<SearchedReading> = None;
    let mut without_sections: Option<SearchedReading> = None;
    for reading in readings {
        // Of the other readings in the convention of the solid, none is as plausible.
        let convention = reading.sheet.as_ref().map(|sheet| sheet.projection);
        if solved.as_ref().is_some_and(|used| used.convention() == convention) {
            continue;
        }
        progress.check("searching", 0.1)?;
        // Sections beside other views choose among the solids of these; they are needed for the search only
        // if none of these solids agrees with them.
        let views = reading.drawing.without_sections();
        let by_views = views.and_then(|views| searched(reading.clone(), &views).ok());
        // Errors of the search refer to entities of the drawing. The files are known only to the caller.
        let searched = match by_views {
            Some(by_views) if by_views.is_solved() => Ok(by_views),
            by_views => match searched(reading.clone(), &reading.drawing) {
                Ok(with_sections) if with_sections.is_solved() => Ok(with_sections),
                result => {
                    without_sections = without_sections.or(by_views.and_then(sections_set_aside));
                    result.map_err(|e| explain(e, &reading.drawing))
                }
            },
        };
        progress.check("comparing", 0.6)?;
        match (searched, &mut solved) {
            (Ok(searched), Some(used)) if searched.is_solved() => {
                used.reading.findings.extend(used.reading.sheet.as_ref().map(sheet::open_convention));
                break;
            }
            (Ok(searched), None) if searched.is_solved() => solved = Some(searched),
            (searched, _) => {
                first.get_or_insert(searched);
            }
        }
    }
    let none = || Err(Error::input("expected views, found none"));
    solved.or(without_sections).map_or_else(|| first.unwrap_or_else(none), Ok)
}

/// The solids of complete views that no section agrees with, as a result without the sections; none if the
/// views have no solid, or if a section is needed because a view is missing.
fn sections_set_aside(searched: SearchedReading) -> Option<SearchedReading> {
    let SearchedReading { mut reading, found, differences, undecided } = searched;
    let views = reading.drawing.without_sections().filter(|views| views.whole_views() == 3)?;
    let compared = |s: &Solution| disagreements(&s.solid, &views, &ReprojectionOptions::default());
    let by_views: Vec<Vec<Disagreement>> = found.solutions.iter().map(compared).collect();
    let first = by_views.iter().position(Vec::is_empty)?;
    let contradiction = differences[first].first().map(line_of)?;
    let text = format!(
        "a section contradicts the solid of the complete views and was not used: {}, {}",
        contradiction.entity.as_deref().unwrap_or("its material"),
        contradiction.reason
    );
    reading.findings.push(Finding::new(FindingCode::SectionSetAside, text));
    reading.drawing = views;
    Some(SearchedReading { reading, found, differences: by_views, undecided })
}

/// Finds the solids of a drawing, and compares them with all views of a reading.
pub(super) fn searched(reading: ReadDrawing, drawing: &Drawing) -> Result<SearchedReading> {
    let found = solve(drawing)?;
    // The search samples places and can miss one. An independent check by rays decides what is written
    // (`docs/decisions/0058`).
    let compared = |s: &Solution| disagreements(&s.solid, &reading.drawing, &ReprojectionOptions::default());
    let differences: Vec<Vec<Disagreement>> = found.solutions.iter().map(compared).collect();
    let undecided = reading.open_widths.then(|| {
        "the two views show outlines of equal widths, which may be round or flat, and the sheet has no \
         centre lines: add a view along the missing direction, centre lines, or a diameter (Ø)"
            .to_owned()
    });
    // The first of so many solids would be a guess.
    let explained = differences.iter().filter(|differences| differences.is_empty()).count();
    let undecided = undecided.or_else(|| {
        (!found.complete && explained > 1).then(|| {
            format!(
                "the search was cut off after {explained} solids that show all lines: add a view, hidden \
                 lines or a section to distinguish them"
            )
        })
    });
    Ok(SearchedReading { reading, found, differences, undecided })
}
