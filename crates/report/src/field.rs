//! Quantities at the vertices of a surface or the points of a cloud, and how they are coloured.

/// Values at the vertices of a surface or the points of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Quantities.
    Numbers(Vec<f64>),
    /// Numbers of categories; [`FieldKind`] holds their names.
    Kinds(Vec<u16>),
}

/// How values are mapped to colours.
#[derive(Debug, Clone, PartialEq)]
pub enum FieldKind {
    /// From small to large; on a logarithmic scale if the range is large.
    Sequential,
    /// Positive and negative values. The limit of the scale is given, or covers all but 2 % of the values at
    /// each end.
    Signed(Option<f64>),
    /// Colours themselves, as numbers `65536 r + 256 g + b` with `r`, `g` and `b` from 0 to 255. Unknown ones
    /// are not finite.
    Colours,
    /// Categories without an order, each with its name.
    Categories(Vec<(u16, String)>),
    /// Categories with an order, each with its name.
    Steps(Vec<(u16, String)>),
}

/// A quantity over a surface or a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// A short name for scripts: `sigma`.
    pub key: String,
    /// A label for readers: `σ along the normal`.
    pub label: String,
    /// Its unit; empty for none.
    pub unit: String,
    /// The displayed unit and its conversion factor, if it differs from [`Self::unit`]: `("mm", 1000.0)` for
    /// a model in metres.
    pub shown: Option<(String, f64)>,
    /// Mapping to colours.
    pub kind: FieldKind,
    /// The values.
    pub values: Values,
}
