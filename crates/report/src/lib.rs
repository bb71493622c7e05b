//! HTML reports: a verdict, an interactive 3D view, figures, tables and drawings on one page.
//!
//! In: a [`Page`], filled by a job. Out: one self-contained HTML file with style, script and model, which
//! loads nothing from the network. The 3D view uses three.js (`assets/three.min.js`, MIT, built in `viewer/`)
//! and the code in `assets/viewer.js`.
//!
//! Not guaranteed: browsers without WebGL do not show the 3D view. They show the rest of the page and a
//! notice.
//!
//! # Examples
//! ```
//! use planish_core::{Finding, FindingCode, FindingLevel};
//! use planish_report::{Block, Page, Section, Table};
//!
//! let mut table = Table::new(["sensor", "σ / mm"]);
//! table.row(["laser".to_owned(), "0.050".to_owned()], false);
//! let page = Page {
//!     job: "fit".to_owned(),
//!     title: "scan.ply".to_owned(),
//!     findings: vec![
//!         Finding::new(FindingCode::Converged, "the fit converged"),
//!         Finding::new(FindingCode::ManyRejected, "12 of 100 readings were rejected"),
//!     ],
//!     sections: vec![Section::new("Sensors", vec![Block::Table(table)])],
//!     ..Page::default()
//! };
//! assert_eq!(page.level(), FindingLevel::Warning);
//! let html = page.html()?;
//! // The most serious finding comes first.
//! assert!(html.find("12 of 100") < html.find("The fit converged."));
//! # Ok::<(), askama::Error>(())
//! ```

pub mod colour;
mod field;
pub mod numbers;
mod page;
pub mod plot;
mod policy;
mod scene;

pub use field::{Field, FieldKind, Values};
pub use page::{Block, Figure, Page, Section, Table};
pub use policy::content_policy;
pub use scene::{Cloud, LineSet, Mark, Scene, SeenBy, SurfaceShown};
