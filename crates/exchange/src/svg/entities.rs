//! Checks what the entities and attributes of an XML document cost before it is parsed.
//!
//! **Input.** The text of a document.
//!
//! **Output.** An error if its entities expand to more than a plain document may hold, or if a tag has so
//! many attributes that the parser, which compares each with all others, would not end.
//!
//! **Limits.** The length is an upper bound: references in comments count. Damage of other kinds is left to
//! the parser.
//!
//! # References
//! W3C, *Extensible Markup Language (XML) 1.0*, section 4.2.

use planish_estimate::{Error, Result};
use std::collections::{HashMap, HashSet};

/// Maximum nesting of entities. The parser has a lower limit.
const MAX_NESTING: usize = 16;
/// Maximum number of attributes of a tag; far above the elements of drawing programs, which have about 40.
/// Guarded by `tags_with_very_many_attributes_are_rejected`.
const MAX_ATTRIBUTES: usize = 2000;
/// Maximum number of declared namespaces times that of different prefixes. The parser copies the outer set
/// for each declaration.
const MAX_NAMESPACES: usize = 1 << 20;

/// Checks a document that may expand to `max` bytes.
///
/// # Errors
/// `Input`, with the line, if it would become longer, or a tag has too many attributes.
pub(super) fn check(text: &str, max: u64) -> Result<()> {
    let declared = declarations(text);
    check_length(text, max, &declared)?;
    check_namespaces(text)?;
    check_tags(text)?;
    declared.values().try_for_each(|value| check_tags(value))
}

fn check_length(text: &str, max: u64, declared: &HashMap<&str, &str>) -> Result<()> {
    if declared.is_empty() {
        return Ok(());
    }
    let mut lengths = HashMap::new();
    let mut length = text.len() as u64;
    for (at, name) in references(text) {
        length = length.saturating_add(expanded(name, declared, &mut lengths, 0));
        if length > max {
            let line = 1 + text[..at].bytes().filter(|b| *b == b'\n').count();
            return Err(Error::input(format!(
                "line {line}: the entity `{name}`: expected entities that expand to at most {max} bytes of \
                 text, found more"
            )));
        }
    }
    Ok(())
}

/// The entities that a document declares, with their values.
fn declarations(text: &str) -> HashMap<&str, &str> {
    let mut found = HashMap::new();
    for (at, keyword) in text.match_indices("<!ENTITY") {
        let rest = text[at + keyword.len()..].trim_start();
        let Some((name, rest)) = rest.split_once(char::is_whitespace) else {
            continue;
        };
        let rest = rest.trim_start();
        // Entities of other files (`SYSTEM`) are not read.
        let Some(quote) = rest.chars().next().filter(|c| matches!(c, '"' | '\'')) else {
            continue;
        };
        if let Some((value, _)) = rest[1..].split_once(quote) {
            // The first declaration counts (section 4.2).
            found.entry(name).or_insert(value);
        }
    }
    found
}

/// References such as `&name;` with their positions. Those of characters (`&#10;`) do not expand.
fn references(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.match_indices('&').filter_map(|(at, _)| {
        let rest = &text[at + 1..];
        let end = rest.find(|c: char| c == ';' || c == '&' || c == '<' || c.is_whitespace())?;
        (rest[end..].starts_with(';') && !rest.starts_with('#')).then_some((at, &rest[..end]))
    })
}

/// Length of an expanded entity.
fn expanded<'a>(
    name: &'a str,
    declared: &HashMap<&'a str, &'a str>,
    lengths: &mut HashMap<&'a str, u64>,
    depth: usize,
) -> u64 {
    if let Some(length) = lengths.get(name) {
        return *length;
    }
    // The predefined ones (`&amp;`) are shorter than their references.
    let Some(value) = declared.get(name) else {
        return 0;
    };
    // An entity that contains itself is reported by the parser.
    if depth > MAX_NESTING {
        return 0;
    }
    // An entity inside itself counts as empty.
    lengths.insert(name, 0);
    let inner = references(value).map(|(_, inner)| expanded(inner, declared, lengths, depth + 1));
    let length = inner.fold(value.len() as u64, u64::saturating_add);
    lengths.insert(name, length);
    length
}

/// Checks the tags of a text, and those in the values of its entities, which become tags where they are used.
fn check_tags(text: &str) -> Result<()> {
    let mut line = 1;
    let mut rest = text;
    while let Some(at) = rest.find('<') {
        line += rest[..at].matches('\n').count();
        rest = &rest[at..];
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        let length = match skipped.into_iter().find(|(start, _)| rest.starts_with(start)) {
            Some((_, end)) => rest.find(end).unwrap_or(rest.len()),
            None => tag_length(&rest[1..], line)? + 1,
        };
        line += rest[..length].matches('\n').count();
        rest = &rest[length..];
    }
    Ok(())
}

/// Length of a tag up to its `>` or the next `<`, outside of quotes.
fn tag_length(tag: &str, line: usize) -> Result<usize> {
    let mut quote = None;
    let mut attributes = 0;
    for (at, byte) in tag.bytes().enumerate() {
        match (quote, byte) {
            (Some(open), _) => quote = Some(open).filter(|open| *open != byte),
            (None, b'"' | b'\'') => quote = Some(byte),
            (None, b'=') => {
                attributes += 1;
                if attributes > MAX_ATTRIBUTES {
                    return Err(Error::input(format!(
                        "line {line}: expected at most {MAX_ATTRIBUTES} attributes in a tag, found more"
                    )));
                }
            }
            (None, b'<' | b'>') => return Ok(at),
            _ => {}
        }
    }
    Ok(tag.len())
}

/// Checks that the sets of namespaces stay small, which the parser copies for each tag that declares one.
fn check_namespaces(text: &str) -> Result<()> {
    let mut prefixes = HashSet::new();
    let mut count = 0_usize;
    for (at, keyword) in text.match_indices("xmlns") {
        count += 1;
        prefixes.insert(text[at + keyword.len()..].split(['=', ' ', '\n']).next());
        if count.saturating_mul(prefixes.len()) > MAX_NAMESPACES {
            let line = 1 + text[..at].matches('\n').count();
            return Err(Error::input(format!(
                "line {line}: expected a few namespaces, found {} that are declared {count} times",
                prefixes.len()
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entities_may_expand_to_what_a_plain_document_holds() {
        let document = |times: usize| {
            let uses = "<path d=\"&a;\"/>\n".repeat(times);
            format!("<!DOCTYPE svg [<!ENTITY a '{}'>]>\n<svg>{uses}</svg>", "M0 0L1 1".repeat(1000))
        };
        assert!(check(&document(50), 1 << 20).is_ok());
        let error = check(&document(500), 1 << 20).unwrap_err().to_string();
        assert!(error.starts_with("line 1") && error.contains("the entity `a`"), "{error}");
        // Nested entities multiply, also if they are declared later.
        let nested = "<!DOCTYPE svg [<!ENTITY a '&b;&b;&b;'><!ENTITY b '0123456789'>]><svg>&a;</svg>";
        let length = nested.len() as u64;
        assert!(check(nested, length + 4 * 12 + 2 * 12 * 10).is_ok());
        assert!(check(nested, length + 20).is_err());
        // Those that contain themselves are left to the parser, and characters do not expand.
        assert!(check("<!DOCTYPE s [<!ENTITY a '&a;&a;'>]><s>&a;&#10;&amp;</s>", 1000).is_ok());
    }

    #[test]
    fn tags_with_very_many_attributes_are_rejected() {
        let tag = |n: usize| {
            let attributes: String = (0..n).map(|k| format!(" a{k}='>='")).collect();
            format!("<svg>\n<!-- it's ' -->\n<g{attributes}/></svg>")
        };
        assert!(check(&tag(MAX_ATTRIBUTES), 1 << 30).is_ok());
        let error = check(&tag(MAX_ATTRIBUTES + 1), 1 << 30).unwrap_err().to_string();
        assert!(error.starts_with("line 3: expected at most"), "{error}");
        // Within an entity, too.
        let hidden = format!("<!DOCTYPE s [<!ENTITY a \"{}\">]><s>&a;</s>", tag(MAX_ATTRIBUTES + 1));
        assert!(check(&hidden, 1 << 30).is_err());
    }

    #[test]
    fn nested_namespaces_are_limited() {
        let many: String = (0..2000).map(|k| format!("<g xmlns:n{k}='u'>")).collect();
        assert!(check(&many, 1 << 30).unwrap_err().to_string().contains("namespaces"));
        // Some programs declare the same one in every element.
        assert!(check(&"<g xmlns='u'/>".repeat(100_000), 1 << 30).is_ok());
    }
}
