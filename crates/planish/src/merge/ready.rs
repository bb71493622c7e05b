//! Prepares patches for merging, and reports on them afterwards.
//!
//! Input: patches as they were read. Output: patches without copies, oriented and aligned, in an order that
//! does not depend on the order of the files; their overlaps; and the report, which names them in the order
//! of the files. Not guaranteed: patches in unrelated frames are not registered.

use super::align::align;
use super::copies::drop_copies;
use super::inspection::{crossings, mismatched_patches, nearest, orient_patches};
use super::outcome::{CompletionReport, FillReport, MergeReport, PatchReport, RegionReport, TriangleQuality};
use super::patches::PatchSet;
use super::sigma_check::sigma_findings;
use super::{MergeMethod, MergeOptions};
use crate::assumed_unit::implausible_size;
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_core::{Progress, ProgressPart};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_mesh::{
    BoundingBox, MergePatch, MeshSearch, Neighbours, Overlap, OverlapOptions, StitchedMesh, TriangleMesh,
    quantile_of_sorted,
};
use planish_report::numbers::counted;
use planish_surface::model::{ScanPoseReport, SigmaSummary};
use rayon::prelude::*;
use std::path::PathBuf;

/// Patches in the order of [`order_in_space`], with reports in the order of the files.
pub(super) struct Ready {
    /// The patches, in space.
    pub patches: Vec<MergePatch>,
    searches: Vec<MeshSearch>,
    /// For each patch in space, its number among the files.
    order: Vec<usize>,
    names: Vec<String>,
    observed: Vec<Vec<u8>>,
    turned: Vec<bool>,
    poses: Vec<ScanPoseReport>,
    /// Whether any patch intersects itself.
    pub crosses: bool,
    unit: Unit,
    /// Findings for the user.
    pub findings: Vec<Finding>,
}

/// Results of the stages after the preparation.
pub(super) struct MergeOutcome {
    pub method: MergeMethod,
    pub completed: Option<CompletionReport>,
    pub filled: Option<FillReport>,
    /// Triangles that stitch patches together.
    pub stitched: usize,
    /// Number of vertices of the merged mesh from each patch in space.
    pub kept: Vec<usize>,
    pub inputs: Vec<PathBuf>,
}

impl Ready {
    /// Removes copies, orients patches consistently, and aligns them on request.
    pub fn new(set: PatchSet, options: &MergeOptions, progress: &dyn Progress) -> Result<Self> {
        let PatchSet { patches: named, unit, mut findings, .. } = set;
        for named in named.iter().filter(|p| p.tidied.dropped > 0) {
            findings.push(Finding::new(
                FindingCode::TrianglesRemoved,
                format!(
                    "{}: {} triangles were removed, because their edges already belong to two others",
                    named.name, named.tidied.dropped
                ),
            ));
        }
        if unit.is_none() {
            let points = named.iter().flat_map(|p| p.tidied.patch.mesh.positions.iter().copied());
            let size = BoundingBox::around(points).map_or(0.0, |b| b.longest_side());
            findings.extend(implausible_size(size, Unit::Millimetre));
        }
        // Copies first: they would make any orientation and any overlap look certain.
        let named = drop_copies(named, &mut findings)?;
        let names: Vec<String> = named.iter().map(|p| p.name.clone()).collect();
        let observed: Vec<Vec<u8>> = named.iter().map(|p| p.observed.clone()).collect();
        let (mut patches, numbers): (Vec<MergePatch>, Vec<Vec<u32>>) =
            named.into_iter().map(|p| (p.tidied.patch, p.tidied.triangles)).unzip();
        let (turned, mut searches) = orient_patches(&mut patches, options.align)?;
        // Before the alignment, so that triangles are named as in the files.
        let crossed = crossings(&searches, &names, &numbers);
        let crosses = !crossed.is_empty();
        findings.extend(crossed);
        for (name, _) in names.iter().zip(&turned).filter(|(_, t)| **t) {
            findings.push(Finding::new(
                FindingCode::PatchReversed,
                format!(
                    "{name} was reversed, because its normals were opposite to those of the patches \
                    that it overlaps"
                ),
            ));
        }
        let poses = match options.align {
            true => {
                let part = ProgressPart::new(progress, 0.1, 0.3);
                let (poses, pose_findings) = align(&mut patches, &mut searches, &names, &part)?;
                findings.extend(pose_findings);
                poses
            }
            false => Vec::new(),
        };
        // After the alignment, which depends on the first file as its frame. From here on, the result does
        // not depend on the order of the files.
        let order = order_in_space(&patches);
        Ok(Self {
            patches: in_order(patches, &order),
            searches: in_order(searches, &order),
            order,
            names,
            observed,
            turned,
            poses,
            crosses,
            unit: unit.unwrap_or(Unit::Millimetre),
            findings,
        })
    }

    /// Finds the overlaps, with a warning for each patch that has none.
    pub fn overlap(&mut self, options: &MergeOptions) -> Result<Overlap> {
        let overlap = Overlap::find_with(
            &self.patches,
            &self.searches,
            &OverlapOptions {
                epsilon: options.epsilon.map(|epsilon| epsilon.in_unit(self.unit)),
                theta_rad: options.theta_deg.map(f64::to_radians),
                believe_sigma: options.believe_sigma,
            },
        )?;
        let in_space = in_order(self.names.clone(), &self.order);
        // An error: the output would be the files side by side, and look like a merge.
        if overlap.regions.is_empty() {
            return Err(Error::undetermined(format!(
                "expected overlapping patches, found none among {}: {}; check that they have the same \
                 frame and unit, align them, or allow a larger distance",
                self.patches.len(),
                nearest(&self.patches, &self.searches, &in_space, self.unit)
            ))
            .with_setting(Setting::Align)
            .with_setting(Setting::Epsilon));
        }
        for (k, name) in self.names.iter().enumerate() {
            let shares = |patches: &[usize; 2]| patches.iter().any(|p| self.order[*p] == k);
            if !overlap.regions.iter().any(|r| shares(&r.patches)) {
                self.findings.push(Finding::new(
                    FindingCode::PatchIsolated,
                    format!("{name} overlaps no other patch: it remains a separate part"),
                ));
            }
        }
        // With an ε of the user, differences are as large as allowed.
        if options.epsilon.is_none() {
            self.findings.extend(mismatched_patches(&self.patches, &overlap, &in_space, self.unit));
        }
        self.findings.extend(sigma_findings(&overlap, &in_space, options, self.unit));
        Ok(overlap)
    }

    /// Number of vertices of the merged mesh from each patch, with a warning for patches that contribute
    /// none.
    pub fn kept(&mut self, stitched_mesh: &StitchedMesh, overlap: &Overlap) -> Vec<usize> {
        let mut kept = vec![0; self.patches.len()];
        for (patch, _) in &stitched_mesh.source {
            if let Some(kept) = kept.get_mut(*patch as usize) {
                *kept += 1;
            }
        }
        for (at, k) in self.order.iter().enumerate().filter(|(at, _)| kept[*at] == 0) {
            // Patches without overlap keep all their vertices and need no message.
            let has_feet =
                (0..self.patches[at].mesh.positions.len()).any(|v| !overlap.patches[at].feet(v).is_empty());
            if has_feet {
                let text = format!(
                    "{}: the mesh has none of its vertices, because the vertices of other patches are \
                     denser or farther from a border; its information is used in their positions",
                    self.names[*k]
                );
                self.findings.push(Finding::new(FindingCode::PatchUnused, text));
            }
        }
        kept
    }

    /// 1 for vertices that were measured, 2 for those that were completed or fill a hole.
    pub fn observed(&self, stitched_mesh: &StitchedMesh) -> Vec<u8> {
        let observed_of = |(patch, v): &(u32, u32)| {
            // Numbers beyond the patches stand for the bound and for filled holes.
            let Some(file) = self.order.get(*patch as usize) else {
                return 2;
            };
            // An empty list means that everything was measured.
            self.observed[*file].get(*v as usize).copied().unwrap_or(1)
        };
        stitched_mesh.source.iter().map(observed_of).collect()
    }

    /// The report, in the order of the files.
    pub fn report(
        &self,
        stitched_mesh: &StitchedMesh,
        overlap: &Overlap,
        outcome: MergeOutcome,
    ) -> MergeReport {
        let check = stitched_mesh.mesh.check();
        // Position of each file's patch in the order in space.
        let mut position_of = vec![0; self.order.len()];
        for (at, k) in self.order.iter().enumerate() {
            position_of[*k] = at;
        }
        let region = |r: &planish_mesh::CommonRegion| {
            // The order of a pair in space is of no meaning for the user.
            let [a, b] = r.patches.map(|p| self.order[p]);
            RegionReport {
                patches: [a.min(b), a.max(b)],
                points: r.points,
                rms: r.rms,
                epsilon: r.epsilon,
                theta_deg: r.theta_rad.to_degrees(),
            }
        };
        let patch = |(k, at): (usize, &usize)| PatchReport {
            name: self.names[k].clone(),
            triangles: self.patches[*at].mesh.triangles.len(),
            vertices_kept: outcome.kept[*at],
            reversed: self.turned[k],
            sigma: SigmaSummary::from_values(overlap.patches[*at].sigma.clone()).median,
            sigma_factor: overlap.patches[*at].check.map(|check| check.factor),
            displacement: overlap.patches[*at].check.map(|check| check.displacement),
        };
        let mut report = MergeReport {
            method: outcome.method,
            vertices: check.vertices,
            triangles: check.triangles,
            boundary_edges: check.boundary_edges,
            nonmanifold_edges: check.nonmanifold_edges,
            watertight: check.watertight,
            parts: check.components,
            regions: overlap.regions.iter().map(region).collect(),
            patches: position_of.iter().enumerate().map(patch).collect(),
            poses: self.poses.clone(),
            completed: outcome.completed,
            filled: outcome.filled,
            sigma_estimated: overlap.sigma_estimated,
            sigma: SigmaSummary::from_values(stitched_mesh.sigma.clone()),
            stitched_triangles: outcome.stitched,
            holes_closed: stitched_mesh.holes_closed,
            removed_fragments: stitched_mesh.fragments,
            valence: stitched_mesh.valence.clone(),
            valence_mesh: valences(&stitched_mesh.mesh),
            quality: quality(&stitched_mesh.mesh),
            inputs: outcome.inputs,
            unit: self.unit,
            findings: self.findings.clone(),
        };
        report.findings.extend(judge(&report));
        report
    }
}

/// The findings that follow from the figures of the merged mesh.
fn judge(report: &MergeReport) -> Vec<Finding> {
    let mut found = Vec::new();
    if report.nonmanifold_edges > 0 {
        let edges = counted(report.nonmanifold_edges, "edge");
        let text = format!("{edges} of the mesh have more than two faces");
        found.push(Finding::new(FindingCode::NonmanifoldEdges, text));
    }
    if report.parts > 1 {
        let parts = counted(report.parts, "separate part");
        let text = format!("the result has {parts}: check the overlaps");
        found.push(Finding::new(FindingCode::SeveralParts, text));
    }
    found.push(if report.watertight {
        Finding::new(FindingCode::MeshClosed, "the mesh is watertight")
    } else {
        let text = format!("the mesh has a boundary: {}", counted(report.boundary_edges, "edge"));
        Finding::new(FindingCode::MeshOpen, text)
    });
    if report.sigma_estimated {
        let text = "the patches state no σ: it was estimated from their differences in the overlaps";
        found.push(Finding::new(FindingCode::SigmaFromOverlaps, text));
    }
    found
}

/// The numbers of patches in the order of their first places in space.
fn order_in_space(patches: &[MergePatch]) -> Vec<usize> {
    let by = |a: &DVec3, b: &DVec3| {
        let by = |k: usize| a[k].total_cmp(&b[k]);
        by(0).then(by(1)).then(by(2))
    };
    let first = |patch: &MergePatch| patch.mesh.positions.iter().copied().min_by(by);
    let firsts: Vec<Option<DVec3>> = patches.iter().map(first).collect();
    let sorted = |k: usize| {
        let mut all = patches[k].mesh.positions.clone();
        all.sort_unstable_by(by);
        all
    };
    // Full sorting is left to ties, because it costs much more than finding the first place.
    let mut order: Vec<usize> = (0..patches.len()).collect();
    order.sort_by(|i, j| match (&firsts[*i], &firsts[*j]) {
        // Patches that begin at one place differ later on.
        (Some(a), Some(b)) => by(a, b).then_with(|| {
            let (a, b) = (sorted(*i), sorted(*j));
            let differing = a.iter().zip(&b).map(|(a, b)| by(a, b)).find(|order| order.is_ne());
            differing.unwrap_or(a.len().cmp(&b.len()))
        }),
        (a, b) => a.is_some().cmp(&b.is_some()),
    });
    order
}

fn in_order<T>(values: Vec<T>, order: &[usize]) -> Vec<T> {
    let mut values: Vec<Option<T>> = values.into_iter().map(Some).collect();
    order.iter().filter_map(|k| values[*k].take()).collect()
}

/// The number of vertices with each number of edges.
fn valences(mesh: &TriangleMesh) -> Vec<usize> {
    let neighbours = Neighbours::from_mesh(mesh);
    let mut found = Vec::new();
    for v in 0..mesh.positions.len() as u32 {
        let mut ends = neighbours.of_vertex(v).to_vec();
        ends.sort_unstable();
        ends.dedup();
        found.resize(found.len().max(ends.len() + 1), 0);
        found[ends.len()] += 1;
    }
    found
}

fn quality(mesh: &TriangleMesh) -> Option<TriangleQuality> {
    let (mut angles, mut aspects): (Vec<f64>, Vec<f64>) = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| planish_mesh::triangle_shape(&mesh.corners(t)))
        .unzip();
    // Unstable sorting is deterministic here: equal numbers are interchangeable.
    angles.par_sort_unstable_by(f64::total_cmp);
    aspects.par_sort_unstable_by(f64::total_cmp);
    (!angles.is_empty()).then(|| TriangleQuality {
        smallest_angle_median_deg: quantile_of_sorted(&angles, 0.5).to_degrees(),
        smallest_angle_p1_deg: quantile_of_sorted(&angles, 0.01).to_degrees(),
        aspect_median: quantile_of_sorted(&aspects, 0.5),
        aspect_p99: quantile_of_sorted(&aspects, 0.99),
    })
}
