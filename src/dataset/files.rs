//! Writing each kind of file of a dataset, with what the description says of it.

use super::{
    block::{Block, Layout},
    folder::is_part,
    format::{FileInfo, HeightInfo, MANIFEST, SplitInfo, SplitName, Summary, ViewInfo, file_name},
    frame::{Plane, write_frame},
    grid::write_grid,
    query_frame::write_query_frame,
    table::write_table,
};
use crate::{
    error::{Error, Result},
    query::{QueryBuffer, RgbImage},
};
use half::f16;
use std::path::Path;

/// Name of the height map's file.
pub(crate) const HEIGHTS: &str = "height.exr";
/// Name of the picture of a dataset.
pub const CONTACT_SHEET: &str = "contact-sheet.png";

/// Writes blocks of one side as the `index`-th file of a split; `noise` is what was asked for.
pub(crate) fn write_blocks(
    root: &Path,
    split: SplitName,
    index: usize,
    side: usize,
    blocks: &[Block],
    noise: Option<f32>,
) -> Result<FileInfo> {
    if blocks.is_empty() || blocks.iter().any(|block| block.side() != side) {
        return Err(Error::config(
            format!("splits.{split}"),
            format!("a file needs at least one block, each of side {side}"),
        ));
    }
    let name = file_name(split, index);
    let variances = || blocks.iter().map(|block| f64::from(block.noise()));
    let is_noisy = |variance: f64| noise.is_some_and(|noise| variance.sqrt() > f64::from(noise));
    Ok(FileInfo {
        blocks: blocks.len(),
        patches: blocks.iter().map(|block| block.patches().len()).sum(),
        level_blocks: count_levels(blocks.iter().map(Block::layout)),
        frame_bytes: write_grid(&root.join(format!("{name}.exr")), side, blocks)?,
        table_bytes: write_table(&root.join(format!("{name}.safetensors")), blocks)?,
        summary: summary(
            blocks.iter().flat_map(|block| block.rgb()).map(|p| p.map(f16::to_f32)),
            mean(variances()),
        ),
        noise: mean(variances().map(f64::sqrt)),
        noisy_blocks: variances().filter(|variance| is_noisy(*variance)).count(),
        name,
    })
}

/// Writes a view: a picture as queries and answers, with the mean variance of the answers.
pub(crate) fn write_view(
    root: &Path,
    name: &str,
    queries: &QueryBuffer,
    rgb: &RgbImage,
    variance: f32,
) -> Result<ViewInfo> {
    let mut info = ViewInfo {
        name: name.into(),
        height: queries.height(),
        width: queries.width(),
        bytes: 0,
        summary: summary(rgb.pixels.iter().copied(), variance),
    };
    info.validate()?;
    info.bytes = write_query_frame(&root.join(info.file()), queries, rgb)?;
    Ok(info)
}

/// Writes the height map: `height * width` values row by row, tile widths.
pub(crate) fn write_heights(
    root: &Path,
    height: usize,
    width: usize,
    values: Vec<f32>,
) -> Result<HeightInfo> {
    if values.is_empty() || height.checked_mul(width) != Some(values.len()) {
        return Err(Error::config(
            "height_map",
            format!("{} values are not {height} x {width}", values.len()),
        ));
    }
    if let Some(k) = values.iter().position(|v| !v.is_finite()) {
        return Err(Error::config(format!("height_map[{k}]"), "is not finite"));
    }
    let bytes = write_frame(&root.join(HEIGHTS), [height, width], vec![("Y", Plane::Float(values))])?;
    Ok(HeightInfo { height, width, bytes })
}

/// True for the names that a dataset's files have.
pub(crate) fn is_ours(name: &str) -> bool {
    let numbered = |rest: &str| {
        let number = rest.strip_suffix(".exr").or(rest.strip_suffix(".safetensors"));
        number.is_some_and(|n| n.len() == 5 && n.bytes().all(|c| c.is_ascii_digit()))
    };
    let of_split = |split: SplitName| name.strip_prefix(&format!("{split}-")).is_some_and(numbered);
    [MANIFEST, HEIGHTS, CONTACT_SHEET].contains(&name)
        || is_part(name)
        || (name.starts_with("views-") && name.ends_with(".exr"))
        || super::shard::is_description(name)
        || SplitName::ALL.into_iter().any(of_split)
}

/// Recomputes what a split says of its files together.
pub(crate) fn refresh(split: &mut SplitInfo) {
    let blocks = split.blocks().max(1) as f64;
    let levels = split.files.iter().map(|f| f.level_blocks.len()).max().unwrap_or(0);
    let count =
        |level: usize| -> usize { split.files.iter().filter_map(|f| f.level_blocks.get(level)).sum() };
    split.level_shares = (0..levels).map(|level| (count(level) as f64 / blocks) as f32).collect();
    let noise: f64 = split.files.iter().map(|f| f.blocks as f64 * f64::from(f.noise)).sum();
    split.noise = (noise / blocks) as f32;
    split.noisy_blocks = split.files.iter().map(|f| f.noisy_blocks).sum();
}

fn count_levels<'a>(layouts: impl Iterator<Item = &'a Layout>) -> Vec<usize> {
    let mut counts = vec![0];
    for layout in layouts {
        let level = layout.level().round() as usize;
        if counts.len() <= level {
            counts.resize(level + 1, 0);
        }
        counts[level] += 1;
    }
    counts
}

fn summary(rgb: impl Iterator<Item = [f32; 3]>, variance: f32) -> Summary {
    let (mut sum, mut max, mut n) = ([0.0f64; 3], f32::NEG_INFINITY, 0u64);
    for pixel in rgb {
        for c in 0..3 {
            sum[c] += f64::from(pixel[c]);
            max = max.max(pixel[c]);
        }
        n += 1;
    }
    Summary { mean: sum.map(|s| (s / n.max(1) as f64) as f32), max: if n > 0 { max } else { 0.0 }, variance }
}

/// Mean of at least one value.
fn mean(values: impl Iterator<Item = f64>) -> f32 {
    let (sum, n) = values.fold((0.0, 0u64), |(sum, n), value| (sum + value, n + 1));
    (sum / n.max(1) as f64) as f32
}
