//! Findings: what a user should know about a result, as data.
//!
//! A job collects [`Finding`]s in its report. The terminal, the HTML page and the JSON output show this list.
//! Programs decide by [`FindingCode`], never by the words: codes are stable, texts are not.

use crate::setting::Setting;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::fmt;

/// Severity of a finding; the larger, the more serious.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FindingLevel {
    /// As expected.
    #[default]
    Info,
    /// Needs attention.
    Warning,
    /// The result cannot be trusted until this is resolved.
    Error,
}

impl FindingLevel {
    /// The name in the JSON output.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

// One registry: the variant, its stable code, its level and its meaning are stated once.
macro_rules! codes {
    ($($variant:ident = $code:literal, $level:ident: $meaning:literal,)*) => {
        /// The kind of a finding.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        // Later versions add codes, so programs need a default case.
        #[non_exhaustive]
        pub enum FindingCode {
            $(#[doc = $meaning] $variant,)*
        }

        impl FindingCode {
            /// All codes, by command.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// The stable identifier, such as `depth-limit`.
            #[must_use]
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$variant => $code,)*
                }
            }

            /// The level of every finding with this code.
            #[must_use]
            pub fn level(self) -> FindingLevel {
                match self {
                    $(Self::$variant => FindingLevel::$level,)*
                }
            }

            /// The meaning in one sentence.
            #[must_use]
            pub fn meaning(self) -> &'static str {
                match self {
                    $(Self::$variant => $meaning,)*
                }
            }
        }
    };
}

codes! {
    // fit
    SensorSigmaMisstated = "sensor-sigma-misstated", Warning:
        "The residuals of a sensor are inconsistent with its stated σ; the estimate is used.",
    LargerResiduals = "larger-residuals", Warning:
        "Residuals are larger than the stated σ, perhaps by gross errors; the estimate is used.",
    SensorSigmaCautious = "sensor-sigma-cautious", Info:
        "The residuals of a sensor are smaller than its stated σ, which is kept.",
    SharedErrors = "shared-errors", Warning:
        "Readings agree far better than their stated σ: their errors count as shared by neighbours.",
    SigmaNotEstimable = "sigma-not-estimable", Warning:
        "A sensor states no σ and has too few readings to estimate it.",
    SigmaTooSmall = "sigma-too-small", Warning:
        "Held-out readings differ from the surface by more than the predicted σ.",
    SigmaTooLarge = "sigma-too-large", Warning:
        "Held-out readings differ from the surface by less than the predicted σ.",
    SigmaConsistent = "sigma-consistent", Info: "Held-out readings agree with the predicted σ.",
    Converged = "converged", Info: "The fit converged.",
    NotConverged = "not-converged", Warning:
        "The fit or the alignment reached the limit of iterations before it converged.",
    DepthLimit = "depth-limit", Warning: "The maximum subdivision depth leaves shape unresolved.",
    CoefficientLimit = "coefficient-limit", Warning:
        "The maximum number of coefficients was reached before the residuals were noise.",
    SurfaceNotFollowing = "surface-not-following", Warning:
        "The surface does not follow all readings: an edge, a handle, a thin part or a wrong shape.",
    UnresolvedShape = "unresolved-shape", Warning:
        "The cells or controls are too far apart for part of the shape.",
    PatchErrorsCorrelated = "patch-errors-correlated", Warning:
        "Residuals in some patches are correlated at the maximum depth.",
    SurfaceFolded = "surface-folded", Warning:
        "The surface passes through itself, or its σ is smaller than all readings allow.",
    SurfaceMisfit = "surface-misfit", Warning:
        "The surface does not follow its readings in some places, which the report lists.",
    SurfaceRefused = "surface-refused", Error:
        "The surface does not follow much of its readings; the result was forced.",
    MostlyUnmeasured = "mostly-unmeasured", Warning: "Less than half of the surface was measured.",
    EdgesSmooth = "edges-smooth", Warning:
        "The readings show sharp edges at which the surface is smooth.",
    OpeningsClosed = "openings-closed", Warning:
        "Parts of a closed surface have no readings: they follow from the smoothness prior.",
    ManyRejected = "many-rejected", Warning: "More than a tenth of the readings was rejected.",
    NormalsMismatch = "normals-mismatch", Warning:
        "The normals of many readings disagree with the surface near them.",
    NormalsUnreliable = "normals-unreliable", Warning:
        "Stated normals of a scan contradict its neighbouring readings and were estimated instead.",
    PointsNotFinite = "points-not-finite", Warning:
        "Points have coordinates that are not finite; they are ignored.",
    PointsUnclassified = "points-unclassified", Warning:
        "Lidar points have no classes: the sheet includes buildings and trees.",
    CurvaturesUnused = "curvatures-unused", Warning: "Curvatures state no σ and are not used.",
    DuplicateReadings = "duplicate-readings", Warning:
        "Two scans share readings to the last digit; these count once.",
    ScanAddedTwice = "scan-added-twice", Warning:
        "The points of a scan were added to the model before.",
    ScanMisfit = "scan-misfit", Error: "A scan does not fit the others.",
    ScansApart = "scans-apart", Warning: "Scans are farther apart than their sizes.",
    FarFromOrigin = "far-from-origin", Warning: "The points are so far from the origin that digits are lost.",
    PoseSigmaUnused = "pose-sigma-unused", Warning: "σ of poses is stated but not used.",
    BiasUnused = "bias-unused", Warning: "σ of the bias of a sensor is stated but not used.",
    PoseUndetermined = "pose-undetermined", Warning:
        "The readings do not determine all six directions of a pose.",
    MotionUnsteady = "motion-unsteady", Warning:
        "A scan is far from where a steady motion would have the object.",
    SheetStretched = "sheet-stretched", Warning: "A state of a bending sheet was stretched.",
    UnitAssumed = "unit-assumed", Warning: "A file states no unit; one was assumed.",
    UnitImplausible = "unit-implausible", Warning:
        "No file states its unit, and the object has an unusual size in the assumed one.",
    UnitConverted = "unit-converted", Warning: "A file was converted to another unit.",
    MeshTriangleLimit = "mesh-triangle-limit", Warning:
        "The chord error of the mesh was enlarged to limit the number of triangles.",
    MeshSubdivisionLimit = "mesh-subdivision-limit", Warning:
        "Some cells need more triangles for the chord error than a cell may have.",
    StlPrecision = "stl-precision", Warning: "The seven digits of STL are too few for the mesh.",
    RasterOverhangs = "raster-overhangs", Warning:
        "Cells of the raster are under an overhang and have no height.",
    RasterEmpty = "raster-empty", Warning: "No cell of the raster has a height.",
    // compare
    CommonOffset = "common-offset", Warning:
        "The model is offset from the reference along its normals by the same distance everywhere.",
    CoverageConsistent = "coverage-consistent", Info:
        "The share of reference points within 1.96 σ is near 95 %.",
    CoverageLow = "coverage-low", Warning:
        "Fewer reference points than expected are within 1.96 σ: σ is too small.",
    CoverageVeryLow = "coverage-very-low", Error: "Less than 70 % of the reference points are within 1.96 σ.",
    CoverageHigh = "coverage-high", Warning:
        "More reference points than expected are within 1.96 σ: σ is too large.",
    ModelWithoutSigma = "model-without-sigma", Warning:
        "The model has no σ, so that its uncertainty cannot be checked.",
    FilesExchanged = "files-exchanged", Warning:
        "The model has points only and the reference a surface: they were exchanged.",
    DeviationsBiased = "deviations-biased", Warning: "Most deviations have the same sign.",
    ReferenceWithoutFaces = "reference-without-faces", Warning:
        "The reference has no faces: only its points are compared.",
    ReferenceNormalsOpposed = "reference-normals-opposed", Warning:
        "Most normals of the reference are opposite to those of the model.",
    // next
    GoalReached = "goal-reached", Info: "The planned measurements reach the goal.",
    GoalNotReached = "goal-not-reached", Warning: "The planned measurements do not reach the goal.",
    FewerViews = "fewer-views", Warning:
        "Fewer views than requested were planned, because more would not reduce σ.",
    AreaUnseen = "area-unseen", Warning: "None of the compared poses sees a part of the area.",
    // view, info, verify
    FileDefective = "file-defective", Error: "A file is damaged, inconsistent or cannot be read.",
    ModelWithoutChecksums = "model-without-checksums", Warning:
        "A saved model has no checksums, so damage may stay undetected.",
    PictureEmpty = "picture-empty", Warning: "The image is empty.",
    PointsThinned = "points-thinned", Warning: "Only some of the points are shown or compared.",
    MeshDefects = "mesh-defects", Warning: "The mesh has edges, triangles or vertices with defects.",
    // merge
    PatchDuplicate = "patch-duplicate", Warning: "A patch repeats another one and is ignored.",
    PatchIsolated = "patch-isolated", Warning: "A patch overlaps no other patch.",
    PatchUnused = "patch-unused", Warning: "The mesh has no vertex of a patch.",
    PatchReversed = "patch-reversed", Warning: "A patch faced the other way and was reversed.",
    PatchFacingUnknown = "patch-facing-unknown", Warning:
        "The bound does not determine which way a part faces.",
    PatchesDiffer = "patches-differ", Warning:
        "Overlapping patches differ as if they were of different objects.",
    PatchNotAligned = "patch-not-aligned", Warning:
        "A patch was not aligned, because it overlaps too little.",
    AlignmentMisfit = "alignment-misfit", Warning: "A patch does not fit its neighbours after the alignment.",
    SelfCrossing = "self-crossing", Warning: "A patch or the merged mesh crosses itself.",
    TrianglesRemoved = "triangles-removed", Warning:
        "Triangles were removed, because their edges belong to two others.",
    FacesSkipped = "faces-skipped", Warning: "Faces of a STEP file were skipped.",
    NonmanifoldEdges = "nonmanifold-edges", Error: "Edges of the merged mesh have more than two faces.",
    SeveralParts = "several-parts", Warning: "The merged mesh has several separate parts.",
    MeshClosed = "mesh-closed", Info: "The merged mesh is watertight.",
    MeshOpen = "mesh-open", Info: "The merged mesh has a boundary.",
    SigmaFromOverlaps = "sigma-from-overlaps", Warning:
        "σ was estimated from the differences of overlapping patches.",
    SplinePartsOmitted = "spline-parts-omitted", Warning:
        "The spline omits small parts of the merged surface.",
    SplineHandlesOmitted = "spline-handles-omitted", Warning:
        "The spline has other handles than the merged surface.",
    // contour
    LengthsInPixels = "lengths-in-pixels", Warning: "Lengths are in pixels, because no pixel size is stated.",
    ReadingsIsolated = "readings-isolated", Warning: "Readings far from all others are not used.",
    ReadingsOnNoWall = "readings-on-no-wall", Warning: "Readings of a room lie on no wall.",
    PartNotFitted = "part-not-fitted", Warning: "No contour could be fitted to a part of the readings.",
    KindAmbiguous = "kind-ambiguous", Warning: "Another kind explains the readings nearly as well.",
    ResidualsInconsistent = "residuals-inconsistent", Warning:
        "Residuals of a contour are inconsistent with the stated σ.",
    BeyondGate = "beyond-gate", Warning: "Many readings of a contour are beyond the gate and are rejected.",
    GivenInconsistent = "given-inconsistent", Warning: "Given constraints are inconsistent with the \
        readings.",
    ConstraintsConflict = "constraints-conflict", Error: "Given constraints conflict.",
    ReadingsConsistent = "readings-consistent", Info: "The readings agree with the contour within their σ.",
    // solid
    EntitiesSkipped = "entities-skipped", Warning: "Entities of a drawing that draw no edges are skipped.",
    EntityWithoutLength = "entity-without-length", Warning:
        "An entity of a drawing has no length and is ignored.",
    DimensionMismatch = "dimension-mismatch", Warning: "A dimension of a drawing differs from what is drawn.",
    LineRepeated = "line-repeated", Warning: "A line occurs twice in a drawing and counts once.",
    DrawingInexact = "drawing-inexact", Warning:
        "Ends or sizes of a drawing nearly agree, or an outline is open.",
    LinesUnexplained = "lines-unexplained", Warning:
        "The solid explains most lines of a picture, but not all.",
    DetailsMerged = "details-merged", Warning:
        "Lines of a picture are so close that they merge, and details may be lost.",
    SheetSetAside = "sheet-set-aside", Info: "Lines of a sheet belong to no view.",
    ScaleApplied = "scale-applied", Info: "Lengths of a drawing are multiplied by its scale.",
    ScaleUnknown = "scale-unknown", Warning: "The scale of a sheet is not known.",
    PictureStraightened = "picture-straightened", Info:
        "Rotation or perspective of a scanned or photographed sheet was corrected.",
    ProjectionOpen = "projection-open", Warning: "A sheet shows a solid in both conventions of projection.",
    SectionUsed = "section-used", Info: "A hatched section of a sheet is a view.",
    HiddenLinesOmitted = "hidden-lines-omitted", Warning:
        "Views draw no hidden lines, so what only these would show is not determined.",
    ToleranceEstimated = "tolerance-estimated", Warning:
        "Coordinates that nearly agree are treated as equal to find a solid.",
    SectionSetAside = "section-set-aside", Warning:
        "A section contradicts the solid of the complete views, and was not used.",
    DiametersUsed = "diameters-used", Info:
        "Diameters, centre lines or the style of a drawing show what is round.",
    NoSolid = "no-solid", Error: "No solid explains all lines.",
    RepairFound = "repair-found", Warning: "A drawing shows a solid after few edits, which are listed.",
    DrawingRepaired = "drawing-repaired", Warning:
        "The solid is that of a drawing after the edits that are listed.",
    SolidsUndecided = "solids-undecided", Error:
        "Several solids have these views, and nothing on the drawing prefers one of them.",
    SolidUnique = "solid-unique", Info: "Exactly one solid has these views.",
    TwoViews = "two-views", Warning:
        "Two views leave open whether faces along the missing direction are flat or round.",
    SolidsAmbiguous = "solids-ambiguous", Warning: "Several solids have these views.",
    StepUndecided = "step-undecided", Warning:
        "The height of a step between two sections is known only to lie between their levels.",
    SearchIncomplete = "search-incomplete", Warning: "There may be more solids than were examined.",
    ViewsConsistent = "views-consistent", Info: "The views agree within their σ.",
    ViewsInconsistent = "views-inconsistent", Warning: "The views differ more than their σ predicts.",
    GraphNotWritten = "graph-not-written", Warning: "No composite graph could be written.",
    // sense
    FewMatches = "few-matches", Warning: "Few pixels of the stereo pair have a match.",
    CrossingsInconsistent = "crossings-inconsistent", Warning:
        "Few crossings of stripes agree with the calibration.",
    BrightnessInconsistent = "brightness-inconsistent", Warning:
        "Brightness differs from that of a matte surface.",
    NormalsMissing = "normals-missing", Warning: "Many pixels of the object have no normal.",
    ImagesSaturated = "images-saturated", Warning: "Saturated readings were not used.",
    DepthCoarse = "depth-coarse", Warning: "The depth image has only 8 bits.",
    StripWithoutMesh = "strip-without-mesh", Warning: "A strip of occluding contours has no triangles.",
    StripWithoutSpline = "strip-without-spline", Warning:
        "No surface could be fitted to a strip of occluding contours.",
    ReadingsSparse = "readings-sparse", Warning: "There are few readings for the shapes that were asked for.",
    LandmarkRejected = "landmark-rejected", Warning:
        "A landmark contradicts the other readings and was not used.",
    HullBetter = "hull-better", Warning:
        "The visual hull alone agrees better with held-out views than the surface.",
    MasksContradictory = "masks-contradictory", Warning:
        "Masks show background where other views show the object, or the reverse.",
    // shell
    MaterialsMissing = "materials-missing", Warning: "A material file is missing.",
    TextureIgnored = "texture-ignored", Warning: "Only one of several textures is used.",
    TextureUnreadable = "texture-unreadable", Warning: "The picture of a texture cannot be read.",
    TextureDropped = "texture-dropped", Warning: "The texture is missing in the output.",
    TextureIncomplete = "texture-incomplete", Warning: "Triangles have no place in the texture.",
    TextureShared = "texture-shared", Warning: "Parts of the mesh share a place of the texture.",
    SigmaAssumed = "sigma-assumed", Warning: "Points state no σ; one was assumed.",
    MaskInverted = "mask-inverted", Warning: "A mask seems to be inverted.",
    MaskMismatch = "mask-mismatch", Warning: "The mesh hardly appears in a mask before the fit.",
    MaskNotReached = "mask-not-reached", Warning: "The fitted mesh and a mask overlap too little.",
    HeldOutView = "held-out-view", Info: "The mesh overlaps the mask of a held-out view.",
    HeldOutViewMisfit = "held-out-view-misfit", Warning:
        "The mesh and the mask of a held-out view overlap too little.",
    ManyOutliers = "many-outliers", Warning: "More than a third of the readings are outliers.",
    MeshFolded = "mesh-folded", Warning: "The mesh folded over at some edges.",
    MeshStretched = "mesh-stretched", Warning: "Edges of the mesh grew far more than others.",
    FacetLimit = "facet-limit", Warning: "The maximum number of facets is too small for spherical metaballs.",
    DeviationLarge = "deviation-large", Warning:
        "A meshed surface is farther than a cell from the exact surface somewhere.",
    PartsLost = "parts-lost", Warning: "Parts thinner than a cell are missing in a meshed surface.",
    FacetsInconsistent = "facets-inconsistent", Warning:
        "The facets of the mesh do not all face the same way.",
    ViewInconsistent = "view-inconsistent", Warning:
        "The colours of a view differ from those of the others; it is not used.",
}

impl fmt::Display for FindingCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl Serialize for FindingCode {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

/// One statement about a result.
///
/// # Examples
/// ```
/// use planish_core::{Finding, FindingCode, FindingLevel, Setting};
/// let finding = Finding::new(FindingCode::DepthLimit, "raise the maximum depth for more detail")
///     .with_setting(Setting::MaxDepth)
///     .in_context("patch 2");
/// assert_eq!(finding.text, "patch 2: raise the maximum depth for more detail");
/// assert_eq!((finding.code.as_str(), finding.level), ("depth-limit", FindingLevel::Warning));
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Its kind.
    pub code: FindingCode,
    /// Its severity, which follows from the code.
    pub level: FindingLevel,
    /// The statement: one or two sentences, without a capital and a full stop at the ends.
    pub text: String,
    /// Settings that would change it. The command prints the names of their options.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub settings: Vec<Setting>,
}

impl Finding {
    /// Creates a finding.
    #[must_use]
    pub fn new(code: FindingCode, text: impl Into<String>) -> Self {
        // The level follows from the code: programs could not rely on codes with different levels.
        Self { code, level: code.level(), text: text.into(), settings: Vec::new() }
    }

    /// The same finding with a setting that would change it.
    #[must_use]
    pub fn with_setting(mut self, setting: Setting) -> Self {
        self.settings.push(setting);
        self
    }

    /// The same finding with words in front: `context: text`.
    #[must_use]
    pub fn in_context(mut self, context: impl fmt::Display) -> Self {
        self.text = format!("{context}: {}", self.text);
        self
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// Serialises findings as two keys, for `#[serde(flatten, serialize_with = …)]`: `warnings` holds the texts
/// of level [`FindingLevel::Warning`], `findings` everything.
///
/// Programs that were written before there were codes read `warnings`.
///
/// # Errors
/// Those of the serializer.
///
/// # Examples
/// ```
/// use planish_core::finding::{Finding, FindingCode, with_warnings};
/// #[derive(serde::Serialize)]
/// struct Report {
///     #[serde(flatten, serialize_with = "with_warnings")]
///     findings: Vec<Finding>,
/// }
/// let findings = vec![
///     Finding::new(FindingCode::Converged, "the fit converged"),
///     Finding::new(FindingCode::RasterEmpty, "no cell has a height"),
/// ];
/// let json = serde_json::to_value(Report { findings })?;
/// assert_eq!(json["warnings"], serde_json::json!(["no cell has a height"]));
/// assert_eq!(json["findings"][0]["code"], "converged");
/// # Ok::<(), serde_json::Error>(())
/// ```
pub fn with_warnings<S: Serializer>(findings: &[Finding], serializer: S) -> Result<S::Ok, S::Error> {
    let warnings: Vec<&str> = (findings.iter())
        .filter(|finding| finding.level == FindingLevel::Warning)
        .map(|finding| finding.text.as_str())
        .collect();
    let mut map = serializer.serialize_map(Some(2))?;
    map.serialize_entry("warnings", &warnings)?;
    map.serialize_entry("findings", findings)?;
    map.end()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn codes_are_unique_and_explained() {
        let codes: BTreeSet<&str> = FindingCode::ALL.iter().map(|code| code.as_str()).collect();
        assert_eq!(codes.len(), FindingCode::ALL.len());
        for code in FindingCode::ALL {
            let plain = |c: char| c.is_ascii_lowercase() || c == '-';
            assert!(code.as_str().chars().all(plain), "{code}");
            assert!(code.meaning().ends_with('.') && !code.meaning().contains("--"), "{code}");
        }
    }
}
