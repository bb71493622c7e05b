//! Skeletons: lines of one pixel in the middle of strokes.
//!
//! # References
//! Zhang, Suen, *A fast parallel algorithm for thinning digital patterns*, Comm. ACM 27, 1984.

/// A picture of which pixels are set.
#[derive(Debug, Clone)]
pub(super) struct Mask {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) pixels: Vec<bool>,
}

/// Neighbours from the right one on, counter-clockwise as one sees the picture.
pub(super) const AROUND: [[isize; 2]; 8] =
    [[1, 0], [1, -1], [0, -1], [-1, -1], [-1, 0], [-1, 1], [0, 1], [1, 1]];

impl Mask {
    /// Whether a pixel is set; those outside are not.
    pub(super) fn is_set(&self, x: isize, y: isize) -> bool {
        x >= 0
            && y >= 0
            && (x as usize) < self.columns
            && (y as usize) < self.rows
            && self.pixels[y as usize * self.columns + x as usize]
    }

    fn around(&self, k: usize) -> [bool; 8] {
        let (x, y) = ((k % self.columns) as isize, (k / self.columns) as isize);
        AROUND.map(|[dx, dy]| self.is_set(x + dx, y + dy))
    }

    /// Connected parts by eight neighbours: the number of each pixel's part from 1 on, and their count.
    pub(super) fn parts(&self) -> (Vec<u32>, usize) {
        let mut labels = vec![0_u32; self.pixels.len()];
        let mut count = 0;
        let mut open = Vec::new();
        for first in 0..self.pixels.len() {
            if !self.pixels[first] || labels[first] != 0 {
                continue;
            }
            count += 1;
            labels[first] = count;
            open.push(first);
            while let Some(k) = open.pop() {
                let (x, y) = ((k % self.columns) as isize, (k / self.columns) as isize);
                for [dx, dy] in AROUND {
                    if self.is_set(x + dx, y + dy) {
                        let other = (y + dy) as usize * self.columns + (x + dx) as usize;
                        if labels[other] == 0 {
                            labels[other] = count;
                            open.push(other);
                        }
                    }
                }
            }
        }
        (labels, count as usize)
    }

    /// The skeleton.
    pub(super) fn thinned(mut self) -> Self {
        let mut set: Vec<usize> = (0..self.pixels.len()).filter(|k| self.pixels[*k]).collect();
        loop {
            let before = set.len();
            for pass in 0..2 {
                let removed: Vec<usize> =
                    set.iter().copied().filter(|k| is_border(&self.around(*k), pass)).collect();
                removed.iter().for_each(|k| self.pixels[*k] = false);
                set.retain(|k| self.pixels[*k]);
            }
            if set.len() == before {
                break;
            }
        }
        // Pixels that the others connect without them, such as corners of stairs.
        for k in set {
            let n = self.around(k);
            let is_filled = |a: usize| n[a] || (a % 2 == 1 && n[a - 1] && n[(a + 1) % 8]);
            let groups = (0..8).filter(|a| !is_filled(*a) && is_filled((a + 1) % 8)).count();
            if groups == 1 && n.iter().filter(|n| **n).count() > 1 {
                self.pixels[k] = false;
            }
        }
        self
    }
}

/// Whether a pixel is removed in a pass: a point of the border at the lower right or upper left whose removal
/// separates nothing.
fn is_border(n: &[bool; 8], pass: usize) -> bool {
    let count = n.iter().filter(|n| **n).count();
    if !(2..=6).contains(&count) {
        return false;
    }
    let changes = (0..8).filter(|k| !n[*k] && n[(k + 1) % 8]).count();
    let [right, above, left, below] = [n[0], n[2], n[4], n[6]];
    changes == 1
        && match pass {
            0 => !(right && below && (above || left)),
            _ => !(above && left && (right || below)),
        }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wide_ring_becomes_a_ring_of_pixels_with_two_neighbours() {
        let (columns, rows) = (80, 80);
        let is_ink = |k: usize| {
            let (x, y) = ((k % columns) as f64 - 40.0, (k / columns) as f64 - 40.0);
            (x.hypot(y) - 30.0).abs() < 1.6
        };
        let mask = Mask { columns, rows, pixels: (0..columns * rows).map(is_ink).collect() };
        assert_eq!(mask.parts().1, 1);
        let thin = mask.thinned();
        assert_eq!(thin.parts().1, 1);
        for k in (0..thin.pixels.len()).filter(|k| thin.pixels[*k]) {
            assert_eq!(thin.around(k).iter().filter(|n| **n).count(), 2, "pixel {k}");
        }
    }
}
