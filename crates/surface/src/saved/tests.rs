use super::*;
use crate::model::{Departure, Observed, PredictionError, PredictiveSigma};
use crate::test_support::{assert_same_model, model_of, small_model};
use planish_core::DVec3;
use planish_estimate::ErrorKind;
use planish_spline::{Hierarchy, QuadDomain, Shape, Surface};
use serde_json::json;

fn session() -> Session {
    Session {
        version: "0.1.0".to_owned(),
        arguments: ["fit", "a.ply", "--seed", "3"].map(str::to_owned).to_vec(),
        seed: 3,
        inputs: vec![SessionInput {
            name: "a.ply".to_owned(),
            points: 1234,
            points_hash: Some("5eed".to_owned()),
        }],
    }
}

/// A model that knows one leaf by parts, and the errors of unobserved surface.
fn model_with_support(shape: Shape) -> SurfaceModel {
    let mut model = small_model(shape);
    model.set_not_followed(2, [[0.0, 0.0], [0.4, 1.0]]);
    assert_eq!(model.observed_at(2, [0.1, 0.9]), Observed::NotFollowed);
    let near = PredictionError { distance: 0.25, factor: 1.5, floor: 1.0 / 3.0 };
    let far = PredictionError { distance: 2.0 / 3.0, factor: 4.0, ..near };
    let of_leaf = (0..model.observed.len()).map(|leaf| (leaf % 5) as f64 / 5.0).collect();
    let departure = Departure::new(vec![[0.25, 0.1], [0.5, 0.7]], of_leaf).unwrap();
    let errors = PredictiveSigma::new(vec![near, far], 1.25, 7.0).unwrap();
    model.predictive = Some(errors.with_departure(departure));
    model
}

#[test]
fn save_load_save_gives_the_same_model_and_bytes() {
    let folder = tempfile::tempdir().unwrap();
    for shape in [Shape::Sheet, Shape::Tube, Shape::Ball, Shape::Torus] {
        let model = model_with_support(shape);
        let (first, second) = (folder.path().join("first.planish"), folder.path().join("second.planish"));
        save(&model, &[session()], &first).unwrap();
        let loaded = load_with_provenance(&first).unwrap();
        assert_eq!(loaded.provenance, [session()]);
        assert_same_model(&loaded.model, &model);
        save(&loaded.model, &loaded.provenance, &second).unwrap();
        assert_eq!(std::fs::read(&first).unwrap(), std::fs::read(&second).unwrap());
    }
}

/// A model over a cube of which some edges are sharp, with a marked corner.
fn model_with_creases(creases: &[[u32; 2]], corners: &[u32]) -> SurfaceModel {
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let cube = QuadDomain::with_creases(&quads, creases, corners);
    let division = cube.unwrap().divided().unwrap();
    let corners: Vec<DVec3> =
        (0..8).map(|k| DVec3::new((k & 1).into(), (k >> 1 & 1).into(), (k >> 2).into())).collect();
    let vertices = division.apply(&corners);
    let surface = Surface::new(Hierarchy::over(division.domain.into()).unwrap().into(), vertices).unwrap();
    model_of(surface, |leaf| leaf % 5 != 0)
}

#[test]
fn creases_are_saved_with_the_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("creased.planish");
    let model = model_with_creases(&[[0, 1], [1, 3], [3, 2], [2, 0], [6, 7], [7, 5]], &[1]);
    save(&model, &[], &path).unwrap();
    let loaded = load(&path).unwrap();
    assert_same_model(&loaded, &model);
    assert!(loaded.surface.space().same_base(model.surface.space()));
    let domain = loaded.surface.space().domain().unwrap();
    assert_eq!((domain.creases().len(), domain.corners().len()), (12, 1));
    let smooth = to_file(&model_with_creases(&[], &[]), &[]).unwrap();
    assert!(!smooth.tensors.contains_key(CREASES) && !smooth.tensors.contains_key(CORNERS));
    assert!(from_file(smooth).is_ok());
    // Cells at ends of creases have several leaves, so a reader that ignores creases notices it.
    let mut file = to_file(&model, &[]).unwrap();
    file.tensors.remove(CREASES);
    let found = from_file(file).expect_err("leaves differ").to_string();
    assert!(found.contains("do not tile the quads"), "{found}");
    // An edge that is none of the quads is damage.
    let mut file = to_file(&model, &[]).unwrap();
    let TensorData::U32(numbers) = &mut file.tensors.get_mut(CREASES).unwrap().data else { panic!() };
    numbers[1] = 4_000_000;
    let found = from_file(file).expect_err("the change is damage").to_string();
    assert!(found.contains("is no edge of a quad"), "{found}");
}

#[test]
fn a_loaded_model_has_the_same_covariance() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.planish");
    let model = small_model(Shape::Ball);
    save(&model, &[], &path).unwrap();
    let loaded = load(&path).unwrap();
    let c = planish_spline::leaf_weights(0.3, 0.6);
    let variance = |model: &SurfaceModel| {
        model.posterior().unwrap().leaf(5).unwrap().variance_along(&c, DVec3::new(0.0, 0.6, 0.8))
    };
    assert_eq!(variance(&model).to_bits(), variance(&loaded).to_bits());
}

/// The message of loading a file after a change.
fn complaint(change: impl FnOnce(&mut ModelFile)) -> String {
    let mut file = to_file(&small_model(Shape::Ball), &[session()]).unwrap();
    change(&mut file);
    let e = from_file(file).expect_err("the change is damage");
    assert_eq!(e.kind(), ErrorKind::Input, "{e}");
    e.to_string()
}

#[test]
fn every_kind_of_damage_is_reported() {
    fn f64s<'a>(file: &'a mut ModelFile, name: &str) -> &'a mut Vec<f64> {
        match &mut file.tensors.get_mut(name).unwrap().data {
            TensorData::F64(values) => values,
            _ => panic!("{name} holds no f64"),
        }
    }
    fn u32s<'a>(file: &'a mut ModelFile, name: &str) -> &'a mut Vec<u32> {
        match &mut file.tensors.get_mut(name).unwrap().data {
            TensorData::U32(values) => values,
            _ => panic!("{name} holds no u32"),
        }
    }
    for name in to_file(&small_model(Shape::Ball), &[]).unwrap().tensors.into_keys() {
        assert!(complaint(|file| drop(file.tensors.remove(&name))).contains(&name), "{name}");
    }
    for (name, words) in [("unit", "expected `mm`"), ("shape", "expected sheet")] {
        assert!(complaint(|file| file.metadata[name] = json!("other")).contains(words));
    }
    assert!(complaint(|file| file.metadata["base"] = json!([1_u64 << 40, 1_u64 << 40])).contains("knots_u"));
    assert!(complaint(|file| file.metadata["poses"] = json!([])).contains("poses"));
    assert!(
        complaint(|file| drop(file.metadata.as_object_mut().unwrap().remove("sensors"))).contains("sensors")
    );
    assert!(complaint(|file| file.metadata["smoothness_weight"] = json!(-1.0)).contains("smoothness_weight"));
    assert!(complaint(|file| f64s(file, "knots_u")[1] = 0.5).contains("knots_u"));
    assert!(complaint(|file| f64s(file, "vertices")[7] = f64::NAN).contains("vertices"));
    assert!(
        complaint(|file| f64s(file, "information_prior_values")[3] = f64::INFINITY).contains("prior_values")
    );
    assert!(
        complaint(|file| u32s(file, "information_data_indices")[3] += 1)
            .contains("expected the couplings of the cells")
    );
    assert!(complaint(|file| u32s(file, "cells")[0] = 13).contains("levels up to"));
    assert!(complaint(|file| u32s(file, "cells")[1] = 1000).contains("outside"));
    assert!(complaint(|file| u32s(file, "cells").copy_within(3..6, 0)).contains("tile"));
    assert!(
        complaint(|file| {
            file.tensors.insert("observed".to_owned(), tensor(&[2], TensorData::U8(vec![1, 1])));
        })
        .contains("observed")
    );
    assert!(
        complaint(|file| {
            let tensor = file.tensors.get_mut("vertices").unwrap();
            tensor.shape = vec![tensor.shape[0] * 3];
        })
        .contains("expected the shape [n, 3]")
    );
}

#[test]
fn cells_in_another_order_keep_their_marks() {
    let model = small_model(Shape::Sheet);
    let mut file = to_file(&model, &[]).unwrap();
    let count = model.observed.len();
    let reversed = |data: &TensorData, width: usize| match data {
        TensorData::U32(v) => TensorData::U32(v.chunks(width).rev().flatten().copied().collect()),
        TensorData::U8(v) => TensorData::U8(v.iter().rev().copied().collect()),
        other => other.clone(),
    };
    for (name, width) in [("cells", 3), ("observed", 1)] {
        let tensor = file.tensors.get_mut(name).unwrap();
        tensor.data = reversed(&tensor.data, width);
    }
    let loaded = from_file(file).unwrap().model;
    assert_eq!((loaded.observed.len(), &loaded.observed), (count, &model.observed));
}

#[test]
fn a_number_that_is_not_finite_is_not_saved() {
    let mut model = small_model(Shape::Sheet);
    model.known.information_mut().unwrap().data.values_mut()[0] = f64::NAN;
    assert!(to_file(&model, &[]).unwrap_err().to_string().contains("information_data_values"));
}

/// Changes a number of a tensor and returns the message of loading.
fn complaint_of(name: &str, index: usize, value: f64) -> String {
    complaint(|file| match &mut file.tensors.get_mut(name).unwrap().data {
        TensorData::F64(values) => values[index] = value,
        TensorData::U8(values) => values[index] = value as u8,
        _ => panic!("{name} holds other numbers"),
    })
}

#[test]
fn numbers_out_of_range_are_named_with_their_index() {
    let of_metadata = |path: &str, value: serde_json::Value| {
        complaint(|file| *file.metadata.pointer_mut(path).unwrap() = value)
    };
    for (path, value, words) in [
        (
            "/sensors/0/sigma_stated",
            json!(-1.0),
            "`sensors[0].sigma_stated`: expected a number > 0, found -1",
        ),
        ("/sensors/0/sigma_estimated", json!(-1.0), "`sensors[0].sigma_estimated`: expected a number ≥ 0"),
        ("/sensors/0/rms", json!(-1.0), "sensors[0].rms"),
        ("/poses/0/sigma_translation", json!(-1.0), "poses[0].sigma_translation"),
        ("/poses/0/covariance/2/2", json!(-1.0), "`poses[0].covariance`, row 2, column 2"),
        ("/poses/0/covariance/2/1", json!(0.9), "`poses[0].covariance`, row 2, column 1"),
    ] {
        let e = of_metadata(path, value);
        assert!(e.contains(words), "{path}: {e}");
    }
    for (name, index, value, words) in [
        ("poses", 6, 0.0, "row 0: expected a quaternion x y z w of length 1"),
        ("observed", 3, 7.0, "row 3: expected 0, 1, 2 or 3, found 7"),
        ("information_prior_values", 0, -1.0, "block 0 (vertex 0): expected numbers ≥ 0 on the diagonal"),
        ("information_data_values", 10, 1e9, "block 1 (vertex 0): expected at most"),
        ("information_shared_corner", 3, -1.0, "row 1, column 1"),
        ("information_shared_corner", 1, 9.0, "row 1, column 0"),
    ] {
        let e = complaint_of(name, index, value);
        assert!(e.contains(&format!("tensor `{name}`")) && e.contains(words), "{name}: {e}");
    }
}

#[test]
fn a_prior_without_information_is_refused() {
    let e = complaint(|file| {
        for part in ["values", "vector"] {
            match &mut file.tensors.get_mut(&format!("information_prior_{part}")).unwrap().data {
                TensorData::F64(values) => values.fill(0.0),
                _ => panic!("expected f64"),
            }
        }
    });
    assert!(
        e.contains("tensor `information_prior_values`, block 0 (vertex 0): expected information > 0"),
        "{e}"
    );
}

#[test]
fn vertices_that_differ_from_their_information_are_refused() {
    for shape in [Shape::Sheet, Shape::Tube, Shape::Ball, Shape::Torus] {
        let original = to_file(&small_model(shape), &[]).unwrap();
        let model = small_model(shape);
        // The limit without a stated residual is in σ, so the vertex is the one with the smallest σ.
        let known = model.known.information().unwrap().data.diagonal();
        let entry = (0..known.len()).max_by(|&a, &b| known[a].total_cmp(&known[b])).unwrap();
        let vertex = entry / 3;
        let normal = model.surface.node_normals()[vertex];
        for (by, is_stated) in [(1e-3, true), (1.0, true), (1.0, false)] {
            let mut file = original.clone();
            if let TensorData::F64(values) = &mut file.tensors.get_mut("vertices").unwrap().data {
                for d in 0..3 {
                    values[3 * vertex + d] += by * normal[d];
                }
            }
            if !is_stated {
                file.metadata.as_object_mut().unwrap().remove("mean_residual");
            }
            let e = from_file(file).map(drop).expect_err("a vertex was moved").to_string();
            assert!(e.contains("`vertices` does not agree with the information"), "{shape:?}: {e}");
        }
    }
}

#[test]
fn rounding_of_coordinates_far_from_the_origin_is_no_damage() {
    // A processor that adds in another order changes the last digits of the residual.
    let changed = |origin: DVec3| {
        let model = small_model(Shape::Ball).translated(origin).unwrap();
        let mut file = to_file(&model, &[]).unwrap();
        from_file(file.clone()).unwrap();
        let stated = file.metadata["mean_residual"].as_f64().unwrap();
        file.metadata["mean_residual"] = json!(stated + 3e-6 * stated.max(1e-3));
        from_file(file).map(|_| ())
    };
    assert!(changed(DVec3::ZERO).is_err());
    assert!(changed(DVec3::new(4e8, 5e9, 300.0)).is_ok());
}

#[test]
fn a_file_without_checksums_has_a_finding() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.planish");
    save(&small_model(Shape::Ball), &[], &path).unwrap();
    assert!(load_with_provenance(&path).unwrap().findings.is_empty());
    // As version 1 wrote it.
    let mut file = read_model(&path).unwrap();
    file.metadata["schema"] = json!(1);
    let codes: Vec<_> = from_file(file).unwrap().findings.iter().map(|f| f.code).collect();
    assert_eq!(codes, [planish_core::FindingCode::ModelWithoutChecksums]);
}

#[test]
fn support_that_does_not_fit_the_cells_is_refused() {
    let complaint = |change: &dyn Fn(&mut ModelFile)| {
        let mut file = to_file(&model_with_support(Shape::Ball), &[]).unwrap();
        change(&mut file);
        from_file(file).expect_err("the change is damage").to_string()
    };
    let bytes = |file: &mut ModelFile, name: &str, at: usize, value: u8| {
        let TensorData::U8(values) = &mut file.tensors.get_mut(name).unwrap().data else { panic!("{name}") };
        values[at] = value;
    };
    let found = complaint(&|file| bytes(file, "support_depth", 0, 9));
    assert!(found.contains("`support_depth`, row 0: expected 0 to 5 divisions, found 9"), "{found}");
    let found = complaint(&|file| bytes(file, "support_depth", 0, 1));
    assert!(found.contains("expected a row for each of"), "{found}");
    let found = complaint(&|file| bytes(file, "support_marks", 3, 4));
    assert!(found.contains("`support_marks`, row 3: expected 0, 1, 2 or 3, found 4"), "{found}");
    let found = complaint(&|file| {
        let TensorData::F64(values) = &mut file.tensors.get_mut("predictive_errors").unwrap().data else {
            panic!()
        };
        values[1] = 0.5;
    });
    assert!(found.contains("predictive_errors") && found.contains("factors ≥ 1"), "{found}");
}
