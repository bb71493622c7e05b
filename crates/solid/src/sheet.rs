//! Finds the views of a part on a sheet, and sets aside what else is drawn there.
//!
//! **Input.** The curves of one file, what accompanies them ([`Annotations`]: pens, texts, hatches,
//! arrowheads and dimensions), and options. **Output.** A [`SheetReading`]: the views in the part's
//! coordinates and in its true size, and why each other curve was left out.
//!
//! 1. A rectangle that contains everything else is a frame. It is left out with all that touches it (zones,
//!    title block) and all that lies within its title block (the projection symbol).
//! 2. Curves with an arrowhead are dimensions, leaders or marks. Of the pens, those whose curves mostly have
//!    a free end draw annotations: edges of a part end at other edges. Of the other pens beside that of the
//!    outlines, curves with a free end are left out.
//! 3. Curves whose bounding boxes touch form groups. The views are the groups that are aligned with one of
//!    them, the front view, and agree with it in their extents; of several choices, that with the most
//!    curves. Details and pictorial views align with none.
//! 4. The scale is that of the dimensions, or of the title block if the frame has the size of a paper.
//!
//! A hatched group is a section: the part behind a cutting plane, marked in another view. It may take
//! the place of a view, or be a further one.
//!
//! **Limits.** Sections are full, by one plane across the line of sight: half sections and offset ones
//! are read as if they were, and their solids are refused.
//!
//! # References
//! ISO 128 (lines, views), ISO 5456-2 (projection), ISO 5457 (frames), ISO 7200 (title blocks).

mod annotations;
mod axes;
mod choice;
mod contacts;
mod frame;
mod groups;
mod hidden_circles;
mod pens;
mod scale;
mod section;
#[cfg(test)]
mod tests;

use crate::drawing::{Drawing, DrawnCurve, Section, View, ViewContent, ViewKind};
use planish_estimate::{Error, Result};

pub use annotations::{Annotations, SheetDimension, SheetText};
pub(crate) use axes::circles_across;
use choice::Choice;
use contacts::Contacts;
use groups::{CurveGroup, grouped};
pub use hidden_circles::hidden_circles;
pub use scale::{ScaleSource, scale_of_dimensions};

/// Distance within which ends touch curves, relative to the size of the sheet. It covers coordinates with
/// four decimals; a larger value joins annotations to the part.
const TOUCHING: f64 = 1e-5;

/// Left and right, bottom and top.
pub type SheetBox = [[f64; 2]; 2];

/// Placement of the views around the front view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Projection {
    /// Used in Europe: the view from above is below the front view, that from the left is at its right.
    FirstAngle,
    /// Used in America: the view from above is above the front view, that from the right is at its right.
    ThirdAngle,
}

impl Projection {
    /// Its name in options and JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::FirstAngle => "first",
            Self::ThirdAngle => "third",
        }
    }
}

/// What is known about a sheet.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SheetOptions {
    /// The convention by which the views are placed; found from the sheet if none is given.
    pub projection: Option<Projection>,
    /// The places of the views on the sheet; found if empty.
    pub views: Vec<(ViewKind, SheetBox)>,
    /// The unit of the drawing in millimetres, by which a frame is compared with sizes of paper.
    pub unit_mm: f64,
}

/// Why a curve is not part of a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum SetAsideReason {
    /// A frame, or what touches it.
    Frame,
    /// A title block or a table.
    TitleBlock,
    /// A dimension, a leader, a mark or a symbol.
    Annotation,
    /// Hatching of a section.
    Hatching,
    /// A hatched section that is aligned with no view.
    Section,
    /// A view that is not aligned with the front view: a detail, a pictorial or an auxiliary view.
    OtherView,
    /// Not within the given places of the views.
    Outside,
}

impl SetAsideReason {
    /// Its description in messages and JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Frame => "frame",
            Self::TitleBlock => "title block or table",
            Self::Annotation => "dimension, leader or mark",
            Self::Hatching => "hatching",
            Self::Section => "section",
            Self::OtherView => "view that is not aligned with the front view",
            Self::Outside => "outside of the given views",
        }
    }
}

/// A view on the sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SheetView {
    /// The direction from which it is seen.
    pub kind: ViewKind,
    /// Where it is on the sheet.
    pub bounds: SheetBox,
    /// Coordinate of the cutting plane along the line of sight, if it is a section.
    pub section_at: Option<f64>,
}

/// The views of a sheet.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetReading {
    /// The views in the part's coordinates; the lower left corner of each is the origin.
    pub drawing: Drawing,
    /// The convention by which the views are placed.
    pub projection: Projection,
    /// Length of the part per length of the drawing.
    pub scale: f64,
    /// From what the scale is known.
    pub scale_source: ScaleSource,
    /// Where the views are.
    pub views: Vec<SheetView>,
    /// Whether outlines have equal widths in the only two views, so that they may be round or flat, and the
    /// sheet has neither centre lines nor diameters that show which.
    pub open_widths: bool,
    /// Whether a centre line crosses a view, which shows that something is round or symmetric.
    pub has_centre_lines: bool,
    /// Entities that belong to no view, and why.
    pub set_aside: Vec<(String, SetAsideReason)>,
}

/// Reads a sheet; the most plausible reading first. Other readings follow where the sheet leaves the
/// convention open, or where another front view explains nearly as many curves.
///
/// ```
/// use planish_solid::drawing::{Curve2, DrawnCurve, LineStyle, ViewKind};
/// use planish_solid::sheet::{Annotations, Projection, SheetOptions, read_sheet};
///
/// let rectangle = |x: f64, y: f64, width: f64, height: f64| {
///     let corners = [[x, y], [x + width, y], [x + width, y + height], [x, y + height]];
///     (0..4).map(move |k| DrawnCurve {
///         curve: Curve2::Segment(corners[k], corners[(k + 1) % 4]),
///         style: LineStyle::Visible,
///         entity: format!("line {k}"),
///     })
/// };
/// // A frame, the front view, and above it the view from above.
/// let frame = rectangle(-10.0, -10.0, 120.0, 100.0);
/// let (front, top) = (rectangle(0.0, 0.0, 40.0, 20.0), rectangle(0.0, 50.0, 40.0, 30.0));
/// let sheet: Vec<_> = frame.chain(front).chain(top).collect();
/// // Two views leave the convention open.
/// let options = SheetOptions { projection: Some(Projection::ThirdAngle), ..SheetOptions::default() };
/// let readings = read_sheet(&sheet, &Annotations::default(), &options)?;
/// let kinds: Vec<_> = readings[0].views.iter().map(|v| v.kind).collect();
/// assert_eq!(kinds, [ViewKind::Front, ViewKind::Top]);
/// assert_eq!((readings.len(), readings[0].projection), (1, Projection::ThirdAngle));
/// assert_eq!(readings[0].set_aside.len(), 4);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # Errors
/// `Input` if there are fewer than two aligned groups of curves, or none where the given convention places a
/// view. The message names an entity of the group.
pub fn read_sheet(
    curves: &[DrawnCurve],
    annotations: &Annotations,
    options: &SheetOptions,
) -> Result<Vec<SheetReading>> {
    let mut reader = SheetReader::new(curves, annotations);
    let found_frame = reader.set_aside_frames();
    reader.set_aside_tables();
    reader.set_aside_hatching();
    reader.set_aside_annotations();
    let scale = scale::scale_of(annotations, found_frame.as_ref(), options.unit_mm);
    let choices = match options.views.is_empty() {
        true => {
            choice::choices(&reader.groups()?, options.projection, found_frame.and_then(|f| f.projection))
                .map_err(|(group, text)| reader.explain(group, &text))?
        }
        false => vec![reader.given(&options.views, options.projection)?],
    };
    Ok(choices.iter().flat_map(|choice| reader.readings(choice, scale)).collect())
}

/// A sheet while its curves are sorted.
struct SheetReader<'a> {
    curves: &'a [DrawnCurve],
    annotations: &'a Annotations,
    contacts: Contacts,
    boxes: Vec<SheetBox>,
    /// Why each curve is left out; none while it may belong to a view.
    reasons: Vec<Option<SetAsideReason>>,
    /// Accuracy of contacts.
    near: f64,
    /// Lines that hatch sections.
    hatching: Vec<[[f64; 2]; 2]>,
}

impl<'a> SheetReader<'a> {
    fn new(curves: &'a [DrawnCurve], annotations: &'a Annotations) -> Self {
        let boxes: Vec<SheetBox> = curves.iter().map(|c| c.curve.bounds()).collect();
        let near = TOUCHING * groups::size_of_boxes(&boxes);
        let contacts = Contacts::new(curves, &boxes, near);
        Self {
            curves,
            annotations,
            contacts,
            boxes,
            reasons: vec![None; curves.len()],
            near,
            hatching: Vec::new(),
        }
    }

    fn is_left(&self, curve: usize) -> bool {
        self.reasons[curve].is_none()
    }

    fn set_aside(&mut self, curves: impl IntoIterator<Item = usize>, reason: SetAsideReason) {
        for curve in curves {
            self.reasons[curve].get_or_insert(reason);
        }
    }

    fn groups(&self) -> Result<Vec<CurveGroup>> {
        let left: Vec<usize> = (0..self.curves.len()).filter(|k| self.is_left(*k)).collect();
        let mut groups = grouped(&left, &self.boxes, groups::size_of_boxes(&self.boxes))?;
        for group in &mut groups {
            group.is_section = self.is_section(&group.bounds);
        }
        Ok(groups)
    }

    /// The groups at the given places.
    fn given(&self, places: &[(ViewKind, SheetBox)], projection: Option<Projection>) -> Result<Choice> {
        let mut views = Vec::new();
        for (kind, place) in places {
            let within = |k: &usize| self.is_left(*k) && groups::is_within(&self.boxes[*k], place, self.near);
            let curves: Vec<usize> = (0..self.curves.len()).filter(within).collect();
            if curves.is_empty() {
                let [[left, right], [bottom, top]] = place;
                return Err(Error::input(format!(
                    "expected lines of the {} view from ({left}, {bottom}) to ({right}, {top}), found none",
                    kind.name()
                )));
            }
            let bounds = groups::joined_box(curves.iter().map(|k| self.boxes[*k]));
            let is_section = self.is_section(&bounds);
            views.push((*kind, CurveGroup { curves, bounds, is_section }));
        }
        Ok(Choice { views, projection: projection.unwrap_or(Projection::ThirdAngle), are_given: true })
    }

    fn explain(&self, group: Option<usize>, text: &str) -> Error {
        match group {
            Some(curve) => Error::input(format!("{}: {text}", self.curves[curve].entity)),
            None => Error::input(text.to_owned()),
        }
    }

    /// The readings of a choice of views; several if it has sections whose cutting planes are not marked.
    fn readings(&self, choice: &Choice, scale: (f64, ScaleSource)) -> Vec<SheetReading> {
        let sections = (0..choice.views.len()).filter(|v| choice.views[*v].1.is_section);
        let planes: Vec<(usize, Vec<(usize, f64)>)> =
            sections.map(|v| (v, self.planes_of(choice, v))).collect();
        let count = planes.iter().map(|(_, planes)| planes.len()).max().unwrap_or(1);
        (0..count)
            .map(|n| {
                // Unmarked sections of one sheet are tried in step.
                let at = |(v, planes): &(usize, Vec<(usize, f64)>)| {
                    planes.get(n.min(planes.len().saturating_sub(1))).map(|plane| (*v, *plane))
                };
                let planes: Vec<(usize, (usize, f64))> = planes.iter().filter_map(at).collect();
                self.reading(choice, &planes, scale)
            })
            .collect()
    }

    /// A reading with the cutting planes of its sections: the view that shows the plane, and its place there.
    fn reading(
        &self,
        choice: &Choice,
        planes: &[(usize, (usize, f64))],
        (scale, scale_source): (f64, ScaleSource),
    ) -> SheetReading {
        let near = choice::MAX_MISALIGNMENT * groups::size_of_boxes(&self.boxes);
        let origins: Vec<[f64; 2]> =
            (0..choice.views.len()).map(|v| self.origin_of(choice, v, near)).collect();
        let mut views: Vec<View> = (choice.views.iter().zip(&origins))
            .map(|((kind, group), origin)| self.placed(*kind, group, *origin))
            .collect();
        for (v, (other, at)) in planes {
            let shown = choice.views[*other].0;
            let k = usize::from(shown.axes()[1] == views[*v].kind.axes()[2]);
            let mut place = origins[*other];
            place[k] = *at;
            let to_part = into_part(shown, origins[*other]);
            let hatch = self.hatch_of(&choice.views[*v].1.bounds);
            let hatch = hatch.mapped(into_part(views[*v].kind, origins[*v]));
            views[*v].content = ViewContent::Section(Section { at: to_part(place)[k], hatch });
        }
        let places: Vec<SheetView> = (choice.views.iter().zip(&views))
            .map(|((kind, group), view)| SheetView {
                kind: *kind,
                bounds: group.bounds,
                section_at: view.section().map(|section| scale * section.at),
            })
            .collect();
        let round = self.candidates(choice, &views, &origins);
        let open_widths = round.as_ref().is_some_and(|round| round.are_open);
        views.extend(round.and_then(|round| round.view));
        let drawing = Drawing { views };
        let drawing = if scale == 1.0 { drawing } else { drawing.scaled(scale) };
        let mut is_used = vec![false; self.curves.len()];
        choice.views.iter().flat_map(|(_, group)| &group.curves).for_each(|k| is_used[*k] = true);
        let reason = |k: usize| match self.reasons[k] {
            Some(reason) => reason,
            None if choice.are_given => SetAsideReason::Outside,
            None if self.is_hatched(k) => SetAsideReason::Section,
            None => SetAsideReason::OtherView,
        };
        let unused = (0..self.curves.len()).filter(|k| !is_used[*k]);
        let mut set_aside: Vec<(String, SetAsideReason)> =
            unused.map(|k| (self.curves[k].entity.clone(), reason(k))).collect();
        // A polyline has several curves.
        set_aside.dedup();
        SheetReading {
            projection: choice.projection,
            scale,
            scale_source,
            views: places,
            drawing,
            open_widths,
            has_centre_lines: choice.views.iter().any(|(_, group)| self.has_centre_line(&group.bounds)),
            set_aside,
        }
    }

    /// Whether a centre line crosses a box.
    fn has_centre_line(&self, bounds: &SheetBox) -> bool {
        let middle = |line: &[[f64; 2]; 2]| [0, 1].map(|c| (line[0][c] + line[1][c]) / 2.0);
        let is_in = |p: [f64; 2]| groups::is_within(&[[p[0]; 2], [p[1]; 2]], bounds, self.near);
        self.annotations.centre_lines.iter().any(|line| is_in(middle(line)))
    }

    /// Whether a curve touches the box of a hatch.
    fn is_hatched(&self, curve: usize) -> bool {
        let points =
            |outline: &Vec<[f64; 2]>| outline.iter().map(|p| [[p[0]; 2], [p[1]; 2]]).collect::<Vec<_>>();
        let boxes = self.annotations.hatches.iter().map(|outline| groups::joined_box(points(outline)));
        boxes.into_iter().any(|hatch| groups::touch(&hatch, &self.boxes[curve], self.near))
    }

    /// The curves of a group as a view, in the part's coordinates.
    fn placed(&self, kind: ViewKind, group: &CurveGroup, origin: [f64; 2]) -> View {
        let at = into_part(kind, origin);
        let moved = |&k: &usize| DrawnCurve {
            curve: self.curves[k].curve.moved(&at, kind == ViewKind::Left),
            ..self.curves[k].clone()
        };
        View::new(kind, group.curves.iter().map(moved).collect())
    }
}

/// Coordinates of the part in a view whose origin is at a place of the sheet.
///
/// In a view from the left, y runs to the left. It is mirrored, so that y runs to the right in all views.
fn into_part(kind: ViewKind, origin: [f64; 2]) -> impl Fn([f64; 2]) -> [f64; 2] {
    let sign = if kind == ViewKind::Left { -1.0 } else { 1.0 };
    move |p| [sign * (p[0] - origin[0]), p[1] - origin[1]]
}
