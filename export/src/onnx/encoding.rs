//! gamma(u), gamma(wi), gamma(wo) in double-angle form, all three side by side.
//!
//! A *lane* is one component of one input at the frequency of a restart, 2^(4 g). All lanes are range-reduced
//! at once, one Sin and one Cos start them, and three doublings s' = 2 s c, c' = 1 - 2 s^2 give the bands
//! between restarts. The result is therefore ordered by doubling and lane, not as [`crate::config`] orders
//! the decoder's inputs; the first layer's columns are stored in the graph's order instead
//! ([`Encoded::columns`]), with zeros where a lane ends before the last doubling. The amplitude of directions
//! is in those columns too.

use super::builder::{Builder, Value};
use super::query::Direction;
use crate::config::Architecture;

/// Bands from one exact restart to the next.
const RESTART: usize = 4;

/// One column of what the decoder reads: the decoder input that it is, and the factor to apply.
pub type Column = Option<(usize, f32)>;

/// The encoding, \[N, columns.len()\] once joined.
pub struct Encoded {
    /// Parts to join.
    pub parts: Vec<Value>,
    /// What each column is, counted from the first input after the features.
    pub columns: Vec<Column>,
    /// True if the footprint attenuates bands, so that the level was used.
    pub uses_level: bool,
}

/// One of u, wi, wo.
struct Source {
    value: Value,
    components: usize,
    bands: usize,
    raw: bool,
    amplitude: f32,
    /// First decoder input that belongs to it, features not counted.
    offset: usize,
    is_u: bool,
}

struct Lane {
    source: usize,
    component: usize,
    group: usize,
}

/// What there is to encode; a graph that answers a part of a query has a part of it.
#[derive(Clone, Copy, Default)]
pub struct Inputs<'a> {
    /// The wrapped u \[N, 2\] and the level \[N, 1\].
    pub u: Option<(&'a Value, &'a Value)>,
    /// The light direction.
    pub wi: Option<&'a Direction>,
    /// The view direction.
    pub wo: Option<&'a Direction>,
}

/// Encodes what there is.
pub fn encode(b: &mut Builder, architecture: &Architecture, inputs: &Inputs) -> Encoded {
    b.scope("encoding");
    let sources = sources(b, architecture, inputs);
    let mut out = Encoded { parts: Vec::new(), columns: Vec::new(), uses_level: false };
    let lanes = lanes(&sources);
    if !lanes.is_empty() {
        let doublings = sources.iter().map(|s| s.bands.min(RESTART)).max().unwrap_or(1);
        let (mut sines, mut cosines) = waves(b, architecture, &sources, &lanes, doublings);
        if let Some((_, level)) = inputs.u
            && architecture.model.encoding.u.attenuate
            && architecture.u_bands() > 0
        {
            let factor = attenuation(b, architecture, &sources, &lanes, doublings, level);
            sines = b.mul("sines.attenuated", &sines, &factor);
            cosines = b.mul("cosines.attenuated", &cosines, &factor);
            out.uses_level = true;
        }
        out.parts.extend([sines, cosines]);
        for cosine in [0, 1] {
            for doubling in 0..doublings {
                out.columns.extend(lanes.iter().map(|lane| {
                    let source = &sources[lane.source];
                    let band = RESTART * lane.group + doubling;
                    let input = source.offset + source.components * (2 * band + cosine) + lane.component;
                    (band < source.bands).then_some((input, source.amplitude))
                }));
            }
        }
    }
    for source in sources.iter().filter(|s| s.raw) {
        out.parts.push(source.value.clone());
        let first = source.offset + 2 * source.components * source.bands;
        out.columns.extend((0..source.components).map(|c| Some((first + c, 1.0))));
    }
    out
}

/// The inputs that the decoder sees, in its order.
fn sources(b: &mut Builder, architecture: &Architecture, inputs: &Inputs) -> Vec<Source> {
    let encoding = &architecture.model.encoding;
    let mut sources = Vec::with_capacity(3);
    if let Some((u, _)) = inputs.u.filter(|_| architecture.u_inputs() > 0) {
        let doubled = b.scale("p.doubled", u, 2.0);
        let one = b.scalar(1.0);
        sources.push(Source {
            value: b.sub("p", &doubled, &one),
            components: 2,
            bands: architecture.u_bands(),
            raw: encoding.u.raw,
            amplitude: 1.0,
            offset: 0,
            is_u: true,
        });
    }
    let mut offset = architecture.u_inputs();
    for (name, w, config) in [("wi", inputs.wi, &encoding.wi), ("wo", inputs.wo, &encoding.wo)] {
        if let Some(w) = w {
            sources.push(Source {
                value: if encoding.components == 3 { w.with_z(b, name) } else { w.xy.clone() },
                components: encoding.components,
                bands: config.bands,
                raw: config.raw,
                amplitude: config.amplitude,
                offset,
                is_u: false,
            });
        }
        offset += architecture.direction_inputs(config);
    }
    sources
}

fn lanes(sources: &[Source]) -> Vec<Lane> {
    let mut lanes = Vec::new();
    for (source, s) in sources.iter().enumerate() {
        for group in 0..s.bands.div_ceil(RESTART) {
            lanes.extend((0..s.components).map(|component| Lane { source, component, group }));
        }
    }
    lanes
}

/// Sines and cosines \[N, doublings * lanes\], doubling by doubling.
fn waves(
    b: &mut Builder,
    architecture: &Architecture,
    sources: &[Source],
    lanes: &[Lane],
    doublings: usize,
) -> (Value, Value) {
    let parts: Vec<&Value> =
        lanes.iter().filter(|l| l.component == 0).map(|lane| &sources[lane.source].value).collect();
    let positions = b.concat("lanes", &parts, 1);
    let factors: Vec<f32> = lanes.iter().map(|lane| frequency(RESTART * lane.group) as f32).collect();
    let factors = b.floats("encoding.frequencies", &[lanes.len()], &factors);
    let mut angle = b.mul("lanes.scaled", &positions, &factors);
    if architecture.model.encoding.pi {
        // sin(pi t) has period 2: reduced to [-1, 1) exactly, before pi rounds.
        let one = b.scalar(1.0);
        let up = b.add("period.up", &angle, &one);
        let half = b.scale("period.half", &up, 0.5);
        let turns = b.floor("period.turns", &half);
        let whole = b.scale("period.whole", &turns, 2.0);
        let reduced = b.sub("period.reduced", &angle, &whole);
        angle = b.scale("angle", &reduced, std::f32::consts::PI);
    }
    let mut sines = vec![b.node("Sin", "sin.0", &[&angle], &[])];
    let mut cosines = vec![b.node("Cos", "cos.0", &[&angle], &[])];
    for doubling in 1..doublings {
        let (s, c) = (sines[doubling - 1].clone(), cosines[doubling - 1].clone());
        let twice = b.add(&format!("sin.{doubling}.twice"), &s, &s);
        let square = b.mul(&format!("sin.{doubling}.square"), &twice, &s);
        sines.push(b.mul(&format!("sin.{doubling}"), &twice, &c));
        cosines.push(b.one_minus(&format!("cos.{doubling}"), &square));
    }
    let sines = b.concat("sines", &sines.iter().collect::<Vec<_>>(), 1);
    let cosines = b.concat("cosines", &cosines.iter().collect::<Vec<_>>(), 1);
    (sines, cosines)
}

/// exp(-(2^k pi s)^2 / 2) for u's lanes and 1 for the others, \[N, doublings * lanes\]. The footprint of
/// 2^level texels, 2^level 2 / N wide in p, has standard deviation s = 2^level (2 / N) / sqrt(12).
fn attenuation(
    b: &mut Builder,
    architecture: &Architecture,
    sources: &[Source],
    lanes: &[Lane],
    doublings: usize,
    level: &Value,
) -> Value {
    let pi = if architecture.model.encoding.pi { std::f64::consts::PI } else { 1.0 };
    let [height, width] = architecture.resolution;
    let mut exponents = Vec::with_capacity(doublings * lanes.len());
    for doubling in 0..doublings {
        exponents.extend(lanes.iter().map(|lane| {
            let texels = if lane.component == 0 { width } else { height };
            let s = 2.0 / texels as f64 / 12f64.sqrt();
            let x = frequency(RESTART * lane.group + doubling) * pi * s;
            if sources[lane.source].is_u { (-x * x / 2.0) as f32 } else { 0.0 }
        }));
    }
    let exponents = b.floats("encoding.attenuation", &[exponents.len()], &exponents);
    let four = b.scalar(4.0);
    let area = b.node("Pow", "footprint.area", &[&four, level], &[]);
    let exponent = b.mul("attenuation.exponent", &area, &exponents);
    b.node("Exp", "attenuation", &[&exponent], &[])
}

fn frequency(band: usize) -> f64 {
    (1u64 << band) as f64
}
