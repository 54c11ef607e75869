//! From the maps of a material.json to the parts of a material.

use super::ReadOptions;
use super::file::MaterialFile;
use super::normals;
use super::sources::{Source, Sources, beside};
use super::words;
use crate::error::{Error, Result};
use crate::reference::heightfield::{HeightMap, MAX_DEPTH};
use crate::reference::material::{Layer, Material, Paint, Part};
use crate::reference::mesh_file::{self, Placement};
use crate::reference::primitives::TriangleMesh;
use crate::reference::resample::{nearest_side, resample};
use crate::reference::texture::Texture;
use crate::reference::tiling::FADE_GROWTH;
use std::path::Path;

/// How far heights may leave the stated range, in tile widths: the rounding of both to f32.
const RANGE_ROUNDING: f32 = 1e-6;

/// Reads a material; `may_have_base` is false inside of another.
pub(super) fn read(path: &Path, options: &ReadOptions, may_have_base: bool) -> Result<Material> {
    let file = MaterialFile::read(path)?;
    if file.base.is_some() && !may_have_base {
        return Err(Error::file(path, "has a base of its own and is one; only one level works"));
    }
    let mut sources = Sources::read(path, &file)?;
    let mut reader = Reader { path, notes: std::mem::take(&mut sources.notes), growth: 1.0 };
    let body = match &file.mesh {
        Some(mesh) => Body::Mesh(reader.mesh(&file, mesh)?),
        None => Body::Height,
    };
    reader.close_seams(&mut sources, &body, options)?;
    let Sources { height, base_colour, roughness, metalness, specular, normal, opacity, .. } = sources;
    let paint = Paint {
        base_colour: reader.shares("base_colour", base_colour)?,
        roughness: reader.shares("roughness", roughness)?,
        metalness: reader.shares("metalness", metalness)?,
        specular: reader.shares("specular", specular)?,
        normal: normal.map(|normal| reader.normal(normal)).transpose()?,
    };
    reader.notes.extend(words::raised_roughness(&paint.roughness));
    let part = match (body, height, opacity) {
        (Body::Mesh(mesh), ..) => Part::Mesh(mesh, paint),
        (Body::Height, height, opacity) => {
            let height = reader.height(&file, height)?;
            reader.notes.extend(words::steep(&height));
            if let Some(normal) = &paint.normal {
                let agreement = normals::agreement(normal, &height);
                let convention = file.normal_convention.unwrap_or_default();
                let word = normals::turned_green(agreement, convention);
                reader.notes.extend(word.map(|word| format!("normal: {word}")));
            }
            let layer = Layer { height, paint };
            match opacity {
                Some(opacity) => {
                    let opacity = reader.shares("opacity", opacity)?;
                    reader.notes.extend(words::holes(&opacity));
                    Part::Sheet(layer, opacity)
                }
                None => Part::Solid(layer),
            }
        }
    };
    let own = reader.height_range(&file, extent(&part))?;
    let Reader { notes, .. } = reader;
    let mut material = Material { name: file.name, parts: vec![part], height_range: own, notes };
    if let Some(base) = &file.base {
        put_base_below(&mut material, read(&beside(path, base), options, false)?);
    }
    Ok(material)
}

/// Adds the parts of the material that is seen through the holes. A stated range is widened to both.
fn put_base_below(sheet: &mut Material, base: Material) {
    if sheet.height_range.is_some() || base.height_range.is_some() {
        let parts = sheet.parts.iter().chain(&base.parts).map(extent);
        let stated = sheet.height_range.into_iter().chain(base.height_range);
        sheet.height_range = parts.chain(stated).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    }
    sheet.parts.extend(base.parts);
    sheet.notes.extend(base.notes.into_iter().map(|note| format!("{}: {note}", base.name)));
}

/// Lowest and highest point of a part that this module makes.
fn extent(part: &Part) -> [f32; 2] {
    let over = |values: &mut dyn Iterator<Item = f32>| {
        values.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], z| [low.min(z), high.max(z)])
    };
    match part {
        Part::Solid(layer) | Part::Sheet(layer, _) => over(&mut layer.height.values.iter().copied()),
        Part::Mesh(mesh, _) => over(&mut mesh.positions.iter().map(|p| p[2] as f32)),
        Part::Fibres(..) => [0.0; 2],
    }
}

/// What carries the paint.
enum Body {
    Height,
    Mesh(TriangleMesh),
}

/// Turns maps into textures and collects what is to be said about them.
struct Reader<'a> {
    path: &'a Path,
    notes: Vec<String>,
    /// Tile widths of the files in a width of the tile that is left of them.
    growth: f64,
}

impl Reader<'_> {
    /// Refuses maps that do not tile, or makes them.
    fn close_seams(&mut self, sources: &mut Sources, body: &Body, options: &ReadOptions) -> Result<()> {
        let Some((map, problem)) = sources.open_seams.first() else {
            if options.make_tileable {
                self.notes.push("every map tiles as it is; make-tileable changed nothing".into());
            }
            return Ok(());
        };
        match body {
            // Where they go round the map is up to the mesh's own coordinates.
            Body::Mesh(TriangleMesh { uv: Some(_), .. }) => Ok(()),
            Body::Mesh(_) => {
                let problem = format!("{problem}; mend the map: it cannot be cropped without its mesh");
                Err(Error::file(map, problem))
            }
            Body::Height if options.make_tileable => {
                sources.cross_fade();
                self.growth = FADE_GROWTH;
                self.notes.push(
                    "made tileable: every map lost an eighth of its width and height, which is cross-faded into the \
                     rest; heights in widths of the smaller tile are 8/7 of what they were"
                        .into(),
                );
                Ok(())
            }
            Body::Height => Err(Error::file(
                map,
                format!("{problem}; mend the map, or crop and blend it with --make-tileable"),
            )),
        }
    }

    fn mesh(&mut self, file: &MaterialFile, mesh: &Path) -> Result<TriangleMesh> {
        let usual = Placement::default();
        let placement = Placement { tile: file.tile.unwrap_or(usual.tile), up: file.up.unwrap_or(usual.up) };
        let (mesh, notes) = mesh_file::read(&beside(self.path, mesh), &placement)?;
        self.notes.extend(notes.into_iter().map(|note| format!("mesh: {note}")));
        if file.normal.is_some() && mesh.uv.is_some() {
            let problem = "is over the plane, and the mesh has texture coordinates of its own; leave it out";
            return Err(self.refuse("normal", problem));
        }
        Ok(mesh)
    }

    fn height(&mut self, file: &MaterialFile, height: Option<Source<1>>) -> Result<HeightMap> {
        let missing = |field, what| self.refuse(field, format!("is missing; state {what}"));
        let height = height.ok_or_else(|| missing("height", "a map or a value, or a mesh"))?;
        let scale =
            file.displacement.ok_or_else(|| missing("displacement", "the height of 1 in tile widths"))?;
        let midlevel = file.midlevel.unwrap_or(0.5);
        let most = 2.0 * f64::from(MAX_DEPTH);
        if !(0.0..=most).contains(&scale) {
            return Err(self.refuse("displacement", format!("is {scale}; 0 to {most} tile widths work")));
        }
        if !(0.0..=1.0).contains(&midlevel) {
            return Err(self.refuse("midlevel", format!("is {midlevel}; 0 to 1 work")));
        }
        let (scale, midlevel) = (scale as f32, midlevel as f32);
        let (side, values) = match height {
            Source::Constant(value) => (2, vec![value; 4]),
            map @ Source::Map(..) => self.square("height", map),
        };
        if let Some([v]) = values.iter().find(|[v]| !v.is_finite() || *v < 0.0) {
            return Err(self.refuse("height", format!("holds {v}; heights are finite and not negative")));
        }
        let scale = f64::from(scale) * self.growth;
        let values: Vec<f32> =
            values.iter().map(|[v]| (scale * (f64::from(*v) - f64::from(midlevel))) as f32).collect();
        if let Some(z) = values.iter().find(|z| z.abs() > MAX_DEPTH) {
            let problem =
                format!("puts the surface at {z} tile widths; at most {MAX_DEPTH} from the plane works");
            return Err(self.refuse("displacement", problem));
        }
        Ok(HeightMap { height: side, width: side, values })
    }

    /// The stated range, if there is one; `extent` is what must lie within.
    fn height_range(&self, file: &MaterialFile, extent: [f32; 2]) -> Result<Option<[f32; 2]>> {
        let Some(stated) = file.height_range else { return Ok(None) };
        let depth = f64::from(MAX_DEPTH);
        if !(stated[0] <= stated[1] && stated.iter().all(|z| (-depth..=depth).contains(z))) {
            let problem = format!(
                "is {} to {}; it goes up, within -{depth} to {depth} tile widths",
                stated[0], stated[1]
            );
            return Err(self.refuse("height_range", problem));
        }
        let range = stated.map(|z| (z * self.growth) as f32);
        let [below, above] = [range[0] - extent[0], extent[1] - range[1]];
        let more = below.max(above);
        if more > RANGE_ROUNDING {
            let (edge, from) = if below > above { ("below", "low") } else { ("above", "high") };
            let problem = format!(
                "is {} to {}, and the surface spans {} to {}: {more:.4} tile widths {edge} its {from} end; widen it \
                 or lower the displacement",
                range[0], range[1], extent[0], extent[1]
            );
            return Err(self.refuse("height_range", problem));
        }
        Ok(Some([range[0].min(extent[0]), range[1].max(extent[1])]))
    }

    /// A texture of shares.
    fn shares<const N: usize>(&mut self, field: &str, source: Source<N>) -> Result<Texture<N>> {
        let texture = match source {
            Source::Constant(value) => Texture::constant(value),
            map @ Source::Map(..) => self.texture(field, map)?,
        };
        match texture.texels().iter().flatten().find(|v| !(0.0..=1.0).contains(*v)) {
            Some(v) => Err(self.refuse(field, format!("holds {v}; 0 to 1 work"))),
            None => Ok(texture),
        }
    }

    /// Blends of unit normals are shorter: they get their length back.
    fn normal(&mut self, source: Source<3>) -> Result<Texture<3>> {
        let (side, mut normals) = self.square("normal", source);
        normals.iter_mut().for_each(|n| *n = normals::upward_unit(*n));
        Texture::new(side, normals).ok_or_else(|| self.refuse("normal", "has no texels"))
    }

    fn texture<const N: usize>(&mut self, field: &str, source: Source<N>) -> Result<Texture<N>> {
        let (side, texels) = self.square(field, source);
        Texture::new(side, texels).ok_or_else(|| self.refuse(field, "has no texels"))
    }

    fn square<const N: usize>(&mut self, field: &str, source: Source<N>) -> (usize, Vec<[f32; N]>) {
        let (map, grid) = match source {
            Source::Constant(value) => return (1, vec![value]),
            Source::Map(map, grid) => (map, grid),
        };
        let (width, height) = (grid.width, grid.height);
        if width == height && width.is_power_of_two() {
            return (width, grid.texels);
        }
        let side = nearest_side(width, height);
        let reason = if width == height { "not a power of two" } else { "not square" };
        let map = map.display();
        self.notes
            .push(format!("{field}: {map} is {width} x {height}, {reason}; resampled to {side} x {side}"));
        (side, resample(&grid.texels, width, height, side))
    }

    fn refuse(&self, field: &str, problem: impl std::fmt::Display) -> Error {
        Error::file(self.path, format!("{field} {problem}"))
    }
}
