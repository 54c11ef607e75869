//! What a scene asks of its materials: a sample of all queries of its path, with what each weighs in a picture.

use super::scene::Scene;
use crate::error::Result;
use crate::query::QueryBuffer;
use crate::random::{Random, Stream};
use std::ops::ControlFlow;

/// What is asked of one material.
#[derive(Clone, Debug)]
pub struct Demand {
    /// The material's name in the scene.
    pub material: String,
    /// Texels \[H, W\] of its tile.
    pub resolution: [usize; 2],
    /// Queries drawn from all that were asked, each with the same probability; one row.
    pub queries: QueryBuffer,
    /// What an answer of 1 adds to its pixel, averaged over RGB: light that comes by other objects counts as if they
    /// reflected all of it.
    pub weight: Vec<f32>,
    /// The frame of each query, from 0 to 1 over the path.
    pub time: Vec<f32>,
    /// Queries that were asked, of which these are a part.
    pub asked: u64,
    /// Camera rays that were traced.
    pub rays: u64,
    /// Pixels to which the material gives light, as a share of all.
    pub pixels: f64,
}

/// How a demand is sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Frames at equal distances over the path; a scene without a path has one.
    pub frames: usize,
    /// Samples a pixel; 0 leaves the scene's.
    pub samples: usize,
    /// Most queries that are kept for a material.
    pub most: usize,
    /// Seed of the choice.
    pub seed: u64,
}

/// One kept query.
struct Kept {
    key: f64,
    frame: usize,
    u: [f32; 2],
    wi: [f32; 2],
    wo: [f32; 2],
    level: f32,
    weight: f32,
}

impl Scene {
    /// What the scene asks of each of its materials, in their order. The same for any number of threads.
    ///
    /// # Errors
    /// Whatever keeps a material from drawing directions; `Interrupted` if `progress`, which is told the share that is done,
    /// breaks.
    pub fn demand(
        &self,
        sample: &Sample,
        progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
    ) -> Result<Vec<Demand>> {
        let frames = if self.frames() == 1 { 1 } else { sample.frames.max(1) };
        let count = self.materials.len();
        let mut kept: Vec<Vec<Kept>> = (0..count).map(|_| Vec::new()).collect();
        // Of all queries those with the lowest random keys are kept; above this, nothing is.
        let mut highest = vec![1.0f64; count];
        let (mut asked_of, mut pixels_of) = (vec![0u64; count], vec![0u64; count]);
        let (mut rays, mut pixels) = (0u64, 0u64);
        for index in 0..frames {
            let frame = self.frame_at(index, frames)?.with_samples(sample.samples);
            let size = frame.camera.width() * frame.camera.height();
            let batches = self.batches(&frame);
            let batch_count = batches.len();
            for (number, batch) in batches.into_iter().enumerate() {
                rays += (batch.len() * frame.samples) as u64;
                let asked = self.ask(&frame, batch)?;
                for (k, part) in asked.parts.iter().enumerate() {
                    // Terms of one pixel may lie apart: light that came by other objects is found later.
                    let mut seen = vec![vec![false; part.pixels.len()]; count];
                    for term in &part.terms {
                        let weight = term.weight.iter().sum::<f32>() / 3.0;
                        for slot in std::iter::once(term.first).chain(term.second) {
                            let m = slot.material as usize;
                            let seen = &mut seen[m][term.pixel as usize];
                            pixels_of[m] += u64::from(!std::mem::replace(seen, true));
                            let ordinal = asked_of[m];
                            asked_of[m] += 1;
                            let key = Random::new(sample.seed, Stream::Probe, ordinal).uniform_f64();
                            if key >= highest[m] {
                                continue;
                            }
                            let at = asked.starts[k][m] + slot.index as usize;
                            let queries = &asked.queries[m];
                            kept[m].push(Kept {
                                key,
                                frame: index,
                                u: queries.u[at],
                                wi: queries.wi[at],
                                wo: queries.wo[at],
                                level: queries.level[at],
                                weight,
                            });
                            if kept[m].len() >= 2 * sample.most.max(1) {
                                highest[m] = thin(&mut kept[m], sample.most);
                            }
                        }
                    }
                }
                let done = index as f64 + (number + 1) as f64 / batch_count as f64;
                if progress(done / frames as f64).is_break() {
                    return Err(crate::error::Error::Interrupted(
                        "the scene was not asked to its end".into(),
                    ));
                }
            }
            pixels += size as u64;
        }
        let all = self.materials.iter().zip(kept).enumerate();
        let demand = all.map(|(m, (material, mut kept))| {
            thin(&mut kept, sample.most);
            // In the order of their keys they are in no order: any beginning is a sample too.
            let last = frames.saturating_sub(1).max(1) as f32;
            let queries = QueryBuffer::new(
                1,
                kept.len(),
                kept.iter().map(|q| q.u).collect(),
                kept.iter().map(|q| q.wi).collect(),
                kept.iter().map(|q| q.wo).collect(),
                kept.iter().map(|q| q.level).collect(),
            )?;
            Ok(Demand {
                material: material.name.clone(),
                resolution: material.resolution,
                queries,
                weight: kept.iter().map(|q| q.weight).collect(),
                time: kept.iter().map(|q| q.frame as f32 / last).collect(),
                asked: asked_of[m],
                rays,
                pixels: pixels_of[m] as f64 / pixels.max(1) as f64,
            })
        });
        demand.collect()
    }
}

/// Keeps the `most` with the lowest keys, in their order, and gives the least key that is not among them.
fn thin(kept: &mut Vec<Kept>, most: usize) -> f64 {
    kept.sort_by(|a, b| a.key.total_cmp(&b.key));
    let highest = kept.get(most).map_or(1.0, |first| first.key);
    kept.truncate(most);
    highest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::format::SceneFile;
    use crate::render::{Model, OpenOptions};
    use std::path::Path;

    fn demand(most: usize) -> Vec<Demand> {
        let text = r#"{"version": 1,
            "materials": {"floor": {"lambert": 0.5}, "ball": {"lambert": 0.2}},
            "objects": [{"shape": "plane", "material": "floor", "scale": 4},
                {"shape": "sphere", "material": "ball", "translate": [0, 0, 1], "scale": 0.5}],
            "lights": [{"directional": {"name": "lamp", "direction": [0, 0, 1], "irradiance": 2}}],
            "camera": {"width": 32, "samples": 4},
            "path": {"frames": 2, "keys": [{"lights": {"lamp": [0, 0, 1]}}, {"lights": {"lamp": [1, 0, 1]}}]}}"#;
        let file = SceneFile::from_json(text, Path::new("two.json")).unwrap();
        let engine = |_: &_, _: &Path| -> Result<Model> { unreachable!("no model is opened") };
        let options = OpenOptions { default_material: None, seed: 1, engine: &engine };
        let scene = Scene::open(file, Path::new("two.json"), &options).unwrap();
        let sample = Sample { frames: 5, samples: 1, most, seed: 3 };
        scene.demand(&sample, &mut |_| ControlFlow::Continue(())).unwrap()
    }

    #[test]
    fn every_material_is_asked_for_its_part_and_weighs_what_its_light_does() {
        let all = demand(100_000);
        assert_eq!(all.iter().map(|d| d.material.as_str()).collect::<Vec<_>>(), ["ball", "floor"]);
        for demand in &all {
            assert_eq!(demand.asked, demand.queries.len() as u64);
            assert_eq!(demand.rays, 5 * 32 * 32);
            assert!(demand.weight.iter().all(|w| (w - 2.0).abs() < 1e-6));
            let mut times: Vec<f32> = demand.time.clone();
            times.sort_by(f32::total_cmp);
            times.dedup();
            assert_eq!(times, [0.0, 0.25, 0.5, 0.75, 1.0]);
        }
        assert!(all[0].pixels > 0.02 && all[0].pixels < 0.5 * all[1].pixels);
    }

    #[test]
    fn a_sample_is_the_beginning_of_a_larger_one() {
        let (few, many) = (demand(50), demand(500));
        for (few, many) in few.iter().zip(&many) {
            assert_eq!((few.queries.len(), few.asked), (50, many.asked));
            assert_eq!(few.queries.u, many.queries.u[..50]);
            assert_eq!(few.time, many.time[..50]);
        }
    }
}
