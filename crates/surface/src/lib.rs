//! Smooth surfaces fitted to scans, with their covariance.
//!
//! | module | purpose |
//! |---|---|
//! | [`observe`] | readings in the world frame with their covariances; shared scan errors; foot points |
//! | [`fit`] | the fit itself: first surface, refinement to the noise, finish; known parameters; moving objects |
//! | [`complete`] | readings inferred from symmetry and from the surroundings of gaps |
//! | [`subdivision`] | which cells are divided, and why |
//! | [`patch_stream`] | one reading at a time into small patches |
//! | [`stream`] | the same for a live sensor |
//! | [`model`] | a fitted surface with its information; posterior covariance |
//! | [`saved`] | `.planish` files |
//! | [`export`] | meshes with σ, height rasters, exact surfaces for CAD |

pub mod complete;
pub mod export;
pub mod fit;
pub mod model;
pub mod observe;
pub mod patch_stream;
pub mod saved;
pub mod stream;
pub mod subdivision;
#[doc(hidden)]
pub mod test_support;
