//! Words of each format: keywords, separators and numbers that its reader treats specially.
//!
//! Random bytes rarely form a keyword. Inserted words take the damage past the first checks of a parser.

/// PLY headers.
pub(super) const PLY: &[&str] = &[
    "ply",
    "format",
    "ascii",
    "binary_little_endian",
    "binary_big_endian",
    "1.0",
    "element",
    "vertex",
    "face",
    // Grids of range scanners: rows of vertex numbers, which have to exist.
    "range_grid",
    "property",
    "list",
    "uchar",
    "int",
    "uint",
    "short",
    "float",
    "double",
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "sigma",
    "sigma_n_deg",
    "cxx",
    "cxy",
    "cxz",
    "cyy",
    "cyz",
    "czz",
    "k1",
    "k2",
    "d1x",
    "d1y",
    "d1z",
    "sigma_k",
    "vertex_indices",
    "vertex_index",
    "comment",
    "unit",
    "mm",
    // The grid size of the Stanford scans.
    "obj_info",
    "num_cols",
    "num_rows",
    // With the line end, so that the body starts at once and the rest of the header becomes data.
    "end_header\n",
    "\n",
    "\r\n",
];

/// Headers of plain point files, and what breaks their parsers.
pub(super) const TEXT: &[&str] = &[
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "sigma",
    "sigma_n_deg",
    "cxx",
    "cxy",
    "cxz",
    "cyy",
    "cyz",
    "czz",
    "#",
    "//",
    ",",
    ";",
    "\t",
    "\"",
    // A byte order mark, which spreadsheets write.
    "\u{feff}",
    "\r\n",
    // NaN as older C libraries of Windows print it.
    "1.#QNAN",
    "-nan(ind)",
    // Two bytes: damage can cut it, so readers meet text that is not UTF-8.
    "é",
    "\0",
];

/// PCD headers.
pub(super) const PCD: &[&str] = &[
    "VERSION",
    "FIELDS",
    "COLUMNS",
    "SIZE",
    "TYPE",
    // `COUNT`, `WIDTH` and `POINTS` promise sizes, which readers must compare with the file.
    "COUNT",
    "WIDTH",
    "HEIGHT",
    "VIEWPOINT",
    "POINTS",
    "DATA",
    "ascii",
    "binary",
    "binary_compressed",
    "x",
    "y",
    "z",
    "normal_x",
    "nx",
    "sigma",
    "F",
    "U",
    "I",
    "1",
    "2",
    "4",
    "8",
    // The name of padding fields.
    "_",
    "\n",
];

// A list can name itself (`a.conf`), leave its folder, or name a file without an end (`/dev/zero`).
/// Lists of scans (VRIP `.conf`).
pub(super) const LIST: &[&str] =
    &["bmesh", "camera", "#", "good.xyz", "a.conf", "a scan.xyz", "..", "/", "/dev/zero", "\r\n", "\0"];

/// Job files (TOML).
pub(super) const JOB: &[&str] = &[
    "unit",
    "\"mm\"",
    "[[scan]]",
    "[sensor.a]",
    "kind",
    "\"range\"",
    "\"touch\"",
    "\"normal\"",
    "sigma",
    "sigma_along",
    "sigma_across",
    "sensor",
    "file",
    "\"good.xyz\"",
    // A job that names itself.
    "\"a.toml\"",
    "pose",
    "translation",
    "quaternion_xyzw",
    "viewpoint",
    "direction",
    // Nesting, for parsers that recurse.
    "[[[[[[[[[[[[[[[[",
    "{",
    "}",
    "=",
    "'''",
    "\"\"\"",
    // A date: a TOML type that no key expects.
    "1979-05-27",
    "\\u0000",
    "\n",
];

/// Headers of saved models (safetensors).
pub(super) const JSON: &[&str] = &[
    "\"dtype\"",
    "\"shape\"",
    "\"data_offsets\"",
    "\"F64\"",
    "\"U32\"",
    "\"U8\"",
    // A type of the format that no model uses.
    "\"BF16\"",
    "null",
    "true",
    "[]",
    "{}",
    "[[[[[[[[",
    "sheet",
    "tube",
    "ball",
    "torus",
    "__metadata__",
    "knots_u",
    "cells",
    // Beyond the largest `f64`: infinity for some parsers, an error for others.
    "1e999",
    "\\\"",
    "schema",
];

// Special to OBJ: indices from the end (`-1`), indices without a texture (`//`), and continued lines.
/// OBJ statements.
pub(super) const OBJ: &[&str] = &[
    "v", "vn", "vt", "f", "l", "p", "o", "g", "s", "usemtl", "#", "unit", "mm", "/", "//", "-1", "\\\n", "\n",
];

// `4OFF` has four coordinates for each vertex; `1e400` is beyond the largest `f64`.
/// OFF headers.
pub(super) const OFF: &[&str] = &["OFF", "COFF", "4OFF", "BINARY", "#", "3", "4", "0", "-1", "1e400", "\n"];

// Options such as `-s` stand between the keyword and the name of the file.
/// Material files.
pub(super) const MTL: &[&str] = &["newmtl", "map_Kd", "Kd", "-s", "#", "a.png", " ", "\n"];

/// STL in text.
pub(super) const STL: &[&str] = &[
    "solid", "facet", "normal", "outer", "loop", "vertex", "endloop", "endfacet", "endsolid", "unit=mm", "\n",
];

/// The JSON chunk of GLB.
pub(super) const GLB: &[&str] = &[
    "\"asset\"",
    "\"meshes\"",
    "\"primitives\"",
    "\"attributes\"",
    "\"POSITION\"",
    "\"NORMAL\"",
    "\"indices\"",
    "\"mode\"",
    "\"accessors\"",
    "\"bufferViews\"",
    // Offsets, lengths and strides refer to each other; readers must check their sums for overflow.
    "\"byteStride\"",
    "\"byteOffset\"",
    "\"byteLength\"",
    "\"componentType\"",
    "5126",
    "5125",
    "5123",
    "\"count\"",
    "\"nodes\"",
    // Nodes can name each other as children, in a circle.
    "\"children\"",
    "\"matrix\"",
    "\"translation\"",
    "\"scenes\"",
    "\"sparse\"",
    "null",
    "[]",
    "{}",
    "[[[[[[[[",
    "1e999",
];

/// NumPy headers.
pub(super) const NPY: &[&str] = &[
    "descr",
    // Order and shape decide which numbers form a point.
    "fortran_order",
    "shape",
    "True",
    "False",
    "'<f8'",
    "'>f4'",
    "'|u1'",
    "'<i8'",
    "(",
    ")",
    ",",
    "{",
    "}",
    "L",
    "()",
];

/// The XML section of E57.
pub(super) const XML: &[&str] = &[
    "<",
    ">",
    "/>",
    "</",
    "type=\"Float\"",
    "type=\"Integer\"",
    "type=\"ScaledInteger\"",
    "minimum=",
    "maximum=",
    "scale=",
    "precision=\"single\"",
    "fileOffset=",
    "recordCount=",
    "cartesianX",
    "sphericalRange",
    "rowIndex",
    "cartesianInvalidState",
    "<![CDATA[",
    "]]>",
    "&amp;",
    // A character that XML forbids.
    "&#0;",
];

/// Camera calibrations (TOML).
pub(super) const CAMERA: &[&str] =
    &["unit", "\"m\"", "fx", "fy", "cx", "cy", "scale", "sigma_a", "sigma_b", "=", "[a]", "\n"];

/// Cameras with masks (TOML).
pub(super) const VIEWS: &[&str] = &[
    "unit", "[[view]]", "K", "R", "t", "P", "name", "mask", "contours", "held_out", "true", "sigma_px",
    "tracks", "=", "[", "]", "\n",
];

/// Poses of a mesh (TOML).
pub(super) const POSES: &[&str] = &[
    "controls",
    "blend",
    "[[rigid]]",
    "part",
    "motion",
    "\"held\"",
    "[[pose]]",
    "name",
    "move",
    "near",
    "within",
    "by",
    "control",
    "[[keyframe]]",
    "seconds",
    "weights",
    "=",
    "[",
    "]",
    "{",
    "}",
    "\n",
];

// The last number is 2³²: a width that wraps in 32 bits.
/// Netpbm headers.
pub(super) const PGM: &[&str] = &["P2", "P3", "P5", "P6", "255", "65535", "#", "\n", " ", "4294967296"];

/// Calibrations of projected stripes (TOML).
pub(super) const GRID: &[&str] = &[
    "unit",
    "sigma_px",
    "[camera]",
    "[projector]",
    "[stripes]",
    "K",
    "R",
    "t",
    "directions_deg",
    "spacing",
    "origin",
    "range",
    "[",
    "]",
    "=",
    "1e308",
    "nan",
    // The limits of `i32`: the number of stripes in a range must not overflow.
    "2147483647",
    "-1024",
];

/// Light calibrations (TOML).
pub(super) const LIGHTS: &[&str] = &[
    "unit",
    "frame",
    "\"viewer\"",
    "\"camera\"",
    "lights",
    "[ball]",
    "images",
    "mask",
    "pixel_size",
    "sigma_brightness",
    "sigma_light_deg",
    "[",
    "]",
    "1e308",
    "nan",
    "=",
];

/// STEP entities.
pub(super) const STEP: &[&str] = &[
    "ISO-10303-21;",
    "DATA;",
    "ENDSEC;",
    "END-ISO-10303-21;",
    "#1",
    "#12",
    "#30",
    "=",
    "(",
    ")",
    ",",
    ";",
    "'",
    "$",
    "*",
    ".T.",
    ".F.",
    "/*",
    "*/",
    "0.",
    "1.E300",
    "-1.E-300",
    "999999999",
    "LINE",
    "CIRCLE",
    "PLANE",
    "CYLINDRICAL_SURFACE",
    "CONICAL_SURFACE",
    "SPHERICAL_SURFACE",
    "TOROIDAL_SURFACE",
    "OFFSET_SURFACE",
    "SURFACE_OF_REVOLUTION",
    "SURFACE_OF_LINEAR_EXTRUSION",
    "VERTEX_LOOP",
    "ORIENTED_FACE",
    // Assemblies, whose parts can contain each other.
    "MAPPED_ITEM",
    "SHAPE_REPRESENTATION",
    "SHAPE_REPRESENTATION_RELATIONSHIP",
];

/// DXF group codes and entities.
pub(super) const DXF: &[&str] = &[
    "SECTION",
    "ENDSEC",
    "HEADER",
    "TABLES",
    "BLOCKS",
    "ENTITIES",
    "EOF",
    "LAYER",
    "BLOCK",
    "ENDBLK",
    // Blocks that are inserted into blocks; one can contain itself.
    "INSERT",
    "LINE",
    "ARC",
    "CIRCLE",
    "ELLIPSE",
    "LWPOLYLINE",
    "POLYLINE",
    "VERTEX",
    "SEQEND",
    "SPLINE",
    "DIMENSION",
    "TEXT",
    "HATCH",
    "HIDDEN",
    "CENTER",
    "BYLAYER",
    "BYBLOCK",
    "part",
    "$INSUNITS",
    // Codes with line ends: each stands on a line of its own, before its value.
    "\n0\n",
    "\n2\n",
    "\n8\n",
    "\n10\n",
    "\n20\n",
    "\n40\n",
    "\n41\n",
    "\n42\n",
    "\n50\n",
    "\n70\n",
    "\n71\n",
    "\n230\n",
    "1e308",
    "nan",
    // Formatting in texts of dimensions, and the placeholder of the measured value.
    "\\A1;",
    "%%c",
    "<>",
    "\r\n",
];

/// SVG elements and path commands.
pub(super) const SVG: &[&str] = &[
    "<svg>",
    "</svg>",
    "<g>",
    "</g>",
    "<path d='",
    "'/>",
    "<line ",
    "<rect ",
    "<circle ",
    "<style>",
    // Entities, which can grow without bounds when they are expanded.
    "<!DOCTYPE svg [",
    "<!ENTITY a '",
    "&a;",
    "]>",
    "transform='",
    "matrix(",
    "rotate(",
    "scale(",
    // An infinite tangent.
    "skewX(90)",
    ")",
    "viewBox='",
    "width='",
    "mm",
    "px",
    "%",
    "M",
    "m",
    "L",
    "A",
    "C",
    "S",
    "Q",
    "T",
    "Z",
    "H",
    "V",
    // An arc without radius.
    "0 0 0 1 1",
    "stroke-dasharray",
    "points='",
    "1e308",
    "nan",
    "-",
    ".",
    "e",
    ",",
    "<![CDATA[",
    "&#0;",
];

/// Headers of planar readings, and CARMEN logs.
pub(super) const READINGS: &[&str] = &[
    "x",
    "y",
    "z",
    "heading_deg",
    "azimuth_deg",
    "elevation_deg",
    "range",
    "sigma",
    "sigma_x",
    "sigma_y",
    "sigma_z",
    "sigma_heading_deg",
    "sigma_range",
    "pose_id",
    "time",
    "level",
    "FLASER",
    "PARAM",
    "#",
    ",",
    "\n",
    "1e308",
    "nan",
    "inf",
    "-1",
    "0",
    "180",
    "4294967296",
];

/// Identified contours (JSON).
pub(super) const CONTOUR: &[&str] = &[
    "\"kind\"",
    "\"circle\"",
    "\"ellipse\"",
    "\"rectangle\"",
    "\"polygon\"",
    "\"line\"",
    "\"parameters\"",
    "\"value\"",
    "\"sigma\"",
    "\"order\"",
    "\"covariance\"",
    "\"contours\"",
    "\"hole_of\"",
    "\"level\"",
    "\"unit\"",
    "\"mm\"",
    "\"constrained\"",
    "\"constraints\"",
    "\"radius\"",
    "\"x0\"",
    "null",
    "[]",
    "{}",
    "[[[[[[[[",
    "1e999",
    "-1",
    "0",
];
