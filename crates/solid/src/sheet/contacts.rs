//! Which curves the ends of a curve touch.

use super::SheetBox;
use super::groups::touch;
use crate::drawing::{Curve2, DrawnCurve, distance, nearest_on_curve};

/// Error of the polygon through a general curve, relative to its extent.
const POLYGON_ERROR: f64 = 1e-3;

/// The contacts of all curves of a sheet.
pub(super) struct Contacts {
    /// For each curve, the curves that its start and its end touch; none for the ends of a closed curve.
    ends: Vec<Option<[Vec<u32>; 2]>>,
    /// For each curve, all curves that it touches, or that touch it, with an end.
    neighbours: Vec<Vec<u32>>,
}

impl Contacts {
    /// Finds the contacts within a distance.
    pub(super) fn new(curves: &[DrawnCurve], boxes: &[SheetBox], near: f64) -> Self {
        let open_ends = |curve: &DrawnCurve| ends_of(&curve.curve, near);
        let places: Vec<Option<[[f64; 2]; 2]>> = curves.iter().map(open_ends).collect();
        let mut contacts = Self {
            ends: places.iter().map(|ends| ends.map(|_| [Vec::new(), Vec::new()])).collect(),
            neighbours: vec![Vec::new(); curves.len()],
        };
        // Pairs whose boxes touch, by a sweep from left to right.
        let mut order: Vec<usize> = (0..curves.len()).collect();
        order.sort_by(|a, b| boxes[*a][0][0].total_cmp(&boxes[*b][0][0]));
        let mut open: Vec<usize> = Vec::new();
        for k in order {
            open.retain(|other| boxes[*other][0][1] + near >= boxes[k][0][0]);
            for &other in open.iter().filter(|other| touch(&boxes[**other], &boxes[k], near)) {
                let first = contacts.add(curves, &places, (k, other), near);
                let second = contacts.add(curves, &places, (other, k), near);
                if first || second {
                    contacts.neighbours[k].push(other as u32);
                    contacts.neighbours[other].push(k as u32);
                }
            }
            open.push(k);
        }
        contacts
    }

    /// Adds the contacts of the ends of one curve with another; true if there are any.
    fn add(
        &mut self,
        curves: &[DrawnCurve],
        places: &[Option<[[f64; 2]; 2]>],
        (own, other): (usize, usize),
        near: f64,
    ) -> bool {
        let (Some(places), Some(ends)) = (&places[own], &mut self.ends[own]) else { return false };
        let curve = &curves[other].curve;
        let reach = near + polygon_error(curve);
        let mut touches = false;
        for (place, end) in places.iter().zip(ends) {
            if distance(nearest_on_curve(curve, *place), *place) <= reach {
                end.push(other as u32);
                touches = true;
            }
        }
        touches
    }

    /// Whether an end of a curve touches none of the curves that are left.
    pub(super) fn free_ends(&self, curve: usize, is_left: impl Fn(usize) -> bool) -> usize {
        let is_free = |end: &Vec<u32>| !end.iter().any(|other| is_left(*other as usize));
        self.ends[curve].iter().flatten().filter(|end| is_free(end)).count()
    }

    /// Curves that touch a curve, or that it touches.
    pub(super) fn of(&self, curve: usize) -> impl Iterator<Item = usize> + '_ {
        self.neighbours[curve].iter().map(|k| *k as usize)
    }

    /// All curves that are connected with some curves through curves of a kind, these included.
    pub(super) fn connected(
        &self,
        from: impl IntoIterator<Item = usize>,
        is_left: impl Fn(usize) -> bool,
    ) -> Vec<usize> {
        let mut is_found = vec![false; self.ends.len()];
        let mut stack: Vec<usize> = from.into_iter().collect();
        stack.iter().for_each(|k| is_found[*k] = true);
        let mut found = Vec::new();
        while let Some(k) = stack.pop() {
            found.push(k);
            for other in self.of(k).filter(|other| is_left(*other)) {
                if !std::mem::replace(&mut is_found[other], true) {
                    stack.push(other);
                }
            }
        }
        found.sort_unstable();
        found
    }
}

/// Start and end of an open curve.
fn ends_of(curve: &Curve2, near: f64) -> Option<[[f64; 2]; 2]> {
    let points = curve.points();
    let ends = [*points.first()?, *points.last()?];
    (points.len() == 2 || distance(ends[0], ends[1]) > near).then_some(ends)
}

fn polygon_error(curve: &Curve2) -> f64 {
    match curve {
        Curve2::Chain(points) => {
            let longest = points.windows(2).map(|p| distance(p[0], p[1])).fold(0.0, f64::max);
            POLYGON_ERROR * longest * points.len() as f64
        }
        _ => 0.0,
    }
}
