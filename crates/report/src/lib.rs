//! One page of HTML that shows what a job found: a verdict, a 3D view, figures, tables and drawings.
//!
//! Comes in: a [`Page`], which jobs fill with what they know. Goes out: its HTML, in which everything is:
//! style, script, model. Opened, it asks the network for nothing. The 3D view is drawn by three.js
//! (`assets/three.min.js`, MIT; `viewer/` makes it) as `assets/viewer.js` says.
//!
//! Not guaranteed: that browsers without WebGL show the 3D view; they show the rest, and say so.

pub mod colour;
mod field;
pub mod numbers;
mod page;
pub mod plot;
mod scene;

pub use field::{Field, FieldKind, Values};
pub use page::{Block, Figure, Finding, Level, Page, Section, Table};
pub use scene::{Cloud, LineSet, Mark, Scene, SeenBy, SurfaceShown};
