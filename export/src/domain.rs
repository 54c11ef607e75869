//! What a material was fitted for, and what it answers to everything else.
//!
//! A fitted material holds the levels that a scene asks, and where a scene shows a part of the tile, a window of it. Every
//! query is first led to one that it was trained for ([`Architecture::fitted`]): levels are clamped to the fitted ones, and
//! outside of the window the coarsest stored level answers, which was trained with the average of the whole tile.

use crate::config::Architecture;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Longest name of a scene.
const MAX_NAME: usize = 1024;

/// What a material was fitted for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Domain {
    /// What asked: the scene's name.
    pub scene: String,
    /// Texels \[H, W\] of the whole tile, which has u in \[0, 1)^2. The architecture's resolution is that of the window.
    pub tile: [usize; 2],
    /// First texel \[row, column\] of the window; it may lap the tile's border.
    pub corner: [usize; 2],
    /// Finest and coarsest level that was asked.
    pub levels: [f32; 2],
    /// Light directions that were asked.
    pub wi: Cone,
    /// View directions that were asked.
    pub wo: Cone,
    /// Share of the training data that is spread over everything else.
    pub floor: f32,
}

/// Unit directions around an axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cone {
    /// The axis, of length 1.
    pub axis: [f32; 3],
    /// Least cosine to the axis.
    pub cosine: f32,
}

/// In what a query is outside of a domain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outside {
    /// Finer than the finest level.
    pub finer: bool,
    /// Coarser than the coarsest level.
    pub coarser: bool,
    /// Outside of the window.
    pub position: bool,
    /// Light from another direction.
    pub wi: bool,
    /// Seen from another direction.
    pub wo: bool,
}

impl Outside {
    /// True if it is outside in anything.
    pub fn any(self) -> bool {
        self.finer || self.coarser || self.position || self.wi || self.wo
    }
}

impl Cone {
    /// True if a stored direction (x, y) lies in it.
    pub fn holds(&self, [x, y]: [f32; 2]) -> bool {
        let z = (1.0 - x * x - y * y).max(0.0).sqrt();
        let [a, b, c] = self.axis;
        a * x + b * y + c * z >= self.cosine
    }

    fn explained(&self) -> String {
        let [x, y, z] = self.axis;
        format!("{:.0} degrees of ({x:.3}, {y:.3}, {z:.3})", self.cosine.clamp(-1.0, 1.0).acos().to_degrees())
    }

    fn validate(&self, field: &str) -> Result<()> {
        /// An axis goes through a text.
        const ROUNDING: f32 = 1e-3;
        let length = self.axis.iter().map(|v| v * v).sum::<f32>().sqrt();
        if !((length - 1.0).abs() < ROUNDING && (-1.0..=1.0).contains(&self.cosine)) {
            return Err(Error::config(field, "needs an axis of length 1 and a cosine from -1 to 1"));
        }
        Ok(())
    }
}

impl Domain {
    /// Checks every bound; `resolution` and `coarsest` are the window's texels and coarsest stored level.
    ///
    /// # Errors
    /// `Config`, naming the field.
    pub fn validate(&self, resolution: [usize; 2], coarsest: usize) -> Result<()> {
        for axis in [0, 1] {
            let (tile, corner, size) = (self.tile[axis], self.corner[axis], resolution[axis]);
            if tile < size || tile > crate::config::MAX_RESOLUTION || corner >= tile {
                let problem = format!("{size} texels from {corner} on are no part of a tile of {tile}");
                return Err(Error::config(format!("domain.corner[{axis}]"), problem));
            }
        }
        let [finest, last] = self.levels;
        // The last level of a window is the average of the tile.
        let most = coarsest - usize::from(self.is_window(resolution)).min(coarsest);
        if !(0.0 <= finest && finest <= last && last <= most as f32) {
            let problem = format!("{finest} to {last} is no range of levels from 0 to {most}");
            return Err(Error::config("domain.levels", problem));
        }
        if self.is_window(resolution) && coarsest == 0 {
            return Err(Error::config("domain.corner", "a window needs a level for the rest of the tile"));
        }
        if !self.is_window(resolution) && self.corner != [0, 0] {
            return Err(Error::config("domain.corner", "the whole tile begins at its own corner, [0, 0]"));
        }
        if !(0.0..=1.0).contains(&self.floor) || self.scene.len() > MAX_NAME {
            return Err(Error::config("domain", "floor is outside 0 to 1, or the scene's name too long"));
        }
        self.wi.validate("domain.wi")?;
        self.wo.validate("domain.wo")
    }

    /// True if the textures hold a part of the tile only.
    pub fn is_window(&self, resolution: [usize; 2]) -> bool {
        resolution != self.tile
    }

    /// A position in the window's own coordinates: \[0, 1)^2 inside, up to tile / window outside.
    pub fn local(&self, resolution: [usize; 2], u: [f32; 2]) -> [f32; 2] {
        self.guide(resolution, 0).local(u)
    }

    /// What the material was fitted for and what it answers outside, in words, a line each.
    pub fn explained(&self, resolution: [usize; 2], coarsest: usize) -> Vec<String> {
        let Self { scene, tile: [height, width], corner: [row, column], levels: [finest, last], .. } = self;
        let mut lines =
            vec![format!("It was fitted for what the scene \"{scene}\" asks: levels {finest} to {last}.")];
        if self.is_window(resolution) {
            let [rows, columns] = resolution;
            lines.push(format!(
                "Its textures hold a window of the tile of {height} x {width} texels: {rows} rows from row {row} and {columns} \
                 columns from column {column} on, over the tile's border if need be. Outside of it every answer is that of level \
                 {coarsest}, which was trained with the average of the whole tile."
            ));
        }
        lines.push(format!(
            "Other levels are clamped. Lights within {} and views within {} were trained for; from other directions an answer \
             may be far off, since only a share of {} of the training data was spread over everything else.",
            self.wi.explained(),
            self.wo.explained(),
            self.floor
        ));
        lines
    }

    fn guide(&self, resolution: [usize; 2], coarsest: usize) -> Guide {
        // Positions are (column, row), sizes (rows, columns).
        let axes = [1, 0];
        Guide {
            corner: axes.map(|a| self.corner[a] as f32 / self.tile[a] as f32),
            scale: axes.map(|a| self.tile[a] as f32 / resolution[a] as f32),
            part: axes.map(|a| self.tile[a] != resolution[a]),
            levels: self.levels,
            outside: coarsest as f32,
        }
    }
}

/// A domain in the numbers by which queries are led to those that a material was fitted for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guide {
    /// The window's corner, in tiles.
    pub corner: [f32; 2],
    /// Windows in a tile.
    pub scale: [f32; 2],
    /// Along which axes the window is a part of the tile.
    pub part: [bool; 2],
    /// Finest and coarsest level that is answered in the window.
    pub levels: [f32; 2],
    /// The level that answers outside of it.
    pub outside: f32,
}

impl Guide {
    /// True if there is an outside.
    pub fn is_window(&self) -> bool {
        self.part != [false; 2]
    }

    fn local(&self, u: [f32; 2]) -> [f32; 2] {
        [0, 1].map(|c| {
            let moved = u[c] - self.corner[c];
            (moved - moved.floor()) * self.scale[c]
        })
    }

    /// True if a position in the window's coordinates is in the window. Along an axis that has all of the tile every one is,
    /// even where rounding makes it 1.
    fn holds(&self, local: [f32; 2]) -> bool {
        (0..2).all(|c| !self.part[c] || local[c] < 1.0)
    }

    /// True if a position is in the window.
    pub fn is_inside(&self, u: [f32; 2]) -> bool {
        self.holds(self.local(u))
    }

    /// How far a position is from the nearest border of the window, along x or y, in tiles; infinite where there is none.
    pub fn border(&self, u: [f32; 2]) -> f32 {
        let local = self.local(u);
        let axes = (0..2).filter(|&c| self.part[c]);
        let apart =
            axes.map(|c| local[c].min((local[c] - 1.0).abs()).min(self.scale[c] - local[c]) / self.scale[c]);
        apart.fold(f32::INFINITY, f32::min)
    }

    /// The position and level that answer in place of a query's.
    pub fn lead(&self, u: [f32; 2], level: f32) -> ([f32; 2], f32) {
        let [finest, coarsest] = self.levels;
        if !self.is_window() {
            return (u, level.clamp(finest, coarsest));
        }
        let local = self.local(u);
        let level = if self.holds(local) { level.clamp(finest, coarsest) } else { self.outside };
        (local.map(|v| v - v.floor()), level)
    }
}

impl Architecture {
    /// Texels \[H, W\] of the whole tile: those that a footprint's level counts.
    pub fn tile(&self) -> [usize; 2] {
        self.domain.as_ref().map_or(self.resolution, |domain| domain.tile)
    }

    /// How queries are led to those that the material was fitted for; nothing for one that was not.
    pub fn guide(&self) -> Option<Guide> {
        self.domain.as_ref().map(|domain| domain.guide(self.resolution, self.coarsest()))
    }

    /// The position and level that a fitted material answers in place of a query's; what was not fitted answers any.
    pub fn fitted(&self, u: [f32; 2], level: f32) -> ([f32; 2], f32) {
        self.guide().map_or((u, level), |guide| guide.lead(u, level))
    }

    /// The position and the level that answer a query, in words.
    pub(crate) fn place_step(&self) -> String {
        let Some(guide) = self.guide() else {
            return format!(
                "Wrap: u = u - floor(u). Clamp: level = min(max(level, 0), {}).",
                self.coarsest()
            );
        };
        let Guide { corner: [x, y], scale: [sx, sy], part, levels: [finest, coarsest], outside } = guide;
        let clamp = format!("level = min(max(level, {finest}), {coarsest})");
        if !guide.is_window() {
            return format!("Wrap: u = u - floor(u). Clamp: {clamp}.");
        }
        let inside = [("v.x < 1", part[0]), ("v.y < 1", part[1])];
        let inside: Vec<&str> = inside.iter().filter(|(_, part)| *part).map(|(test, _)| *test).collect();
        format!(
            "Window, in 32-bit floats: p = u - ({x}, {y}); v = (p - floor(p)) ({sx}, {sy}); u = v - floor(v). Level: where {}, \
             {clamp}; elsewhere level = {outside}.",
            inside.join(" and ")
        )
    }

    /// In what a query is outside of what the material was fitted for.
    pub fn outside(&self, u: [f32; 2], wi: [f32; 2], wo: [f32; 2], level: f32) -> Outside {
        /// Levels come from footprints in f32.
        const ROUNDING: f32 = 1e-4;
        let (Some(domain), Some(guide)) = (&self.domain, self.guide()) else { return Outside::default() };
        Outside {
            finer: level < domain.levels[0] - ROUNDING,
            coarser: level > domain.levels[1] + ROUNDING,
            position: !guide.is_inside(u),
            wi: !domain.wi.holds(wi),
            wo: !domain.wo.holds(wo),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ModelConfig;

    fn fitted() -> Architecture {
        let model: ModelConfig = serde_json::from_str(
            r#"{"texture": {"channels": 4, "init_std": 0.1}, "parallax": {"kind": "none"},
                "encoding": {"pi": true, "components": 2,
                    "u": {"bands": 0, "limit_to_resolution": true, "attenuate": true, "raw": false},
                    "wi": {"bands": 0, "raw": true, "amplitude": 1.0}, "wo": {"bands": 0, "raw": true, "amplitude": 1.0}},
                "decoder": {"kind": "mlp", "hidden": [8]},
                "output": {"space": "rgb", "transform": "identity", "mask": false}}"#,
        )
        .unwrap();
        let mut architecture = Architecture::new(model, [16, 32]).unwrap();
        architecture.domain = Some(Domain {
            scene: "near".into(),
            tile: [64, 64],
            corner: [56, 8],
            levels: [0.0, 1.5],
            wi: Cone { axis: [0.0, 0.0, 1.0], cosine: 0.5 },
            wo: Cone { axis: [0.6, 0.0, 0.8], cosine: 0.9 },
            floor: 0.1,
        });
        architecture
    }

    #[test]
    fn a_window_that_laps_the_border_has_its_own_coordinates() {
        let architecture = fitted();
        architecture.validate().unwrap();
        assert_eq!(architecture.tile(), [64, 64]);
        // Column 8 of 64 and row 56 of 64 are the window's corner; row 0 of the next tile is its middle.
        assert_eq!(architecture.fitted([0.125, 0.875], 0.5), ([0.0, 0.0], 0.5));
        assert_eq!(architecture.fitted([0.375, 1.0], 3.0), ([0.5, 0.5], 1.5));
        let (u, level) = architecture.fitted([0.125, 0.25], 0.0);
        assert_eq!((u, level), ([0.0, 0.5], architecture.coarsest() as f32));
    }

    #[test]
    fn the_whole_tile_is_only_clamped_and_a_band_of_it_has_no_border_along_itself() {
        let mut architecture = fitted();
        let domain = architecture.domain.as_mut().unwrap();
        (domain.tile, domain.corner) = ([16, 32], [0, 0]);
        architecture.validate().unwrap();
        assert_eq!(architecture.fitted([-7.3, 12.5], 9.0), ([-7.3, 12.5], 1.5));
        // All columns, half of the rows: a position that rounding wraps to 1 is still inside.
        let domain = architecture.domain.as_mut().unwrap();
        (domain.tile, domain.corner) = ([32, 32], [8, 0]);
        assert_eq!(architecture.fitted([-1e-9, 0.25], 0.5), ([0.0, 0.0], 0.5));
        assert!(!architecture.outside([-1e-9, 0.25], [0.0, 0.0], [0.6, 0.0], 0.5).position);
        assert!(architecture.outside([0.5, 0.2], [0.0, 0.0], [0.6, 0.0], 0.5).position);
    }

    #[test]
    fn queries_outside_are_known_by_what_they_leave() {
        let architecture = fitted();
        let inside = ([0.2, 0.9], [0.0, 0.0], [0.6, 0.0], 1.0);
        let outside = |u, wi, wo, level| architecture.outside(u, wi, wo, level);
        assert_eq!(outside(inside.0, inside.1, inside.2, inside.3), Outside::default());
        assert!(outside([0.2, 0.5], inside.1, inside.2, 1.0).position);
        assert!(outside(inside.0, [0.9, 0.0], inside.2, 1.0).wi);
        assert!(outside(inside.0, inside.1, [-0.6, 0.0], 1.0).wo);
        assert!(outside(inside.0, inside.1, inside.2, 1.6).coarser);
        let mut later = architecture.clone();
        if let Some(domain) = &mut later.domain {
            domain.levels[0] = 1.0;
        }
        assert!(later.outside(inside.0, inside.1, inside.2, 0.5).finer);
    }

    #[test]
    fn domains_that_cannot_be_are_refused() {
        let refused = |change: &dyn Fn(&mut Domain)| {
            let mut architecture = fitted();
            change(architecture.domain.as_mut().unwrap());
            architecture.validate().unwrap_err().to_string()
        };
        assert!(refused(&|d| d.tile = [8, 64]).contains("domain.corner[0]"));
        assert!(refused(&|d| d.levels = [0.0, 3.0]).contains("domain.levels"));
        assert!(refused(&|d| d.levels = [f32::NAN, 1.0]).contains("domain.levels"));
        assert!(refused(&|d| d.wi.axis = [0.0; 3]).contains("domain.wi"));
        assert!(refused(&|d| d.floor = 2.0).contains("floor"));
        assert!(refused(&|d| d.tile = [16, 32]).contains("domain.corner[0]"));
        let whole = |d: &mut Domain| (d.tile, d.corner) = ([16, 32], [0, 1]);
        assert!(refused(&whole).contains("its own corner"));
    }
}
