//! Solids from their orthographic views.

mod cells;
mod column;
mod drawing;
mod plan;
mod profile;
mod search;
mod sight;

pub use drawing::{Curve2, DrawnCurve, Drawing, LineStyle, View, ViewKind};

/// Debug
pub fn debug_solve(drawing: &Drawing) -> String {
    let t0 = std::time::Instant::now();
    let plan = plan::Plan::of(drawing);
    let cells = match cells::Cells::of(&plan) { Ok(c) => c, Err(e) => return e.to_string() };
    let t1 = t0.elapsed().as_secs_f64();
    let looks = sight::Looks::at(&cells, drawing);
    let t2 = t0.elapsed().as_secs_f64();
    let found = search::search(&cells, &looks, 64);
    let t3 = t0.elapsed().as_secs_f64();
    let mut s = format!("grid {:?} atoms {} looks {} vars {} solutions {} complete {} unexplained {} t {:.3} {:.3} {:.3}", [0,1,2].map(|a| plan.grid[a].len()), cells.atoms(), looks.looks.len(), found.assignments.first().map_or(0, |a| a.len()), found.assignments.len(), found.complete, found.unexplained.len(), t1, t2-t1, t3-t2);
    for a in &found.assignments { s += &format!("\n  vol {:.6}", volume_estimate(&cells, a)); }
    for (st, p) in &found.unexplained { s += &format!("\n   {:?} {} {:?} {}", st, drawing.views[p.view].kind.name(), p.at, p.curve.map_or("-", |c| &drawing.views[p.view].curves[c].entity)); }
    s
}

fn volume_estimate(cells: &cells::Cells, a: &search::Assignment) -> f64 {
    let g = &cells.plan.grid;
    let mut v = 0.0;
    for i in 0..g[0].len()-1 { for j in 0..g[1].len()-1 { for k in 0..g[2].len()-1 {
        let plain = (0..cells.plan.views.len()).all(|w| cells::pieces_in(cells.plan, w, [i,j,k]).is_empty());
        let n = if plain {1} else {12};
        let d = [g[0][i+1]-g[0][i], g[1][j+1]-g[1][j], g[2][k+1]-g[2][k]];
        let mut c = 0;
        for x in 0..n { for y in 0..n { for z in 0..n {
            let p = [g[0][i]+d[0]*(x as f64+0.5)/n as f64, g[1][j]+d[1]*(y as f64+0.5)/n as f64, g[2][k]+d[2]*(z as f64+0.5)/n as f64];
            if a.get(&cells.at_in([i,j,k], p)).copied().unwrap_or(false) { c += 1; }
        }}}
        v += c as f64 / (n*n*n) as f64 * d[0]*d[1]*d[2];
    }}}
    v
}
