//! Which parts of a picture are views: outlines close, and all else in their boxes belongs to them.

use super::skeleton::PixelGraph;

/// Minimum size of an outline, relative to the picture: letters with loops are smaller.
const MIN_OUTLINE: f64 = 0.04;

/// Left, right, top and bottom in pixels.
pub(super) type PixelBox = [[f64; 2]; 2];

/// The boxes of the views: of connected parts with a loop that are larger than letters. Boxes that overlap
/// are one.
pub(super) fn view_boxes(
    graph: &PixelGraph,
    part_of: impl Fn([i32; 2]) -> u32,
    parts: usize,
    size: f64,
) -> Vec<PixelBox> {
    // Edges minus ends of a connected graph: −1 for a tree, more for each loop.
    let mut edges = vec![0_i64; parts + 1];
    let mut boxes = vec![[[f64::MAX, f64::MIN]; 2]; parts + 1];
    let mut part_of_node = vec![0_usize; graph.nodes.len()];
    for path in &graph.paths {
        // Places of junctions may lie beside the ink.
        let part = path.pixels.iter().map(|p| part_of(*p) as usize).find(|part| *part > 0).unwrap_or(0);
        let free = path.nodes.iter().filter(|n| n.is_none()).count() as i64;
        edges[part] += if path.is_closed() { 1 } else { 1 - free };
        path.nodes.iter().flatten().for_each(|n| part_of_node[*n] = part);
        for p in &path.pixels {
            for (range, c) in boxes[part].iter_mut().zip(p) {
                *range = [range[0].min(f64::from(*c)), range[1].max(f64::from(*c))];
            }
        }
    }
    part_of_node.iter().filter(|part| **part > 0).for_each(|part| edges[*part] -= 1);
    let is_outline = |k: &usize| {
        let extent = boxes[*k].iter().map(|r| r[1] - r[0]).fold(0.0, f64::max);
        edges[*k] >= 0 && extent >= MIN_OUTLINE * size
    };
    joined_boxes((1..=parts).filter(is_outline).map(|k| boxes[k]))
}

/// Boxes from left to right; those that overlap are one.
pub(super) fn joined_boxes(boxes: impl Iterator<Item = PixelBox>) -> Vec<PixelBox> {
    let mut found: Vec<PixelBox> = Vec::new();
    for mut own in boxes {
        while let Some(at) = found.iter().position(|other| overlap(other, &own, 2.0)) {
            let other = found.swap_remove(at);
            own = [0, 1].map(|c| [own[c][0].min(other[c][0]), own[c][1].max(other[c][1])]);
        }
        found.push(own);
    }
    found.sort_by(|a, b| a[0][0].total_cmp(&b[0][0]).then(a[1][0].total_cmp(&b[1][0])));
    found
}

fn overlap(a: &PixelBox, b: &PixelBox, gap: f64) -> bool {
    (0..2).all(|k| a[k][0] <= b[k][1] + gap && b[k][0] <= a[k][1] + gap)
}

/// Whether a point lies in a box.
pub(super) fn contains(bounds: &PixelBox, p: [f64; 2], margin: f64) -> bool {
    (0..2).all(|k| p[k] >= bounds[k][0] - margin && p[k] <= bounds[k][1] + margin)
}
