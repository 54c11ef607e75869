//! The maps of one material as they come from their files: decoded, their seams measured, not yet square.

use super::file::{Colour, Convention, MaterialFile, Scalar};
use super::lookalikes::lookalikes;
use super::normals;
use crate::error::{Error, Result};
use crate::reference::map_file::{self, MapImage, png_value};
use crate::reference::tiling::Grid;
use crate::srgb;
use std::path::{Path, PathBuf};

/// A property: the same everywhere, or a map.
pub(super) enum Source<const N: usize> {
    Constant([f32; N]),
    Map(PathBuf, Grid<N>),
}

impl<const N: usize> Source<N> {
    fn cross_fade(&mut self) {
        if let Self::Map(_, grid) = self {
            *grid = grid.cross_faded();
        }
    }
}

/// Everything that a material.json names.
pub(super) struct Sources {
    pub height: Option<Source<1>>,
    pub base_colour: Source<3>,
    pub roughness: Source<1>,
    pub metalness: Source<1>,
    pub specular: Source<1>,
    /// Unit normals over the plane.
    pub normal: Option<Source<3>>,
    pub opacity: Option<Source<1>>,
    /// For every map that does not tile: its path and by how much.
    pub open_seams: Vec<(PathBuf, String)>,
    pub notes: Vec<String>,
}

impl Sources {
    /// Reads every map that the material.json at `path` names.
    pub fn read(path: &Path, file: &MaterialFile) -> Result<Self> {
        let mut loader = Loader { path, open_seams: Vec::new(), notes: Vec::new() };
        let height = file.height.as_ref().map(|h| loader.scalar("height", h)).transpose()?;
        let base_colour = loader.colour("base_colour", loader.stated("base_colour", &file.base_colour)?)?;
        let roughness = loader.scalar("roughness", loader.stated("roughness", &file.roughness)?)?;
        let metalness =
            loader.scalar("metalness", file.metalness.as_ref().unwrap_or(&Scalar::Constant(0.0)))?;
        let specular =
            loader.scalar("specular", file.specular.as_ref().unwrap_or(&Scalar::Constant(0.04)))?;
        let convention = file.normal_convention.unwrap_or_default();
        let normal = file.normal.as_ref().map(|map| loader.normal(map, convention)).transpose()?;
        let opacity = file.opacity.as_ref().map(|map| loader.grey_map("opacity", map)).transpose()?;
        let Loader { open_seams, notes, .. } = loader;
        Ok(Self { height, base_colour, roughness, metalness, specular, normal, opacity, open_seams, notes })
    }

    /// Crops and cross-fades every map by the same share.
    pub fn cross_fade(&mut self) {
        self.base_colour.cross_fade();
        for source in [&mut self.roughness, &mut self.metalness, &mut self.specular] {
            source.cross_fade();
        }
        self.height.iter_mut().chain(&mut self.opacity).for_each(Source::cross_fade);
        self.normal.iter_mut().for_each(Source::cross_fade);
    }
}

struct Loader<'a> {
    path: &'a Path,
    open_seams: Vec<(PathBuf, String)>,
    notes: Vec<String>,
}

impl Loader<'_> {
    /// A field that every material needs.
    fn stated<'v, T>(&self, field: &str, value: &'v Option<T>) -> Result<&'v T> {
        value.as_ref().ok_or_else(|| {
            let problem = format!("has no {field}; state a value or a map{}", lookalikes(self.path, field));
            Error::file(self.path, problem)
        })
    }

    fn scalar(&mut self, field: &str, scalar: &Scalar) -> Result<Source<1>> {
        match scalar {
            Scalar::Constant(value) => Ok(Source::Constant([*value])),
            Scalar::Map(map) => self.grey_map(field, map),
        }
    }

    fn colour(&mut self, field: &str, colour: &Colour) -> Result<Source<3>> {
        let map = match colour {
            Colour::Constant(value) => return Ok(Source::Constant(*value)),
            Colour::Map(map) => map,
        };
        let (path, mut grid, is_png) = self.open(field, map)?;
        // Before decoding: equal steps of sRGB look equal.
        self.measure(field, &path, &grid, 1.0);
        if is_png {
            // PNG holds at most 16 bits, so a table has every value.
            let table: Vec<f32> = (0..=u16::MAX).map(|v| srgb::decode(png_value(v))).collect();
            let linear = |v: f32| table[(v * f32::from(u16::MAX)).round() as usize];
            grid.texels.iter_mut().for_each(|t| *t = t.map(linear));
        }
        Ok(Source::Map(map.clone(), grid))
    }

    /// A map of one quantity: grey, or RGB with three equal channels.
    fn grey_map(&mut self, field: &str, map: &Path) -> Result<Source<1>> {
        let (path, grid, _) = self.open(field, map)?;
        if grid.texels.iter().any(|t| t[0] != t[1] || t[0] != t[2]) {
            let problem = format!("has three different channels where {field} needs one; save it as grey");
            return Err(Error::file(&path, problem));
        }
        let texels = grid.texels.iter().map(|t| [t[0]]).collect();
        let grid = Grid { width: grid.width, height: grid.height, texels };
        // Heights have no unit of their own: what shows is a step against their range.
        let span = if field == "height" { span(&grid) } else { 1.0 };
        self.measure(field, &path, &grid, span);
        Ok(Source::Map(map.to_path_buf(), grid))
    }

    fn normal(&mut self, map: &Path, convention: Convention) -> Result<Source<3>> {
        let (path, mut grid, is_png) = self.open("normal", map)?;
        let range =
            normals::decode(&mut grid, is_png, convention).map_err(|problem| Error::file(&path, problem))?;
        self.measure("normal", &path, &grid, 2.0);
        if !is_png {
            let range = match range {
                normals::Range::Signed => "-1 to 1",
                normals::Range::Shifted => "0 to 1",
            };
            self.notes.push(format!("normal: {} is read as normals stored from {range}", map.display()));
        }
        Ok(Source::Map(map.to_path_buf(), grid))
    }

    fn open(&self, field: &str, map: &Path) -> Result<(PathBuf, Grid<3>, bool)> {
        let path = beside(self.path, map);
        if !path.exists() {
            let problem = format!("does not exist, and {field} names it{}", lookalikes(&path, field));
            return Err(Error::file(&path, problem));
        }
        let MapImage { width, height, texels, is_png } = map_file::read(&path)?;
        Ok((path, Grid { width, height, texels }, is_png))
    }

    fn measure<const N: usize>(&mut self, field: &str, path: &Path, grid: &Grid<N>, span: f64) {
        if let Some(seam) = grid.seams().into_iter().find(|seam| seam.is_open(span)) {
            self.open_seams.push((path.to_path_buf(), format!("does not tile as {field}: {seam}")));
        }
    }
}

/// A path that is relative to the file that names it.
pub(super) fn beside(file: &Path, path: &Path) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).join(path)
}

fn span(grid: &Grid<1>) -> f64 {
    let low = grid.texels.iter().fold(f32::INFINITY, |a, t| a.min(t[0]));
    let high = grid.texels.iter().fold(f32::NEG_INFINITY, |a, t| a.max(t[0]));
    f64::from(high) - f64::from(low)
}
