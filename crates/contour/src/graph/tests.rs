use super::*;
use crate::constraint::{
    Axis, BarId, Constraint, ConstraintEquations, Entry, EquationBlock, Incidence, ParametricDrawing,
    PointId, constrain, diagnose, witness,
};
use petgraph::algo::maximum_matching;
use petgraph::graph::UnGraph;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

const A: f64 = 3.0;
const B: f64 = 4.0;
const D: f64 = 7.0;

fn distance(a: u32, b: u32, value: f64) -> Constraint {
    Constraint::Distance { a: PointId(a), b: PointId(b), value }
}

fn fixed(axis: Axis) -> Constraint {
    Constraint::Coordinate { point: PointId(0), axis, value: 0.0 }
}

/// Eq. 4.1 with P6 read as P3 and f5 as y1 = e: right angle at P1, legs b along x and a.
fn front() -> (ParametricDrawing, Vec<Constraint>) {
    let drawing = ParametricDrawing::polygon(&[[0.0, 0.0], [B, 0.0], [0.0, A]]).unwrap();
    let constraints = vec![
        distance(0, 1, B),
        distance(0, 2, A),
        Constraint::Perpendicular { a: BarId(0), b: BarId(2) },
        fixed(Axis::X),
        fixed(Axis::Y),
        Constraint::Horizontal { bar: BarId(0) },
    ];
    (drawing, constraints)
}

/// Eq. 4.2 with P8 read as P3 and the last three as f6, f7, f8; first coordinate y, second z.
fn side() -> (ParametricDrawing, Vec<Constraint>) {
    let mut drawing = ParametricDrawing::default();
    let [p1, p2, p3, p4] = [[0.0, 0.0], [D, 0.0], [0.0, A], [D, A]].map(|p| drawing.point(p));
    for (a, b) in [(p1, p2), (p1, p3), (p3, p4), (p2, p4)] {
        drawing.bar(a, b).unwrap();
    }
    let constraints = vec![
        distance(0, 1, D),
        distance(0, 2, A),
        distance(2, 3, D),
        distance(1, 3, A),
        Constraint::Perpendicular { a: BarId(0), b: BarId(1) },
        fixed(Axis::X),
        fixed(Axis::Y),
        Constraint::Horizontal { bar: BarId(0) },
    ];
    (drawing, constraints)
}

/// `(parameter, equation)` from names such as `("x1", 4)`.
fn pairs(incidence: &Incidence, named: &[(&str, usize)]) -> Vec<(usize, usize)> {
    named
        .iter()
        .map(|&(name, f)| (incidence.parameters.iter().position(|p| p == name).unwrap(), f - 1))
        .collect()
}

fn perfect_matchings(parameters_of: &[Vec<usize>], used: &mut Vec<usize>) -> usize {
    let Some(list) = parameters_of.get(used.len()) else {
        return 1;
    };
    let mut count = 0;
    for &parameter in list {
        if !used.contains(&parameter) {
            used.push(parameter);
            count += perfect_matchings(parameters_of, used);
            used.pop();
        }
    }
    count
}

#[test]
fn views_of_the_prism_have_ranks_six_and_eight() {
    for ((drawing, constraints), rank) in [(front(), 6), (side(), 8)] {
        let diagnosis = diagnose(&drawing, &constraints).unwrap();
        assert_eq!((diagnosis.equations, diagnosis.rank, diagnosis.rank_at_solution), (rank, rank, rank));
        assert_eq!((diagnosis.freedoms, diagnosis.structure.rank), (0, rank));
        assert!(diagnosis.is_generic && diagnosis.redundant.is_empty() && diagnosis.conflicting.is_empty());
    }
}

#[test]
fn printed_equations_have_the_same_zeros_and_ranks() {
    // The squared distances and plain products of eq. 4.1 at the prism, row by row, x1 y1 x2 y2 x3 y3.
    let squared = nalgebra::DMatrix::from_row_slice(
        6,
        6,
        &[
            -2.0 * B,
            0.0,
            2.0 * B,
            0.0,
            0.0,
            0.0, //
            0.0,
            -2.0 * A,
            0.0,
            0.0,
            0.0,
            2.0 * A, //
            B,
            A,
            0.0,
            -A,
            -B,
            0.0, //
            1.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0, //
            0.0,
            1.0,
            0.0,
            0.0,
            0.0,
            0.0, //
            0.0,
            -1.0,
            0.0,
            1.0,
            0.0,
            0.0,
        ],
    );
    let (drawing, constraints) = front();
    let (_, analytic) =
        ConstraintEquations::new(&drawing, &constraints).residuals_and_jacobian(&drawing.values());
    assert_eq!(squared.rank(1e-9), 6);
    for row in 0..6 {
        let factor = squared.row(row).norm() / analytic.row(row).norm();
        let same = (squared.row(row) - analytic.row(row) * factor)
            .norm()
            .min((squared.row(row) + analytic.row(row) * factor).norm());
        assert!(same < 1e-12, "f{}", row + 1);
    }
}

#[test]
fn published_matching_is_valid_but_uses_vanishing_entries() {
    let (drawing, constraints) = front();
    let incidence = Incidence::new(&drawing, &constraints);
    let published = pairs(&incidence, &[("x1", 4), ("y1", 5), ("x2", 1), ("y2", 6), ("x3", 2), ("y3", 3)]);
    assert!(incidence.is_matching(&published));
    assert_eq!(incidence.vanishing(&published), pairs(&incidence, &[("x3", 2), ("y3", 3)]));
    let maximum = incidence.matching();
    assert_eq!(maximum.len(), 6);
    assert!(incidence.is_matching(&maximum) && incidence.vanishing(&maximum).is_empty());
    assert_eq!(
        maximum,
        pairs(&incidence, &[("x1", 4), ("y1", 5), ("x2", 1), ("y2", 6), ("x3", 3), ("y3", 2)])
    );
    assert_eq!(perfect_matchings(&incidence.parameters_of_equations(), &mut Vec::new()), 2);
    // The entries vanish at every prism, not just at this one.
    let generic = drawing.with_values(&witness(&drawing, &constraints).unwrap()).unwrap();
    assert!((generic.length(BarId(0)) - B).abs() > 1e-3);
    // A witness moves the anchor, but keeps the right angle and the horizontal bar.
    assert_eq!(Incidence::new(&generic, &constraints).vanishing(&published), incidence.vanishing(&published));
    let (eight, sides) = side();
    assert_eq!(Incidence::new(&eight, &sides).matching().len(), 8);
}

#[test]
fn graphs_of_the_front_view_match_the_paper() {
    let (drawing, constraints) = front();
    let graphs = ViewGraphs::new(&drawing, &constraints);
    // Section 4.1: x3 and x1 are joined by f3 (and by f2, which the text omits); x1 and y2 by f1 and f3.
    assert_eq!(graphs.full.arc("x3", "x1").unwrap().labels, ["f2", "f3"]);
    assert_eq!(graphs.full.arc("x1", "y2").unwrap().labels, ["f1", "f3"]);
    assert!(graphs.full.arc("x1", "y1").is_some() && graphs.bipartite.arc("x1", "f4").unwrap().strong);
    // Every arc of the minimal graph enters a parameter by its own equation; anchored ones have none.
    let own = |name: &str| graphs.matching.iter().find(|(p, _)| p == name).map(|(_, f)| f.clone());
    for arc in &graphs.minimal.arcs {
        let to = &graphs.minimal.nodes[arc.to].label;
        assert_eq!(arc.labels, [own(to).unwrap()]);
        assert!(to != "x1" && to != "y1");
    }
    // Read literally, the rule removes every arc: no label is matched to both ends of its arc.
    for arc in &graphs.full.arcs {
        let [from, to] = [arc.from, arc.to].map(|i| own(&graphs.full.nodes[i].label));
        assert!(!arc.labels.iter().any(|label| from.as_ref() == Some(label) && to.as_ref() == Some(label)));
    }
    let pair: BTreeSet<(String, String)> = graphs
        .pair
        .arcs
        .iter()
        .map(|arc| (graphs.pair.nodes[arc.from].label.clone(), graphs.pair.nodes[arc.to].label.clone()))
        .collect();
    let expected = [("{x1, y1}", "{x2, y2}"), ("{x1, y1}", "{x3, y3}"), ("{x2, y2}", "{x3, y3}")];
    assert_eq!(pair, expected.map(|(a, b)| (a.to_owned(), b.to_owned())).into());
    assert_eq!(graphs.to_dot().matches("penwidth=3").count(), 6);
}

#[test]
fn matchings_are_maximum_on_random_graphs() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..200 {
        let (rows, columns) = (random.random_range(1..9), random.random_range(1..9));
        let mut entries = Vec::new();
        let mut reference = UnGraph::<(), ()>::default();
        let nodes: Vec<_> = (0..rows + columns).map(|_| reference.add_node(())).collect();
        for equation in 0..rows {
            for parameter in 0..columns {
                if random.random_bool(0.3) {
                    entries.push(Entry { equation, parameter, vanishes: random.random_bool(0.4) });
                    reference.add_edge(nodes[equation], nodes[rows + parameter], ());
                }
            }
        }
        let incidence = Incidence {
            parameters: (0..columns).map(|i| format!("p{i}")).collect(),
            owners: (0..rows).collect(),
            entries,
        };
        let found = incidence.matching();
        assert!(incidence.is_matching(&found));
        assert_eq!(found.len(), maximum_matching(&reference).edges().count());
        check_decomposition(&incidence);
    }
}

/// Laws of the decomposition: parts are disjoint, their sizes have the stated order, and no entry leads from
/// an equation to a later part.
fn check_decomposition(incidence: &Incidence) {
    let parts = incidence.decomposition();
    let all = [&parts.over, &parts.well, &parts.under];
    assert_eq!(all.iter().map(|p| p.equations.len()).sum::<usize>(), incidence.equations());
    assert_eq!(all.iter().map(|p| p.parameters.len()).sum::<usize>(), incidence.parameters.len());
    assert!(
        parts.over.equations.len() > parts.over.parameters.len() || parts.over == EquationBlock::default()
    );
    assert_eq!(parts.well.equations.len(), parts.well.parameters.len());
    assert!(
        parts.under.equations.len() < parts.under.parameters.len() || parts.under == EquationBlock::default()
    );
    assert_eq!(
        parts.rank,
        parts.over.parameters.len() + parts.well.equations.len() + parts.under.equations.len()
    );
    let rank_of = |list: [&Vec<usize>; 3], i: usize| list.iter().position(|part| part.contains(&i)).unwrap();
    for entry in &incidence.entries {
        let equation = rank_of(all.map(|p| &p.equations), entry.equation);
        let parameter = rank_of(all.map(|p| &p.parameters), entry.parameter);
        // Over-determined equations use over-determined parameters only; well-determined ones use no
        // under-determined parameters.
        assert!(parameter <= equation);
    }
    // A block uses its own parameters and those of earlier blocks.
    let mut known: BTreeSet<usize> = parts.over.parameters.iter().copied().collect();
    for block in &parts.blocks {
        known.extend(&block.parameters);
        for entry in incidence.entries.iter().filter(|entry| block.equations.contains(&entry.equation)) {
            assert!(known.contains(&entry.parameter));
        }
    }
    assert_eq!(parts.blocks.iter().map(|b| b.equations.len()).sum::<usize>(), parts.well.equations.len());
}

fn edge(a: usize, b: usize, length: f64) -> TourEdge {
    TourEdge { a, b, length }
}

fn check_tour(edges: &[TourEdge], tour: &Tour, start: usize) {
    assert_eq!((tour.vertices[0], tour.vertices[tour.edges.len()]), (start, start));
    for (k, &i) in tour.edges.iter().enumerate() {
        let ends = [tour.vertices[k], tour.vertices[k + 1]];
        assert!(ends == [edges[i].a, edges[i].b] || ends == [edges[i].b, edges[i].a]);
    }
    for i in 0..edges.len() {
        let again = tour.repeated.iter().filter(|&&edge| edge == i).count();
        assert_eq!(tour.edges.iter().filter(|&&edge| edge == i).count(), 1 + again);
    }
    let length: f64 = tour.edges.iter().map(|&i| edges[i].length).sum();
    assert!((length - tour.length).abs() < 1e-9 * length);
}

#[test]
fn euler_tours_are_complete_where_the_printed_rule_omits_edges() {
    // From 0 to 1, around the triangle 1 2 3, and back through 4.
    let edges = [
        edge(0, 1, 1.0),
        edge(1, 2, 1.0),
        edge(2, 3, 1.0),
        edge(3, 1, 1.0),
        edge(1, 4, 1.0),
        edge(4, 0, 1.0),
    ];
    check_tour(&edges, &euler_tour(&edges, 0).unwrap(), 0);
    // The printed rule: notes at the vertex that is left, followed last one first. The walk is 0 1 2 3 1 4 0.
    let walk = [0, 1, 2, 3, 1, 4, 0];
    let mut notes = vec![Vec::new(); 5];
    walk.windows(2).for_each(|step| notes[step[0]].push(step[1]));
    let (mut current, mut steps) = (0, 0);
    while let Some(neighbour) = notes[current].pop() {
        (current, steps) = (neighbour, steps + 1);
    }
    assert!(steps < edges.len());
}

#[test]
fn postman_tours_are_as_short_as_any_pairing() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    for _ in 0..50 {
        let n = random.random_range(4..9);
        // A ring keeps the graph connected.
        let mut edges: Vec<TourEdge> =
            (0..n).map(|i| edge(i, (i + 1) % n, random.random_range(1.0..5.0))).collect();
        for _ in 0..random.random_range(1..7) {
            let (a, b) = (random.random_range(0..n), random.random_range(0..n));
            if a != b {
                edges.push(edge(a, b, random.random_range(1.0..5.0)));
            }
        }
        let tour = postman_tour(&edges, 0).unwrap();
        check_tour(&edges, &tour, 0);
        // Reference: every subset of repeated edges that makes all degrees even.
        let shortest = (0_usize..1 << edges.len())
            .filter(|set| {
                (0..n).all(|v| {
                    let degree = edges
                        .iter()
                        .enumerate()
                        .filter(|(_, e)| e.a == v || e.b == v)
                        .map(|(i, _)| 1 + (set >> i & 1));
                    degree.sum::<usize>() % 2 == 0
                })
            })
            .map(|set| {
                edges.iter().enumerate().map(|(i, e)| e.length * (1 + (set >> i & 1)) as f64).sum::<f64>()
            })
            .fold(f64::INFINITY, f64::min);
        assert!(tour.is_shortest && (tour.length - shortest).abs() < 1e-9);
    }
}

#[test]
fn many_vertices_of_odd_degree_are_paired_greedily_and_this_is_reported() {
    // Eighteen spokes with a pendant each: all ends are odd, and each spoke is walked twice.
    let edges: Vec<TourEdge> = (1..=18).map(|i| edge(0, i, 1.0)).collect();
    let tour = postman_tour(&edges, 0).unwrap();
    check_tour(&edges, &tour, 0);
    assert!(!tour.is_shortest && tour.length == 36.0);
    assert!(
        postman_tour(&[edge(0, 1, 1.0), edge(2, 3, 1.0)], 0)
            .unwrap_err()
            .to_string()
            .contains("several parts")
    );
    assert!(euler_tour(&[edge(0, 1, 1.0)], 0).unwrap_err().to_string().contains("odd degree"));
}

#[test]
fn views_of_the_prism_give_six_vertices_and_a_tour_of_its_edges() {
    let ((front, of_front), (side, of_side)) = (front(), side());
    // The front view of the paper shows x and y, the side view z and y: depth d along z, height a along y.
    let views = [
        SketchView {
            name: "front",
            axes: [SpaceAxis::X, SpaceAxis::Y],
            drawing: &front,
            constraints: &of_front,
            covariance: None,
        },
        SketchView {
            name: "side",
            axes: [SpaceAxis::Z, SpaceAxis::Y],
            drawing: &side,
            constraints: &of_side,
            covariance: None,
        },
    ];
    let prism = composite(&views, 1e-9, 0.0).unwrap();
    assert_eq!((prism.views.len(), prism.vertices.len(), prism.unmatched.len()), (2, 6, 0));
    // The initial matching is P1 of both views, as in Fig. 10.
    assert_eq!(prism.vertices[0].points, [PointId(0), PointId(0)]);
    let found: BTreeSet<[i64; 3]> =
        prism.vertices.iter().map(|v| v.position.map(|x| x.round() as i64)).collect();
    let truth = [[0, 0, 0], [4, 0, 0], [0, 3, 0], [0, 0, 7], [4, 0, 7], [0, 3, 7]];
    assert_eq!(found, truth.into());
    // Nine edges of the prism, and diagonals of faces, which two views cannot distinguish from edges.
    let is_edge = |edge: &&CompositeEdge| {
        let (p, q) = (prism.vertices[edge.a].position, prism.vertices[edge.b].position);
        p[2] == q[2] || p[..2] == q[..2]
    };
    assert_eq!(prism.edges.iter().filter(is_edge).count(), 9);
    let tour = prism.tour().unwrap();
    assert_eq!(tour.edges.iter().collect::<BTreeSet<_>>().len(), prism.edges.len());
    assert_eq!(prism.graph().arcs.iter().filter(|arc| arc.labels == ["initial"]).count(), 1);
    assert_eq!(prism.graph().arcs.iter().filter(|arc| arc.strong).count(), 6);
    let json = serde_json::to_value(&prism).unwrap();
    assert_eq!(json["vertices"].as_array().unwrap().len(), 6);
}

#[test]
fn views_of_different_objects_are_rejected() {
    let ((front, _), (side, _)) = (front(), side());
    let view = |name, axes, drawing| SketchView { name, axes, drawing, constraints: &[], covariance: None };
    let (xy, zy) = ([SpaceAxis::X, SpaceAxis::Y], [SpaceAxis::Z, SpaceAxis::Y]);
    let moved = side.with_values(&side.values().map(|v| v + 0.5)).unwrap();
    let error = |views: &[SketchView<'_>]| composite(views, 1e-9, 0.0).unwrap_err().to_string();
    assert!(
        error(&[view("front", xy, &front), view("side", zy, &moved)]).contains("expected points that agree")
    );
    assert!(
        error(&[view("front", xy, &front), view("rear", xy, &front)]).contains("expected different axes")
    );
    assert!(error(&[view("front", xy, &front)]).contains("two or three views"));
}

#[test]
fn noisy_views_of_the_prism_give_dimensions_with_correct_sigma() {
    use nalgebra::{DMatrix, DVector};
    use planish_estimate::{ChiSquareMean, Coverage};
    use rand_distr::{Distribution, StandardNormal};

    let mut random = ChaCha8Rng::seed_from_u64(21);
    let ((front, _), (side, _)) = (front(), side());
    let sigma = 0.01;
    let mut coverage = Coverage::of_interval(0.95).unwrap();
    let mut squared = ChiSquareMean::new(1.0).unwrap();
    let (mut all_six, runs) = (0, 100);
    for _ in 0..runs {
        let seen = [&front, &side].map(|truth| {
            let noise =
                DVector::from_fn(truth.parameters(), |_, _| -> f64 { StandardNormal.sample(&mut random) });
            let drawing = truth.with_values(&(truth.values() + noise * sigma)).unwrap();
            let covariance = DMatrix::identity(truth.parameters(), truth.parameters()) * (sigma * sigma);
            constrain(&drawing, &covariance, &Default::default()).unwrap()
        });
        let views = [("front", SpaceAxis::X), ("side", SpaceAxis::Z)];
        let views: Vec<SketchView<'_>> = views
            .iter()
            .zip(&seen)
            .map(|(&(name, axis), seen)| SketchView {
                name,
                axes: [axis, SpaceAxis::Y],
                drawing: &seen.drawing,
                constraints: &seen.constraints,
                covariance: Some(&seen.covariance),
            })
            .collect();
        let prism = composite(&views, 0.0, 4.0).unwrap();
        all_six += usize::from(prism.vertices.len() == 6);
        for vertex in &prism.vertices {
            let truth = [
                front.position(vertex.points[0])[0],
                front.position(vertex.points[0])[1],
                side.position(vertex.points[1])[0],
            ];
            // One coordinate of each vertex; the six coordinates share errors.
            coverage.add(vertex.position[1] - truth[1], vertex.sigma[1]).unwrap();
            squared.add(((vertex.position[1] - truth[1]) / vertex.sigma[1]).powi(2)).unwrap();
        }
    }
    println!(
        "six vertices in {all_six} of {runs}; heights covered {:.3}, reduced χ² {:.3}",
        coverage.share(),
        squared.reduced()
    );
    assert!(all_six >= 97);
    // Some 600 heights, about a third of them independent.
    assert!((0.90..0.985).contains(&coverage.share()));
}
