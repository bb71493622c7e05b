//! Valid drawings, planar readings and contours.

use planish_estimate::Result;

/// Drawings with layers, an inserted block, an old polyline, a dimension, and one curve of every type.
pub fn dxfs() -> Result<Vec<Vec<u8>>> {
    // DXF has a code or a value on each line. Blanks keep the texts below readable.
    let lines = |text: &str| text.split(' ').collect::<Vec<_>>().join("\n") + "\n";
    let head =
        "0 SECTION 2 HEADER 9 $INSUNITS 70 4 0 ENDSEC 0 SECTION 2 TABLES 0 LAYER 2 INNER 6 HIDDEN 0 ENDSEC";
    let blocks = "0 SECTION 2 BLOCKS 0 BLOCK 2 part 10 1 20 0 0 LINE 8 0 10 1 20 0 11 3 21 0 0 ARC 8 0 10 1 \
        20 0 40 2 50 0 51 90 0 ENDBLK 0 ENDSEC";
    // An array of insertions with a scale and an angle: the transformation of a block has all its parts.
    let placed = "0 INSERT 2 part 10 5 20 5 41 2 42 2 50 30 70 2 71 2 44 10 45 10";
    let curves = "0 LINE 5 2A 8 INNER 10 0 20 0 11 40 21 0 0 CIRCLE 8 0 10 20 20 10 40 6 0 ELLIPSE 10 0 20 \
        0 11 4 21 0 40 0.5 41 0 42 6.28 \
                  0 LWPOLYLINE 90 3 70 1 10 0 20 0 42 0.5 10 4 20 0 10 4 20 3";
    let others = "0 POLYLINE 70 1 0 VERTEX 10 0 20 0 0 VERTEX 10 4 20 0 42 1 0 SEQEND \
                  0 SPLINE 70 8 71 2 72 6 73 3 40 0 40 0 40 0 40 1 40 1 40 1 10 0 20 0 10 1 20 2 10 2 20 0";
    let dimension = "0 DIMENSION 5 D1 70 32 13 0 23 0 14 40 24 0 1 40 0 TEXT 1 hello";
    let end = "0 ENDSEC 0 EOF";
    let entities = "0 SECTION 2 ENTITIES";
    Ok(vec![
        lines(&format!("{head} {blocks} {entities} {placed} {curves} {others} {dimension} {end}"))
            .into_bytes(),
        lines(&format!("{entities} {curves} {end}")).into_bytes(),
    ])
}

/// Drawings with groups, transforms, styles, and every shape.
pub fn svgs() -> Result<Vec<Vec<u8>>> {
    let shapes = "<g id='HIDDEN' transform='translate(3 4) rotate(30)'><line x1='1' x2='5'/><circle r='4' \
        cx='2'/></g><rect width='9' height='5' rx='1'/>\
                  <polygon points='0,0 1,0 1,1'/><ellipse rx='3' ry='2' class='d'/><path d='M0 0h3v2l-1-1A2 \
                  2 0 0 1 5 5C1 2 3 4 5 6S1 1 0 0Q1 2 3 4T5 5z'/>";
    // The entity is used in an attribute, where a reader has to expand or reject it.
    let sheet = "<?xml version='1.0'?><!DOCTYPE svg [<!ENTITY w '20'>]><svg \
        xmlns='http://www.w3.org/2000/svg' width='100mm' viewBox='0 0 100 50'>\
                 <style>.d { stroke-dasharray: 3 2 }</style><text>40</text>";
    Ok(vec![
        format!("{sheet}{shapes}<line x2='&w;'/></svg>").into_bytes(),
        format!("<svg>{shapes}</svg>").into_bytes(),
    ])
}

/// Drawings with curves, dashes, hatching, text, a form, and compressed objects.
pub fn pdfs() -> Result<Vec<Vec<u8>>> {
    let lines: String = (0..7).map(|k| format!("{} 20 m {} 30 l S ", 10 + 3 * k, 20 + 3 * k)).collect();
    let dashes: String = (0..6).map(|k| format!("{} 5 m {} 5 l ", 9 * k, 9 * k + 6)).collect();
    let content = format!(
        "q 1 0 0 1 9 9 cm .7 w [6 3] 0 d 0 0 m 40 0 l S Q {dashes} S \
         50 20 m 50 25.52 45.52 30 40 30 c 34.48 30 30 25.52 30 20 c s 5 5 30 20 re S {lines} \
         BT /F1 9 Tf 1 0 0 1 20 40 Tm [(4) -20 (0)] TJ ET 10 38 m 13 39 l 13 37 l f /A Do \
         /OC /L BDC 0 0 m 1 1 l S EMC"
    );
    let form = "0 0 m 9 9 l S";
    let head = "%PDF-1.5\n1 0 obj<</Pages 2 0 R/OCProperties<</D<</OFF[9 0 R]>>>>>>endobj \
        2 0 obj<</Kids[3 0 R]/MediaBox[0 0 99 99]>>endobj \
        3 0 obj<</Parent 2 0 R/Contents 4 0 R/Resources<</Font<</F1 8 0 R>>\
        /XObject<</A 5 0 R>>/Properties<</L 9 0 R>>>>>>endobj \
        8 0 obj<</Type/Font/FirstChar 48/Widths[500 500]/Encoding<</Differences[52/four]>>>>endobj \
        9 0 obj<</Name(L)>>endobj";
    let plain = format!(
        "{head} 5 0 obj<</Subtype/Form/Matrix[1 0 0 1 5 5]/Length {}>>stream\n{form}\nendstream endobj 4 0 \
         obj<</Length {}>>stream\n{content}\nendstream endobj trailer<</Root 1 0 R>>",
        form.len(),
        content.len()
    );
    let objects =
        b"1 0 2 18 3 36 <</Pages 2 0 R>>  <</Kids[3 0 R]>>  <</MediaBox[0 0 99 99]/Contents 4 0 R>>";
    let mut packed = b"%PDF-1.5\n".to_vec();
    for (entries, bytes) in [
        ("5 0 obj<</Type/ObjStm/N 3/First 14", &objects[..]),
        ("4 0 obj<</Length 300", content.as_bytes()),
        ("7 0 obj<</Type/XRef/Root 1 0 R", b""),
    ] {
        packed.extend(format!("{entries}/Filter/FlateDecode>>stream\n").bytes());
        packed.extend(super::zlib(bytes));
        packed.extend(b"\nendstream endobj\n");
    }
    Ok(vec![plain.into_bytes(), packed])
}

/// Planar readings and overhead points.
pub fn readings() -> Result<Vec<Vec<u8>>> {
    let poses = "x,y,heading_deg,range,sigma_x,sigma_y,sigma_heading_deg,sigma_range,pose_id,time,level\n";
    let rows: String = (0..12)
        .map(|k| format!("{k},0,{},5.5,0.1,0.1,0.5,0.05,{},{}.5,{}\n", 30 * k, k / 2, k, k / 6))
        .collect();
    Ok(vec![format!("{poses}{rows}").into_bytes(), b"x,y,sigma\n0,0,0.1\n1,0,0.1\n1,1,0.2\n".to_vec()])
}

/// Logs of a planar laser scanner (CARMEN).
pub fn carmen_logs() -> Result<Vec<Vec<u8>>> {
    let ranges = |n: usize| (0..n).map(|k| format!("{:.2} ", 2.0 + 0.01 * k as f64)).collect::<String>();
    let line =
        |n: usize, t: usize| format!("FLASER {n} {}1.0 2.0 0.5 1.1 2.1 0.4 {t}.5 host {t}.5\n", ranges(n));
    Ok(vec![
        format!("# a log\nPARAM robot 1\n{}{}", line(5, 1), line(5, 2)).into_bytes(),
        line(180, 1).into_bytes(),
    ])
}

/// Ranges and points in three dimensions.
pub fn rays() -> Result<Vec<Vec<u8>>> {
    let ranges = "x,y,z,azimuth_deg,elevation_deg,range,sigma_x,sigma_range\n\
        0,0,1,10,20,5,0.1,0.1\n1,0,1,-10,2e1,4.5,0.1,0.1\n";
    Ok(vec![ranges.as_bytes().to_vec(), b"x,y,z,sigma\n0,0,0,0.1\n1,2,3,0.1\n".to_vec()])
}

/// Identified contours with their covariance.
pub fn contours() -> Result<Vec<Vec<u8>>> {
    let circle = concat!(
        r#""kind":"circle","parameters":{"center_x":{"value":1,"sigma":0.1},"#,
        r#""center_y":{"value":2,"sigma":0.1},"radius":{"value":3,"sigma":0.1}},"#,
        r#""order":["center_x","center_y","radius"],"covariance":[[0.01,0,0],[0,0.01,0],[0,0,0.01]]"#
    );
    let constrained = r#""constrained":{"constraints":[{"from":"given","kind":"horizontal","bar":0}]}"#;
    Ok(vec![
        format!("{{{circle},\"unit\":\"mm\",\"level\":1.5}}").into_bytes(),
        format!("{{\"contours\":[{{{circle}}},{{{circle},\"hole_of\":0}}],{constrained}}}").into_bytes(),
    ])
}
