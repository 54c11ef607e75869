//! The Pareto front: what nothing else beats in both cost and error.

/// True for each point that no other dominates: is nowhere worse and somewhere better. Less is better in both
/// coordinates; equal points do not dominate each other.
pub(super) fn front(points: &[[f64; 2]]) -> Vec<bool> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a][0].total_cmp(&points[b][0]).then(points[a][1].total_cmp(&points[b][1])));
    let mut on = vec![false; points.len()];
    let mut best: Option<[f64; 2]> = None;
    for i in order {
        let [x, y] = points[i];
        if best.is_none_or(|[bx, by]| y < by || (x == bx && y == by)) {
            (on[i], best) = (true, Some([x, y]));
        }
    }
    on
}

/// Corners of the line below which nothing is: from the top at the cheapest member to the right at the best one, in
/// the coordinates of `members`, whose y grows towards worse.
pub(super) fn steps(members: &[[f64; 2]], top: f64, right: f64) -> Vec<[f64; 2]> {
    let mut members = members.to_vec();
    members.sort_by(|a, b| a[0].total_cmp(&b[0]).then(b[1].total_cmp(&a[1])));
    members.dedup();
    let mut line = Vec::with_capacity(2 * members.len() + 2);
    let mut height = top;
    for [x, y] in members {
        line.extend([[x, height], [x, y]]);
        height = y;
    }
    if !line.is_empty() {
        line.push([right, height]);
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As the definition says, pair by pair.
    fn by_pairs(points: &[[f64; 2]]) -> Vec<bool> {
        let beats = |a: &[f64; 2], b: &[f64; 2]| a[0] <= b[0] && a[1] <= b[1] && (a[0] < b[0] || a[1] < b[1]);
        points.iter().map(|b| !points.iter().any(|a| beats(a, b))).collect()
    }

    #[test]
    fn agrees_with_the_definition() {
        let mut state = 1u64;
        let mut next = |most: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % most) as f64
        };
        for round in 0..300 {
            // Few places make many ties.
            let places = [4, 12, 1_000_000][round % 3];
            let points: Vec<[f64; 2]> = (0..round % 40).map(|_| [next(places), next(places)]).collect();
            assert_eq!(front(&points), by_pairs(&points), "{points:?}");
        }
    }

    #[test]
    fn ties_and_single_points() {
        assert_eq!(front(&[]), Vec::<bool>::new());
        assert_eq!(front(&[[3.0, 4.0]]), [true]);
        assert_eq!(front(&[[1.0, 1.0], [1.0, 1.0], [1.0, 2.0], [2.0, 1.0]]), [true, true, false, false]);
    }

    #[test]
    fn steps_go_down_to_the_right() {
        let line = steps(&[[3.0, 1.0], [1.0, 5.0]], 9.0, 7.0);
        assert_eq!(line, [[1.0, 9.0], [1.0, 5.0], [3.0, 5.0], [3.0, 1.0], [7.0, 1.0]]);
        assert!(steps(&[], 9.0, 7.0).is_empty());
    }
}
