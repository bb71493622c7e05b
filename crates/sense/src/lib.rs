//! Sensors: what a scan is, how its errors are modelled, which readings are not to be trusted, and which are
//! of the ground.

mod depth_camera;
mod edges;
mod ground;
mod image;
mod normals;
pub mod occluding;
mod photometric;
mod pose;
mod rectify;
mod scan;
mod sensor;
mod silhouette;
mod stereo;
mod stereo_camera;
pub mod stripes;
mod view_sensor;

pub use depth_camera::DepthCamera;
pub use edges::{EdgeOptions, EdgePoint, edge_points};
pub use ground::{Ground, GroundOptions, classify_ground};
pub use image::Image;
pub use normals::{
    CloudGeometry, ScanChecks, ScanGeometry, Suspicion, cloud_geometry, local_roughness, orient_normals,
    ray_at, scan_geometry,
};
pub use photometric::{
    NormalMap, PhotometricOptions, lights_from_ball, normals_from_colours, photometric_normals,
};
pub use pose::Pose;
pub use rectify::{LensCamera, Rectification, StereoRig};
pub use scan::{PrincipalCurvatures, RangeGrid, Scan, Viewing};
pub use sensor::{Noise, Sensor, SensorKind, variance_along};
pub use silhouette::{Silhouette, SilhouetteOptions, silhouette};
pub use stereo::{DisparityMap, StereoOptions, StereoRejected, match_stereo};
pub use stereo_camera::{StereoCamera, StereoPoints};
pub use view_sensor::ViewSensor;
