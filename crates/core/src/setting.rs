//! Settings of jobs, by which errors and findings name what a user can change.
//!
//! A message names a setting in words, because a user of the library writes a field and a user of the command
//! an option. An error or a finding also holds the [`Setting`], and each user interface prints its own name.

use serde::{Serialize, Serializer};

// One registry: the variant, its stable name and its meaning are stated once.
macro_rules! settings {
    ($($variant:ident = $name:literal: $meaning:literal,)*) => {
        /// A setting of a job that a message is about.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Setting {
            $(#[doc = $meaning] $variant,)*
        }

        impl Setting {
            /// All settings, by name.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// The stable name, such as `max_depth`.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                }
            }
        }
    };
}

settings! {
    Align = "align": "Align scans or patches with each other.",
    Animation = "animation": "The file that shows how the model formed.",
    BelieveSigma = "believe_sigma": "Use σ of the points as stated.",
    Calibration = "calibration": "The calibration file.",
    CellSize = "cell_size": "Side of the cells of a raster.",
    Close = "close": "Whether the surface is closed where nothing was measured.",
    CompleteSmooth = "complete_smooth": "Complete gaps smoothly.",
    Constrain = "constrain": "Find constraints between contours.",
    Count = "count": "Number of points to plan.",
    Disparities = "disparities": "The range of disparities.",
    Epsilon = "epsilon": "Largest distance of overlapping patches.",
    EstimateSigma = "estimate_sigma": "Lower a stated σ to that of the residuals.",
    Filter = "filter": "How readings are fused.",
    Force = "force": "Keep a result that would be refused.",
    Gap = "gap": "Distance that separates parts of the readings.",
    Given = "given": "Constraints that are known.",
    Graphs = "graphs": "Files of constraint graphs.",
    Ground = "ground": "Fit the ground only.",
    Kind = "kind": "The kind of contour or shape.",
    KnownParameters = "known_parameters": "The grid of readings with known parameters.",
    Level = "level": "Significance level of tests.",
    MaxCoefficients = "max_coefficients": "Maximum number of coefficients.",
    MaxDepth = "max_depth": "Maximum subdivision depth.",
    MaxMemory = "max_memory": "Maximum memory of the process.",
    MeshTolerance = "mesh_tolerance": "Maximum chord error of meshes.",
    Motion = "motion": "How the object moves.",
    Patch = "patches": "Files of the patches of occluding contours.",
    PixelSize = "pixel_size": "Size of a pixel.",
    Projection = "projection": "The convention by which views are placed on a sheet.",
    Product = "product": "Use the product form of the equations.",
    RangeGate = "range_gate": "Ranges that are used.",
    Reference = "reference": "The reference of a comparison.",
    Region = "region": "The region that is used.",
    Repair = "repair": "Find the solid with the fewest edits of a drawing.",
    Scan = "first_scan": "The first scan of a log.",
    Scans = "scan_count": "Number of scans of a log.",
    Shape = "shape": "The topology of the surface.",
    SigmaHeading = "sigma_heading_deg": "Default σ of headings.",
    SigmaPoint = "sigma_point": "Default σ of points.",
    SigmaPosition = "sigma_position": "Default σ of positions.",
    SigmaRange = "sigma_range": "Default σ of ranges.",
    Snap = "snap": "The grid of rounded lengths.",
    Symmetry = "symmetry": "The symmetry that completes the surface.",
    Tolerance = "tolerance": "Where refinement stops, or which coordinates are joined.",
    Unit = "unit": "Unit of files without a unit.",
    ViewPlaces = "view_places": "Places of views on a sheet.",
    Views = "views": "Number of views to plan.",
}

// By its stable name, as programs read it from findings; variants may be renamed.
impl Serialize for Setting {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}
