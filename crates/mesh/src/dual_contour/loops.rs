//! The pieces of a surface in one cube, by the signs at its corners.
//!
//! Corner `c` of a cube has the offset of the bits of `c`, x first. Edge `4 k + i + 2 j` runs along axis `k`,
//! at offset `i` along the next axis and `j` along the one after. Face `2 k + s` is across axis `k`, at
//! offset `s`.
//!
//! A surface crosses the edges whose ends have different signs. In each face, crossed edges are joined in
//! pairs, and the pairs form loops around the cube: each loop is the boundary of one piece of the surface. A
//! face with four crossed edges is ambiguous. Its inner corners are separated, unless the face is flipped.
//! The choice belongs to the face, so that both of its cubes agree.

/// Mark of an edge that the surface does not cross.
pub(super) const NONE: u8 = u8::MAX;

/// The loops of the surface around a cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Loops {
    /// The loop of each edge; [`NONE`] if the surface does not cross it.
    pub of_edge: [u8; 12],
    /// Number of loops, at most four.
    pub count: u8,
}

/// The corners at the ends of an edge, the lower first.
pub(super) fn ends(edge: usize) -> [usize; 2] {
    let axis = edge / 4;
    let low = (edge & 1) << ((axis + 1) % 3) | (edge >> 1 & 1) << ((axis + 2) % 3);
    [low, low | 1 << axis]
}

/// The corners of a face in a ring, and the edges from each corner to the next.
fn ring(face: usize) -> ([usize; 4], [usize; 4]) {
    let (axis, side) = (face / 2, face % 2);
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    let corner = |i: usize, j: usize| side << axis | i << a | j << b;
    // The axes after a are b and the face's own; those after b are the face's own and a.
    let (along_a, along_b) = (|j: usize| 4 * a + j + 2 * side, |i: usize| 4 * b + side + 2 * i);
    (
        [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)],
        [along_a(0), along_b(1), along_a(1), along_b(0)],
    )
}

/// The pairs of crossed edges that are joined in a face: none, one or two.
fn pairs(inside: &[bool; 8], face: usize, flipped: bool) -> ([[usize; 2]; 2], usize) {
    let (corners, edges) = ring(face);
    let is = corners.map(|c| inside[c]);
    let crossed = |k: usize| is[k] != is[(k + 1) % 4];
    match (0..4).filter(|&k| crossed(k)).count() {
        2 => {
            let mut found = (0..4).filter(|&k| crossed(k));
            let pair = [found.next(), found.next()].map(|k| edges[k.unwrap_or(0)]);
            ([pair; 2], 1)
        }
        4 => {
            // Around a corner, the edge that ends there and the one that starts there.
            let first = usize::from(is[0] == flipped);
            let around = |k: usize| [edges[(k + 3) % 4], edges[k]];
            ([around(first), around(first + 2)], 2)
        }
        _ => ([[0; 2]; 2], 0),
    }
}

/// The loops around a cube with these signs. Bit `f` of `flipped` flips face `f`.
pub(super) fn loops(inside: &[bool; 8], flipped: u8) -> Loops {
    let mut root: [usize; 12] = std::array::from_fn(|e| e);
    for face in 0..6 {
        let (joined, count) = pairs(inside, face, flipped >> face & 1 == 1);
        for [a, b] in &joined[..count] {
            let (from, to) = (root[*a].max(root[*b]), root[*a].min(root[*b]));
            root.iter_mut().filter(|r| **r == from).for_each(|r| *r = to);
        }
    }
    let mut found = Loops { of_edge: [NONE; 12], count: 0 };
    for edge in 0..12 {
        let [low, high] = ends(edge);
        if inside[low] == inside[high] {
            continue;
        }
        // The root is the lowest edge of its loop, so it has been numbered before the others.
        found.of_edge[edge] = if root[edge] == edge { found.count } else { found.of_edge[root[edge]] };
        found.count += u8::from(root[edge] == edge);
    }
    found
}

/// True if an ambiguous face of a cube joins a loop with itself: the surface then passes twice through the
/// face without being two pieces.
pub(super) fn joins_itself(inside: &[bool; 8], flipped: u8, face: usize) -> bool {
    let (joined, count) = pairs(inside, face, flipped >> face & 1 == 1);
    let loops = loops(inside, flipped);
    count == 2 && loops.of_edge[joined[0][0]] == loops.of_edge[joined[1][0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signs(case: usize) -> [bool; 8] {
        std::array::from_fn(|c| case >> c & 1 == 1)
    }

    /// Every crossed edge belongs to a loop of at least three edges, and to exactly two faces.
    #[test]
    fn all_crossed_edges_belong_to_loops() {
        for case in 0..256 {
            let inside = signs(case);
            let found = loops(&inside, 0);
            for edge in 0..12 {
                let [low, high] = ends(edge);
                assert_eq!((low ^ high).count_ones(), 1);
                let faces = (0..6).filter(|f| ring(*f).1.contains(&edge)).count();
                assert_eq!(faces, 2);
                assert_eq!(found.of_edge[edge] != NONE, inside[low] != inside[high]);
            }
            for one in 0..found.count {
                assert!(found.of_edge.iter().filter(|l| **l == one).count() >= 3);
            }
        }
    }

    /// Two opposite inner corners are two pieces; two opposite outer corners of one face are one, until the
    /// face is flipped.
    #[test]
    fn flips_separate_what_a_face_joins() {
        assert_eq!(loops(&signs(0b1000_0001), 0).count, 2);
        let outer = signs(!0b0000_1001 & 0xff);
        let ambiguous: Vec<usize> = (0..6).filter(|f| joins_itself(&outer, 0, *f)).collect();
        assert_eq!((loops(&outer, 0).count, ambiguous.len()), (1, 1));
        assert_eq!(loops(&outer, 1 << ambiguous[0]).count, 2);
    }
}
