//! Quantities at the vertices of a surface or the points of a cloud.

/// Values at the vertices of a surface or the dots of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Quantities.
    Numbers(Vec<f64>),
    /// Kinds, as the field's categories number them.
    Kinds(Vec<u16>),
}

/// How values become colours.
#[derive(Debug, Clone, PartialEq)]
pub enum FieldKind {
    /// From small to large; on a logarithmic scale where they span much.
    Sequential,
    /// About zero; the limit of the colours, or what holds most of the values where none is given.
    Signed(Option<f64>),
    /// Kinds without an order, each with its name.
    Categories(Vec<(u16, String)>),
    /// Kinds in an order, each with its name.
    Steps(Vec<(u16, String)>),
}

/// A quantity over a surface or a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// A short name for scripts: `sigma`.
    pub key: String,
    /// What people read: `σ along the normal`.
    pub label: String,
    /// Its unit; empty for none.
    pub unit: String,
    /// The unit that people read and how many of it are one of [`Self::unit`], where that is another:
    /// millimetres of a thing in metres.
    pub shown: Option<(String, f64)>,
    /// How it becomes colours.
    pub kind: FieldKind,
    /// The values.
    pub values: Values,
}
