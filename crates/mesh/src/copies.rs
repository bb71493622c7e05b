//! Copies of triangles: the same vertices in the same order, from any of them on.
//!
//! Files of some programs hold each face many times. Nothing that depends on the nearest triangle changes
//! without the copies, and a search that cannot exclude them compares all of them.

use rayon::prelude::*;

/// The indices of the triangles that are no copies of an earlier one. Cost O(n log n).
///
/// # Examples
/// ```
/// use planish_mesh::distinct_triangles;
/// // The second triangle is the first one turned, the third one faces the other side.
/// assert_eq!(distinct_triangles(&[[0, 1, 2], [1, 2, 0], [0, 2, 1]]), [0, 2]);
/// ```
#[must_use]
pub fn distinct_triangles(triangles: &[[u32; 3]]) -> Vec<u32> {
    (0..).zip(first_copies(triangles)).filter(|(t, first)| t == first).map(|(t, _)| t).collect()
}

/// For each triangle, the index of the first one with the same vertices and orientation.
pub(crate) fn first_copies(triangles: &[[u32; 3]]) -> Vec<u32> {
    let turned = |t: &[u32; 3]| {
        let mut t = *t;
        let least = (1..3).fold(0, |least, k| if t[k] < t[least] { k } else { least });
        t.rotate_left(least);
        t
    };
    let mut order: Vec<([u32; 3], u32)> = triangles.iter().map(turned).zip(0..).collect();
    // Sorted by index among equal ones, so that the first copy comes first.
    order.par_sort_unstable();
    let mut first: Vec<u32> = vec![0; triangles.len()];
    let mut last: Option<([u32; 3], u32)> = None;
    for (key, triangle) in order {
        let kept = last.filter(|(other, _)| *other == key).map_or(triangle, |(_, kept)| kept);
        first[triangle as usize] = kept;
        last = Some((key, kept));
    }
    first
}
