use super::*;
use planish_estimate::ErrorKind;
use proptest::prelude::*;
use serde_json::json;

fn model() -> ModelFile {
    let tensor = |shape: &[usize], data| Tensor { shape: shape.to_vec(), data };
    ModelFile {
        tensors: [
            ("vertices", tensor(&[2, 3], TensorData::F64(vec![0.1, -0.0, 1e-300, f64::MAX, 5.0, 6.0]))),
            ("cells", tensor(&[2, 1], TensorData::U32(vec![0, u32::MAX]))),
            ("observed", tensor(&[3], TensorData::U8(vec![0, 1, 2]))),
            ("order", tensor(&[], TensorData::I64(vec![-3]))),
            ("none", tensor(&[0, 3], TensorData::F64(vec![]))),
        ]
        .map(|(name, tensor)| (name.to_owned(), tensor))
        .into(),
        metadata: json!({ "unit": "mm", "sensors": [{ "name": "läser \"1\"" }], "schema": SCHEMA }),
    }
}

#[test]
fn models_read_back_unchanged_and_write_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.planish");
    write_model(&path, &model()).unwrap();
    let first = std::fs::read(&path).unwrap();
    let read = read_model(&path).unwrap();
    assert_eq!(read, model());
    for _ in 0..5 {
        write_model(&path, &read).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), first);
    }
}

#[test]
fn numbers_of_the_metadata_keep_every_bit() {
    let mut state = 1_u64;
    let numbers: Vec<f64> = (0..2000)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 * 1e-14
        })
        .chain([31.245_270_191_439_438])
        .collect();
    let mut model = model();
    model.metadata["numbers"] = json!(numbers);
    let read = from_bytes(&to_bytes(&model).unwrap()).unwrap();
    assert_eq!(read.metadata["numbers"], json!(numbers));
}

#[test]
fn truncated_files_are_rejected() {
    let bytes = to_bytes(&model()).unwrap();
    for end in 0..bytes.len() {
        assert_eq!(from_bytes(&bytes[..end]).unwrap_err().kind(), ErrorKind::Input, "{end}");
    }
    let longer = [&bytes[..], b"x"].concat();
    assert!(from_bytes(&longer).is_err());
}

/// A file of the first version, which had no checksums.
fn without_checksums(model: &ModelFile) -> Vec<u8> {
    let mut metadata = model.metadata.clone();
    metadata[SCHEMA_KEY] = json!(1);
    let metadata = HashMap::from([(KEY.to_owned(), metadata.to_string())]);
    safetensors::serialize(model.tensors.iter(), Some(metadata)).unwrap()
}

#[test]
fn every_flipped_bit_is_detected() {
    let bytes = to_bytes(&model()).unwrap();
    let original = from_bytes(&bytes).unwrap();
    for bit in 0..8 * bytes.len() {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        // A few bits have no meaning: the padding of the header may be any white space.
        if let Ok(read) = from_bytes(&damaged) {
            assert_eq!(read, original, "bit {} of byte {}", bit % 8, bit / 8);
        }
    }
}

#[test]
fn a_changed_tensor_is_named_with_both_checksums() {
    let bytes = to_bytes(&model()).unwrap();
    let at = bytes.windows(8).position(|w| w == 0.1_f64.to_le_bytes()).unwrap();
    let mut damaged = bytes.clone();
    damaged[at] ^= 1;
    let e = from_bytes(&damaged).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Input);
    assert!(e.to_string().starts_with("tensor `vertices`: expected the SHA-256"), "{e}");
}

#[test]
fn metadata_and_the_list_of_tensors_are_covered() {
    let bytes = to_bytes(&model()).unwrap();
    let replaced = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        let mut damaged = bytes.clone();
        damaged[at..at + to.len()].copy_from_slice(to.as_bytes());
        from_bytes(&damaged).unwrap_err().to_string()
    };
    assert!(replaced("l\u{e4}ser", "l\u{f6}ser").contains("metadata `planish`: expected the SHA-256"));
    assert!(replaced(r#"\"unit\":\"mm\""#, r#"\"unit\":\"ft\""#).contains("metadata `planish`"));
    assert!(
        replaced(r#""shape":[2,3]"#, r#""shape":[3,2]"#).contains("expected the shape [2,3], found [3,2]")
    );
    assert!(replaced(r#""none":"#, r#""gone":"#).contains("expected the tensor `none`"));
    assert!(replaced(r#"\"tensors\""#, r#"\"sensor2\""#).contains("metadata `planish`"));
}

#[test]
fn files_without_checksums_are_read_and_say_so() {
    let bytes = without_checksums(&model());
    let read = from_bytes(&bytes).unwrap();
    assert!(!read.has_checksums());
    assert_eq!(read.tensors, model().tensors);
    // Written again, the file has checksums.
    let again = from_bytes(&to_bytes(&read).unwrap()).unwrap();
    assert!(again.has_checksums());
    assert_eq!(again, model());
}

#[test]
fn a_damaged_version_does_not_switch_checksums_off() {
    let bytes = to_bytes(&model()).unwrap();
    let version = br#"\"schema\":2"#;
    let at = bytes.windows(version.len()).position(|w| w == version).unwrap();
    let mut damaged = bytes;
    damaged[at + version.len() - 1] = b'1';
    let e = from_bytes(&damaged).unwrap_err();
    assert!(e.to_string().contains("expected the SHA-256"), "{e}");
}

#[test]
fn another_program_can_compute_the_checksum_of_the_metadata() {
    let mut model = model();
    // Zeros like those in place of the checksum must not confuse a reader.
    model.metadata["name"] = json!("0".repeat(64));
    let bytes = to_bytes(&model).unwrap();
    assert_eq!(from_bytes(&bytes).unwrap(), model);
}

#[test]
fn foreign_and_newer_files_have_their_own_messages() {
    let none: [(&str, &Tensor); 0] = [];
    let write = |metadata: Option<&str>| {
        let metadata = metadata.map(|text| HashMap::from([(KEY.to_owned(), text.to_owned())]));
        safetensors::serialize(none, metadata).unwrap()
    };
    let e = from_bytes(&write(None)).unwrap_err();
    assert!(e.kind() == ErrorKind::Input && e.to_string().contains("without metadata `planish`"), "{e}");
    let e = from_bytes(&write(Some(r#"{"schema": 3}"#))).unwrap_err();
    assert!(e.kind() == ErrorKind::Unsupported && e.to_string().contains("newer Planish"), "{e}");
    assert!(from_bytes(&write(Some("{}"))).unwrap_err().to_string().contains("expected a schema"));
    assert!(from_bytes(&write(Some("{"))).unwrap_err().to_string().contains("expected JSON"));
    assert!(from_bytes(b"solid part").unwrap_err().to_string().contains("expected a model saved by Planish"));
}

#[test]
fn a_shape_that_disagrees_with_its_numbers_is_rejected() {
    let mut wrong = model();
    wrong.tensors.insert("bad".to_owned(), Tensor { shape: vec![2], data: TensorData::U8(vec![1]) });
    assert!(to_bytes(&wrong).unwrap_err().to_string().contains("tensor `bad`"));
}

proptest! {
    #[test]
    fn no_bytes_cause_a_panic(
        mut bytes in proptest::collection::vec(any::<u8>(), 0..200),
        length in 0_u64..100,
    ) {
        let _ = from_bytes(&bytes);
        bytes.splice(0..0, length.to_le_bytes());
        let _ = from_bytes(&bytes);
    }

    #[test]
    fn no_changed_byte_causes_a_panic(at in 0_usize..600, value in any::<u8>()) {
        let mut bytes = to_bytes(&model()).unwrap();
        let at = at % bytes.len();
        bytes[at] = value;
        let _ = from_bytes(&bytes);
    }
}
