//! Which views the groups of a picture are, by their sizes and places.

use planish_solid::drawing::ViewKind;

/// Left and right, bottom and top.
pub(super) type Extent = [[f64; 2]; 2];

/// Difference of sizes of views up to which they may be equal: in pixels, and relative to the size.
const SAME_SIZE: [f64; 2] = [2.5, 0.012];

/// The kind of each group; none if it is no view.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    pub(super) kinds: Vec<Option<ViewKind>>,
    /// Whether the views are placed as a convention places them.
    pub(super) is_aligned: bool,
    /// Whether the top view is above the front view.
    pub(super) is_third: bool,
}

/// Value of a title that states the kind of a view: more than alignment, less than another view.
const TITLE_VALUE: f64 = 200.0;

/// The layout of groups of curves, with the kinds that titles state; none if their sizes are not those of
/// views of one part.
pub(super) fn layout_of(extents: &[Extent], titles: &[Option<ViewKind>]) -> Option<Layout> {
    let size = |g: usize, k: usize| extents[g][k][1] - extents[g][k][0];
    let is_same = |a: f64, b: f64| (a - b).abs() <= SAME_SIZE[0].max(SAME_SIZE[1] * a.max(b));
    let largest = (0..extents.len()).map(|g| size(g, 0).max(size(g, 1))).fold(0.0, f64::max);
    let are_level = |a: usize, b: usize, k: usize| {
        (0..2).all(|e| (extents[a][k][e] - extents[b][k][e]).abs() <= SAME_SIZE[0] + 0.02 * largest)
    };
    let mut best: Option<(f64, Layout)> = None;
    let all = || (0..extents.len()).map(Some).chain([None]);
    for front in 0..extents.len() {
        for top in all().filter(|t| *t != Some(front)) {
            for side in all().filter(|s| *s != Some(front) && (s.is_none() || *s != top)) {
                let mut off = 0.0;
                let mut agrees = |a: f64, b: f64| {
                    off += (a - b).abs();
                    is_same(a, b)
                };
                let fits = top.is_none_or(|t| agrees(size(front, 0), size(t, 0)))
                    && side.is_none_or(|s| agrees(size(front, 1), size(s, 1)))
                    && (top.zip(side)).is_none_or(|(t, s)| agrees(size(t, 1), size(s, 0)));
                if !fits || (top.is_none() && side.is_none()) {
                    continue;
                }
                let top_level = top.is_none_or(|t| are_level(front, t, 0) && !are_level(front, t, 1));
                let side_level = side.is_none_or(|s| are_level(front, s, 1) && !are_level(front, s, 0));
                let is_aligned = top_level && side_level;
                // Views that are not aligned need all three sizes to be distinguished.
                if !is_aligned && (top.is_none() || side.is_none()) {
                    continue;
                }
                let is_above = |t: usize| extents[t][1][0] > extents[front][1][0];
                let is_right = |s: usize| extents[s][0][0] > extents[front][0][0];
                let is_third = !is_aligned || top.is_none_or(is_above);
                let is_side = !is_aligned || side.is_none_or(|s| is_right(s) == is_third);
                let views = 1 + usize::from(top.is_some()) + usize::from(side.is_some());
                let states = |g: Option<usize>, kind: ViewKind| {
                    let title = g.and_then(|g| titles.get(g).copied().flatten());
                    title.is_some_and(|t| t.axes() == kind.axes())
                };
                let named = [(Some(front), ViewKind::Front), (top, ViewKind::Top), (side, ViewKind::Side)];
                let named = named.into_iter().filter(|(g, kind)| states(*g, *kind)).count();
                // More views first, then those that titles name, aligned ones, and those that agree best.
                let value =
                    1000.0 * views as f64 + TITLE_VALUE * named as f64 + if is_aligned { 100.0 } else { 0.0 }
                        - off;
                if best.as_ref().is_none_or(|b| value > b.0) {
                    let mut kinds = vec![None; extents.len()];
                    kinds[front] = Some(ViewKind::Front);
                    if let Some(t) = top {
                        kinds[t] = Some(ViewKind::Top);
                    }
                    if let Some(s) = side {
                        kinds[s] = Some(if is_side { ViewKind::Side } else { ViewKind::Left });
                    }
                    best = Some((value, Layout { kinds, is_aligned, is_third }));
                }
            }
        }
    }
    best.map(|(_, layout)| layout)
}

/// Where the lower left corner of each view goes: in a row and a column beside the front view.
pub(super) fn corners(layout: &Layout, extents: &[Extent]) -> Vec<[f64; 2]> {
    let size = |g: usize| [0, 1].map(|k| extents[g][k][1] - extents[g][k][0]);
    let front = layout.kinds.iter().position(|k| *k == Some(ViewKind::Front)).unwrap_or(0);
    let origin = [extents[front][0][0], extents[front][1][0]];
    let gap = 0.2 * extents.iter().flatten().map(|r| r[1] - r[0]).fold(0.0, f64::max);
    (0..extents.len())
        .map(|g| {
            let own = [extents[g][0][0], extents[g][1][0]];
            match layout.kinds[g] {
                Some(ViewKind::Front) | None => own,
                Some(ViewKind::Top) if layout.is_aligned => [origin[0], own[1]],
                Some(ViewKind::Top) => [origin[0], origin[1] + size(front)[1] + gap],
                Some(_) if layout.is_aligned => [own[0], origin[1]],
                Some(_) => [origin[0] + size(front)[0] + gap, origin[1]],
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extent(x: f64, y: f64, width: f64, height: f64) -> Extent {
        [[x, x + width], [y, y + height]]
    }

    #[test]
    fn views_that_are_placed_freely_are_told_by_their_sizes() {
        // Width 200, depth 120, height 80: side, front, top.
        let groups = [
            extent(500.0, 33.0, 120.0, 80.0),
            extent(40.0, 400.0, 200.0, 80.0),
            extent(60.0, 70.0, 200.0, 120.0),
        ];
        let layout = layout_of(&groups, &[]).unwrap();
        assert_eq!(layout.kinds, [Some(ViewKind::Side), Some(ViewKind::Front), Some(ViewKind::Top)]);
        assert!(!layout.is_aligned);
        let corners = corners(&layout, &groups);
        assert!(corners[2][0] == 40.0 && corners[0][1] == 400.0 && corners[2][1] > 480.0, "{corners:?}");
    }

    #[test]
    fn titles_decide_between_views_of_equal_sizes() {
        // Width and depth are equal: the views in the row may be front and side, or side and front.
        let groups = [
            extent(500.0, 33.0, 120.0, 80.0),
            extent(40.0, 400.0, 120.0, 80.0),
            extent(60.0, 70.0, 120.0, 120.0),
        ];
        for (titles, front) in
            [([Some(ViewKind::Front), None, None], 0), ([Some(ViewKind::Side), None, None], 1)]
        {
            let layout = layout_of(&groups, &titles).unwrap();
            assert_eq!(layout.kinds[front], Some(ViewKind::Front), "{layout:?}");
        }
    }

    #[test]
    fn aligned_views_keep_their_convention() {
        // First angle: the top view is below the front view.
        let groups = [extent(0.0, 200.0, 200.0, 80.0), extent(0.0, 0.0, 200.0, 120.0)];
        let layout = layout_of(&groups, &[]).unwrap();
        assert_eq!(layout.kinds, [Some(ViewKind::Front), Some(ViewKind::Top)]);
        assert!(layout.is_aligned && !layout.is_third);
        assert_eq!(layout_of(&[extent(0.0, 0.0, 50.0, 40.0), extent(100.0, 0.0, 90.0, 77.0)], &[]), None);
    }
}
