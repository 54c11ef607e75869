//! `neumip look`: what a material looks like, before anything is learned.

use super::console::{Console, short};
use super::surface::{Surface, materials};
use crate::dataset::Scene;
use crate::error::{Error, Result};
use crate::query::{QueryBuffer, RgbImage};
use crate::reference::{Reference, Sampling};
use crate::report::picture::{self, Picture};
use clap::Args;
use neumip_export::whole_file::write_whole;
use std::path::PathBuf;
use std::time::Instant;

/// Queries between two looks at the clock.
const CHUNK: usize = 1 << 13;
/// The pictures of a row: light (tilt, pan in degrees) and tiles a side of the viewed plane.
const VIEWS: [([f64; 2], usize); 4] =
    [([0.0, 0.0], 1), ([45.0, 30.0], 1), ([60.0, 90.0], 1), ([45.0, 30.0], 3)];

/// Render a contact sheet of materials: a perspective plane under three lights, and three tiles a side.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip look all --out materials.png\n  \
    neumip look my-material/material.json --out mine.png --size 512 --spp 256")]
pub struct Look {
    /// Built-in materials, material.json files or their folders; `all` for every built-in one. A row each.
    #[arg(required = true)]
    materials: Vec<String>,
    /// The PNG file.
    #[arg(long)]
    out: PathBuf,
    /// Pixels along a side of each picture.
    #[arg(long, default_value_t = 256)]
    size: usize,
    /// Rays a pixel.
    #[arg(long, default_value_t = 64)]
    spp: usize,
    /// Exposure in stops.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true)]
    stops: f32,
    /// Seed of the rays.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    surface: Surface,
    /// Replace an existing picture.
    #[arg(long)]
    force: bool,
}

impl Look {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        if self.out.exists() && !self.force {
            return Err(Error::file(&self.out, "exists: name another file or add --force"));
        }
        if !(16..=4096).contains(&self.size) {
            return Err(Error::usage(format!("--size {}: 16 to 4096 work", self.size)));
        }
        if !(-16.0..=16.0).contains(&self.stops) {
            return Err(Error::usage(format!("--stops {}: -16 to 16 work", self.stops)));
        }
        let names: Vec<String> = self.materials.iter().flat_map(|name| materials(name)).collect();
        // Each is opened before any is rendered, so that a bad name costs nothing.
        let side = self.size.next_power_of_two();
        let references =
            names.iter().map(|name| self.surface.open(name, side)).collect::<Result<Vec<_>>>()?;
        let rows = references.iter().map(|r| self.row(r, console)).collect::<Result<Vec<_>>>()?;
        write_whole(&self.out, &picture::png(&picture::sheet(&rows)?)?)?;
        console.say(format!(
            "{}: {} materials, {} pictures each",
            self.out.display(),
            rows.len(),
            VIEWS.len()
        ));
        Ok(())
    }

    fn row(&self, reference: &Reference, console: &Console) -> Result<Vec<Picture>> {
        for note in reference.notes() {
            console.say(format!("note: {}: {note}", reference.name()));
        }
        let begun = Instant::now();
        let total = (VIEWS.len() * self.size * self.size) as u64;
        let mut meter = console.meter(format!("look at {}", reference.name()), total, "pixels");
        let (mut done, mut rays, mut row) = (0, 0, Vec::new());
        for (light, tiles) in VIEWS {
            let scene = Scene::new(light[0], light[1]);
            let queries = scene.queries(self.size, tiles, reference.resolution());
            let mut pixels = Vec::with_capacity(queries.len());
            while pixels.len() < queries.len() {
                console.check("nothing was written")?;
                let start = pixels.len();
                let part: QueryBuffer = queries.range(start, (start + CHUNK).min(queries.len()));
                let sampling = Sampling { spp: self.spp, seed: self.seed, first: done };
                let measured = reference.measure(&part, &sampling)?;
                pixels.extend(measured.rgb.pixels);
                (done, rays) = (done + part.len() as u64, rays + measured.rays);
                let rate = rays as f64 / begun.elapsed().as_secs_f64().max(1e-9);
                meter.update(done, &format!("{}/s", short(rate, "rays")));
            }
            let image = RgbImage { height: self.size, width: self.size, pixels };
            row.push(picture::srgb(&image, self.stops)?);
        }
        meter.finish(done);
        let seconds = begun.elapsed().as_secs_f64();
        let rate = short(rays as f64 / seconds.max(1e-9), "rays");
        console.say(format!("{}: {seconds:.1} s, {rate}/s", reference.name()));
        Ok(row)
    }
}
