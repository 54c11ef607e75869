//! Names beside marks: each takes the best free place around its mark, in turn.

/// Left, top, right, bottom.
pub(super) type Box4 = [f64; 4];

/// Distances from a mark at which a name is tried, and directions in steps of 22.5 degrees.
const DISTANCES: [f64; 6] = [9.0, 16.0, 26.0, 40.0, 58.0, 80.0];
const DIRECTIONS: usize = 16;
/// From this distance on a line leads from the mark to its name.
const LEADER: f64 = 14.0;
/// Radius of a mark that names keep free.
const MARK: f64 = 7.0;
/// A name on a mark, a line through a name, a leader over a mark or name, a unit of distance, the wrong direction.
const ON_MARK: f64 = 60.0;
const ON_LINE: f64 = 9.0;
const LEADER_OVER: f64 = 25.0;
const AWAY: f64 = 0.45;
const WRONG_WAY: f64 = 5.0;
/// Names that cost more are left out.
const DEAREST: f64 = 75.0;

/// What names keep clear of.
pub(super) struct Obstacles<'a> {
    /// Names stay inside.
    pub(super) frame: Box4,
    /// Centres of all marks.
    pub(super) marks: &'a [[f64; 2]],
    /// Ends of all lines.
    pub(super) lines: &'a [[[f64; 2]; 2]],
    /// The direction with most room, as an angle from the right, y down.
    pub(super) towards: f64,
}

/// A name's place.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Place {
    /// What it covers.
    pub(super) covers: Box4,
    /// The line from its mark.
    pub(super) leader: Option<[[f64; 2]; 2]>,
}

/// Places for names of \[width, height\] at marks, in order of importance; none where there is no room.
pub(super) fn places(wanted: &[([f64; 2], [f64; 2])], around: &Obstacles) -> Vec<Option<Place>> {
    let mut taken: Vec<Place> = Vec::new();
    let mut out = Vec::with_capacity(wanted.len());
    for (at, size) in wanted {
        let mut best: Option<(f64, Place)> = None;
        for distance in DISTANCES {
            for direction in 0..DIRECTIONS {
                let angle = std::f64::consts::TAU * direction as f64 / DIRECTIONS as f64;
                let place = candidate(*at, *size, distance, angle);
                let Some(cost) = cost(&place, *at, distance, angle, around, &taken) else { continue };
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, place));
                }
            }
        }
        let place = best.filter(|(cost, _)| *cost < DEAREST).map(|(_, place)| place);
        taken.extend(place.clone());
        out.push(place);
    }
    out
}

/// The box whose edge or corner that faces the mark is at a distance from it: the corner in slanting directions.
fn candidate(at: [f64; 2], [width, height]: [f64; 2], distance: f64, angle: f64) -> Place {
    let (dx, dy) = (angle.cos(), angle.sin());
    let edge = [at[0] + dx * distance, at[1] + dy * distance];
    let beyond = |way: f64| (1.0 - (1.6 * way).clamp(-1.0, 1.0)) / 2.0;
    let (left, top) = (edge[0] - width * beyond(dx), edge[1] - height * beyond(dy));
    let from = [at[0] + dx * 5.0, at[1] + dy * 5.0];
    let leader = (distance >= LEADER).then_some([from, edge]);
    Place { covers: [left, top, left + width, top + height], leader }
}

fn cost(
    place: &Place,
    at: [f64; 2],
    distance: f64,
    angle: f64,
    around: &Obstacles,
    taken: &[Place],
) -> Option<f64> {
    let (covers, frame) = (&place.covers, &around.frame);
    let outside =
        covers[0] < frame[0] || covers[1] < frame[1] || covers[2] > frame[2] || covers[3] > frame[3];
    if outside || taken.iter().any(|other| overlap(covers, &other.covers)) {
        return None;
    }
    let mut cost = AWAY * distance + WRONG_WAY * (1.0 - (angle - around.towards).cos());
    for mark in around.marks {
        let own = (mark[0] - at[0]).hypot(mark[1] - at[1]) < 1.0;
        let box_of = [mark[0] - MARK, mark[1] - MARK, mark[0] + MARK, mark[1] + MARK];
        cost += if overlap(covers, &box_of) { ON_MARK } else { 0.0 };
        let crossed = place.leader.is_some_and(|leader| crosses(&leader, &box_of));
        cost += if crossed && !own { LEADER_OVER } else { 0.0 };
    }
    cost += ON_LINE * around.lines.iter().filter(|line| crosses(line, covers)).count() as f64;
    for other in taken {
        let over = place.leader.is_some_and(|leader| crosses(&leader, &other.covers));
        let under = other.leader.is_some_and(|leader| crosses(&leader, covers));
        cost += if over || under { LEADER_OVER } else { 0.0 };
    }
    Some(cost)
}

fn overlap(a: &Box4, b: &Box4) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// True if a part of the line is inside the box: the line's range of parameters is cut by both slabs.
fn crosses(line: &[[f64; 2]; 2], covers: &Box4) -> bool {
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for k in 0..2 {
        let (start, way) = (line[0][k], line[1][k] - line[0][k]);
        let (low, high) = (covers[k] - start, covers[k + 2] - start);
        if way == 0.0 {
            if low > 0.0 || high < 0.0 {
                return false;
            }
        } else {
            (from, to) = (from.max((low / way).min(high / way)), to.min((low / way).max(high / way)));
        }
    }
    from < to
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Box4 = [0.0, 0.0, 400.0, 300.0];

    #[test]
    fn names_do_not_overlap_and_stay_inside() {
        let marks: Vec<[f64; 2]> =
            (0..20).map(|i| [30.0 + f64::from(i * 97 % 340), 20.0 + f64::from(i * 53 % 260)]).collect();
        let wanted: Vec<_> = marks.iter().map(|m| (*m, [70.0, 13.0])).collect();
        let around = Obstacles { frame: FRAME, marks: &marks, lines: &[], towards: 2.0 };
        let placed: Vec<Place> = places(&wanted, &around).into_iter().flatten().collect();
        assert!(placed.len() > 12, "{} of 20", placed.len());
        for (i, a) in placed.iter().enumerate() {
            assert!(a.covers[0] >= 0.0 && a.covers[2] <= 400.0 && a.covers[1] >= 0.0 && a.covers[3] <= 300.0);
            assert!(placed[..i].iter().all(|b| !overlap(&a.covers, &b.covers)));
        }
        // Names wider than the frame have no place.
        assert_eq!(places(&[([9.0, 9.0], [500.0, 13.0])], &around), [None]);
    }

    #[test]
    fn lines_cross_boxes() {
        let covers = [10.0, 10.0, 20.0, 20.0];
        assert!(crosses(&[[0.0, 15.0], [30.0, 15.0]], &covers));
        assert!(crosses(&[[12.0, 12.0], [13.0, 14.0]], &covers));
        assert!(!crosses(&[[0.0, 15.0], [9.0, 15.0]], &covers));
        assert!(!crosses(&[[0.0, 21.0], [30.0, 21.0]], &covers));
        assert!(!crosses(&[[0.0, 5.0], [5.0, 30.0]], &covers));
    }
}
