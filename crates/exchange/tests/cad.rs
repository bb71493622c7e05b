//! Reads CAD files of other programs and compares area and volume with Open Cascade. Files are skipped unless
//! they are in `../shared/data` beside the repository, or in the folder that PLANISH_DATA names.

#![allow(clippy::print_stdout, reason = "reports skipped files and deviations")]

use planish_exchange::Unit;
use planish_exchange::step::read_step;
use planish_mesh::TriangleMesh;
use planish_solid::parametric::Fineness;
use std::path::PathBuf;

/// File, unit, faces, parts; area and volume of all faces in mm² and mm³, computed by Open Cascade 7.9.
const FILES: [(&str, Unit, usize, usize, f64, f64); 9] = [
    ("cad/FlatTargetv3.step", Unit::Millimetre, 38, 1, 51158.90315529454, 223283.24792028122),
    ("cad/frame.step", Unit::Inch, 375, 1, 1026843.886840436, 10156645.592817303),
    ("cad/nist_ctc_01_asme1_ap242-e1.stp", Unit::Millimetre, 117, 1, 807080.8219457449, 14644823.305937588),
    ("cad/nist_ctc_02_asme1_ap242-e2.stp", Unit::Millimetre, 637, 2, 2490716.5591846486, 47106787.80020491),
    ("cad/nist_ctc_03_asme1_ap242-e2.stp", Unit::Millimetre, 120, 1, 354787.6501753441, 332122.9076266054),
    ("cad/nist_ctc_04_asme1_ap242-e1.stp", Unit::Millimetre, 484, 2, 1023459.2083351734, 17519780.21875622),
    ("cad/nist_ctc_05_asme1_ap242-e1.stp", Unit::Inch, 156, 1, 861243.3507515282, 12694917.818574062),
    ("cad/screw.step", Unit::Millimetre, 10, 1, 1929.3326727317942, 3788.270593373757),
    ("meshes/tea_cup.step", Unit::Millimetre, 28, 1, 87984.58797123565, 130327.08407598422),
];

#[test]
fn area_and_volume_of_cad_files_agree_with_open_cascade() {
    let data = std::env::var_os("PLANISH_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")),
        PathBuf::from,
    );
    for (file, unit, count, parts, area, volume) in FILES {
        let path = data.join(file);
        if !path.is_file() {
            println!("skipped: {} is not there", path.display());
            continue;
        }
        let faces = read_step(&path).unwrap();
        assert_eq!(faces.unit(), Some(unit), "{file}");
        let fineness = Fineness { chord: 1e-4 * faces.size(), longest: f64::INFINITY };
        let read = faces.triangles(&fineness).unwrap();
        assert_eq!((read.faces, read.parts.len()), (count, parts), "{file}: {:?}", read.unreadable);
        assert!(read.unreadable.is_empty());
        let (mut areas, mut volumes) = (0.0, 0.0);
        for part in read.parts {
            let mesh = TriangleMesh::try_new(part.points, part.triangles).unwrap();
            let check = mesh.check();
            assert!(check.manifold, "{file}: {check:?}");
            for t in &mesh.triangles {
                let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
                let n = (b - a).cross(c - a);
                areas += 0.5 * n.length();
                // Open shells beside a body enclose no volume.
                volumes += if check.watertight { a.dot(n) / 6.0 } else { 0.0 };
            }
        }
        let mm = unit.millimetres();
        let (area_off, volume_off) = (areas * mm * mm / area - 1.0, volumes * mm * mm * mm / volume - 1.0);
        println!(
            "{file}: {count} faces, area {area_off:+.1e}, volume {volume_off:+.1e} relative to Open Cascade"
        );
        assert!(area_off.abs() < 1e-3 && volume_off.abs() < 2e-3, "{file}: {area_off} {volume_off}");
    }
}
