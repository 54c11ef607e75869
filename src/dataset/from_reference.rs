//! The reference surface as a source of data.

use super::source::{Answers, Source};
use crate::error::Result;
use crate::query::QueryBuffer;
use crate::reference::{Reference, Sampling};
use serde_json::json;

impl Source for Reference {
    fn name(&self) -> &str {
        self.name()
    }

    fn height_range(&self) -> [f32; 2] {
        self.height_range()
    }

    fn height_map(&self) -> Option<(usize, usize, Vec<f32>)> {
        let map = self.height_map()?;
        Some((map.height, map.width, map.values))
    }

    fn measure(&self, queries: &QueryBuffer, spp: usize, seed: u64, first: u64) -> Result<Answers> {
        let measured = self.measure(queries, &Sampling { spp, seed, first })?;
        Ok(Answers { rgb: measured.rgb.pixels, variance: measured.variance, rays: measured.rays })
    }

    fn description(&self) -> serde_json::Value {
        json!({
            "kind": "reference",
            "name": self.name(),
            "height_range": self.height_range(),
            "bounces": self.bounces(),
            "fingerprint": self.fingerprint(),
        })
    }
}
