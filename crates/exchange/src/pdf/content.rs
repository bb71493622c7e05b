//! Draws the content of a page: paths, texts and forms.
//!
//! # References
//! ISO 32000-1:2008, section 8 (graphics), table 51 and the following (operators).

use super::file::{Page, PdfFile, find};
use super::state::{PathBuilder, State};
use super::syntax::{Dictionary, Lexer, Object, is_space};
use super::text::{Font, Run};
use crate::affine::Affine;
use crate::bezier::bezier;
use crate::dash_pattern::style_of_pattern;
use planish_estimate::{Error, Result};
use planish_solid::views::{Curve2, DrawnCurve};
use std::collections::{BTreeMap, HashMap};
use std::rc::Rc;

/// Maximum number of operators, counted again for each use of a form.
const MAX_OPERATORS: usize = 4_000_000;
/// Maximum number of curves; far above the drawing of a part.
const MAX_CURVES: usize = 200_000;
/// Maximum nesting of forms and of saved states.
const MAX_FORMS: usize = 16;
const MAX_STATES: usize = 4096;
/// Maximum number of operands of an operator.
const MAX_OPERANDS: usize = 4096;
/// Share of the page that a fill covers from which on it is the background.
const BACKGROUND: f64 = 0.8;

/// What a page draws. Lengths are in millimetres, y points up.
#[derive(Default)]
pub(super) struct Drawn {
    /// Strokes, with the numbers of their pens.
    pub(super) curves: Vec<(DrawnCurve, u32)>,
    /// Filled triangles.
    pub(super) triangles: Vec<[[f64; 2]; 3]>,
    pub(super) runs: Vec<Run>,
    /// What draws no edges: number and first path or operator of each kind.
    pub(super) ignored: BTreeMap<&'static str, (usize, String)>,
    /// Number of pictures.
    pub(super) pictures: usize,
    /// How many numbers of paths have 0, 1, 2 … digits behind the point.
    pub(super) decimals: [usize; 8],
    /// Length of a unit of the page in millimetres.
    pub(super) unit: f64,
}

pub(super) struct Painter<'a> {
    file: &'a PdfFile<'a>,
    state: State,
    saved: Vec<State>,
    path: PathBuilder,
    /// Whether the next painting operator also sets the clip.
    clips: bool,
    /// Of each open marked content, whether its layer is switched off.
    marked: Vec<bool>,
    hidden_layers: Vec<Object>,
    layer: String,
    text: [Affine; 2],
    pens: HashMap<String, u32>,
    fonts: HashMap<u32, Rc<Font>>,
    forms: HashMap<u32, Rc<(Dictionary, Vec<u8>)>>,
    operators: usize,
    paths: usize,
    /// Area of the page in mm².
    area: f64,
    /// Whether a dark fill covers the page, on which white lines are seen.
    is_dark: bool,
    drawn: Drawn,
}

impl<'a> Painter<'a> {
    /// Draws the page.
    pub(super) fn draw(file: &'a PdfFile<'a>, page: &Page) -> Result<Drawn> {
        let map = map_of_page(page);
        if !map.is_finite() {
            return Err(Error::input("expected a page with sides below 1e12, found larger ones"));
        }
        let [left, bottom, right, top] = page.sheet;
        let corners = [map.point([left, bottom]), map.point([right, top])];
        let clip = [0, 1].map(|k| [corners[0][k].min(corners[1][k]), corners[0][k].max(corners[1][k])]);
        let state = State {
            map,
            width: 1.0,
            dashes: Vec::new(),
            color: "0 G".to_owned(),
            fill: "0 g".to_owned(),
            is_transparent: false,
            clip,
            font: Rc::default(),
            size: 1.0,
            character_gap: 0.0,
            word_gap: 0.0,
            stretch: 1.0,
            leading: 0.0,
            rise: 0.0,
        };
        let mut painter = Self {
            file,
            state,
            saved: Vec::new(),
            path: PathBuilder::default(),
            clips: false,
            marked: Vec::new(),
            hidden_layers: file.hidden_layers()?,
            layer: String::new(),
            text: [Affine::IDENTITY; 2],
            pens: HashMap::new(),
            fonts: HashMap::new(),
            forms: HashMap::new(),
            operators: 0,
            paths: 0,
            area: (clip[0][1] - clip[0][0]) * (clip[1][1] - clip[1][0]),
            is_dark: false,
            drawn: Drawn { unit: 25.4 / 72.0 * page.unit, ..Drawn::default() },
        };
        painter.content(&page.content, &page.resources, 0)?;
        Ok(painter.drawn)
    }

    fn content(&mut self, content: &[u8], resources: &Dictionary, depth: usize) -> Result<()> {
        let mut lexer = Lexer::new(content, 0);
        let mut operands: Vec<Object> = Vec::new();
        let mut decimals = [0; 8];
        while let Some(object) = lexer.object()? {
            let Object::Word(operator) = object else {
                decimals[lexer.decimals.min(7)] += 1;
                operands.push(object);
                if operands.len() > MAX_OPERANDS {
                    return Err(Error::input(
                        "expected an operator behind its operands, found only operands",
                    ));
                }
                continue;
            };
            self.operators += 1;
            if self.operators > MAX_OPERATORS {
                return Err(Error::input(format!("expected at most {MAX_OPERATORS} operators, found more")));
            }
            match operator.as_str() {
                // The keywords are operands, too.
                "true" | "false" | "null" => {
                    operands.push(Object::Word(operator));
                    continue;
                }
                "BI" => {
                    skip_inline_picture(&mut lexer)?;
                    self.drawn.pictures += usize::from(self.is_shown());
                }
                "Do" => self.form(&operands, resources, depth)?,
                "Tf" => self.set_font(&operands, resources)?,
                "gs" => self.set_parameters(&operands, resources)?,
                "BDC" | "BMC" => self.begin_marked(&operator, &operands, resources)?,
                "EMC" => {
                    self.marked.pop();
                }
                // Others change colours, shades, or how text is rendered: they draw no lines.
                _ => {
                    if self.path_operator(&operator, &operands)? {
                        self.drawn.decimals.iter_mut().zip(decimals).for_each(|(all, own)| *all += own);
                    } else if !self.state_operator(&operator, &operands)? {
                        self.text_operator(&operator, &operands);
                    }
                }
            }
            decimals = [0; 8];
            operands.clear();
        }
        Ok(())
    }

    fn is_shown(&self) -> bool {
        !self.marked.contains(&true)
    }

    /// Operators that make and paint paths.
    fn path_operator(&mut self, operator: &str, operands: &[Object]) -> Result<bool> {
        let v: Vec<f64> = operands.iter().filter_map(Object::number).collect();
        let at = |x: f64, y: f64| self.state.map.point([x, y]);
        match (operator, &v[..]) {
            ("m", &[x, y]) => self.path.move_to(at(x, y)),
            ("l", &[x, y]) => self.path.line_to(at(x, y)),
            ("c", &[a, b, c, d, x, y]) => self.curve([at(a, b), at(c, d), at(x, y)]),
            ("v", &[c, d, x, y]) => self.curve([self.path.at, at(c, d), at(x, y)]),
            ("y", &[a, b, x, y]) => self.curve([at(a, b), at(x, y), at(x, y)]),
            ("h", _) => self.path.close(),
            ("re", &[x, y, w, h]) => {
                let corners = [at(x, y), at(x + w, y), at(x + w, y + h), at(x, y + h)];
                self.path.move_to(corners[0]);
                corners[1..].iter().for_each(|p| self.path.line_to(*p));
                self.path.close();
            }
            ("m" | "l" | "c" | "v" | "y" | "re", _) => {
                return Err(Error::input(format!(
                    "operator {} (`{operator}`): expected the numbers of a path, found {}",
                    self.operators,
                    v.len()
                )));
            }
            ("W" | "W*", _) => self.clips = true,
            ("S", _) => self.paint(true, false)?,
            ("s", _) => {
                self.path.close();
                self.paint(true, false)?;
            }
            ("f" | "F" | "f*", _) => self.paint(false, true)?,
            ("B" | "B*", _) => self.paint(true, true)?,
            ("b" | "b*", _) => {
                self.path.close();
                self.paint(true, true)?;
            }
            ("n", _) => self.paint(false, false)?,
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn curve(&mut self, [a, b, end]: [[f64; 2]; 3]) {
        let poles = [self.path.at, a, b, end];
        self.path.add(bezier(&poles), end);
    }

    fn paint(&mut self, strokes: bool, fills: bool) -> Result<()> {
        let path = std::mem::take(&mut self.path);
        self.path.at = path.at;
        let sets_clip = std::mem::take(&mut self.clips);
        if strokes || fills {
            self.paths += 1;
        }
        let bounds = joined_bounds(path.parts.iter().flatten());
        if self.is_shown() && (strokes || fills) {
            if fills {
                self.fill(&path, &bounds, strokes);
            }
            let is_white = is_white(&self.state.color) && !self.is_dark;
            if strokes && !self.state.is_transparent && !is_white {
                self.stroke(path.parts)?;
            }
        }
        if sets_clip {
            let clip = &mut self.state.clip;
            *clip = [0, 1].map(|k| [clip[k][0].max(bounds[k][0]), clip[k][1].min(bounds[k][1])]);
        }
        Ok(())
    }

    fn stroke(&mut self, parts: Vec<Vec<Curve2>>) -> Result<()> {
        let entity = format!("path {}", self.paths);
        let Some(style) = style_of_pattern(self.state.dashes.clone()) else {
            self.ignore("centre line", entity);
            return Ok(());
        };
        let scale = self.state.map.columns.iter().flatten().map(|c| c * c).sum::<f64>();
        let width = (1e4 * self.state.width * (0.5 * scale).sqrt()).round();
        let key = format!("{}/{}/{width}", self.layer, self.state.color);
        let next = self.pens.len() as u32;
        let pen = *self.pens.entry(key).or_insert(next);
        for curve in parts.into_iter().flatten() {
            let own = joined_bounds([&curve]);
            let clip = &self.state.clip;
            if curve.length() <= 0.0 || (0..2).any(|k| own[k][1] < clip[k][0] || own[k][0] > clip[k][1]) {
                continue;
            }
            if self.drawn.curves.len() >= MAX_CURVES {
                return Err(Error::input(format!("expected at most {MAX_CURVES} curves, found more")));
            }
            let is_finite = own.iter().flatten().all(|c| c.abs() < 1e12);
            if !is_finite {
                return Err(Error::input(format!("{entity}: expected coordinates below 1e12 mm")));
            }
            self.drawn.curves.push((DrawnCurve { curve, style, entity: entity.clone() }, pen));
        }
        Ok(())
    }

    /// Fills are arrowheads, characters and backgrounds.
    fn fill(&mut self, path: &PathBuilder, bounds: &[[f64; 2]; 2], is_stroked: bool) {
        let area = (bounds[0][1] - bounds[0][0]) * (bounds[1][1] - bounds[1][0]);
        if area >= BACKGROUND * self.area {
            self.is_dark = !is_white(&self.state.fill);
            return;
        }
        let triangles: Vec<_> = path.parts.iter().map(|part| triangle(part)).collect();
        match triangles.iter().all(Option::is_some) {
            true => self.drawn.triangles.extend(triangles.into_iter().flatten()),
            false if is_stroked => {}
            false => self.ignore("filled shape", format!("path {}", self.paths)),
        }
    }

    fn ignore(&mut self, kind: &'static str, entity: String) {
        self.drawn.ignored.entry(kind).or_insert((0, entity)).0 += 1;
    }

    /// Operators that change the state.
    fn state_operator(&mut self, operator: &str, operands: &[Object]) -> Result<bool> {
        let v: Vec<f64> = operands.iter().filter_map(Object::number).collect();
        match (operator, &v[..]) {
            ("q", _) => {
                if self.saved.len() >= MAX_STATES {
                    return Err(Error::input(format!(
                        "expected at most {MAX_STATES} saved states, found more"
                    )));
                }
                self.saved.push(self.state.clone());
            }
            ("Q", _) => {
                if let Some(state) = self.saved.pop() {
                    self.state = state;
                }
            }
            ("cm", &[a, b, c, d, e, f]) => {
                let own = Affine { columns: [[a, b], [c, d]], origin: [e, f] };
                self.state.map = self.state.map.after(&own);
                if !self.state.map.is_finite() {
                    return Err(Error::input("expected a matrix with numbers below 1e15, found larger ones"));
                }
            }
            ("w", &[width]) => self.state.width = width,
            ("d", _) => {
                let pattern = operands.first().and_then(Object::array).unwrap_or_default();
                self.state.dashes = pattern.iter().filter_map(Object::number).collect();
            }
            ("G" | "RG" | "K" | "SC" | "SCN", _) => self.state.color = color(operator, operands),
            ("g" | "rg" | "k" | "sc" | "scn", _) => self.state.fill = color(operator, operands),
            ("CS", _) => self.state.color = "0 G".to_owned(),
            ("cs", _) => self.state.fill = "0 g".to_owned(),
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// Parameters of the state from a dictionary of the resources.
    fn set_parameters(&mut self, operands: &[Object], resources: &Dictionary) -> Result<()> {
        let Some(name) = operands.first().and_then(Object::name) else { return Ok(()) };
        let states = self.file.dictionary(resources, "ExtGState")?;
        let entries = self.file.dictionary(&states, name)?;
        if let Some(width) = self.file.value(&entries, "LW")?.and_then(|v| v.number()) {
            self.state.width = width;
        }
        if let Some(opacity) = self.file.value(&entries, "CA")?.and_then(|v| v.number()) {
            self.state.is_transparent = opacity <= 0.0;
        }
        if let Some(Object::Array(dashes)) = self.file.value(&entries, "D")? {
            let pattern = dashes.first().and_then(Object::array).unwrap_or_default();
            self.state.dashes = pattern.iter().filter_map(Object::number).collect();
        }
        Ok(())
    }

    /// Marked content may be on a layer that is switched off.
    fn begin_marked(&mut self, operator: &str, operands: &[Object], resources: &Dictionary) -> Result<()> {
        let mut is_hidden = false;
        if let ("BDC", [Object::Name(tag), Object::Name(name)]) = (operator, operands)
            && tag == "OC"
        {
            let layers = self.file.dictionary(resources, "Properties")?;
            is_hidden = layers.get(name).is_some_and(|layer| self.hidden_layers.contains(layer));
            self.layer.clone_from(name);
        }
        if self.marked.len() >= MAX_STATES {
            return Err(Error::input(format!("expected at most {MAX_STATES} nested layers, found more")));
        }
        self.marked.push(is_hidden);
        Ok(())
    }

    /// Draws a form, or counts a picture.
    fn form(&mut self, operands: &[Object], resources: &Dictionary, depth: usize) -> Result<()> {
        let Some(name) = operands.first().and_then(Object::name) else { return Ok(()) };
        let objects = self.file.dictionary(resources, "XObject")?;
        let Some(Object::Reference(id)) = objects.get(name) else { return Ok(()) };
        let Some(Object::Dictionary(entries)) = self.file.resolved(&Object::Reference(*id))? else {
            return Ok(());
        };
        let is_hidden = entries.get("OC").is_some_and(|layer| self.hidden_layers.contains(layer));
        if is_hidden || !self.is_shown() {
            return Ok(());
        }
        if entries.get("Subtype").and_then(Object::name) == Some("Image") {
            self.drawn.pictures += 1;
            return Ok(());
        }
        if depth >= MAX_FORMS {
            return Err(Error::input(format!(
                "expected at most {MAX_FORMS} nested forms, found more: does `{name}` contain itself?"
            )));
        }
        if !self.forms.contains_key(id) {
            let Some(form) = self.file.stream(&Object::Reference(*id))? else { return Ok(()) };
            self.forms.insert(*id, Rc::new(form));
        }
        let Some(form) = self.forms.get(id).cloned() else { return Ok(()) };
        let (entries, content) = &*form;
        let (state, count) = (self.state.clone(), self.saved.len());
        if let Some(Object::Array(matrix)) = self.file.value(entries, "Matrix")? {
            self.state_operator("cm", &matrix)?;
        }
        let own = match entries.contains_key("Resources") {
            true => self.file.dictionary(entries, "Resources")?,
            false => resources.clone(),
        };
        self.content(content, &own, depth + 1)?;
        self.state = state;
        self.saved.truncate(count);
        Ok(())
    }

    fn set_font(&mut self, operands: &[Object], resources: &Dictionary) -> Result<()> {
        let [Object::Name(name), Object::Number(size)] = operands else { return Ok(()) };
        self.state.size = *size;
        let fonts = self.file.dictionary(resources, "Font")?;
        self.state.font = match fonts.get(name) {
            Some(Object::Reference(id)) => match self.fonts.get(id) {
                Some(font) => font.clone(),
                None => {
                    let font = Rc::new(Font::read(self.file, &self.file.dictionary(&fonts, name)?)?);
                    self.fonts.insert(*id, font.clone());
                    font
                }
            },
            _ => Rc::default(),
        };
        Ok(())
    }

    /// Operators that place and show text.
    fn text_operator(&mut self, operator: &str, operands: &[Object]) {
        let v: Vec<f64> = operands.iter().filter_map(Object::number).collect();
        match (operator, &v[..], operands.last()) {
            ("BT", ..) => self.text = [Affine::IDENTITY; 2],
            ("Tm", &[a, b, c, d, e, f], _) => {
                self.text = [Affine { columns: [[a, b], [c, d]], origin: [e, f] }; 2];
            }
            ("Td", &[x, y], _) => self.next_line([x, y]),
            ("TD", &[x, y], _) => {
                self.state.leading = -y;
                self.next_line([x, y]);
            }
            ("T*", ..) => self.next_line([0.0, -self.state.leading]),
            ("Tc", &[gap], _) => self.state.character_gap = gap,
            ("Tw", &[gap], _) => self.state.word_gap = gap,
            ("Tz", &[percent], _) => self.state.stretch = 0.01 * percent,
            ("TL", &[leading], _) => self.state.leading = leading,
            ("Ts", &[rise], _) => self.state.rise = rise,
            ("Tj", _, Some(Object::Text(string))) => self.show(string),
            ("'" | "\"", numbers, Some(Object::Text(string))) => {
                if let [word, character] = numbers {
                    (self.state.word_gap, self.state.character_gap) = (*word, *character);
                }
                self.next_line([0.0, -self.state.leading]);
                self.show(string);
            }
            ("TJ", _, Some(Object::Array(items))) => {
                for item in items {
                    match item {
                        Object::Text(string) => self.show(string),
                        Object::Number(back) => {
                            self.advance(-1e-3 * back * self.state.size * self.state.stretch)
                        }
                        _ => {}
                    }
                }
            }
            _ => {}
        }
    }

    fn next_line(&mut self, by: [f64; 2]) {
        let line = self.text[1].after(&Affine { origin: by, ..Affine::IDENTITY });
        self.text = [line; 2];
    }

    fn advance(&mut self, by: f64) {
        self.text[0] = self.text[0].after(&Affine { origin: [by, 0.0], ..Affine::IDENTITY });
    }

    fn show(&mut self, string: &[u8]) {
        let state = &self.state;
        let (text, widths) = state.font.text(string);
        let width = |(width, is_blank): &(f64, bool)| {
            let gap = state.character_gap + if *is_blank { state.word_gap } else { 0.0 };
            (width * state.size + gap) * state.stretch
        };
        let (by, rise, size) = (widths.iter().map(width).sum(), state.rise, state.size);
        let place = |text: &Affine| state.map.after(text).point([0.0, rise]);
        let begin = place(&self.text[0]);
        let up = state.map.turned(self.text[0].turned([0.0, size]));
        let after = self.text[0].after(&Affine { origin: [by, 0.0], ..Affine::IDENTITY });
        let run = Run { begin, end: place(&after), height: up[0].hypot(up[1]), text };
        self.advance(by);
        let is_finite = run.begin.iter().chain(&run.end).all(|c| c.is_finite());
        if self.is_shown() && is_finite && self.drawn.runs.len() < MAX_CURVES {
            self.drawn.runs.push(run);
        }
    }
}

/// Millimetres of the page as a viewer shows it, from units of the page.
fn map_of_page(page: &Page) -> Affine {
    let [left, bottom, right, top] = page.sheet;
    let mm = 25.4 / 72.0 * page.unit;
    let moved = Affine { origin: [-left, -bottom], ..Affine::IDENTITY };
    let (w, h) = (mm * (right - left), mm * (top - bottom));
    // Turned clockwise, and moved back to the first quadrant.
    let (columns, origin) = match page.quarter_turns.rem_euclid(4) {
        0 => ([[mm, 0.0], [0.0, mm]], [0.0, 0.0]),
        1 => ([[0.0, -mm], [mm, 0.0]], [0.0, w]),
        2 => ([[-mm, 0.0], [0.0, -mm]], [w, h]),
        _ => ([[0.0, mm], [-mm, 0.0]], [h, 0.0]),
    };
    Affine { columns, origin }.after(&moved)
}

/// The corners of a filled triangle.
fn triangle(part: &[Curve2]) -> Option<[[f64; 2]; 3]> {
    let mut corners: Vec<[f64; 2]> = Vec::new();
    for curve in part {
        let Curve2::Segment(a, b) = curve else { return None };
        for p in [a, b] {
            if !corners.contains(p) {
                corners.push(*p);
            }
        }
    }
    <[_; 3]>::try_from(corners).ok()
}

fn joined_bounds<'c>(curves: impl IntoIterator<Item = &'c Curve2>) -> [[f64; 2]; 2] {
    curves.into_iter().fold([[f64::MAX, f64::MIN]; 2], |all, curve| {
        let own = curve.bounds();
        [0, 1].map(|k| [all[k][0].min(own[k][0]), all[k][1].max(own[k][1])])
    })
}

/// A colour as a key.
fn color(operator: &str, operands: &[Object]) -> String {
    let words: Vec<String> = (operands.iter())
        .map(|operand| match operand {
            Object::Number(number) => format!("{number:.3}"),
            other => format!("{:?}", other.name()),
        })
        .collect();
    format!("{} {operator}", words.join(" "))
}

fn is_white(color: &str) -> bool {
    let numbers: Vec<f64> = color.split(' ').filter_map(|word| word.parse().ok()).collect();
    match numbers[..] {
        // Cyan, magenta, yellow and black are ink.
        [_, _, _, _] => numbers.iter().all(|c| *c <= 0.01),
        [_] | [_, _, _] => numbers.iter().all(|c| *c >= 0.99),
        _ => false,
    }
}

/// Skips the picture between `BI` and `EI`.
fn skip_inline_picture(lexer: &mut Lexer<'_>) -> Result<()> {
    let mut at = find(lexer.bytes, b"ID", lexer.at);
    while let Some(found) = at {
        let end = find(lexer.bytes, b"EI", found + 2);
        let Some(end) = end else { break };
        let is_end = lexer.bytes.get(end - 1).is_some_and(|b| is_space(*b))
            && lexer.bytes.get(end + 2).is_none_or(|b| is_space(*b));
        if is_end {
            lexer.at = end + 2;
            return Ok(());
        }
        // The data may contain the two letters.
        at = Some(end);
    }
    Err(Error::input("expected the end `EI` of a picture in the content, found none"))
}
