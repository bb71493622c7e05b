//! Findings about a unit of length that no file and no option states.

use planish_core::numbers::significant;
use planish_core::{Finding, FindingCode, Setting, Unit};

/// Sizes of objects that are measured by scanners, probes and lidar, in millimetres: from a screw's thread to
/// a ship. Outside of them another unit is more likely than such an object.
const PLAUSIBLE_MM: [f64; 2] = [1.0, 1e5];

/// A finding if an object of the size `longest` (its longest side, in `assumed`) is implausible in the
/// assumed unit.
pub(crate) fn implausible_size(longest: f64, assumed: Unit) -> Option<Finding> {
    let plausible =
        |unit: Unit| (PLAUSIBLE_MM[0]..=PLAUSIBLE_MM[1]).contains(&(longest * unit.millimetres()));
    // Points that coincide have no size, and no unit gives them one.
    if plausible(assumed) || longest.is_nan() || longest <= 0.0 {
        return None;
    }
    let size = significant(longest, 3);
    // Metres first: programs that name no unit mostly work in metres.
    let other = [Unit::Metre, Unit::Inch, Unit::Foot].into_iter().find(|unit| plausible(*unit));
    let hint = other.map_or_else(
        || "specify the unit".to_owned(),
        |unit| {
            let millimetres = significant(longest * unit.millimetres(), 3);
            format!("in {unit} it would measure {millimetres} mm; specify the unit")
        },
    );
    Some(
        Finding::new(
            FindingCode::UnitImplausible,
            format!(
                "no file states its unit of length: {assumed} is assumed, but an object of {size} {assumed} \
                 is unusual; {hint}"
            ),
        )
        .with_setting(Setting::Unit),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_implausible_sizes_are_reported() {
        for usual in [1.5, 40.0, 2000.0, 9e4] {
            assert_eq!(implausible_size(usual, Unit::Millimetre), None);
        }
        // The Stanford bunny in metres.
        let found = implausible_size(0.1557, Unit::Millimetre).unwrap();
        assert_eq!(found.settings, [Setting::Unit]);
        assert!(found.text.contains("0.156 mm is unusual; in m it would measure 156 mm"), "{}", found.text);
        let found = implausible_size(3e7, Unit::Millimetre).unwrap();
        assert!(found.text.ends_with("is unusual; specify the unit"), "{}", found.text);
        for nothing in [0.0, f64::NAN] {
            assert_eq!(implausible_size(nothing, Unit::Millimetre), None);
        }
    }
}
