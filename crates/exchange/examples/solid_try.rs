#![allow(missing_docs, clippy::all, clippy::print_stdout, clippy::unwrap_used)]
use planish_exchange::dxf::read_dxf;
use planish_exchange::step::{StepOptions, write_solid};
use planish_solid::reprojection::{CompareOptions, disagreements};
use planish_solid::views::{Drawing, Projection, View, ViewKind, solve, views_of_sheet};
use std::path::Path;
fn main() {
    let write = std::env::var("OUT").ok();
    for base in std::env::args().skip(1) {
        let start = std::time::Instant::now();
        let mut drawing = Drawing::default();
        if base.ends_with(".dxf") {
            drawing = views_of_sheet(&read_dxf(Path::new(&base)).unwrap().curves, Projection::FirstAngle).unwrap();
        } else {
            for (kind, name) in [
                (ViewKind::Front, "front"),
                (ViewKind::Top, "top"),
                (ViewKind::Side, "side"),
            ] {
                let path = format!("{base}.{name}.dxf");
                if Path::new(&path).exists() {
                    drawing.views.push(View {
                        kind,
                        curves: read_dxf(Path::new(&path)).unwrap().curves,
                    });
                }
            }
        }
        let name = Path::new(&base).file_name().unwrap().to_string_lossy().into_owned();
        match solve(&drawing) {
            Err(e) => println!("{name}: ERROR {e}"),
            Ok(found) => {
                let mut good = Vec::new();
                let mut refused = 0;
                let mut why = String::new();
                for s in &found.solutions {
                    let d = disagreements(&s.solid, &drawing, &CompareOptions::default());
                    if d.is_empty() {
                        good.push(s)
                    } else {
                        refused += 1;
                        why = format!("{:?}", d[0]);
                    }
                }
                println!(
                    "{name}: {} good {refused} refused {} rejected complete {} unexplained {} in {:.3}s {why}",
                    good.len(),
                    found.rejected.len(),
                    found.complete,
                    found.unexplained.len(),
                    start.elapsed().as_secs_f64()
                );
                for u in found.unexplained.iter().take(6) {
                    println!("     {:?} {:?} {}", u.view, u.entity, u.why);
                }
                for (k, s) in good.iter().enumerate() {
                    if k < 12 {
                        println!("   {} {:.6} {:?}", k + 1, s.measures.volume, s.solid.faces_by_kind());
                    }
                    if let Some(out) = &write {
                        write_solid(
                            Path::new(&format!("{out}/{name}.{}.step", k + 1)),
                            &s.solid,
                            &StepOptions::default(),
                        )
                        .unwrap();
                    }
                }
                for r in found.rejected.iter().take(40) {
                    println!("   - {:?} {}", r.why, r.message);
                }
            }
        }
    }
}
