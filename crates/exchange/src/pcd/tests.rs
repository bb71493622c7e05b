use super::*;
use planish_sense::RangeGrid;
use proptest::prelude::*;

fn read(bytes: &[u8]) -> Result<Scan> {
    scan_from(&mut Source::new(bytes, Some(bytes.len() as u64)), "a.pcd")
}

fn message(bytes: &[u8]) -> String {
    read(bytes).unwrap_err().to_string()
}

/// Two rows of two points, one of them NaN, with a normal and an unused field of three numbers.
fn header(data: &str) -> String {
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z normal_x normal_y \
         normal_z extra\n\
         SIZE 8 8 8 4 4 4 2\nTYPE F F F F F F U\nCOUNT 1 1 1 1 1 1 3\nWIDTH 2\nHEIGHT 2\nVIEWPOINT 0 0 \
         5 1 0 0 0\n\
         POINTS 4\nDATA {data}\n"
    )
}

const POINTS: [DVec3; 4] =
    [DVec3::Z, DVec3::new(1.0, 0.0, 1.5), DVec3::new(f64::NAN, 0.0, 0.0), DVec3::new(1.0, 1.0, 0.25)];

fn record(p: DVec3) -> [Vec<u8>; 7] {
    let [x, y, z] = p.to_array().map(|c| c.to_le_bytes().to_vec());
    let [a, b, c] = [0.0_f32, 0.0, 1.0].map(|n| n.to_le_bytes().to_vec());
    [x, y, z, a, b, c, vec![1, 0, 2, 0, 3, 0]]
}

fn binary() -> Vec<u8> {
    let mut bytes = header("binary").into_bytes();
    bytes.extend(POINTS.iter().flat_map(|&p| record(p).concat()));
    bytes
}

fn text() -> Vec<u8> {
    let lines: String =
        POINTS.iter().map(|DVec3 { x, y, z }| format!("{x} {y} {z} 0 0 1 1 2 3\r\n")).collect();
    (header("ascii") + &lines).into_bytes()
}

fn compressed() -> Vec<u8> {
    let records = POINTS.map(record);
    let body: Vec<u8> = (0..7).flat_map(|field| records.iter().flat_map(move |r| r[field].clone())).collect();
    // Literal runs only.
    let mut packed = Vec::new();
    for run in body.chunks(32) {
        packed.push(run.len() as u8 - 1);
        packed.extend_from_slice(run);
    }
    let mut bytes = header("binary_compressed").into_bytes();
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend((body.len() as u32).to_le_bytes());
    bytes.extend(packed);
    bytes
}

#[test]
fn three_encodings_give_the_same_organised_scan() {
    for bytes in [text(), binary(), compressed()] {
        let scan = read(&bytes).unwrap();
        assert_eq!(scan.points, [POINTS[0], POINTS[1], POINTS[3]]);
        assert_eq!(scan.normals.unwrap(), [DVec3::Z; 3]);
        assert_eq!((scan.dropped_not_finite, scan.viewing), (1, Viewing::Origin(DVec3::new(0.0, 0.0, 5.0))));
        let grid = scan.grid.unwrap();
        assert_eq!((grid.columns, grid.rows), (2, 2));
        assert_eq!(grid.cells, [0, 1, RangeGrid::EMPTY, 2]);
    }
}

#[test]
fn copies_may_overlap_their_own_output() {
    // "ab", then eight bytes from two back, then 20 times the last byte.
    let packed = [1, b'a', b'b', (6 << 5), 1, (7 << 5), 11, 0];
    assert_eq!(
        unpack(&packed, 30).unwrap(),
        b"ababababab".iter().chain(&[b'b'; 20]).copied().collect::<Vec<u8>>()
    );
    assert!(unpack(&packed, 29).is_none() && unpack(&packed, 31).is_none());
    assert!(unpack(&[32, 0], 3).is_none(), "nothing to copy from");
    assert!(unpack(&[3, 1, 2], 4).is_none(), "cut off");
}

#[test]
fn the_default_viewpoint_of_an_unorganised_cloud_is_unknown() {
    let scan = read(
        b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 \
        0\nPOINTS 1\nDATA ascii\n1 2 3\n",
    )
    .unwrap();
    assert_eq!(
        (scan.points, scan.viewing, scan.grid),
        (vec![DVec3::new(1.0, 2.0, 3.0)], Viewing::Unknown, None)
    );
}

#[test]
fn conflicting_sizes_are_rejected() {
    let text = String::from_utf8(text()).unwrap();
    let height = text.replace("WIDTH 2", "WIDTH 3").replace("HEIGHT 2", "HEIGHT 9223372036854775807");
    assert!(message(height.as_bytes()).contains("declares 3 × 9223372036854775807 points"));
    assert!(message(text.replace("WIDTH 2\n", "").as_bytes()).contains("expected `WIDTH`"));
    let plain = text.replace("WIDTH 2\n", "").replace("HEIGHT 2\n", "");
    assert!(read(plain.as_bytes()).unwrap().grid.is_none());
}

#[test]
fn errors_name_line_or_byte() {
    let cut = binary();
    assert!(message(&cut[..cut.len() - 1]).contains("declares 4 points"));
    let text = String::from_utf8(text()).unwrap();
    assert!(message(text.replace("POINTS 4", "POINTS 5").as_bytes()).contains("`WIDTH` × `HEIGHT` is 4"));
    assert!(
        message(
            text.replace("POINTS 4", "POINTS 1000000000").replace("WIDTH 2", "WIDTH 500000000").as_bytes()
        )
        .contains("only")
    );
    assert!(
        message(text.replace("0 0 1 1 2 3", "0 0 one 1 2 3").as_bytes())
            .contains("line 12: expected a number, found `one`")
    );
    assert!(message(text.replace("TYPE F", "TYPE Q").as_bytes()).contains("`x`: expected a type"));
    assert!(
        message(text.replace("COUNT 1 1", "COUNT 1").as_bytes())
            .contains("in `COUNT`, one per field, found 6")
    );
    assert!(message(text.replace("FIELDS x", "FIELDS w").as_bytes()).contains("found no x"));
    assert!(message(b"hello\n").contains("line 1: expected `VERSION`"));
    assert!(message(b"VERSION 0.7\n").contains("before `DATA`"));
    let mut damaged = compressed();
    let last = damaged.len() - 1;
    damaged.truncate(last);
    assert!(message(&damaged).contains("cut off"));
}

proptest! {
    #[test]
    fn no_bytes_cause_a_panic(at in 0_usize..400, value in any::<u8>(), which in 0..3) {
        let mut bytes = [text(), binary(), compressed()][which as usize].clone();
        let at = at % bytes.len();
        bytes[at] = value;
        let _ = read(&bytes);
        let _ = read(&bytes[..at]);
    }
}
