//! Error against cost over everything that was measured: a picture (SVG, PNG) and an interactive page.
//!
//! ```text
//! results.json ... -> find -> Results -> points: variants, seeds -> front, axes, labels -> plot: scene -> SVG, PNG
//!                                                 └-> page: the same numbers as JSON, drawn by the reader's browser
//! ```
//!
//! A mark is a variant: what was trained, how, at which resolution and budget; its seeds make its mean and its bars.
//! Pictures are the same bytes for the same results.

mod axes;
mod caption;
mod family;
mod find;
mod front;
mod labels;
mod metric;
mod page;
mod panel;
mod plot;
mod points;
pub(crate) mod raster;
pub(crate) mod scene;
#[cfg(test)]
mod tests;

pub use find::gather;

use crate::error::{Error, Result};
use crate::results::Results;
use metric::Metric;
use points::Group;
use std::collections::BTreeSet;

/// Width of the picture in its own units: CSS pixels of the SVG.
pub const WIDTH: u32 = 1200;
/// Widths of a PNG that can be asked for.
pub const PNG_WIDTHS: std::ops::RangeInclusive<u32> = 300..=4800;

/// A cost: what the error is shown against.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Against {
    /// Time of a query.
    Ns,
    /// Weights and textures.
    Bytes,
    /// Work of the networks, a query.
    Flops,
    /// Time and bytes, side by side.
    #[default]
    Both,
}

/// Which marks of a picture are named.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Labels {
    /// Those of the Pareto front.
    #[default]
    Front,
    /// All that there is room for.
    All,
    /// None.
    None,
}

/// Which rows a picture has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Panels {
    /// Each material, and their mean where there are several.
    #[default]
    All,
    /// The mean over the materials.
    Mean,
    /// Each material.
    Materials,
}

/// What to show.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Heading; by default what is shown.
    pub title: Option<String>,
    /// Name of the error as the results have it.
    pub metric: String,
    /// The cost.
    pub against: Against,
    /// Split; `views` means all `views/NAME`.
    pub split: String,
    /// Level; none for all of the split.
    pub level: Option<usize>,
    /// Directions of the training data; none for all.
    pub regime: Option<String>,
    /// Materials; empty for all.
    pub materials: Vec<String>,
    /// Rows of the picture.
    pub panels: Panels,
    /// Names beside the marks.
    pub labels: Labels,
    /// Queries of a round of the timing, for the caption.
    pub timed_queries: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            title: None,
            metric: "mse".into(),
            against: Against::Both,
            split: "test".into(),
            level: None,
            regime: None,
            materials: Vec::new(),
            panels: Panels::All,
            labels: Labels::Front,
            timed_queries: 0,
        }
    }
}

/// Results that can be drawn.
#[derive(Clone, Debug)]
pub struct Chart {
    settings: Settings,
    /// Of all splits, levels and regimes, in order; the mean over the materials is a material without a name.
    groups: Vec<Group>,
    metrics: Vec<Metric>,
    materials: Vec<String>,
    machines: Vec<String>,
    generator: String,
}

impl Chart {
    /// Groups the cells of `results`.
    ///
    /// # Errors
    /// `Usage` if the settings name a metric, split, level, regime or material that no cell has; it says which there
    /// are.
    pub fn new(results: &Results, settings: Settings) -> Result<Self> {
        let there: BTreeSet<&str> = results.cells.iter().map(|c| c.material.as_str()).collect();
        if let Some(name) = settings.materials.iter().find(|name| !there.contains(name.as_str())) {
            return Err(absent("--materials", name, there));
        }
        let wanted = |name: &String| settings.materials.is_empty() || settings.materials.contains(name);
        let cells: Vec<_> = results.cells.iter().filter(|c| wanted(&c.material)).collect();
        let groups = points::groups(&cells);
        let metrics = metric::of(&groups);
        if !metrics.iter().any(|m| m.name == settings.metric) {
            return Err(absent("--metric", &settings.metric, metrics.iter().map(|m| m.name.as_str())));
        }
        if !groups.iter().any(|g| g.split == settings.split) {
            return Err(absent("--split", &settings.split, groups.iter().map(|g| g.split.as_str())));
        }
        let level = level_name(settings.level);
        let of_split = || groups.iter().filter(|g| g.split == settings.split);
        if !of_split().any(|g| g.level == settings.level) {
            let levels: Vec<String> = of_split().map(|g| level_name(g.level)).collect();
            return Err(absent("--level", &level, levels.iter().map(String::as_str)));
        }
        let regimes = || groups.iter().map(|g| g.variant.regime.as_str());
        if let Some(regime) = settings.regime.as_deref().filter(|r| !regimes().any(|mine| mine == *r)) {
            return Err(absent("--regime", regime, regimes()));
        }
        let materials: BTreeSet<String> = cells.iter().map(|c| c.material.clone()).collect();
        let (machines, generator) = (results.machines.clone(), results.generator.clone());
        let materials = materials.into_iter().collect();
        Ok(Self { settings, groups, metrics, materials, machines, generator })
    }

    /// The picture as an SVG file.
    ///
    /// # Errors
    /// `Usage` if nothing can be drawn, or more panels than a picture has room for.
    pub fn svg(&self) -> Result<String> {
        Ok(scene::svg(&plot::scene(self)?))
    }

    /// The picture as a PNG file of `width` pixels.
    ///
    /// # Errors
    /// As [`Chart::svg`]; `Usage` if the width is not one of [`PNG_WIDTHS`].
    pub fn png(&self, width: u32) -> Result<Vec<u8>> {
        if !PNG_WIDTHS.contains(&width) {
            let (least, most) = (PNG_WIDTHS.start(), PNG_WIDTHS.end());
            return Err(Error::usage(format!("--width {width}: {least} to {most} work")));
        }
        raster::png(&plot::scene(self)?, width)
    }

    /// The page: one file that needs no other and no network.
    ///
    /// # Errors
    /// As [`Chart::svg`].
    pub fn html(&self) -> Result<String> {
        page::html(self)
    }

    /// What is drawn, in one line.
    ///
    /// # Errors
    /// As [`Chart::svg`].
    pub fn summary(&self) -> Result<String> {
        let panels = panel::panels(self)?;
        let variants: BTreeSet<_> = panels.iter().flat_map(|p| p.marks.iter().map(|m| &m.variant)).collect();
        let (variants, materials) = (counted(variants.len(), "variant"), self.material_count());
        Ok(format!("{variants}, {materials}, {}", counted(panels.len(), "panel")))
    }

    fn material_count(&self) -> String {
        counted(self.materials.len(), "material")
    }
}

/// A flag names what no cell has.
fn absent<'a>(flag: &str, name: &str, there: impl IntoIterator<Item = &'a str>) -> Error {
    let there: BTreeSet<&str> = there.into_iter().collect();
    if there.is_empty() {
        return Error::usage(format!("{flag} {name}: the results have none at all"));
    }
    let there: Vec<&str> = there.into_iter().collect();
    Error::usage(format!("{flag} {name}: no result has it; there are {}", there.join(", ")))
}

fn level_name(level: Option<usize>) -> String {
    level.map_or("all".into(), |level| level.to_string())
}

fn counted(n: usize, noun: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    format!("{n} {noun}{s}")
}
