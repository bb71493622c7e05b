//! Names of options for the settings that messages of the library are about.
//!
//! The library names settings in words, because it has users without a command line. The command adds the
//! options when it prints a message: `… raise the maximum depth (option --max-depth)`.

use planish::Setting;

/// The option that states a setting.
pub fn option(setting: Setting) -> &'static str {
    // Without a wildcard, a new setting does not compile before it has an option.
    match setting {
        Setting::Align => "--align",
        Setting::Animation => "--animate",
        Setting::BelieveSigma => "--believe-sigma",
        Setting::Calibration => "--calib",
        Setting::CellSize => "--cell-size",
        Setting::Close => "--close",
        Setting::CompleteSmooth => "--complete",
        Setting::Constrain => "--constrain",
        Setting::Count => "--count",
        Setting::Disparities => "--disparities",
        Setting::Epsilon => "--epsilon",
        Setting::EstimateSigma => "--estimate-sigma",
        Setting::Filter => "--filter",
        Setting::Force => "--force",
        Setting::Gap => "--gap",
        Setting::Given => "--given",
        Setting::Graphs => "--graphs",
        Setting::Ground => "--ground",
        Setting::Kind => "--kind",
        Setting::KnownParameters => "--known-uv",
        Setting::Level => "--level",
        Setting::MaxCoefficients => "--max-coefficients",
        Setting::MaxDepth => "--max-depth",
        Setting::MaxMemory => "--max-memory",
        Setting::MeshTolerance => "--mesh-tolerance",
        Setting::Motion => "--motion",
        Setting::Patch => "--patch",
        Setting::PixelSize => "--pixel-size",
        Setting::Product => "--product",
        Setting::Projection => "--projection",
        Setting::Repair => "--repair",
        Setting::RangeGate => "--range-gate",
        Setting::Reference => "--reference",
        Setting::Region => "--region",
        Setting::Scan => "--scan",
        Setting::Scans => "--scans",
        Setting::Shape => "--shape",
        Setting::SigmaHeading => "--sigma-heading-deg",
        Setting::SigmaPoint => "--sigma-point",
        Setting::SigmaPosition => "--sigma-position",
        Setting::SigmaRange => "--sigma-range",
        Setting::Snap => "--snap",
        Setting::Symmetry => "--symmetry",
        Setting::Tolerance => "--tolerance",
        Setting::Unit => "--unit",
        Setting::ViewPlaces => "--view",
        Setting::Views => "--views",
    }
}

/// A message with the options of its settings behind it.
pub fn with_options(message: &str, settings: &[Setting]) -> String {
    let names: Vec<&str> = settings.iter().map(|setting| option(*setting)).collect();
    match names.len() {
        // The options follow the message, so that it reads the same with and without a command line.
        0 => message.to_owned(),
        1 => format!("{message} (option {})", names[0]),
        _ => format!("{message} (options {})", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;
    use std::collections::BTreeSet;

    /// The options of a command and of its subcommands.
    fn options(command: &clap::Command) -> BTreeSet<String> {
        let own = command.get_arguments().filter_map(|argument| argument.get_long());
        let own = own.map(|name| format!("--{name}"));
        own.chain(command.get_subcommands().flat_map(options)).collect()
    }

    #[test]
    fn every_setting_has_an_option_that_exists() {
        let known = options(&crate::Cli::command());
        for setting in Setting::ALL {
            assert!(known.contains(option(*setting)), "{}: {}", setting.name(), option(*setting));
        }
    }

    #[test]
    fn options_follow_the_message() {
        assert_eq!(with_options("expected a sheet", &[]), "expected a sheet");
        assert_eq!(with_options("expected a sheet", &[Setting::Shape]), "expected a sheet (option --shape)");
        assert_eq!(
            with_options("omit one", &[Setting::Motion, Setting::Filter]),
            "omit one (options --motion, --filter)"
        );
    }
}
