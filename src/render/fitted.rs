//! Directions by the importance sampler that was fitted to a material.

use super::directions::{Cosine, Directions, Lobes, View};
use crate::error::Result;
use crate::sampler::{self, MaterialSampler};
use neumip_export::bundle::SAMPLER;
use neumip_export::checkpoint::Checkpoint;
use neumip_export::sampler::Sampler;
use sha2::{Digest, Sha256};
use std::path::Path;

/// Directions by a mixture for each view.
pub struct Fitted(MaterialSampler);

/// The directions of a checkpoint that comes from `path`, and what tells them from others: the sampler beside it, where it has
/// one, else [`Cosine`].
///
/// # Errors
/// `File`, naming a sampler that is damaged; `Config` if it is not this material's.
pub fn directions_of(checkpoint: &Checkpoint, path: &Path) -> Result<(Box<dyn Directions>, String)> {
    let file = path.join(SAMPLER);
    if !file.is_file() {
        return Ok((Box::new(Cosine), "cosine".into()));
    }
    let sampler = Sampler::read(&file)?;
    let identity = super::material::hex(&Sha256::digest(sampler.to_bytes()?));
    Ok((Box::new(Fitted(MaterialSampler::from_checkpoint(checkpoint, &sampler)?)), identity))
}

impl Directions for Fitted {
    fn lobes<'a>(&'a self, views: &[View]) -> Result<Box<dyn Lobes + 'a>> {
        let u: Vec<[f32; 2]> = views.iter().map(|view| view.u).collect();
        let level: Vec<f32> = views.iter().map(|view| view.level).collect();
        let wo: Vec<[f32; 2]> = views.iter().map(|view| view.wo).collect();
        Ok(Box::new(Mixtures(self.0.lobes(&u, &level, &wo)?)))
    }
}

/// The mixtures of some views.
struct Mixtures(Vec<sampler::Lobes>);

impl Lobes for Mixtures {
    fn sample(&self, k: usize, xi: [f32; 2]) -> Option<([f32; 3], f32)> {
        let (wi, pdf) = self.0.get(k)?.sample(xi);
        (wi[2] > 0.0 && pdf > 0.0).then_some((wi, pdf))
    }

    fn pdf(&self, k: usize, wi: [f32; 3]) -> f32 {
        self.0.get(k).map_or(0.0, |lobes| lobes.pdf(wi))
    }
}
