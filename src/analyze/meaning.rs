//! What the figures come to, a line each.

use super::Asked;
use super::direction::{Cone, Directions};
use super::levels::Levels;
use super::position::Position;
use crate::report::numbers::{count, short};

/// A share from which it is said that something happens.
const SAID: f64 = 0.01;
/// A share of the tile or of the hemisphere from which it is all of it: a few cells or texels are not met by chance.
const ALL: f64 = 0.95;
/// Degrees of a cone below which its directions are one: the sun is a quarter wide.
const ONE: f64 = 0.5;
/// Degrees of a cone above which its axis says nothing.
const WIDE: f64 = 60.0;
/// A share of the queries below which they have half of the weight unevenly.
const UNEVEN: f64 = 0.2;

pub(super) fn lines(asked: &Asked) -> Vec<String> {
    let mut lines = Vec::new();
    if asked.resolution == [1, 1] {
        lines.push("it has no texture: only directions matter".into());
    } else {
        lines.extend(levels(&asked.levels, asked.coarsest));
        lines.push(position(&asked.position));
    }
    lines.push(light(&asked.wi));
    lines.push(view(&asked.wo));
    lines.extend(below(&asked.wi, "light"));
    lines.extend(below(&asked.wo, "the view"));
    match asked.half_of_weight {
        None => lines.push("no query has a weight: no light arrives".into()),
        Some(half) if half < UNEVEN => {
            lines.push(format!("{} of the queries have half of the weight", percent(half)));
        }
        Some(_) => {}
    }
    if (asked.kept as u64) < asked.asked {
        let (kept, all) = (count(asked.kept as u64), count(asked.asked));
        lines.push(format!("the figures are of a sample: {kept} of {all} queries"));
    }
    lines
}

/// A share as text.
pub(super) fn percent(share: f64) -> String {
    format!("{} %", short(100.0 * share))
}

fn levels(levels: &Levels, coarsest: f32) -> Vec<String> {
    let [low, .., high] = levels.quantiles.queries;
    let (finest, last) = (low.floor(), high.ceil());
    let mut unread = Vec::new();
    if finest >= 1.0 {
        unread.push(format!("finer than level {finest:.0}"));
    }
    if last < coarsest.floor() {
        unread.push(format!("coarser than level {last:.0}"));
    }
    let reads = match unread.is_empty() {
        true => "all textures are read".to_string(),
        false => format!("textures {} are never read", unread.join(" and ")),
    };
    let mut lines = vec![format!("levels {low:.1} to {high:.1}: {reads}")];
    if levels.finest >= SAID {
        let share = percent(levels.finest);
        lines.push(format!(
            "{share} at level 0, where a pixel is no larger than a texel: more texels would show"
        ));
    }
    if levels.coarsest >= SAID {
        let share = percent(levels.coarsest);
        lines.push(format!("{share} at the coarsest level, where a pixel spans half of the tile or more"));
    }
    lines
}

fn position(position: &Position) -> String {
    let window = &position.window;
    if window.area() >= ALL && position.cells >= ALL {
        return "all of the tile is asked".into();
    }
    let cells = percent(position.cells);
    if window.area() >= ALL {
        return format!("{cells} of the tile is asked, in all its parts");
    }
    let sides = [1, 0].map(|axis| {
        let end = window.start[axis] + window.length[axis];
        // A whole side has no beginning.
        match window.length[axis] >= 1.0 {
            true => "all of".to_string(),
            false => format!("{} to {} of", short(window.start[axis]), short(end)),
        }
    });
    let area = percent(window.area());
    format!("{cells} of the tile is asked, within {area} of it: {} u and {} v", sides[0], sides[1])
}

fn degrees(value: f64) -> String {
    format!("{} degrees", short(value))
}

fn light(wi: &Directions) -> String {
    let Some(all) = wi.all else { return "no light comes from above the horizon".into() };
    if all.degrees() < ONE {
        return format!("light comes from one direction, {} from the normal", degrees(all.tilt()));
    }
    if wi.cells >= ALL {
        return format!("light comes from the whole hemisphere{}", narrower(wi.most_of_weight));
    }
    let (cells, width) = (percent(wi.cells), degrees(2.0 * all.degrees()));
    format!("light comes from {cells} of the hemisphere, {width} wide{}", narrower(wi.most_of_weight))
}

/// Where most of the weight is, if that is not all around.
fn narrower(most: Option<Cone>) -> String {
    let described = |cone: Cone| {
        let (width, tilt) = (degrees(2.0 * cone.degrees()), degrees(cone.tilt()));
        format!("; 99 % of its weight from {width} of directions, {tilt} from the normal")
    };
    most.filter(|cone| cone.degrees() < WIDE).map_or(String::new(), described)
}

fn view(wo: &Directions) -> String {
    let Some(all) = wo.all else { return "it is never seen from above the horizon".into() };
    let (width, tilt) = (degrees(2.0 * all.degrees()), degrees(all.tilt()));
    let grazing = match wo.grazing >= SAID {
        true => format!("; {} within 10 degrees of the horizon", percent(wo.grazing)),
        false => String::new(),
    };
    if wo.cells >= ALL {
        return format!("it is seen from the whole hemisphere{grazing}");
    }
    if all.degrees() > WIDE {
        let cells = percent(wo.cells);
        return format!("it is seen from {cells} of the hemisphere, {width} wide{grazing}");
    }
    if all.degrees() < ONE {
        return format!("it is seen from one direction, {tilt} from the normal{grazing}");
    }
    format!("it is seen from {width} of directions around {tilt} from the normal{grazing}")
}

fn below(directions: &Directions, what: &str) -> Option<String> {
    let share = directions.below;
    (share >= SAID).then(|| format!("{what} is on or below the horizon in {} of the queries", percent(share)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_levels(level: &[f32]) -> Vec<String> {
        levels(&Levels::new(level, &vec![1.0; level.len()], [128, 128], 6.0), 6.0)
    }

    #[test]
    fn textures_that_are_never_read_are_named() {
        assert_eq!(
            of_levels(&[2.1, 3.0, 4.0]),
            ["levels 2.1 to 4.0: textures finer than level 2 and coarser than level 4 are never read"]
        );
        // One query between the levels reads both.
        assert_eq!(
            of_levels(&[1.9, 4.1]),
            ["levels 1.9 to 4.1: textures finer than level 1 and coarser than level 5 are never read"]
        );
        let all = of_levels(&[0.0, 6.0]);
        assert_eq!(all[0], "levels 0.0 to 6.0: all textures are read");
        assert!(all[1].starts_with("50 % at level 0") && all[2].starts_with("50 % at the coarsest"));
    }

    #[test]
    fn directions_are_one_or_so_many_degrees() {
        let one = Directions::new(&[[0.5, 0.0]; 3], &[1.0; 3]);
        assert_eq!(light(&one), "light comes from one direction, 30 degrees from the normal");
        assert_eq!(view(&one), "it is seen from one direction, 30 degrees from the normal");
        let two = Directions::new(&[[0.5, 0.0], [0.0, 0.0]], &[1.0; 2]);
        assert!(light(&two).contains("30 degrees wide"), "{}", light(&two));
        assert_eq!(view(&two), "it is seen from 30 degrees of directions around 15 degrees from the normal");
    }

    #[test]
    fn a_part_of_the_tile_is_named_by_its_sides() {
        let u = [[0.1, 0.9], [0.2, 0.05]];
        let said = position(&Position::new(&u, &[1.0; 2], [8, 8]));
        assert!(said.ends_with("within 6.25 % of it: 0 to 0.25 of u and 0.875 to 1.12 of v"), "{said}");
        let side: Vec<f32> = (0..64).map(|k| (k as f32 + 0.5) / 64.0).collect();
        let grid: Vec<[f32; 2]> = side.iter().flat_map(|y| side.iter().map(|x| [*x, *y])).collect();
        let all = Position::new(&grid, &vec![1.0; grid.len()], [8, 8]);
        assert_eq!(position(&all), "all of the tile is asked");
    }
}
