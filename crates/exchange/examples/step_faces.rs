//! Prints a table of STEP files: faces, skipped faces, and area, volume and open edges of their triangles.
//!
//! `cargo run --release -p planish-exchange --example step_faces -- CHORD FILE...`, where CHORD is the chord
//! error as a share of the size.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program whose output is a table")]

use planish_exchange::step::read_step;
use planish_mesh::TriangleMesh;
use planish_solid::parametric::Fineness;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let share: f64 = arguments.next().ok_or("expected a chord error as the first argument")?.parse()?;
    println!("file,unit,parts,faces,left_out,triangles,open_edges,nonmanifold,turned,area,volume,seconds");
    for file in arguments {
        let begun = Instant::now();
        let made = read_step(Path::new(&file)).and_then(|faces| {
            let fineness = Fineness { chord: share * faces.size(), longest: f64::INFINITY };
            Ok((faces.unit(), faces.triangles(&fineness)?))
        });
        let (unit, mesh) = match made {
            Ok(made) => made,
            Err(e) => {
                println!("{file}: {e}");
                continue;
            }
        };
        let seconds = begun.elapsed().as_secs_f64();
        let mut sums = [0.0; 2];
        let mut counts = [0; 4];
        for part in &mesh.parts {
            let mesh = TriangleMesh::try_new(part.points.clone(), part.triangles.clone())?;
            let check = mesh.check();
            counts[0] += mesh.triangles.len();
            counts[1] += check.boundary_edges;
            counts[2] += check.nonmanifold_edges;
            counts[3] += check.misoriented_edges;
            for t in &mesh.triangles {
                let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
                let n = (b - a).cross(c - a);
                sums[0] += 0.5 * n.length();
                sums[1] += a.dot(n) / 6.0;
            }
        }
        let [triangles, open, shared, turned] = counts;
        println!(
            "{},{},{},{},{},{triangles},{open},{shared},{turned},{},{},{seconds:.3}",
            Path::new(&file).file_name().unwrap_or_default().to_string_lossy(),
            unit.map_or("none", |u| u.name()),
            mesh.parts.len(),
            mesh.faces,
            mesh.unreadable.len(),
            sums[0],
            sums[1]
        );
        for word in &mesh.unreadable {
            eprintln!("  {word}");
        }
    }
    Ok(())
}
