use super::*;
use crate::export::{ModelMesh, trimmed_mesh_from_model};
use crate::model::{Support, SupportCell};
use crate::test_support::{model_of, refined_surface};
use planish_core::DVec3;
use planish_spline::test_meshes::voxels;
use planish_spline::{Hierarchy, QuadDomain, Surface};
use std::sync::Arc;

/// A curved sheet of which `keep` selects the measured places, in shares of the extent.
fn sheet(depth: u8, keep: impl Fn([f64; 2]) -> bool) -> SurfaceModel {
    let flat = refined_surface(Shape::Sheet);
    let bent = flat.vertices().iter().map(|p| DVec3::new(p[0], p[1], 0.2 * (3.0 * p[0]).sin() * p[1]));
    let surface = flat.with_vertices(bent.collect()).unwrap();
    let space = surface.space().clone();
    model_with_parts(surface, depth, |leaf, local| {
        let at = space.parameters(leaf, local);
        keep([0, 1].map(|d| at[d] / space.extent()[d]))
    })
}

/// A model of which `keep` selects the measured places of leaves.
fn model_with_parts(surface: Surface, depth: u8, keep: impl Fn(usize, [f64; 2]) -> bool) -> SurfaceModel {
    let mut model = model_of(surface, |_| true);
    let cells = |leaf: usize| {
        let cell = |local: [f64; 2]| {
            let kept = keep(leaf, local);
            SupportCell { observed: Observed::from_measured(kept), distance: f64::from(u8::from(!kept)) }
        };
        (depth, crate::model::middles(depth).map(cell).collect())
    };
    let leaves = 0..model.surface.space().leaves().len();
    model.support = Support::new(leaves.map(cells).collect()).unwrap();
    model
}

/// A block with a hole through it, over quads with divided cells in one corner: a rounded torus.
fn block_with_hole() -> Surface {
    let cubes: Vec<[i32; 3]> = (0..9).filter(|k| *k != 4).map(|k| [k % 3, k / 3, 0]).collect();
    let (quads, mut positions) = voxels(&cubes);
    let mut domain = QuadDomain::new(&quads).unwrap();
    for _ in 0..2 {
        let division = domain.divided().unwrap();
        positions = division.apply(&positions);
        domain = division.domain;
    }
    let space = Arc::new(Hierarchy::over(Arc::new(domain)).unwrap());
    let surface = Surface::new(Arc::clone(&space), positions).unwrap();
    let is_corner = |&leaf: &usize| surface.leaf_point(leaf, 0.5, 0.5).max_element() < 1.2;
    let marked: Vec<usize> = (0..space.leaves().len()).filter(is_corner).collect();
    surface.refined(Arc::new(space.refine(&marked))).unwrap()
}

/// Length of the borders of a mesh.
fn border_of(made: &ModelMesh) -> f64 {
    let mesh = &made.mesh;
    let edges = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let all: std::collections::HashSet<[u32; 2]> = edges.collect();
    let length = |[a, b]: &[u32; 2]| mesh.positions[*a as usize].distance(mesh.positions[*b as usize]);
    all.iter().filter(|[a, b]| !all.contains(&[*b, *a])).map(length).sum()
}

/// Length of a curve of cubics, by four chords of each.
fn length_of_edge(poles: &[DVec3]) -> f64 {
    let point = |c: &[DVec3], t: f64| {
        let s = 1.0 - t;
        s * s * s * c[0] + 3.0 * s * s * t * c[1] + 3.0 * s * t * t * c[2] + t * t * t * c[3]
    };
    let cubics = (0..poles.len() - 1).step_by(3).map(|k| &poles[k..k + 4]);
    cubics
        .map(|c| {
            (0..4)
                .map(|k| point(c, f64::from(k) / 4.0).distance(point(c, f64::from(k + 1) / 4.0)))
                .sum::<f64>()
        })
        .sum()
}

/// Closed surfaces and tubes that are left open: faces share their edges, and their rims are as long as those
/// of the mesh. Cut through poles, across seams, extraordinary vertices and a hole.
#[test]
fn closed_surfaces_are_left_open_where_nothing_was_measured() {
    let shapes = [Shape::Ball, Shape::Tube, Shape::Torus].map(refined_surface);
    let cuts: [fn(DVec3) -> bool; 3] = [|p| p.z < 0.3, |p| p.x + 0.7 * p.y > 0.1, |p| p.length() > 0.9];
    let mut tested = 0;
    for (shape, surface) in shapes.into_iter().chain([block_with_hole()]).enumerate() {
        for (number, cut) in cuts.iter().enumerate() {
            let case = format!("shape {shape}, cut {number}");
            let surface = surface.clone();
            let middle = surface.vertices().iter().sum::<DVec3>() / surface.vertices().len() as f64;
            let keep = |leaf: usize, [s, t]: [f64; 2]| cut(surface.leaf_point(leaf, s, t) - middle);
            let model = model_with_parts(surface.clone(), 2, keep);
            if KeptParts::new(&model, Closing::Never).is_none() {
                continue;
            }
            tested += 1;
            assert!(KeptParts::new(&model, Closing::Auto).is_none(), "{case}");
            let posterior = model.posterior().unwrap();
            let mesh = trimmed_mesh_from_model(&model, &posterior, Closing::Never, Some(2e-3)).unwrap();
            let check = mesh.mesh.check();
            assert!(check.manifold && check.oriented && !check.watertight, "{case}: {check:?}");
            assert!(mesh.observed.contains(&1), "{case}");
            let border = border_of(&mesh);
            for max_control_points in [usize::MAX, 0] {
                let brep = brep_from_model(&model, Closing::Never, &BrepOptions { max_control_points });
                brep.check(1e-9).unwrap();
                assert!(!brep.closed);
                let mut uses = vec![0; brep.edges.len()];
                for face in &brep.faces {
                    face.edges
                        .iter()
                        .chain(face.holes.iter().flatten())
                        .for_each(|(edge, _)| uses[*edge] += 1);
                }
                let rim: f64 = (brep.edges.iter().zip(&uses))
                    .filter(|(_, uses)| **uses == 1)
                    .map(|(edge, _)| length_of_edge(&edge.curve.poles))
                    .sum();
                assert!((rim / border - 1.0).abs() < 0.03, "{case}: {rim} {border}");
            }
        }
    }
    // The last cut keeps all of the ball.
    assert!(tested >= 10, "{tested}");
}

/// Faces over few and over many patches, and the mesh, hold the same part of the sheet.
#[test]
fn a_sheet_with_a_hole_keeps_its_outline_and_its_hole() {
    let model = sheet(3, |[u, v]| (0.1..0.9).contains(&u) && (u - 0.5).hypot(v - 0.5) > 0.2);
    for max_control_points in [usize::MAX, 0] {
        let brep = brep_from_model(&model, Closing::Auto, &BrepOptions { max_control_points });
        brep.check(1e-9).unwrap();
        assert!(!brep.closed && !brep.faces.is_empty());
        if max_control_points > 0 {
            assert_eq!((brep.faces.len(), brep.faces[0].holes.len()), (1, 1));
        }
        // Every edge lies on the surface: its middle has the height of the surface there.
        for edge in &brep.edges {
            for p in &edge.curve.poles[..1] {
                assert!((p[2] - 0.2 * (3.0 * p[0]).sin() * p[1]).abs() < 0.05, "{p:?}");
            }
        }
    }
    let posterior = model.posterior().unwrap();
    let [whole, trimmed] = [Closing::Always, Closing::Auto]
        .map(|closing| trimmed_mesh_from_model(&model, &posterior, closing, Some(1e-3)).unwrap().mesh);
    let share = trimmed.area() / whole.area();
    let expected = 0.8 - std::f64::consts::PI * 0.04;
    assert!((share - expected).abs() < 0.05, "{share} {expected}");
    assert!(trimmed.check().manifold && trimmed.check().components == 1);
}

#[test]
fn parts_that_touch_in_a_corner_are_separate_faces() {
    let model = sheet(2, |[u, v]| (u < 0.5) == (v < 0.5));
    let brep = brep_from_model(&model, Closing::Auto, &BrepOptions::default());
    brep.check(1e-9).unwrap();
    assert_eq!(brep.faces.len(), 2);
    assert!(brep.faces.iter().all(|face| face.edges.len() == 4 && face.holes.is_empty()));
}

#[test]
fn an_island_in_a_hole_is_a_face_of_its_own() {
    let ring = |[u, v]: [f64; 2]| (u - 0.5).abs().max((v - 0.5).abs());
    let model = sheet(4, |at| ring(at) > 0.3 || ring(at) < 0.1);
    let brep = brep_from_model(&model, Closing::Auto, &BrepOptions::default());
    brep.check(1e-9).unwrap();
    let mut holes: Vec<usize> = brep.faces.iter().map(|face| face.holes.len()).collect();
    holes.sort_unstable();
    assert_eq!(holes, [0, 1]);
}

#[test]
fn sheets_that_are_known_everywhere_stay_whole() {
    for model in [sheet(2, |_| true), sheet(2, |_| false)] {
        assert!(KeptParts::new(&model, Closing::Auto).is_none());
        let brep = brep_from_model(&model, Closing::Auto, &BrepOptions::default());
        assert_eq!((brep.faces.len(), brep.edges.len()), (1, 4));
    }
}

/// Readings all over a ball leave gaps by chance, which are no openings.
#[test]
fn small_gaps_of_closed_surfaces_are_closed() {
    let surface = refined_surface(Shape::Ball);
    // Away from the poles.
    let middle = surface.leaf_point(surface.space().leaves().len() / 2, 0.5, 0.5);
    let size = surface.vertices().iter().map(|p| p.length()).fold(0.0, f64::max);
    let with_gap = |radius: f64| {
        let of_surface = surface.clone();
        let measured = |leaf: usize, [s, t]: [f64; 2]| {
            of_surface.leaf_point(leaf, s, t).distance(middle) > radius * size
        };
        model_with_parts(surface.clone(), 5, measured)
    };
    let chance = with_gap(0.05);
    let marked = |model: &SurfaceModel| {
        model.support.leaves().any(|(_, parts)| parts.iter().any(|p| p.observed == Observed::PriorOnly))
    };
    assert!(marked(&chance) && KeptParts::new(&chance, Closing::Never).is_none());
    assert!(KeptParts::new(&with_gap(0.5), Closing::Never).is_some());
}
