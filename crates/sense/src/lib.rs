//! Sensors: scans, error models of readings, checks of single readings, and methods that turn images into
//! scans.
//!
//! - [`Scan`], [`Sensor`], [`Noise`], [`Pose`]: points, their instrument, its errors, and where it stood.
//! - [`scan_geometry`]: normals, and marks for depth edges and grazing readings. [`classify_ground`]: bare
//!   earth.
//! - [`neighbour_noise`]: noise of readings from their neighbours, without a surface.
//! - [`match_stereo`], [`StereoCamera`], [`Rectification`]: dense stereo.
//! - [`photometric_normals`]: normals from images under several lights.
//! - [`stripes`]: normals and curvatures from crossed stripes. [`occluding`]: points from occluding contours.
//! - [`silhouette`], [`edge_points`]: borders and edges in images.
//! - [`ViewSensor`]: the rays of a sensor, for planning views.
//!
//! # Examples
//!
//! The covariance of a range reading is larger along its ray:
//! ```
//! use planish_core::DVec3;
//! use planish_sense::Noise;
//! let noise = Noise::Ray { sigma_along: 0.3, sigma_across: 0.1 };
//! let covariance = noise.covariance(Some(DVec3::Z));
//! assert!((covariance.along(DVec3::Z) - 0.09).abs() < 1e-12);
//! assert!((covariance.along(DVec3::X) - 0.01).abs() < 1e-12);
//! ```
//!
//! A pose carries points from the scanner's frame into the world:
//! ```
//! use planish_core::DVec3;
//! use planish_sense::Pose;
//! let world_from_scanner = Pose::from_rotation_vector(std::f64::consts::PI * DVec3::Z, DVec3::X);
//! let p = world_from_scanner.apply(DVec3::X);
//! assert!(p.length() < 1e-12);
//! ```

mod consensus;
mod depth_camera;
mod edges;
mod ground;
mod image;
mod neighbour_noise;
mod neighbours;
mod normals;
pub mod occluding;
mod photometric;
mod rectify;
mod scan;
mod sensor;
mod silhouette;
mod stereo;
mod stereo_camera;
pub mod stripes;
mod view_sensor;

pub use consensus::{MIN_FOR_CONSENSUS, Neighbourhoods, SurfaceConsensus, surface_consensus};
pub use depth_camera::DepthCamera;
pub use edges::{EdgeOptions, EdgePoint, edge_points};
pub use ground::{Ground, GroundOptions, classify_ground};
pub use image::Image;
pub use neighbour_noise::{NeighbourNoise, SharedNeighbourNoise, neighbour_noise};
pub use normals::{
    CloudGeometry, PointFlag, ScanChecks, ScanGeometry, cloud_geometry, local_roughness, orient_normals,
    ray_at, scan_geometry,
};
pub use photometric::{
    NormalMap, PhotometricOptions, ReadingCounts, lights_from_ball, normals_from_colours, photometric_normals,
};
pub use planish_core::{Pinhole, Pose};
pub use rectify::{LensCamera, Rectification, StereoRig};
pub use scan::{PrincipalCurvatures, RangeGrid, Scan, Viewing};
pub use sensor::{Noise, Sensor, SensorKind};
pub use silhouette::{Silhouette, SilhouetteOptions, silhouette};
pub use stereo::{DisparityMap, StereoOptions, StereoRejected, match_stereo};
pub use stereo_camera::{StereoCamera, StereoPoints};
pub use view_sensor::ViewSensor;
