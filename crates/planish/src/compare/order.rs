//! Which of two files is the model: the one with a surface.

use super::{Compared, Reference};
use planish_core::{Finding, FindingCode};
use planish_estimate::Result;
use planish_exchange::extension;
use planish_exchange::mesh::has_faces;
use planish_exchange::ply::read_contents;
use std::path::Path;

/// Two files in the order in which they are compared.
pub(super) struct Ordered<'a> {
    pub model: Compared,
    pub reference: Reference,
    /// Names of the model and of the reference.
    pub paths: [&'a Path; 2],
    /// States that the files were exchanged.
    pub finding: Option<Finding>,
}

/// Reads a model and its reference. They are exchanged if only the second one has a surface, because foot
/// points are on surfaces.
pub(super) fn read_in_order<'a>(model: &'a Path, reference: &'a Path) -> Result<Ordered<'a>> {
    let is_exchanged = !may_have_surface(model)? && may_have_surface(reference)?;
    let paths = if is_exchanged { [reference, model] } else { [model, reference] };
    let [surface, points] = paths.map(|path| path.display());
    let finding = is_exchanged.then(|| {
        let text = format!(
            "{points} has points only, so it is the reference, and {surface} the model: deviations are those \
             of {surface} from {points}"
        );
        Finding::new(FindingCode::FilesExchanged, text)
    });
    Ok(Ordered { model: Compared::read(paths[0])?, reference: Reference::read(paths[1])?, paths, finding })
}

/// False for files that hold points only; their contents are not read.
fn may_have_surface(path: &Path) -> Result<bool> {
    Ok(match extension(path).as_str() {
        "planish" => true,
        "ply" => read_contents(path)?.count("face") > 0,
        _ => has_faces(path),
    })
}
