use super::*;
use planish_estimate::ErrorKind;
use std::f64::consts::PI;

/// Knots of `spans` uniform spans, clamped, with inner multiplicity `inner`.
fn knots(degree: usize, spans: usize, inner: usize) -> Vec<(f64, usize)> {
    let at = |k: usize| if k == 0 || k == spans { degree + 1 } else { inner };
    (0..=spans).map(|k| (k as f64 / spans as f64, at(k))).collect()
}

/// Cubic arcs of a circle as one spline with continuous first derivative: poles (x, y) and knots.
fn arc(from: f64, to: f64, spans: usize, radius: f64) -> (Vec<[f64; 2]>, Vec<(f64, usize)>) {
    let step = (to - from) / spans as f64;
    let handle = radius * 4.0 / 3.0 * (step / 4.0).tan();
    let mut poles = Vec::new();
    for k in 0..=spans {
        let angle = from + k as f64 * step;
        let (p, t) = ([radius * angle.cos(), radius * angle.sin()], [-angle.sin(), angle.cos()]);
        if k > 0 {
            poles.push([p[0] - handle * t[0], p[1] - handle * t[1]]);
        }
        if k == 0 || k == spans {
            poles.push(p);
        }
        if k < spans {
            poles.push([p[0] + handle * t[0], p[1] + handle * t[1]]);
        }
    }
    (poles, knots(3, spans, 2))
}

fn curve(knots: &[(f64, usize)], poles: Vec<DVec3>) -> BsplineCurve {
    BsplineCurve { degree: 3, knots: knots.to_vec(), poles }
}

fn surface(
    knots_u: &[(f64, usize)],
    knots_v: &[(f64, usize)],
    n_u: usize,
    poles: Vec<DVec3>,
) -> BsplineSurface {
    BsplineSurface {
        degree_u: 3,
        degree_v: 3,
        knots_u: knots_u.to_vec(),
        knots_v: knots_v.to_vec(),
        n_u,
        n_v: poles.len() / n_u,
        poles,
    }
}

fn row(s: &BsplineSurface, i: usize) -> Vec<DVec3> {
    (0..s.n_v).map(|j| s.poles[i * s.n_v + j]).collect()
}

fn column(s: &BsplineSurface, j: usize) -> Vec<DVec3> {
    (0..s.n_u).map(|i| s.poles[i * s.n_v + j]).collect()
}

fn ends(poles: &[DVec3]) -> [DVec3; 2] {
    [poles[0], poles[poles.len() - 1]]
}

/// A flat bicubic sheet of 3 × 2.
fn sheet() -> Brep {
    let k = knots(3, 4, 1);
    let greville = |i: usize| [0.0, 1.0 / 12.0, 0.25, 0.5, 0.75, 11.0 / 12.0, 1.0][i];
    let poles = (0..49).map(|n| DVec3::new(3.0 * greville(n / 7), 2.0 * greville(n % 7), 0.0)).collect();
    let s = surface(&k, &k, 7, poles);
    let sides = [column(&s, 0), row(&s, 6), column(&s, 6), row(&s, 0)];
    let [a, b] = ends(&sides[0]);
    let [d, c] = ends(&sides[2]);
    let edge = |side: usize, start, end| BrepEdge { curve: curve(&k, sides[side].clone()), start, end };
    Brep {
        vertices: vec![a, b, c, d],
        edges: vec![edge(0, 0, 1), edge(1, 1, 2), edge(2, 3, 2), edge(3, 0, 3)],
        faces: vec![BrepFace {
            surface: s,
            edges: vec![(0, true), (1, true), (2, false), (3, false)],
            holes: Vec::new(),
            same_sense: true,
        }],
        closed: false,
    }
}

/// A tube of radius 2 and height 5 as two half faces that share their seams.
fn tube() -> Brep {
    let k_v = knots(3, 1, 1);
    let half = |from: f64| {
        let (arc, k_u) = arc(from, from + PI, 4, 2.0);
        let heights = [0.0, 5.0 / 3.0, 10.0 / 3.0, 5.0];
        let poles = arc.iter().flat_map(|p| heights.map(|z| DVec3::new(p[0], p[1], z))).collect();
        surface(&k_u, &k_v, arc.len(), poles)
    };
    let halves = [half(0.0), half(PI)];
    let seam = |h: usize, start, end| BrepEdge { curve: curve(&k_v, row(&halves[h], 0)), start, end };
    let ring = |h: usize, j: usize, start, end| BrepEdge {
        curve: curve(&halves[h].knots_u, column(&halves[h], j)),
        start,
        end,
    };
    let [a, b] = ends(&row(&halves[0], 0));
    let [c, d] = ends(&row(&halves[1], 0));
    Brep {
        vertices: vec![a, b, c, d],
        edges: vec![
            seam(0, 0, 1),
            seam(1, 2, 3),
            ring(0, 0, 0, 2),
            ring(0, 3, 1, 3),
            ring(1, 0, 2, 0),
            ring(1, 3, 3, 1),
        ],
        faces: vec![
            BrepFace {
                surface: halves[0].clone(),
                edges: vec![(2, true), (1, true), (3, false), (0, false)],
                holes: Vec::new(),
                same_sense: true,
            },
            BrepFace {
                surface: halves[1].clone(),
                edges: vec![(4, true), (0, true), (5, false), (1, false)],
                holes: Vec::new(),
                same_sense: true,
            },
        ],
        closed: false,
    }
}

/// A ball of radius 1.5 as two half balls, each with two collapsed sides.
fn ball() -> Brep {
    let (profile, k_v) = arc(-PI / 2.0, PI / 2.0, 4, 1.5);
    let n_v = profile.len();
    let half = |from: f64| {
        let (arc, k_u) = arc(from, from + PI, 4, 1.0);
        let pole = |u: &[f64; 2], j: usize| {
            // Exactly on the axis, so that the side is a point.
            let r = if j == 0 || j == n_v - 1 { 0.0 } else { profile[j][0] };
            DVec3::new(r * u[0], r * u[1], profile[j][1])
        };
        let poles = arc.iter().flat_map(|u| (0..n_v).map(move |j| pole(u, j)).collect::<Vec<_>>()).collect();
        surface(&k_u, &k_v, arc.len(), poles)
    };
    ball_of([half(0.0), half(PI)])
}

/// Two halves that share the meridians at their first rows.
fn ball_of(halves: [BsplineSurface; 2]) -> Brep {
    let meridian =
        |h: usize| BrepEdge { curve: curve(&halves[h].knots_v, row(&halves[h], 0)), start: 0, end: 1 };
    let face = |h: usize| BrepFace {
        surface: halves[h].clone(),
        edges: vec![(1 - h, true), (h, false)],
        holes: Vec::new(),
        same_sense: true,
    };
    Brep {
        vertices: ends(&row(&halves[0], 0)).to_vec(),
        edges: vec![meridian(0), meridian(1)],
        faces: vec![face(0), face(1)],
        closed: true,
    }
}

/// A ball with bumps, cubic and continuous to the second derivative within each of its two halves.
fn bumpy_ball() -> Brep {
    let (n_u, n_v) = (64, 80);
    let (k_u, k_v) = (knots(3, n_u - 3, 1), knots(3, n_v - 3, 1));
    let half = |from: f64| {
        let pole = |i: usize, j: usize| {
            let theta = from + PI * i as f64 / (n_u - 1) as f64;
            let phi = PI * (j as f64 / (n_v - 1) as f64 - 0.5);
            let r = 10.0 + (5.0 * theta).sin() * (4.0 * phi).sin() * phi.cos().powi(2);
            let across = if j == 0 || j == n_v - 1 { 0.0 } else { r * phi.cos() };
            DVec3::new(across * theta.cos(), across * theta.sin(), r * phi.sin())
        };
        let poles = (0..n_u * n_v).map(|n| pole(n / n_v, n % n_v)).collect();
        surface(&k_u, &k_v, n_u, poles)
    };
    ball_of([half(0.0), half(PI)])
}

/// The same ball with surfaces whose u runs the other way: their normals point inwards, the faces' do not.
fn turned_ball() -> Brep {
    let mut brep = ball();
    for face in &mut brep.faces {
        let rows: Vec<_> = (0..face.surface.n_u).rev().map(|i| row(&face.surface, i)).collect();
        face.surface.poles = rows.concat();
        face.same_sense = false;
    }
    brep
}

fn written(brep: &Brep, options: &StepOptions) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.step");
    write_step(&path, brep, options).unwrap();
    std::fs::read_to_string(&path).unwrap()
}

#[test]
fn reals_read_back_exactly_and_follow_part_21() {
    let shown = |v: f64| reals(&[v]).to_string();
    for (value, expected) in
        [(0.0, "0."), (-0.0, "0."), (1.0, "1."), (-2.5, "-2.5"), (1e-7, "1.E-7"), (1.5e300, "1.5E300")]
    {
        assert_eq!(shown(value), expected);
    }
    let mut bits = 0x9e37_79b9_7f4a_7c15_u64;
    for _ in 0..2000 {
        bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let value = f64::from_bits(bits);
        if value.is_finite() {
            let text = shown(value);
            assert!(text.contains('.') && !text.contains('e'), "{text}");
            assert_eq!(text.parse::<f64>().unwrap().to_bits(), value.to_bits(), "{text}");
        }
    }
}

#[test]
fn names_are_encoded_as_part_21_requires() {
    assert_eq!(text("it's a \\ läser 🙂"), "'it''s a \\\\ l\\X2\\00E4\\X0\\ser \\X2\\D83DDE42\\X0\\'");
}

#[test]
fn the_same_shape_gives_the_same_bytes() {
    let options = StepOptions::default();
    let first = written(&ball(), &options);
    assert_eq!(first, written(&ball(), &options));
    assert!(first.contains("FILE_NAME('part','1970-01-01T00:00:00',(''),(''),'Planish','Planish','');"));
}

#[test]
fn all_references_are_valid() {
    for brep in [sheet(), tube(), ball(), turned_ball(), bumpy_ball()] {
        for unit in [Unit::Millimetre, Unit::Metre, Unit::Inch] {
            let options = StepOptions { unit, ..StepOptions::default() };
            let text = written(&brep, &options);
            let instances = text.lines().filter(|l| l.starts_with('#')).count() as u64;
            for reference in text.split('#').skip(1) {
                let number = reference.split(|c: char| !c.is_ascii_digit()).next().unwrap();
                assert!((1..=instances).contains(&number.parse::<u64>().unwrap()));
            }
        }
    }
}

/// A shape beside another one.
fn beside(mut brep: Brep, other: Brep) -> Brep {
    let (vertices, edges) = (brep.vertices.len(), brep.edges.len());
    brep.vertices.extend(other.vertices);
    let moved = |edge: BrepEdge| BrepEdge { start: edge.start + vertices, end: edge.end + vertices, ..edge };
    brep.edges.extend(other.edges.into_iter().map(moved));
    for mut face in other.faces {
        face.edges.iter_mut().chain(face.holes.iter_mut().flatten()).for_each(|(edge, _)| *edge += edges);
        brep.faces.push(face);
    }
    brep.closed &= other.closed;
    brep
}

#[test]
fn each_body_has_its_shell() {
    let count = |brep: &Brep, words: [&str; 3]| {
        let text = written(brep, &StepOptions::default());
        words.map(|word| text.matches(word).count())
    };
    let kinds = ["MANIFOLD_SOLID_BREP", "CLOSED_SHELL", "OPEN_SHELL"];
    assert_eq!(count(&beside(ball(), turned_ball()), kinds), [2, 2, 0]);
    assert_eq!(count(&beside(tube(), sheet()), kinds), [0, 0, 2]);
    // A solid beside a sheet is a closed shell of a surface model.
    assert_eq!(count(&beside(sheet(), ball()), kinds), [0, 1, 1]);
    assert_eq!(beside(sheet(), tube()).shells(), [vec![0], vec![1, 2]]);
}

#[test]
fn inconsistent_shapes_are_rejected_by_name() {
    let error_after = |change: fn(&mut Brep)| {
        let mut brep = tube();
        change(&mut brep);
        let e = brep.check(1e-6).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Input);
        e.to_string()
    };
    assert!(error_after(|b| b.faces.clear()).contains("at least one face"));
    assert!(error_after(|b| b.edges[1].end = 9).contains("edge 1: expected a vertex below 4, found 9"));
    assert!(
        error_after(|b| b.vertices[3][0] += 0.1)
            .contains("edge 1: expected its curve to end at vertex 3, found a distance of 0.1")
    );
    assert!(
        error_after(|b| b.faces[1].edges[0].0 = 77).contains("face 1: expected an edge below 6, found 77")
    );
    assert!(
        error_after(|b| b.faces[1].edges[0].1 = false).contains("face 1: expected edge 4 to start at vertex")
    );
    assert!(error_after(|b| b.faces[0].surface.poles[5][1] = f64::NAN).contains("face 0: expected finite"));
    assert!(error_after(|b| b.faces[0].surface.knots_u[1].1 = 1).contains("face 0: along u"));
    assert!(error_after(|b| b.edges[0].curve.knots.swap(0, 1)).contains("edge 0: expected ascending knots"));
    assert!(error_after(|b| b.closed = true).contains("edge 2: expected one use in each direction"));
    assert!(
        error_after(|b| b.faces.push(b.faces[0].clone()))
            .contains("face 2: expected edge 2 once in each direction")
    );
    let folder = tempfile::tempdir().unwrap();
    let mut brep = sheet();
    brep.vertices[0][0] = f64::INFINITY;
    assert!(write_step(&folder.path().join("a.step"), &brep, &StepOptions::default()).is_err());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// Writes the shapes into the folder that PLANISH_STEP_OUT names, for tests/peers/check_step.py.
#[test]
fn shapes_for_open_cascade() {
    let Some(folder) = std::env::var_os("PLANISH_STEP_OUT").map(std::path::PathBuf::from) else {
        println!("skipped: PLANISH_STEP_OUT does not name a folder");
        return;
    };
    for (name, brep) in [
        ("sheet", sheet()),
        ("tube", tube()),
        ("ball", ball()),
        ("turned", turned_ball()),
        ("bumpy", bumpy_ball()),
    ] {
        for schema in [Schema::Ap214, Schema::Ap242] {
            for unit in [Unit::Millimetre, Unit::Metre, Unit::Inch] {
                let options =
                    StepOptions { name: format!("{name} ä"), unit, schema, ..StepOptions::default() };
                let file = format!("{name}.{unit}.{schema:?}.step");
                write_step(&folder.join(file), &brep, &options).unwrap();
            }
        }
    }
}
