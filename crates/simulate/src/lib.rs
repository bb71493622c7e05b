//! Known truth: simulated measurements of surfaces that are known exactly.
//!
//! Input: options and a seed. Output: readings as a job would hold them, and the truth behind each of
//! them. The same options give the same bytes, at any number of threads.
//!
//! | module | what |
//! |---|---|
//! | form | smooth freeform surfaces in closed form |
//! | truth | any known surface: points, normals, samples, distances |
//! | virtual_sensor | range scanners and touch probes that measure it |
//! | sphere | the figures of the paper on Kalman spline fusion: a sphere found again by both filters |
//! | figure | line charts as SVG |
//! | render | what a camera sees of a textured object, under a lamp or projected stripes |
//! | pictures | the scenes `stereo` and `grid`: such pictures from several views |
//! | scans | the scene `scans`: several sensors, outliers, a misstated σ |
//! | bending | the scene `bending`: a sheet that bends without stretch between scans |
//! | contours | the scene `contours`: occluding contours of a hyperboloid or a carafe, two camera motions |
//! | readings | the scene `readings`: a contour, ranged from uncertain poses |
//! | views | the scene `views`: the outlines of a prism in three views, ranged so |
//! | shell | the scene `shell`: a mesh deformed by known controls, points, masks |
//! | turning | the scene `turning`: an object on a turntable, scanned at known times |
//! | vessel | the scene `vessel`: a surface of revolution seen from one side |
//!
//! ```
//! use planish_simulate::{ScanSceneOptions, scans};
//! # fn main() -> planish_estimate::Result<()> {
//! let scene = scans(&ScanSceneOptions { readings: 500, probe_points: 5, ..ScanSceneOptions::default() })?;
//! let reading = scene.set.scans[0].scan.world_from_scanner.apply(scene.set.scans[0].scan.points[0]);
//! let foot = scene.truth.foot(reading).expect("readings are finite");
//! assert!(foot.signed_distance.abs() < 20.0);
//! # Ok(())
//! # }
//! ```

mod bending;
mod contours;
mod figure;
mod form;
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
pub use pictures::{
    PictureScene, PictureSceneOptions, PictureSceneSummary, PictureTruth, ViewPose, write_picture_scene,
};
pub use readings::{ReadingsOptions, ReadingsSummary, write_readings_scene};
pub use render::{Exposure, Light, RayTarget, Texture};
pub use scans::{
    ScanFile, ScanScene, ScanSceneOptions, ScanSceneSummary, SensorTruth, TrueMotion, TruthSummary, scans,
    write_scan_scene, write_scans_scene,
};
pub use shell::{ShellSceneOptions, ShellSceneSummary, write_shell_scene};
pub use sphere::{
    SPHERE_COLUMNS, SphereOptions, SphereRow, sphere, sphere_csv, sphere_figure, sphere_forming,
};
pub use truth::{Truth, TruthFoot, TruthPoint};
pub use turning::{TurningOptions, turning, write_turning_scene};
pub use vessel::{VesselOptions, vessel, write_vessel_scene};
pub use views::{PRISM_MM, ViewsOptions, write_views_scene};
pub use virtual_sensor::{Optics, TrueReading, VirtualProbe, VirtualScan, VirtualScanner};
