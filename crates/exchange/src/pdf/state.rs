//! The state of graphics and text, and paths while they are built.

use super::text::Font;
use crate::affine::Affine;
use planish_solid::views::Curve2;
use std::rc::Rc;

/// The state that `q` saves.
#[derive(Clone)]
pub(super) struct State {
    pub(super) map: Affine,
    pub(super) width: f64,
    pub(super) dashes: Vec<f64>,
    pub(super) color: String,
    pub(super) fill: String,
    pub(super) is_transparent: bool,
    pub(super) clip: [[f64; 2]; 2],
    pub(super) font: Rc<Font>,
    pub(super) size: f64,
    pub(super) character_gap: f64,
    pub(super) word_gap: f64,
    pub(super) stretch: f64,
    pub(super) leading: f64,
    pub(super) rise: f64,
}

/// Commands of a path, in millimetres.
#[derive(Default)]
pub(super) struct PathBuilder {
    /// Curves of each connected part.
    pub(super) parts: Vec<Vec<Curve2>>,
    pub(super) begin: [f64; 2],
    pub(super) at: [f64; 2],
}

impl PathBuilder {
    pub(super) fn move_to(&mut self, p: [f64; 2]) {
        (self.begin, self.at) = (p, p);
        self.parts.push(Vec::new());
    }

    pub(super) fn add(&mut self, curve: Curve2, end: [f64; 2]) {
        if self.parts.is_empty() {
            self.parts.push(Vec::new());
        }
        if let Some(part) = self.parts.last_mut() {
            part.push(curve);
        }
        self.at = end;
    }

    pub(super) fn line_to(&mut self, p: [f64; 2]) {
        self.add(Curve2::Segment(self.at, p), p);
    }

    pub(super) fn close(&mut self) {
        let begin = self.begin;
        if self.at != begin {
            self.line_to(begin);
        }
        // What follows without `m` begins there.
        self.at = begin;
    }
}
