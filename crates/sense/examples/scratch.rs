use planish_sense::*;
use std::fs;
fn read(p:&str,c:usize,r:usize)->Image{let b=fs::read(p).unwrap();Image::try_new(c,r,b.chunks_exact(4).map(|x|f32::from_le_bytes([x[0],x[1],x[2],x[3]])).collect()).unwrap()}
fn main(){let a:Vec<String>=std::env::args().collect();
let c:usize=a[3].parse().unwrap();let r:usize=a[4].parse().unwrap();
let mut o=StereoOptions{disparities:a[5].parse().unwrap(),..Default::default()};
if a.len()>7{o.small_step=a[7].parse().unwrap();o.large_step=a[8].parse().unwrap();}
if a.len()>9{o.uniqueness=a[9].parse().unwrap();o.left_right=a[10].parse().unwrap();o.speckle=a[11].parse().unwrap();}
let t=std::time::Instant::now();
let m=match_stereo(&read(&a[1],c,r),&read(&a[2],c,r),&o,&mut |s|{eprintln!("{s} {:?}",t.elapsed());Ok(())}).unwrap();
eprintln!("{:?} {:?}",t.elapsed(),m.rejected);
let mut out=Vec::new();
for v in m.disparity.iter().chain(&m.sigma){out.extend(v.to_le_bytes());}
fs::write(&a[6],out).unwrap();

}
