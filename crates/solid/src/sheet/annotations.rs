//! What a file says about a sheet beside its curves.

/// What accompanies the curves of a sheet.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Annotations {
    /// The pen of each curve: a number for layer, colour, weight and line type. Without pens, all curves have
    /// the same.
    pub pens: Vec<u32>,
    /// Texts outside of dimensions.
    pub texts: Vec<SheetText>,
    /// Outlines of hatched regions; a point is hatched if it is inside of an odd number of them.
    pub hatches: Vec<Vec<[f64; 2]>>,
    /// Straight chain lines: lines of symmetry, and marks of cutting planes.
    pub centre_lines: Vec<[[f64; 2]; 2]>,
    /// Corners of filled triangles, such as arrowheads.
    pub arrowheads: Vec<[[f64; 2]; 3]>,
    /// Dimensions of lengths.
    pub dimensions: Vec<SheetDimension>,
    /// The factor other than 1 from lengths of the drawing to the lengths that dimensions would state, as the
    /// file sets it (`DIMLFAC`).
    pub length_factor: Option<f64>,
    /// Ends of the lengths that dimensions state as diameters (Ø), seen from the side or along the axis.
    pub diameters: Vec<[[f64; 2]; 2]>,
}

/// A text.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetText {
    /// Where it begins, or its middle.
    pub at: [f64; 2],
    /// The text without codes for its format.
    pub text: String,
}

/// A dimension of a length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SheetDimension {
    /// The length between its points in the drawing.
    pub drawn: f64,
    /// The length that its text states.
    pub stated: f64,
    /// Half of the last digit of the text; zero if the length is known to all digits.
    pub rounding: f64,
}

impl Annotations {
    /// The pen of a curve.
    pub(super) fn pen(&self, curve: usize) -> u32 {
        self.pens.get(curve).copied().unwrap_or(0)
    }
}
