//! Search for the straight pieces of lines near a point of a view.

use std::collections::HashMap;

/// A straight piece of a line.
#[derive(Clone, Copy)]
pub(super) struct Piece {
    pub(super) ends: [[f64; 2]; 2],
    /// Index of the line, and of the piece within it.
    pub(super) line: usize,
    pub(super) index: usize,
}

/// Pieces by the squares of a grid that they are near to.
pub(super) struct Nearby {
    pieces: Vec<Piece>,
    squares: HashMap<[i64; 2], Vec<u32>>,
    side: f64,
    near: f64,
}

impl Nearby {
    /// Prepares the search within the distance `near`, on a grid of squares with the given side.
    pub(super) fn new(pieces: Vec<Piece>, near: f64, side: f64) -> Self {
        let mut squares: HashMap<[i64; 2], Vec<u32>> = HashMap::new();
        let square = |x: f64| (x / side).floor() as i64;
        for (index, piece) in pieces.iter().enumerate() {
            let [a, b] = piece.ends;
            let length = (b[0] - a[0]).hypot(b[1] - a[1]);
            // Squares around points along the piece, a half side apart.
            let steps = (2.0 * length / side).ceil().clamp(1.0, 1e6) as usize;
            let more = near + side / 4.0;
            for k in 0..=steps {
                let share = k as f64 / steps as f64;
                let p = [0, 1].map(|c| a[c] + share * (b[c] - a[c]));
                for i in square(p[0] - more)..=square(p[0] + more) {
                    for j in square(p[1] - more)..=square(p[1] + more) {
                        // Pieces come in order, so a repeated entry of this piece is the last one.
                        let found = squares.entry([i, j]).or_default();
                        if found.last() != Some(&(index as u32)) {
                            found.push(index as u32);
                        }
                    }
                }
            }
        }
        Self { pieces, squares, side, near }
    }

    /// Pieces within the distance of a point. Each comes with the share of the piece at its nearest point,
    /// and with the distance.
    pub(super) fn at(&self, p: [f64; 2]) -> impl Iterator<Item = (Piece, f64, f64)> + '_ {
        let square = p.map(|x| (x / self.side).floor() as i64);
        let found = self.squares.get(&square).map_or(&[][..], Vec::as_slice);
        found.iter().filter_map(move |&index| {
            let piece = self.pieces[index as usize];
            let [a, b] = piece.ends;
            let d = [b[0] - a[0], b[1] - a[1]];
            let square = d[0] * d[0] + d[1] * d[1];
            let share = match square > 0.0 {
                true => (((p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1]) / square).clamp(0.0, 1.0),
                false => 0.0,
            };
            let far = (a[0] + share * d[0] - p[0]).hypot(a[1] + share * d[1] - p[1]);
            (far <= self.near).then_some((piece, share, far))
        })
    }
}
