//! Nanoseconds a query of models of many sizes, which `neumip fit` expects costs from: the rows of src/fit/chart.json, and the
//! smaller ones of src/fit/times.json, timed together.
//!
//! ```sh
//! cargo run --release --example sizes > times.json
//! ```

use candle_core::Device;
use neumip::config::Config;
use neumip::engine::FusedMaterial;
use neumip::evaluate::{costs_on, random_queries};
use neumip::export::Precision;
use neumip::fit::prior::{Timed, sizes};
use neumip::kernels::simd::Isa;
use neumip::model::Variables;
use neumip::query::Reflectance;
use std::error::Error;

/// Texels along a side of the tile.
const SIDE: usize = 128;
/// Queries of a round, and rounds.
const QUERIES: usize = 1 << 17;
const ROUNDS: usize = 9;

fn main() -> Result<(), Box<dyn Error>> {
    let full = Config::preset("improved")?.model;
    let mut timed = Vec::new();
    for levels in [2, 1] {
        // Between levels both are read, on a level one.
        let mut queries = random_queries(QUERIES, 2, 1);
        queries.level.fill(if levels == 2 { 2.5 } else { 2.0 });
        let shapes: Vec<_> = sizes()?.into_iter().filter(|size| size.levels == levels).collect();
        let mut materials = Vec::new();
        for size in &shapes {
            let architecture = size.shape.of_tile(&full, [SIDE; 2])?;
            let tensors = Variables::initial(&architecture, 1, &Device::Cpu)?.to_stored()?;
            for precision in [Precision::Single, Precision::Half] {
                materials.push(FusedMaterial::new(&architecture, &tensors, precision, Isa::chosen()?)?);
            }
        }
        let answerers: Vec<&dyn Reflectance> = materials.iter().map(|m| m as &dyn Reflectance).collect();
        let costs = costs_on(&answerers, &queries, ROUNDS)?;
        for (size, pair) in shapes.into_iter().zip(costs.chunks(2)) {
            let round = |ns: f64| (ns * 10.0).round() / 10.0;
            timed.push(Timed {
                ns: round(pair[0].ns_per_query),
                ns_half: round(pair[1].ns_per_query),
                ..size
            });
        }
    }
    let rows: Vec<String> = timed.iter().map(serde_json::to_string).collect::<Result<_, _>>()?;
    println!("[\n{}\n]", rows.join(",\n"));
    Ok(())
}
