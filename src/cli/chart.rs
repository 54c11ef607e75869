//! `neumip chart`.

use super::console::Console;
use crate::chart::{Against, Chart as Drawing, Labels, Panels, Settings, WIDTH, gather};
use crate::error::{Error, Result};
use crate::evaluate::TIMED_QUERIES;
use clap::Args;
use neumip_export::whole_file::write_whole;
use std::path::{Path, PathBuf};

/// Error against time and size, over all results found in folders: SVG, PNG and an interactive page.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip chart results --out chart.svg,chart.png,chart.html\n  \
    neumip chart day1 day2 --metric flip --split views --against ns --panels mean --out flip.svg")]
pub struct Chart {
    /// Folders that are searched for results.json, or such files; later ones win where both have a result.
    #[arg(required = true)]
    results: Vec<PathBuf>,
    /// The error, by its name in the results.
    #[arg(long, default_value = "mse")]
    metric: String,
    /// What the error is shown against.
    #[arg(long, default_value = "both")]
    against: Against,
    /// Split; `views` for the mean of all views/NAME.
    #[arg(long, default_value = "test")]
    split: String,
    /// Level, or `all` for all of the split.
    #[arg(long, default_value = "all", value_parser = level)]
    level: Level,
    /// Directions of the training data; by default all of them.
    #[arg(long)]
    regime: Option<String>,
    /// Materials; by default all of them.
    #[arg(long, value_delimiter = ',')]
    materials: Vec<String>,
    /// Rows of the picture: the mean over the materials, each material, or all of these.
    #[arg(long, default_value = "all")]
    panels: Panels,
    /// Marks that are named in the picture.
    #[arg(long, default_value = "front")]
    labels: Labels,
    /// Heading.
    #[arg(long)]
    title: Option<String>,
    /// The files, of a kind by their endings: .svg, .png, .html.
    #[arg(long, value_delimiter = ',', default_value = "chart.svg,chart.png,chart.html")]
    out: Vec<PathBuf>,
    /// Pixels along the width of a PNG.
    #[arg(long, default_value_t = WIDTH)]
    width: u32,
    /// Replace existing files.
    #[arg(long)]
    force: bool,
}

/// A level, or all of a split.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Level(Option<usize>);

fn level(text: &str) -> std::result::Result<Level, String> {
    match text {
        "all" => Ok(Level(None)),
        _ => text.parse().map(|level| Level(Some(level))).map_err(|_| "use a whole number or all".into()),
    }
}

/// Kinds of files by their endings.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Svg,
    Png,
    Html,
}

fn kind(path: &Path) -> Result<Kind> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("svg") => Ok(Kind::Svg),
        Some("png") => Ok(Kind::Png),
        Some("html" | "htm") => Ok(Kind::Html),
        _ => Err(Error::usage(format!("--out {}: use a name ending in .svg, .png or .html", path.display()))),
    }
}

impl Chart {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        let kinds = self.out.iter().map(|path| kind(path)).collect::<Result<Vec<_>>>()?;
        for (i, path) in self.out.iter().enumerate() {
            super::check_json(Some(path))?;
            if self.out[..i].contains(path) {
                return Err(Error::usage(format!("--out {}: is named twice", path.display())));
            }
            if path.exists() && !self.force {
                return Err(Error::file(path, "exists: name another file or add --force"));
            }
        }
        let (results, files) = gather(&self.results)?;
        let settings = Settings {
            title: self.title,
            metric: self.metric,
            against: self.against,
            split: self.split,
            level: self.level.0,
            regime: self.regime,
            materials: self.materials,
            panels: self.panels,
            labels: self.labels,
            timed_queries: TIMED_QUERIES,
        };
        let chart = Drawing::new(&results, settings)?;
        // All is made before anything is written.
        let made = |kind: &Kind| match kind {
            Kind::Svg => chart.svg().map(String::into_bytes),
            Kind::Png => chart.png(self.width),
            Kind::Html => chart.html().map(String::into_bytes),
        };
        let contents = kinds.iter().map(made).collect::<Result<Vec<_>>>()?;
        for (path, bytes) in self.out.iter().zip(&contents) {
            write_whole(path, bytes)?;
            console.say(path.display().to_string());
        }
        let files = if files.len() == 1 { "1 file".into() } else { format!("{} files", files.len()) };
        console.say(format!("{} from {files} of results", chart.summary()?));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_and_levels_by_name() {
        assert_eq!(kind(Path::new("a/b.SVG")).unwrap(), Kind::Svg);
        assert_eq!(kind(Path::new("b.html")).unwrap(), Kind::Html);
        for bad in ["chart", "chart.pdf", "folder/"] {
            assert_eq!(kind(Path::new(bad)).unwrap_err().exit_code(), 2, "{bad}");
        }
        assert_eq!((level("all"), level("3")), (Ok(Level(None)), Ok(Level(Some(3)))));
        assert!(level("-1").is_err() && level("").is_err());
    }
}
