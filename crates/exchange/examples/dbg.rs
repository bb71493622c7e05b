use planish_solid::views::*;
fn main() {
    let name = std::env::args().nth(1).unwrap();
    let views = [(ViewKind::Front,"front"),(ViewKind::Top,"top"),(ViewKind::Side,"side")].into_iter().map(|(kind,v)| {
        let d = planish_exchange::dxf::read_dxf(std::path::Path::new(&format!("{name}.{v}.dxf"))).unwrap();
        View{kind, curves: d.curves}
    }).collect();
    println!("{}", debug_solve(&Drawing{views}));
}
