//! Simulated measurements with known ground truth.
//!
//! Input: options with a seed. Output: readings in the form that a job reads, and the true value of each
//! reading. The same options give the same bytes, for any number of threads.
//!
//! | module | contents |
//! |---|---|
//! | form | smooth freeform surfaces in closed form |
//! | truth | a known surface: points, normals, samples, distances |
//! | virtual_sensor | range scanners and touch probes that measure a known surface |
//! | sphere | figures 2 and 3 of the paper on Kalman spline fusion: a sphere, estimated by both filters |
//! | figure | line charts as SVG |
//! | render | images of a textured object under a lamp or projected stripes |
//! | pictures | the scenes `stereo` and `grid`: such images from several views |
//! | scans | the scene `scans`: several sensors, outliers, a misstated σ |
//! | objects | solid objects of known genus: rings, a plate, a cup, a bracket |
//! | object_scenes | the scenes `handles`, `plate`, `cup` and `bracket`: such an object, scanned all around |
//! | bending | the scene `bending`: a sheet that bends without stretch between scans |
//! | contours | the scene `contours`: occluding contours of a hyperboloid or a carafe, two camera motions |
//! | readings | the scene `readings`: ranges to a contour from uncertain poses |
//! | views | the scene `views`: ranges to the outlines of a prism in three views |
//! | shell | the scene `shell`: a mesh that is deformed by known controls, with points and masks |
//! | turning | the scene `turning`: an object on a turntable, scanned at known times |
//! | vessel | the scene `vessel`: a surface of revolution, seen from one side |
//!
//! # Examples
//! Simulate a complete scene in memory. The truth gives the error of every reading:
//!
//! ```
//! use planish_simulate::{ScanSceneOptions, scans};
//! # fn main() -> planish_estimate::Result<()> {
//! let scene = scans(&ScanSceneOptions { readings: 500, probe_points: 5, ..ScanSceneOptions::default() })?;
//! let scan = &scene.set.scans[0].scan;
//! let reading = scan.world_from_scanner.apply(scan.points[0]);
//! let foot = scene.truth.foot(reading).expect("readings are finite");
//! assert!(foot.signed_distance.abs() < 20.0);
//! # Ok(())
//! # }
//! ```
//!
//! Or measure a surface of your own with a single sensor:
//!
//! ```
//! use planish_core::DVec3;
//! use planish_sense::{Noise, Pose};
//! use planish_simulate::{Optics, Truth, VirtualScanner};
//! use planish_spline::Shape;
//! # fn main() -> planish_estimate::Result<()> {
//! let truth = Truth::freeform(Shape::Sheet, 100.0, 7)?;
//! // The scanner looks along −z, from 300 above the sheet.
//! let pose = Pose { translation: DVec3::new(0.0, 0.0, 300.0), ..Pose::identity() };
//! let noise = Noise::Isotropic { sigma: 0.05 };
//! let scanner = VirtualScanner::new("top", pose, Optics::Parallel { half: [60.0; 2] }, [40, 40], noise);
//! let measured = scanner.scan(&truth, 1)?;
//! // Rays that miss the sheet give no reading; every other one comes with the point that it hit.
//! assert!(measured.scan.points.len() > 800);
//! assert_eq!(measured.scan.points.len(), measured.truth.len());
//! # Ok(())
//! # }
//! ```

mod bending;
mod contours;
mod figure;
mod form;
mod object_scenes;
mod objects;
#[cfg(test)]
mod pair_tests;
mod pictures;
mod readings;
mod render;
mod scans;
mod second_order;
mod shell;
mod sphere;
mod truth;
mod turning;
mod vessel;
mod views;
mod virtual_sensor;

#[cfg(test)]
mod tests;

pub use bending::{BendingOptions, bending, in_bending_hole, write_bending_scene};
pub use contours::{ContoursOptions, ContoursShape, ContoursSummary, write_contours_scene};
pub use form::{BallBump, BallForm, BentForm, ClosedForm, SheetBump, SheetForm, TubeForm, TubeWave};
pub use object_scenes::{ObjectScene, ObjectSceneOptions, object_scene, write_object_scene};
pub use objects::{
    BracketForm, CupForm, HandlesForm, ObjectKind, ObjectMesh, PlateForm, SolidObject, TrueEdge, TrueFillet,
    TrueHole,
};
pub use pictures::{
    PictureScene, PictureSceneOptions, PictureSceneSummary, PictureTruth, ViewPose, write_picture_scene,
};
pub use readings::{ReadingsOptions, ReadingsSummary, write_readings_scene};
pub use render::{Exposure, Light, RaySurface, Texture};
pub use scans::{
    ObjectTruth, ScanFile, ScanScene, ScanSceneOptions, ScanSceneSummary, SensorTruth, TrueMotion,
    TruthSummary, scans, write_scan_scene, write_scans_scene,
};
pub use shell::{ShellSceneOptions, ShellSceneSummary, write_shell_scene};
pub use sphere::{
    SPHERE_COLUMNS, SphereOptions, SphereRow, sphere, sphere_csv, sphere_figure, sphere_forming,
};
pub use truth::{Truth, TruthFoot, TruthPoint};
pub use turning::{TurningOptions, turning, write_turning_scene};
pub use vessel::{VesselOptions, vessel, write_vessel_scene};
pub use views::{PRISM_MM, ViewsOptions, write_views_scene};
pub use virtual_sensor::{Optics, ScannedSurface, TrueReading, VirtualProbe, VirtualScan, VirtualScanner};
