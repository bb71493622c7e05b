//! Experimental driver.
use super::engine::*;
use super::observations::Observations;
use planish_estimate::Result;
use planish_estimate::sparse::stochastic_trace;
use planish_spline::*;
use std::sync::Arc;
use std::time::Instant;

pub fn median_abs(feet: &[Foot]) -> f64 {
    let mut h: Vec<f64> = feet.iter().filter(|f| f.state == FootState::Good).map(|f| f.height.abs()).collect();
    if h.is_empty() { return 0.0; }
    let m = h.len() / 2;
    *h.select_nth_unstable_by(m, f64::total_cmp).1
}

/// Debug.
pub fn debug_fit(obs: &Observations, dump: &dyn Fn(&str, &Surface)) -> Result<()> {
    let t0 = Instant::now();
    let n = obs.len();
    let every = n.div_ceil(30_000).max(1);
    let some: Vec<u32> = (0..n as u32).step_by(every).collect();
    let pts: Vec<_> = some.iter().map(|&i| obs.points[i as usize]).collect();
    let nrm: Vec<_> = some.iter().map(|&i| obs.normal(i as usize)).collect();
    let base = choose_base_shape(&pts, &nrm, None)?;
    eprintln!("{:.2?} base {base:?}", t0.elapsed());
    let grid = base.grid(128);
    eprintln!("grid {grid:?}");
    let mut surface = base.surface(grid)?;
    let extent = surface.space().extent();
    let mut at: Vec<[f64; 2]> = obs.points.iter().map(|p| { let q = base.parameters(*p); [q[0] * extent[0], q[1] * extent[1]] }).collect();
    // Stage 0: known (u, v) by direction.
    let factors = vec![1.0];
    let mut weight: f64 = 0.0;
    let size = base.size.iter().fold(0.0f64, |a, b| a.max(*b));
    let envf = |k: &str, d: f64| std::env::var(k).ok().and_then(|s| s.parse().ok()).unwrap_or(d);
    let levels = envf("LEVELS", 4.0) as usize;
    let iters = envf("ITERS", 6.0) as usize;
    let share = envf("HOLD", 0.5);
    if envf("GROW", 1.0) > 0.0 {
        let t = Instant::now();
        let indicator = super::indicator::Indicator::new(&pts, &nrm);
        eprintln!("indicator {:.2?} cell {:.3e}", t.elapsed(), indicator.cell());
        surface = super::growth::grow(&base, grid, &pts, &indicator, &|_| Ok(()))?;
        eprintln!("grown {:.2?}", t.elapsed());
        dump("grown", &surface);
        let sys = SurfaceSystem::new(surface.space())?;
        let x: Vec<f64> = surface.vertices().iter().flatten().copied().collect();
        let search = FootPointSearch::new(&surface, 3, envf("NS", 0.3) * size)?;
        let feet = project(&surface, obs, &some, &mut at, Some(&search), &factors, &ProjectionPass { least_cosine: 0.3, correct_bias: false, newton: ProjectionOptions::default() });
        let rms = (feet.iter().map(|f| f.height * f.height).sum::<f64>() / feet.len() as f64).sqrt();
        eprintln!("grown bend {:.1} med {:.3e} rms {rms:.3e} good {:.4}", sys.thin_plate(&surface)?.expanded(3)?.quadratic_form(&x)?, median_abs(&feet), feet.iter().filter(|f| f.state == FootState::Good).count() as f64 / feet.len() as f64);
        if envf("ONLY", 0.0) > 0.0 { return Ok(()); }
    }
    let grown = envf("GROW", 1.0) > 0.0;
    let schedule: Vec<(usize, f64)> = std::env::var("SCHED").unwrap_or("0:0.5,0:0.4,0:0.3,1:0.25,1:0.2,1:0.16,1:0.13,2:0.1,2:0.08,2:0.065,2:0.05,2:0.04,2:0.032,2:0.026,2:0.02".into()).split(',').map(|x| { let (a, b) = x.split_once(':').unwrap(); (a.parse().unwrap(), b.parse().unwrap()) }).collect();
    let _ = (levels, iters);
    let visc = envf("VISC", 0.0);
    let mut level = if grown { envf("GL", 2.0) as usize } else { 0 };
    let mut made: Option<SurfaceSystem> = None;
    for (it, &(want, ell)) in schedule.iter().enumerate() {
        while level < want { surface = surface.refined(Arc::new(surface.space().refine_all()))?; level += 1; made = None; }
        if made.is_none() { made = Some(SurfaceSystem::new(surface.space())?); }
        let system = made.as_ref().unwrap();
        let subset: Vec<u32> = { let e = n.div_ceil((surface.space().leaves().len() * 10).max(15_000)).max(1); (0..n as u32).step_by(e).collect() };
        let t = Instant::now();
        let mut reference = base.surface(grid)?;
        if level > 0 { reference = reference.refined(surface.space().clone())?; }
        let current = want >= envf("CUR", 9.0) as usize;
        let energy1 = system.thin_plate(if current { &surface } else { &reference })?;
        let area: f64 = (if current { &surface } else { &reference }).thin_plate(surface.space()).iter().map(|l| l.area).sum();
        let energy = energy1.expanded(3)?;
        let hold = system.tangential_hold(&surface, share)?;
        let data; let s;
        if it == 0 && !grown {
            s = 1.0;
            let mut lists: Vec<Vec<u32>> = vec![Vec::new(); surface.space().leaves().len()];
            for &i in &subset { let q = at[i as usize]; lists[surface.space().locate(q[0], q[1]).0].push(i); }
            data = system.accumulate(|leaf, cell| {
                for &i in &lists[leaf] {
                    let q = at[i as usize];
                    let (_, l) = surface.space().locate(q[0], q[1]);
                    cell.add_vector(&leaf_weights(l[0], l[1]), obs.points[i as usize], &[1., 0., 0., 1., 0., 1.]);
                }
                !lists[leaf].is_empty()
            })?;
        } else {
            let search = FootPointSearch::new(&surface, 3, envf("NS", 0.3) * size)?;
            let feet = project(&surface, obs, &subset, &mut at, Some(&search), &factors, &ProjectionPass { least_cosine: envf("COS", 0.3), correct_bias: false, newton: ProjectionOptions::default() });
            let m = 1.4826 * median_abs(&feet);
            s = 1.0;
            let good = feet.iter().filter(|f| f.state == FootState::Good).count();
            let far = feet.iter().filter(|f| f.height.abs() > 5.0 * m && f.state == FootState::Good).count();
            let rms = (feet.iter().map(|f| f.height * f.height).sum::<f64>() / feet.len() as f64).sqrt();
            let rmsg = (feet.iter().filter(|f| f.state == FootState::Good).map(|f| f.height * f.height).sum::<f64>() / good as f64).sqrt();
            eprint!("   s {m:.3e} rms {rms:.3e} {rmsg:.3e} good {:.4} far {:.4} ", good as f64 / feet.len() as f64, far as f64 / feet.len() as f64);
            let info: Vec<f64> = feet.iter().zip(&subset).map(|(f, &i)| { let c = planish_estimate::vector3::dot(f.normal, obs.normal(i as usize)).max(0.0); let r = f.height.abs() / (envf("HUB", 6.0) * m); c * c * if r > 1.0 { 1.0 / r } else { 1.0 } }).collect();
            data = accumulate(system, &surface, &feet, &info)?;
        }
        let t1 = t.elapsed();
        let density = subset.len() as f64 / area;
        let weight = (ell * size).powi(4) * density;
        let mut held = system.nothing()?;
        held.add_scaled(&hold, envf("HW", 1.0) * size * size * 1e-4)?;
        if visc > 0.0 {
            let x: Vec<f64> = surface.vertices().iter().flatten().copied().collect();
            let mut y = vec![0.0; x.len()];
            energy.multiply(&x, &mut y)?;
            let wv = weight * visc;
            held.add_scaled(&energy, wv)?;
            for (h, v) in held.vector_mut().iter_mut().zip(&y) { *h += wv * v; }
        }
        let solved = solve(system, &data, &energy, weight, &held)?;
        let t2 = t.elapsed();
        let own = system.thin_plate(&solved.surface)?.expanded(3)?;
        let x: Vec<f64> = solved.surface.vertices().iter().flatten().copied().collect();
        eprintln!("{it} level {level} ell {ell} nodes {} bend {:.1} assemble {t1:.2?} solve {t2:.2?}", surface.space().node_count(), own.quadratic_form(&x)?);
        surface = solved.surface;
        dump(&format!("i{it}"), &surface);
    }
    eprintln!("total {:.2?}", t0.elapsed());
    let _ = (weight, stochastic_trace as usize, s_unused());
    Ok(())
}
fn s_unused() {}
