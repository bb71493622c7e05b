use planish_solid::views::*;
fn main() {
    let name = std::env::args().nth(1).unwrap();
    let views = [(ViewKind::Front,"front"),(ViewKind::Top,"top"),(ViewKind::Side,"side")].into_iter().map(|(kind,v)| {
        let d = planish_exchange::dxf::read_dxf(std::path::Path::new(&format!("{name}.{v}.dxf"))).unwrap();
        View{kind, curves: d.curves}
    }).collect();
    let t = std::time::Instant::now();
    match solve(&Drawing{views}) {
        Ok(s) => { println!("{} solutions, {} unexplained, {} rejected {:.3} s", s.solutions.len(), s.unexplained.len(), s.rejected.len(), t.elapsed().as_secs_f64());
          for x in s.solutions.iter().take(2) { println!("  vol {:.9} area {:.6} faces {:?}", x.measures.volume, x.measures.area, x.solid.faces_by_kind()); }
          for r in s.rejected.iter().take(2) { println!("  rej {r}"); } }
        Err(e) => println!("ERR {e}"),
    }
}
