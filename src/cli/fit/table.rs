//! `neumip fit-table`: what fitting saves, on two scenes of each kind and three materials.

use super::Told;
use super::open;
use crate::cli::console::Console;
use crate::cli::generate;
use crate::cli::reproduce::machine;
use crate::cli::surface::Surface;
use crate::dataset::{Dataset, Existing, GenerateConfig};
use crate::error::{Error, Result};
use crate::fit::folder::Folder;
use crate::fit::goal::{Goal, Metric, Prefer, Target};
use crate::fit::job::{Effort, Job};
use crate::fit::outcome::Outcome;
use crate::fit::table::{Cell, SCENES, Table, kind_of};
use crate::fit::{page, prior::Prior, shape::Shape};
use crate::reference::builtin;
use crate::render::format::DEFAULT_MATERIAL;
use clap::Args;
use neumip_export::whole_file::{write_json, write_whole};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Materials of the table: glossy metal, matte stones, woven fibres.
const MATERIALS: &str = "metal-rings,rocks,basket-cloth";

/// Side of a material's field, and its seed.
const MADE: (usize, u64) = (512, 0);

/// Fit materials to two scenes of each kind (far, middle, near, fixed camera) and put what it saves in a table.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  neumip fit-table --out fit-table\n  \
    neumip fit-table --quick --out fit-quick\n  \
    neumip fit-table --out rocks --materials rocks --scenes near-corner,near-slope")]
pub struct FitTable {
    /// The table's folder; what is finished is kept, and the same command goes on.
    #[arg(long)]
    out: PathBuf,
    /// Built-in materials, with commas.
    #[arg(long, default_value = MATERIALS, value_delimiter = ',')]
    materials: Vec<String>,
    /// Built-in scenes of the table, with commas; by default all eight.
    #[arg(long, value_delimiter = ',')]
    scenes: Vec<String>,
    /// One material at 64 x 64 on two scenes: a minute or two.
    #[arg(long)]
    quick: bool,
    /// Seed of everything.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Sizes of a table.
struct Scale {
    resolution: usize,
    /// Unique samples and samples presented a texel of the full model's training.
    unique: u64,
    presented: u64,
    /// Training samples of a fit.
    fit: usize,
    picture_spp: usize,
    materials: Vec<String>,
    scenes: Vec<String>,
}

impl FitTable {
    /// Runs the command.
    pub fn run(self, console: &Console) -> Result<()> {
        let scale = self.scale()?;
        let mut table = Table {
            settings: settings(&scale, self.quick, self.seed),
            machine: format!("Machine: {}.", machine::machine()),
            cells: Vec::new(),
        };
        for material in &scale.materials {
            for scene in &scale.scenes {
                let path = self.cell(material, scene);
                let cell = match std::fs::read(&path).ok().and_then(|b| serde_json::from_slice(&b).ok()) {
                    Some(cell) => cell,
                    None => self.fit(&scale, material, scene, console)?,
                };
                table.cells.push(cell);
            }
        }
        table.cells.sort_by_key(|cell| SCENES.iter().position(|scene| *scene == cell.scene));
        write_json(&self.out.join("table.json"), &table)?;
        write_whole(&self.out.join("FIT.md"), table.markdown().as_bytes())?;
        let count = |what: &str| table.cells.iter().filter(|cell| cell.reached() == what).count();
        console.say(format!(
            "{}: {} fits, {} reach the goal, {} the floor, {} neither; see FIT.md",
            self.out.display(),
            table.cells.len(),
            count("goal"),
            count("floor"),
            count("below")
        ));
        Ok(())
    }

    fn scale(&self) -> Result<Scale> {
        let scenes =
            if self.scenes.is_empty() { SCENES.map(String::from).to_vec() } else { self.scenes.clone() };
        if let Some(name) = scenes.iter().find(|name| !SCENES.contains(&name.as_str())) {
            let problem = format!("--scenes {name}: is none of the table's; those are {}", SCENES.join(", "));
            return Err(Error::usage(problem));
        }
        if let Some(name) = self.materials.iter().find(|name| !builtin::NAMES.contains(&name.as_str())) {
            let names = builtin::NAMES.join(", ");
            return Err(Error::usage(format!("--materials {name}: is not built in; built in are {names}")));
        }
        let full = Scale {
            resolution: 128,
            unique: 200,
            presented: 4800,
            fit: Effort::default().unique,
            picture_spp: 64,
            materials: self.materials.clone(),
            scenes,
        };
        if !self.quick {
            return Ok(full);
        }
        Ok(Scale {
            resolution: 64,
            unique: 60,
            presented: 300,
            fit: 1 << 17,
            picture_spp: 8,
            materials: vec!["rocks".into()],
            scenes: ["far-floor", "near-corner"].map(String::from).to_vec(),
        })
    }

    fn cell(&self, material: &str, scene: &str) -> PathBuf {
        self.out.join("cells").join(format!("{material}.{scene}.json"))
    }

    fn fit(&self, scale: &Scale, material: &str, scene: &str, console: &Console) -> Result<Cell> {
        for part in ["cells", "pictures", "data", "full", "fits"] {
            let folder = self.out.join(part);
            std::fs::create_dir_all(&folder)
                .map_err(|e| Error::file(&folder, format!("cannot be made: {e}")))?;
        }
        let data = self.data(scale, material, console)?;
        let texels = (scale.resolution * scale.resolution) as u64;
        let own = self.out.join("full").join(material);
        let full = open::full(None, &data, &own, (scale.presented * texels, self.seed), console)?;
        let models = BTreeMap::from([(DEFAULT_MATERIAL.to_string(), full.path.clone())]);
        let mut opened = open::scene(scene, &models, self.seed)?;
        let truth = open::truth(None, MADE, &data, &full, console)?;
        let goal = goal(scene, &full)?;
        let name = format!("{material}.{scene}");
        let settings = (env!("CARGO_PKG_VERSION"), data.identity()?, scene, goal, self.seed, scale.fit);
        let folder = Folder::open(&self.out.join("fits").join(&name), &settings, false)?;
        let job = Job {
            name: scene,
            material: 0,
            full: &full.checkpoint,
            config: &full.config,
            trained: full.trained,
            truth: &truth,
            data: Some(&data),
            goal,
            effort: Effort {
                unique: scale.fit,
                picture_spp: scale.picture_spp,
                training: scale.presented * texels,
                seed: self.seed,
                ..Effort::default()
            },
            folder: folder.root(),
        };
        let told = Told::new(console);
        let fitted = job.run(&mut opened, &|label, done| told.tell(&format!("{name}: {label}"), done));
        told.finish();
        let fitted = fitted?;
        folder.write(&fitted, &full.checkpoint, opened.file.stops)?;
        let sheet = folder.root().join("pictures").join("all.png");
        let picture = self.out.join("pictures").join(format!("{name}.png"));
        std::fs::copy(&sheet, &picture)
            .map_err(|e| Error::file(&picture, format!("cannot be written: {e}")))?;
        for path in Job::workings(folder.root()) {
            let _ = std::fs::remove_dir_all(path);
        }
        console.say(format!("{name}: {}", page::verdict(&fitted.outcome)));
        self.save(&fitted.outcome, material, scene)
    }

    fn save(&self, outcome: &Outcome, material: &str, scene: &str) -> Result<Cell> {
        let cell = Cell::new(outcome).ok_or_else(|| Error::config(scene, "has pictures without FLIP"))?;
        write_json(&self.cell(material, scene), &cell)?;
        Ok(cell)
    }

    fn data(&self, scale: &Scale, material: &str, console: &Console) -> Result<Dataset> {
        let path = self.out.join("data").join(material);
        if let Some(data) = Dataset::open(&path).ok().filter(|data| data.manifest().complete) {
            return Ok(data);
        }
        let texels = (scale.resolution * scale.resolution) as u64;
        let mut config = GenerateConfig::new(scale.resolution);
        config.samples = scale.unique * texels;
        config.test_pairs = 8;
        config.view_size = 0;
        config.heights = false;
        config.grazing_samples = 0;
        config.seed = self.seed;
        let (field_side, material_seed) = MADE;
        let surface = Surface { bounces: 1, field_side, material_seed, make_tileable: false };
        let reference = generate::reference(material, &surface, &config)?;
        let existing = if path.exists() { Existing::Resume } else { Existing::Refuse };
        generate::dataset(&reference, &config, &path, existing, console)
    }
}

/// The fastest model that is as good as the full one in the bytes of the kind's goal; from near, where time is not asked for, the
/// best one in those bytes and no more time.
fn goal(scene: &str, full: &open::Full) -> Result<Goal> {
    let kind = kind_of(scene).ok_or_else(|| Error::config(scene, "is no scene of the table"))?;
    let architecture = &full.checkpoint.header.architecture;
    let bytes = (kind.bytes[1] > 1.0).then(|| (architecture.bytes() as f64 / kind.bytes[1]) as usize);
    if kind.ns[1] > 1.0 {
        let target = Some(Target { metric: Metric::Flip, most: None });
        return Ok(Goal { target, ns: None, bytes, prefer: Prefer::Time });
    }
    let shape = Shape::of(&architecture.model)
        .ok_or_else(|| Error::config("model.decoder", "is no fully connected decoder"))?;
    Ok(Goal { ns: Some(Prior::new()?.ns_of(&shape)), bytes, ..Goal::FREE })
}

fn settings(scale: &Scale, quick: bool, seed: u64) -> String {
    format!(
        "`neumip fit-table{}`: tiles of {2} x {2} texels; full models (`improved`) of {3} unique samples a texel, {4} presented; fits \
         of {5} unique samples, a tenth of them anywhere; pictures of 4 samples a pixel, {6} rays a query of the truth, other samples \
         and frames than those that choices were made on; seed {1}.",
        if quick { " --quick" } else { "" },
        seed,
        scale.resolution,
        scale.unique,
        scale.presented,
        scale.fit,
        scale.picture_spp,
    )
}
