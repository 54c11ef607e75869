//! The reference surface as a source of data.

use super::source::Source;
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
        let map = self.height_map();
        Some((map.height, map.width, map.values))
    }

    fn measure(
        &self,
        queries: &QueryBuffer,
        spp: usize,
        seed: u64,
        first: u64,
    ) -> Result<(Vec<[f32; 3]>, Vec<f32>)> {
        let measured = self.measure(queries, &Sampling { spp, seed, first })?;
        Ok((measured.rgb.pixels, measured.variance))
    }

    fn description(&self) -> serde_json::Value {
        json!({ "kind": "displaced-heightfield", "name": self.name(), "height_range": self.height_range() })
    }
}
