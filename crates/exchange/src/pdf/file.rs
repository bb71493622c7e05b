//! The objects of a PDF file, its streams and its page.
//!
//! **Input.** The bytes of a file. **Output.** Objects by their numbers, decoded streams, and the only page
//! with what it inherits.
//!
//! The whole file is searched for objects; its tables of references are not used. So damaged tables do no
//! harm, and of several versions of an object the last in the file counts, as in the tables.
//!
//! **Limits.** Encrypted files and files with several pages are refused.
//!
//! # References
//! ISO 32000-1:2008, section 7.5 (file structure) and 7.7.3 (page tree).

use super::filter::decoded;
use super::syntax::{Dictionary, Lexer, Object, is_space};
use planish_estimate::{Error, Result};
use std::cell::Cell;
use std::collections::BTreeMap;

/// Maximum length of chains of references, and depth of the page tree.
const MAX_DEPTH: usize = 32;
/// Unpacked size of streams that is accepted for any file, and its ratio to the size of the file. Content
/// packs to a tenth of its size, repeated dashes to a fiftieth.
const ALWAYS_ALLOWED_BYTES: u64 = 16 << 20;
const MAX_EXPANSION: u64 = 100;

/// Where an object begins.
#[derive(Clone, Copy)]
enum Place {
    InFile(usize),
    InStream { stream: usize, at: usize },
}

pub(super) struct PdfFile<'a> {
    bytes: &'a [u8],
    places: BTreeMap<u32, Place>,
    /// Decoded streams of objects.
    streams: Vec<Vec<u8>>,
    /// Entries of all trailers.
    trailer: Dictionary,
    /// Bytes of decoded streams.
    unpacked: Cell<u64>,
}

/// A page.
pub(super) struct Page {
    /// Left, bottom, right and top in units of the page.
    pub(super) sheet: [f64; 4],
    /// Clockwise, in quarter turns.
    pub(super) quarter_turns: i64,
    /// Length of a unit in points.
    pub(super) unit: f64,
    pub(super) resources: Dictionary,
    pub(super) content: Vec<u8>,
}

impl<'a> PdfFile<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self> {
        // Some programs write a few bytes before the header (ISO 32000-1, annex H).
        if find(bytes, b"%PDF-", 0).is_none_or(|at| at > 1024) {
            return Err(Error::input(
                "expected a PDF file that begins with `%PDF-`, found another beginning",
            ));
        }
        let mut file = Self {
            bytes,
            places: BTreeMap::new(),
            streams: Vec::new(),
            trailer: Dictionary::new(),
            unpacked: Cell::new(0),
        };
        let packed = file.find_objects();
        if file.trailer.contains_key("Encrypt") {
            return Err(Error::unsupported(
                "expected a PDF without encryption, found an encrypted one: save it without a password and \
                 without restrictions",
            ));
        }
        for at in packed {
            file.add_packed(at)?;
        }
        Ok(file)
    }

    /// Finds all objects and trailers; returns the places of the streams of objects.
    fn find_objects(&mut self) -> Vec<usize> {
        let mut packed: Vec<usize> = Vec::new();
        let mut at = 0;
        while let Some(found) = find(self.bytes, b"obj", at) {
            at = found + 3;
            let Some(id) = self.number_of_object(found) else { continue };
            let mut lexer = Lexer::new(self.bytes, at);
            let object = lexer.object();
            // The search goes on behind what was read, also if it is damaged: time stays linear.
            at = at.max(lexer.at);
            let Ok(Some(object)) = object else { continue };
            self.places.insert(id, Place::InFile(found + 3));
            if let Object::Dictionary(entries) = object
                && lexer.takes(b"stream")
            {
                at = self.end_of_stream(&entries, lexer.at).1;
                match entries.get("Type").and_then(Object::name) {
                    Some("ObjStm") => packed.push(found + 3),
                    Some("XRef") => self.trailer.extend(entries),
                    _ => {}
                }
            }
        }
        let mut at = 0;
        while let Some(found) = find(self.bytes, b"trailer", at) {
            let mut lexer = Lexer::new(self.bytes, found + 7);
            if let Ok(Some(Object::Dictionary(entries))) = lexer.object() {
                self.trailer.extend(entries);
            }
            at = lexer.at.max(found + 7);
        }
        packed
    }

    /// The number of the object whose word `obj` is at a position.
    fn number_of_object(&self, at: usize) -> Option<u32> {
        let before = |end: usize, keeps: fn(u8) -> bool| {
            end - self.bytes[..end].iter().rev().take(12).take_while(|b| keeps(**b)).count()
        };
        let digit = |b: u8| b.is_ascii_digit();
        let generation = before(before(at, is_space), digit);
        let end = before(generation, is_space);
        let begin = before(end, digit);
        if end == generation || generation == before(at, is_space) {
            return None;
        }
        std::str::from_utf8(&self.bytes[begin..end]).ok()?.parse().ok()
    }

    /// Begin and end of the data of a stream; `at` is behind the word `stream`.
    fn end_of_stream(&self, entries: &Dictionary, at: usize) -> (usize, usize) {
        let begin = match self.bytes.get(at..) {
            Some([b'\r', b'\n', ..]) => at + 2,
            Some([b'\n' | b'\r', ..]) => at + 1,
            _ => at,
        };
        let length = match entries.get("Length") {
            Some(Object::Reference(_)) | None => None,
            Some(length) => length.number(),
        };
        let stated = begin.saturating_add(length.unwrap_or(0.0).max(0.0) as usize);
        if length.is_some()
            && stated <= self.bytes.len()
            && Lexer::new(self.bytes, stated).takes(b"endstream")
        {
            return (begin, stated);
        }
        let end = find(self.bytes, b"endstream", begin).unwrap_or(self.bytes.len());
        (begin, end)
    }

    /// Adds the objects of a stream, except those that are defined after it.
    fn add_packed(&mut self, place: usize) -> Result<()> {
        let Some((entries, content)) = self.stream_at(place)? else { return Ok(()) };
        let first = entries.get("First").and_then(Object::number).unwrap_or(0.0) as usize;
        let stream = self.streams.len();
        let mut lexer = Lexer::new(&content, 0);
        while lexer.at < first {
            let Some((id, offset)) = lexer.whole_number().zip(lexer.whole_number()) else { break };
            if !matches!(self.places.get(&id), Some(Place::InFile(other)) if *other > place) {
                self.places.insert(id, Place::InStream { stream, at: first + offset as usize });
            }
        }
        self.streams.push(content);
        Ok(())
    }

    /// The object that an object refers to; none if there is no such object.
    pub(super) fn resolved(&self, object: &Object) -> Result<Option<Object>> {
        let mut object = object.clone();
        for _ in 0..MAX_DEPTH {
            let Object::Reference(id) = object else { return Ok(Some(object)) };
            let (bytes, at) = match self.places.get(&id) {
                Some(Place::InFile(at)) => (self.bytes, *at),
                Some(Place::InStream { stream, at }) => (&self.streams[*stream][..], *at),
                None => return Ok(None),
            };
            if at > bytes.len() {
                return Ok(None);
            }
            match Lexer::new(bytes, at).object()? {
                Some(next) => object = next,
                None => return Ok(None),
            }
        }
        Err(Error::input(format!("expected at most {MAX_DEPTH} references in a row, found more")))
    }

    /// The value of a key, resolved.
    pub(super) fn value(&self, entries: &Dictionary, key: &str) -> Result<Option<Object>> {
        entries.get(key).map_or(Ok(None), |value| self.resolved(value))
    }

    /// The dictionary that is the value of a key; empty if there is none.
    pub(super) fn dictionary(&self, entries: &Dictionary, key: &str) -> Result<Dictionary> {
        Ok(match self.value(entries, key)? {
            Some(Object::Dictionary(found)) => found,
            _ => Dictionary::new(),
        })
    }

    /// Dictionary and decoded data of a stream; none if the object is no stream.
    pub(super) fn stream(&self, object: &Object) -> Result<Option<(Dictionary, Vec<u8>)>> {
        match object {
            Object::Reference(id) => match self.places.get(id) {
                Some(Place::InFile(at)) => self.stream_at(*at),
                _ => Ok(None),
            },
            _ => Ok(None),
        }
    }

    fn stream_at(&self, at: usize) -> Result<Option<(Dictionary, Vec<u8>)>> {
        let mut lexer = Lexer::new(self.bytes, at);
        let Some(Object::Dictionary(mut entries)) = lexer.object()? else { return Ok(None) };
        if !lexer.takes(b"stream") {
            return Ok(None);
        }
        // Its length may be an object of its own.
        if let Some(length) = self.value(&entries, "Length")? {
            entries.insert("Length".to_owned(), length);
        }
        let (begin, end) = self.end_of_stream(&entries, lexer.at);
        let names = self.list(&entries, "Filter")?;
        let options = self.list(&entries, "DecodeParms")?;
        let filters: Vec<(String, Dictionary)> = (names.iter().enumerate())
            .map(|(k, name)| {
                let own = options.get(k).and_then(Object::dictionary).cloned().unwrap_or_default();
                (name.name().unwrap_or_default().to_owned(), own)
            })
            .collect();
        let allowed = ALWAYS_ALLOWED_BYTES + MAX_EXPANSION * self.bytes.len() as u64;
        let content =
            decoded(&self.bytes[begin..end], &filters, allowed.saturating_sub(self.unpacked.get()))?;
        self.unpacked.set(self.unpacked.get() + content.len() as u64);
        Ok(Some((entries, content)))
    }

    /// The items of an array, or the only item.
    fn list(&self, entries: &Dictionary, key: &str) -> Result<Vec<Object>> {
        Ok(match self.value(entries, key)? {
            Some(Object::Array(items)) => items
                .iter()
                .map(|item| Ok(self.resolved(item)?.unwrap_or(Object::Word("null".to_owned()))))
                .collect::<Result<_>>()?,
            Some(item) => vec![item],
            None => Vec::new(),
        })
    }

    /// The groups of optional content (layers) that are switched off.
    pub(super) fn hidden_layers(&self) -> Result<Vec<Object>> {
        let root = self.dictionary(&self.trailer, "Root")?;
        let layers = self.dictionary(&root, "OCProperties")?;
        let configuration = self.dictionary(&layers, "D")?;
        let listed = |entries: &Dictionary, key: &str| {
            Ok::<_, Error>(self.value(entries, key)?.and_then(|v| v.array().map(<[Object]>::to_vec)))
        };
        let mut hidden = match configuration.get("BaseState").and_then(Object::name) {
            Some("OFF") => listed(&layers, "OCGs")?.unwrap_or_default(),
            _ => Vec::new(),
        };
        let shown = listed(&configuration, "ON")?.unwrap_or_default();
        hidden.retain(|layer| !shown.contains(layer));
        hidden.extend(listed(&configuration, "OFF")?.unwrap_or_default());
        Ok(hidden)
    }

    /// The only page.
    pub(super) fn page(&self) -> Result<Page> {
        let root = self.dictionary(&self.trailer, "Root")?;
        let mut pages = Vec::new();
        if let Some(tree) = root.get("Pages") {
            self.add_pages(tree, &Dictionary::new(), 0, &mut pages)?;
        }
        match &pages[..] {
            [entries] => self.page_of(entries),
            [] => Err(Error::input("expected a PDF with one page, found none: the file may be damaged")),
            _ => Err(Error::input(
                "expected a PDF with one page, found several: save the page with the views as a file of its \
                 own",
            )),
        }
    }

    /// Adds pages with what they inherit, until there are two.
    fn add_pages(
        &self,
        node: &Object,
        inherited: &Dictionary,
        depth: usize,
        pages: &mut Vec<Dictionary>,
    ) -> Result<()> {
        if depth > MAX_DEPTH || pages.len() > 1 {
            return Ok(());
        }
        let Some(Object::Dictionary(own)) = self.resolved(node)? else { return Ok(()) };
        let mut entries = inherited.clone();
        entries.extend(own);
        match self.value(&entries, "Kids")? {
            Some(Object::Array(kids)) => {
                entries.remove("Kids");
                kids.iter().try_for_each(|kid| self.add_pages(kid, &entries, depth + 1, pages))
            }
            _ => {
                pages.push(entries);
                Ok(())
            }
        }
    }

    fn page_of(&self, entries: &Dictionary) -> Result<Page> {
        let number = |key: &str, default: f64| {
            Ok::<f64, Error>(self.value(entries, key)?.and_then(|v| v.number()).unwrap_or(default))
        };
        let sides: Vec<f64> = self.list(entries, "MediaBox")?.iter().filter_map(Object::number).collect();
        let [a, b, c, d] = sides[..] else {
            return Err(Error::input("expected a page with a MediaBox of four numbers, found none"));
        };
        let content = match entries.get("Contents") {
            Some(content) => self.content(content)?,
            None => Vec::new(),
        };
        Ok(Page {
            sheet: [a.min(c), b.min(d), a.max(c), b.max(d)],
            quarter_turns: (number("Rotate", 0.0)? / 90.0).round() as i64,
            unit: number("UserUnit", 1.0)?,
            resources: self.dictionary(entries, "Resources")?,
            content,
        })
    }

    /// The content of a page: one stream, or several that follow each other.
    fn content(&self, content: &Object) -> Result<Vec<u8>> {
        if let Some((_, bytes)) = self.stream(content)? {
            return Ok(bytes);
        }
        let mut all = Vec::new();
        if let Some(Object::Array(parts)) = self.resolved(content)? {
            for part in &parts {
                if let Some((_, bytes)) = self.stream(part)? {
                    all.extend(bytes);
                    // A stream may end within a line.
                    all.push(b'\n');
                }
            }
        }
        Ok(all)
    }
}

/// The first place of a word from a position on.
pub(super) fn find(bytes: &[u8], word: &[u8], from: usize) -> Option<usize> {
    let left = bytes.get(from..)?;
    left.windows(word.len()).position(|window| window == word).map(|at| from + at)
}
