//! What a scene asks of its materials: which levels, where on the tile, from which light, under which view.
//!
//! ```text
//! demand (render) ─ a sample of the queries, with what each weighs
//!   │
//! histogram ─ counts and weights by bin, quantiles
//!   │
//! levels, position, direction ─ the parts of a query      meaning ─ what they come to, a line each
//!   │
//! plate ─ a picture a material      page ─ all of them      folder ─ analysis.json, index.html, pictures
//! ```
//!
//! Each figure is there twice: by number of queries, which is what answering them costs, and by weight, which is what an
//! error in their answers costs the picture.

mod direction;
mod folder;
mod histogram;
mod levels;
mod meaning;
mod page;
mod plate;
mod position;

pub use direction::{Cone, Directions};
pub use folder::{free, write};
pub use histogram::{Histogram, QUANTILES, Quantiles};
pub use levels::Levels;
pub use position::{Position, Window, arc};

use crate::error::{Error, Result};
use crate::render::{Demand, Material, Sample, Scene};
use serde::Serialize;
use std::path::Path;

/// Tells an analysis from other JSON.
pub const KIND: &str = "what a scene asks";

/// What a scene asks of all its materials.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Analysis {
    /// [`KIND`].
    pub kind: &'static str,
    /// The scene as it was named.
    pub scene: String,
    /// Columns of a frame.
    pub width: usize,
    /// Rows of a frame.
    pub height: usize,
    /// Samples a pixel.
    pub samples: usize,
    /// Frames over the path.
    pub frames: usize,
    /// Seed of the samples and of the choice among the queries.
    pub seed: u64,
    /// Most queries that are kept for a material.
    pub most: usize,
    /// The shares at which quantiles are given.
    pub quantiles: [f64; QUANTILES.len()],
    /// The materials in the scene's order.
    pub materials: Vec<Asked>,
}

/// What a scene asks of one material.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Asked {
    /// Its name in the scene.
    pub material: String,
    /// What answers for it.
    pub described: String,
    /// Its picture in the folder.
    pub picture: String,
    /// Texels \[H, W\] of its tile.
    pub resolution: [usize; 2],
    /// The coarsest level that it is asked at.
    pub coarsest: f32,
    /// Queries that were asked.
    pub asked: u64,
    /// Those of them that the figures are of.
    pub kept: usize,
    /// Camera rays that were traced.
    pub rays: u64,
    /// Pixels to which it gives light, as a share of all.
    pub pixels: f64,
    /// The least share of the queries that has half of the weight; None without any weight.
    pub half_of_weight: Option<f64>,
    /// Levels.
    pub levels: Levels,
    /// Places on the tile.
    pub position: Position,
    /// Directions of the light.
    pub wi: Directions,
    /// Directions of the view.
    pub wo: Directions,
    /// What that comes to, a line each.
    pub meaning: Vec<String>,
}

impl Analysis {
    /// The analysis of a scene, `name`d so, of what was demanded of it by `sample`; `path` is its file, by which errors go.
    ///
    /// # Errors
    /// `File`, naming a material of which nothing is asked.
    pub fn new(name: &str, path: &Path, scene: &Scene, sample: &Sample, demands: &[Demand]) -> Result<Self> {
        let camera = &scene.file.camera;
        let mut materials: Vec<Asked> = Vec::new();
        for (demand, material) in demands.iter().zip(&scene.materials) {
            if demand.queries.is_empty() {
                let problem = format!(
                    "materials.{}: no ray meets it in a place that has light, so nothing is asked of it",
                    demand.material
                );
                return Err(Error::file(path, problem));
            }
            let taken: Vec<&str> = materials.iter().map(|asked| asked.picture.as_str()).collect();
            let picture = folder::picture(&demand.material, &taken);
            materials.push(Asked::new(demand, material, picture));
        }
        Ok(Self {
            kind: KIND,
            scene: name.into(),
            width: camera.width,
            height: camera.height.unwrap_or(camera.width),
            samples: if sample.samples > 0 { sample.samples } else { camera.samples },
            frames: if scene.frames() == 1 { 1 } else { sample.frames.max(1) },
            seed: sample.seed,
            most: sample.most,
            quantiles: QUANTILES,
            materials,
        })
    }

    /// A short table a material, and what it means.
    pub fn table(&self) -> String {
        self.materials.iter().map(page::text).collect::<Vec<_>>().join("\n\n")
    }
}

impl Asked {
    fn new(demand: &Demand, material: &Material, picture: String) -> Self {
        let weight: Vec<f64> = demand.weight.iter().map(|w| f64::from(*w).max(0.0)).collect();
        let queries = &demand.queries;
        let mut asked = Self {
            material: demand.material.clone(),
            described: material.described.clone(),
            picture,
            resolution: demand.resolution,
            coarsest: material.coarsest,
            asked: demand.asked,
            kept: queries.len(),
            rays: demand.rays,
            pixels: demand.pixels,
            half_of_weight: histogram::half(&weight),
            levels: Levels::new(&queries.level, &weight, demand.resolution, material.coarsest),
            position: Position::new(&queries.u, &weight, demand.resolution),
            wi: Directions::new(&queries.wi, &weight),
            wo: Directions::new(&queries.wo, &weight),
            meaning: Vec::new(),
        };
        asked.meaning = meaning::lines(&asked);
        asked
    }
}
