//! A picture of a sheet: straightened, without its frame, title block and texts.

use super::frame::clear_frame;
use super::ink::Ink;
use super::paper_edge::Quad;
use super::straighten::{Perspective, Placement, mapped};
use crate::dxf::PicturePlacement;
use crate::glyphs::{PictureText, read_words};
use nalgebra::Matrix3;
use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_sense::Image;
use planish_solid::sheet::SheetDimension;

/// Probability from which the number of a dimension is used.
const READ: f64 = 0.9;

/// Probability from which the pixels of a word are no part of a view.
const CLEAR: f64 = 0.8;

/// Ink of the views of a picture, and how the sheet lies in it.
pub(super) struct SheetPicture {
    pub(super) ink: Ink,
    /// Whether it is a scan, a photograph or a sheet with a frame.
    pub(super) is_sheet: bool,
    has_frame: bool,
    placement: Option<Placement>,
    picture_from_sheet: Matrix3<f64>,
    pub(super) texts: PictureText,
}

/// Clears the pixels of clear words. Line work may look like a word.
fn clear_words(ink: &mut Ink, texts: &PictureText) {
    for word in texts.words.iter().filter(|w| w.confidence >= CLEAR) {
        let range = |k: usize, size: usize| {
            let low = word.corners.iter().map(|c| c[k]).fold(f64::MAX, f64::min) - 0.3 * word.height;
            let high = word.corners.iter().map(|c| c[k]).fold(f64::MIN, f64::max) + 0.3 * word.height;
            low.max(0.0) as usize..(high.max(0.0) as usize + 1).min(size)
        };
        for y in range(1, ink.rows) {
            for x in range(0, ink.columns) {
                if texts.mask[y * ink.columns + x] {
                    ink.clear(y * ink.columns + x);
                }
            }
        }
    }
}

impl SheetPicture {
    /// Reads a picture.
    ///
    /// # Errors
    /// `Input` if there is no ink.
    pub(super) fn read(image: &Image) -> Result<Self> {
        let none = || Error::input("expected a picture of a drawing with dark lines, found none");
        let page = Quad::find(image);
        let mut ink = Ink::new(image, page.as_ref()).ok_or_else(none)?;
        let mut placement = Placement::find(&ink, page.as_ref());
        if let Some(placement) = &mut placement {
            ink = placement.resampled(&ink, page.as_ref()).ok_or_else(|| {
                Error::input(
                    "expected a picture of a sheet seen from the front, found one that is too slanted",
                )
            })?;
        }
        let has_frame = clear_frame(&mut ink);
        let is_sheet = has_frame || placement.is_some();
        let texts = if is_sheet { read_words(&ink.image()) } else { read_words(image) };
        if is_sheet {
            clear_words(&mut ink, &texts);
        }
        let inverse = placement.as_ref().and_then(|p| p.sheet_from_picture.try_inverse());
        let picture_from_sheet = inverse.unwrap_or_else(Matrix3::identity);
        Ok(Self { ink, is_sheet, has_frame, placement, picture_from_sheet, texts })
    }

    /// Dimensions in pixels of the ink.
    pub(super) fn dimensions(&self) -> Vec<SheetDimension> {
        self.texts.dimensions(self.ink.rows, READ)
    }

    /// The place in the picture of a pixel of the ink.
    pub(super) fn in_picture(&self, p: [f64; 2]) -> [f64; 2] {
        mapped(&self.picture_from_sheet, p)
    }

    /// What was left out, and how the picture was straightened. `thin`: number of thin lines.
    pub(super) fn left_out(&self, thin: usize) -> Vec<Finding> {
        let mut parts = Vec::new();
        if self.has_frame {
            parts.push("the frame with its title block".to_owned());
        }
        let words = self.texts.words.iter().filter(|w| w.confidence >= CLEAR).count();
        if words > 0 && self.is_sheet {
            parts.push(format!("{words} × text"));
        }
        if thin > 0 {
            parts.push(format!("{thin} × thin line or arrowhead"));
        }
        let mut findings = Vec::new();
        if !parts.is_empty() {
            let text = format!("left out as no part of a view: {}", parts.join(", "));
            findings.push(Finding::new(FindingCode::SheetSetAside, text));
        }
        if let Some(placement) = &self.placement {
            let [angle, sigma] = [placement.rotation_rad, placement.sigma_rad].map(f64::to_degrees);
            let turned = format!("rotated by {angle:.3}° (σ {sigma:.3}°)");
            let text = match placement.perspective {
                Perspective::None => format!("the sheet is {turned} in the picture; this was corrected"),
                Perspective::PageOfSeriesA => format!(
                    "the sheet is {turned} and seen in perspective; this was corrected, and the page is \
                     assumed to be of the A series (1 : √2)"
                ),
                Perspective::UnknownRatio => format!(
                    "the sheet is {turned} and seen in perspective; this was corrected, but the ratio of \
                     height to width is not known: equal scales are assumed in the middle of the picture"
                ),
            };
            findings.push(Finding::new(FindingCode::PictureStraightened, text));
        }
        findings
    }

    /// How the sheet lies in the picture.
    pub(super) fn placement(&self) -> Option<PicturePlacement> {
        let placement = self.placement.as_ref()?;
        let m = &placement.sheet_from_picture;
        Some(PicturePlacement {
            sheet_from_picture: [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)] / m[(2, 2)])),
            rotation_rad: placement.rotation_rad,
            sigma_rad: placement.sigma_rad,
            perspective: match placement.perspective {
                Perspective::None => "none",
                Perspective::PageOfSeriesA => "page-of-series-a",
                Perspective::UnknownRatio => "unknown-ratio",
            },
        })
    }
}
