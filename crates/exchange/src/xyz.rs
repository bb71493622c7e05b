//! Points in text files: XYZ, TXT, ASC, CSV, PTS.
//!
//! **Input.** One point per line. The first line shows whether commas, semicolons, or blanks and tabs
//! separate the numbers. Blank lines and comments (`#`, `//`) are ignored.
//!
//! **Output.** A [`Scan`] at the identity pose.
//!
//! **Columns.** A header line names them, in any order and case: `x y z`, `sigma` or
//! `cxx cxy cxz cyy cyz czz`, `nx ny nz`, `sigma_n_deg`, `k1 k2 d1x d1y d1z`, `sigma_k`, `time`, `scan`;
//! other names are ignored. A comment directly before the first point that names `x`, `y` and `z` counts as a
//! header. Without a header the first three columns are x y z; of exactly six, the last three are normals if
//! all of them have length 1 within 1 %. Further columns are ignored. A first line of one whole number is the
//! count of a PTS file and is skipped.
//!
//! **Limits.** A column without a header is never read as σ, because scanners write intensities there
//! (decision 0039). Decimal commas are an error, because a comma may also separate numbers.

use std::io::Read;
use std::path::Path;

use planish_core::Budget;
use planish_estimate::{Error, Result};
use planish_sense::Scan;

use crate::points::{PointCollector, PointColumns, keep_unit_normals};
use crate::source::{Source, next_word, parse_number, read_file, shown};

/// Reads points. Records with a coordinate that is not finite (or an empty field) are dropped and counted.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) when the file is missing or unreadable,
/// [`Input`](planish_estimate::ErrorKind::Input) for a word that is no number, a line that is too short, or a
/// σ or covariance that is not positive: with file and line.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("points.csv");
/// std::fs::write(&path, "x;y;z;sigma\n1;2;3;0.1\n4;5;6;0.2\n")?;
/// let scan = planish_exchange::xyz::read_points(&path)?;
/// assert_eq!(scan.points, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
/// assert_eq!(scan.sigma, Some(vec![0.1, 0.2]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_points(path: &Path) -> Result<Scan> {
    read_file(path, |mut source, name| points_from(&mut source, name))
}

/// Maximum number of columns that a header may name.
///
/// Names are compared pairwise, so a million of them would take quadratic time. Guarded by
/// `a_header_of_a_million_columns_is_rejected_at_once`.
const MAX_COLUMNS: usize = 4096;

/// Separator of the numbers of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Separator {
    Blank,
    Byte(u8),
}

impl Separator {
    /// Detects the separator: a semicolon, else a comma, else blanks and tabs.
    fn detect(line: &[u8]) -> Self {
        // The semicolon first: where it separates fields, a comma can only be a decimal comma.
        let found = [b';', b','].into_iter().find(|byte| line.contains(byte));
        found.map_or(Self::Blank, Self::Byte)
    }

    /// Next field, without surrounding blanks and quotes.
    fn next_field<'a>(self, rest: &mut Option<&'a [u8]>) -> Option<&'a [u8]> {
        let line = rest.as_mut()?;
        match self {
            Self::Blank => next_word(line),
            Self::Byte(byte) => {
                let end = line.iter().position(|&b| b == byte);
                let field = &line[..end.unwrap_or(line.len())];
                *rest = end.map(|end| &line[end + 1..]);
                // Spreadsheet programs may quote every field.
                let field = field.trim_ascii();
                Some(match field {
                    [b'"', inside @ .., b'"'] => inside,
                    _ => field,
                })
            }
        }
    }

    fn fields(self, line: &[u8]) -> Vec<&[u8]> {
        let mut rest = Some(line);
        std::iter::from_fn(|| self.next_field(&mut rest)).collect()
    }
}

/// Text of a comment line, without `#` or `//`; none for other lines.
fn comment(line: &[u8]) -> Option<&[u8]> {
    let line = line.trim_ascii_start();
    line.strip_prefix(b"#").or_else(|| line.strip_prefix(b"//"))
}

/// Fields of a line as column names, if it names x, y and z.
fn names(line: &[u8]) -> Option<Vec<String>> {
    let fields = Separator::detect(line).fields(line);
    let names: Vec<String> = fields
        .iter()
        .map(|field| String::from_utf8_lossy(field).trim_matches('"').to_ascii_lowercase())
        .collect();
    ["x", "y", "z"].iter().all(|axis| names.iter().any(|n| n == axis)).then_some(names)
}

/// Layout of the records of a file.
struct Layout {
    separator: Separator,
    collector: PointCollector,
    /// Number of fields that a record requires.
    width: usize,
    /// True if columns four to six are normals only if all of them have unit length.
    tentative_normals: bool,
}

impl Layout {
    fn new(columns: PointColumns, separator: Separator, tentative_normals: bool, budget: &Budget) -> Self {
        Self {
            separator,
            width: columns.width(),
            // Nothing is reserved: the count of a PTS file is not trusted, and other files state none.
            collector: PointCollector::new(columns, 0, budget),
            tentative_normals,
        }
    }

    fn named(names: &[String], separator: Separator, budget: &Budget) -> Result<Self> {
        if names.len() > MAX_COLUMNS {
            return Err(Error::input(format!(
                "expected at most {MAX_COLUMNS} columns, found {}",
                names.len()
            )));
        }
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        if let Some(twice) =
            (1..names.len()).find(|&k| !names[k].is_empty() && names[..k].contains(&names[k]))
        {
            return Err(Error::input(format!("the column `{}` is named twice", names[twice])));
        }
        Ok(Self::new(PointColumns::find(&names)?, separator, false, budget))
    }

    /// Parses the required fields of a line into `record`.
    fn read_record(&self, line: &[u8], number: u64, record: &mut Vec<f64>) -> Result<()> {
        record.clear();
        let mut rest = Some(line);
        while record.len() < self.width {
            let Some(field) = self.separator.next_field(&mut rest) else {
                if self.tentative_normals && record.len() >= 3 {
                    // A line with fewer columns: its normal is zero, which has not unit length, so that
                    // `keep_unit_normals` discards the normals of the whole file.
                    record.resize(6, 0.0);
                    break;
                }
                return Err(Error::input(format!(
                    "line {number}: expected {} numbers, found {}",
                    self.width,
                    record.len()
                )));
            };
            record.push(match parse_number(field) {
                Some(value) => value,
                // An empty field is a missing value; a missing coordinate drops the record.
                None if field.is_empty() => f64::NAN,
                // A word in these columns shows that they hold no normals; zero discards them, as above.
                None if self.tentative_normals && record.len() >= 3 => 0.0,
                None => return Err(self.no_number(field, number)),
            });
        }
        Ok(())
    }

    /// Error for a field that is not a number.
    fn no_number(&self, field: &[u8], number: u64) -> Error {
        let point: Vec<u8> = field.iter().map(|&b| if b == b',' { b'.' } else { b }).collect();
        // Decimal commas are the likely cause if a point makes it a number, or if a field between commas has
        // a blank, as `5 2` in `1,5 2,5`.
        let halves = self.separator == Separator::Byte(b',') && field.iter().any(u8::is_ascii_whitespace);
        let way_out = match parse_number(&point) {
            None if !halves => "",
            _ => ": write decimals with a point",
        };
        Error::input(format!("line {number}: expected a number, found {}{way_out}", shown(field)))
    }
}

pub(crate) fn points_from<R: Read>(source: &mut Source<R>, name: &str) -> Result<Scan> {
    let mut layout: Option<Layout> = None;
    let mut names_in_comment = None;
    let mut count_line = None;
    let mut record = Vec::new();
    let budget = source.budget().clone();
    loop {
        let number = source.line_number() + 1;
        let Some(mut line) = source.line()? else { break };
        if number == 1 {
            // Byte order mark, which some Windows programs put before UTF-8.
            line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
        }
        if line.iter().all(u8::is_ascii_whitespace) {
            continue;
        }
        if let Some(comment) = comment(line) {
            // Each comment replaces the previous one, so only the last one before the first point counts.
            names_in_comment = names(comment);
            continue;
        }
        let at = |e: Error| e.in_context(format_args!("line {number}"));
        let layout = match &mut layout {
            Some(layout) => layout,
            None => {
                let separator = Separator::detect(line);
                let fields = separator.fields(line);
                let first = fields.first().copied().unwrap_or_default();
                // PTS files begin with the number of points.
                let is_count = fields.len() == 1 && first.iter().all(u8::is_ascii_digit);
                if is_count && count_line.is_none() {
                    count_line = Some(number);
                    continue;
                }
                // An empty first field is a missing coordinate, not a header.
                if parse_number(first).is_none() && !first.is_empty() {
                    let Some(names) = names(line) else {
                        return Err(Error::input(format!(
                            "line {number}: expected a point or a header with x, y and z, found {}",
                            shown(line)
                        )));
                    };
                    layout = Some(Layout::named(&names, separator, &budget).map_err(at)?);
                    continue;
                }
                // A comment with another number of words is prose that happens to name x, y and z.
                let named = names_in_comment.take().filter(|names: &Vec<String>| names.len() == fields.len());
                layout.insert(match named {
                    Some(names) => Layout::named(&names, separator, &budget).map_err(at)?,
                    None if fields.len() == 6 => {
                        let columns = PointColumns::positions_and_normals();
                        Layout::new(columns, separator, true, &budget)
                    }
                    None => Layout::new(PointColumns::positions_only(), separator, false, &budget),
                })
            }
        };
        layout.read_record(line, number, &mut record)?;
        layout.collector.push(&record, format_args!("line {number}"))?;
    }
    let Some(layout) = layout else {
        return Err(Error::input(format!("expected points, found none in {} lines", source.line_number())));
    };
    let (mut scan, _) = layout.collector.finish(name);
    if layout.tentative_normals {
        keep_unit_normals(&mut scan);
    }
    Ok(scan)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::DVec3;
    use proptest::prelude::*;

    fn read(text: &[u8]) -> Result<Scan> {
        points_from(&mut Source::new(text, Some(text.len() as u64)), "a.xyz")
    }

    fn message(text: &str) -> String {
        read(text.as_bytes()).unwrap_err().to_string()
    }

    #[test]
    fn all_separators_and_line_ends_give_the_same_points() {
        let expected = [[1.0, 2.5, -3.0], [4.0, 5.0, 6e-3]];
        for text in [
            "1 2.5 -3\n4 5 6e-3\n",
            "1\t2.5\t-3\r\n4\t5\t6e-3",
            "1,2.5,-3\n4, 5 ,6e-3\n",
            "1;2.5;-3\n\n4; 5;6e-3\n",
            "\"x\",\"y\",\"z\"\n\"1\",\"2.5\",-3\n4,5,\"6e-3\"\n",
            "# made by hand\n1 2.5 -3\n// and more\n  4 5 6e-3  \n",
            "2\n1 2.5 -3\n4 5 6e-3\n",
            "\u{feff}x,y,z\n1,2.5,-3\n4,5,6e-3\n",
            "1 2.5 -3 255 0\n4 5 6e-3 0 255\n",
        ] {
            let scan = read(text.as_bytes()).unwrap();
            assert_eq!(scan.points, expected.map(planish_core::DVec3::from_array), "{text:?}");
            assert!(scan.normals.is_none() && scan.sigma.is_none());
        }
    }

    #[test]
    fn a_header_names_columns_in_any_order() {
        let scan = read(b"sigma,Z,Y,X,time,nx,ny,nz,sigma_n_deg\n0.1,3,2,1,99,0,0,1,2\n").unwrap();
        assert_eq!(scan.points, [DVec3::new(1.0, 2.0, 3.0)]);
        assert_eq!(scan.sigma.unwrap(), [0.1]);
        assert_eq!(scan.normals.unwrap(), [DVec3::Z]);
        assert_eq!(scan.sigma_normal_deg.unwrap(), [2.0]);
        let scan = read(b"# x y z sigma\n1 2 3 0.5\n").unwrap();
        assert_eq!(scan.sigma.unwrap(), [0.5]);
        let scan = read(b"x y z cxx cxy cxz cyy cyz czz\n1 2 3 4 0 0 5 0 6\n").unwrap();
        assert_eq!(scan.covariance.unwrap()[0].to_array(), [4.0, 0.0, 0.0, 5.0, 0.0, 6.0]);
    }

    #[test]
    fn six_columns_are_normals_only_when_all_have_unit_length() {
        let scan = read(b"0 0 0 0 0 1\n1 0 0 0.6 0.8 0\n").unwrap();
        assert_eq!(scan.normals.unwrap(), [DVec3::Z, DVec3::new(0.6, 0.8, 0.0)]);
        for colours in ["0 0 0 0 0 1\n1 0 0 255 0 0\n", "0 0 0 0 0 1\n1 0 0 a b c\n", "0 0 0 0 0 1\n1 0 0\n"]
        {
            let scan = read(colours.as_bytes()).unwrap();
            assert!(scan.normals.is_none());
            assert_eq!(scan.points.len(), 2);
        }
    }

    #[test]
    fn points_that_are_not_finite_are_dropped_and_counted() {
        let scan = read(b"nan 0 0\n1 2 3\ninf 0 0\n").unwrap();
        assert_eq!((scan.points.len(), scan.dropped_not_finite), (1, 2));
        let scan = read(b"x,y,z\n1,2,\n1,2,3\n").unwrap();
        assert_eq!((scan.points.len(), scan.dropped_not_finite), (1, 1));
    }

    #[test]
    fn errors_name_the_line() {
        assert!(message("1 2 3\n1 2\n").contains("line 2: expected 3 numbers, found 2"));
        assert!(message("1 2 3\n\n1 two 3\n").contains("line 3: expected a number, found `two`"));
        assert!(message("x,y,z,sigma\n1,2,3,0.1\n1,2,3,0\n").contains("line 3: expected sigma > 0, found 0"));
        assert!(message("x,y,sigma\n").contains("line 1: expected a point or a header"));
        assert!(message("x,y,z,cxx\n").contains("line 1: expected all of the columns cxx"));
        assert!(message("1,5;2,5;3,5\n").contains("found `1,5;2,5;3,5`"));
        assert!(message("1,5 2,5 3,5\n").contains("found `5 2`: write decimals with a point"));
        assert!(message("# nothing\n\n").contains("found none in 2 lines"));
        assert!(message("hello\n").contains("line 1"));
        assert!(message("x,y,z,x\n").contains("named twice"));
    }

    #[test]
    fn a_header_of_a_million_columns_is_rejected_at_once() {
        let names: String = (0..1_000_000).map(|k| format!(",{k}")).collect();
        assert!(
            message(&format!("x,y,z{names}\n"))
                .contains("line 1: expected at most 4096 columns, found 1000003")
        );
    }

    proptest! {
        #[test]
        fn no_bytes_cause_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = read(&bytes);
        }

        #[test]
        fn no_text_of_the_right_alphabet_causes_a_panic(text in "[xyz0-9 .,;#e\n\r\t-]{0,200}") {
            let _ = read(text.as_bytes());
        }
    }
}
