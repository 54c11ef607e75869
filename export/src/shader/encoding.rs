//! gamma(u), gamma(wi), gamma(wo): sines and cosines by double angles, taken anew from an exactly reduced angle every
//! [`RESTART`] octaves.

use super::writer::{Type::Float, Writer, letter, number};
use crate::config::{Architecture, DirectionEncoding};

/// Octaves from one restart to the next: three doublings make a rounding eight times as large.
const RESTART: usize = 4;

/// One of u, wi, wo.
struct Source<'a> {
    /// The value to encode, and the prefix of what is made of it.
    name: &'a str,
    components: usize,
    bands: usize,
    raw: bool,
}

/// Declares the encoding of `p` = 2 u - 1 at the clamped `level`; the names of its values, in the decoder's order.
pub fn position(w: &mut Writer, architecture: &Architecture) -> Vec<String> {
    let encoding = &architecture.model.encoding;
    let source = Source { name: "p", components: 2, bands: architecture.u_bands(), raw: encoding.u.raw };
    if !encoding.u.attenuate || source.bands == 0 {
        return encode(w, &source, encoding.pi, |_, _| None);
    }
    // The footprint of 2^level texels, 2^level 2 / N wide in p, has the standard deviation 2^level (2 / N) / sqrt(12).
    let pi = if encoding.pi { std::f64::consts::PI } else { 1.0 };
    let exponent = |band: usize, texels: usize| {
        let x = (1u64 << band) as f64 * pi * 2.0 / texels as f64 / 12f64.sqrt();
        number((-x * x / 2.0) as f32)
    };
    let [height, width] = architecture.resolution;
    w.declare(Float(1), "area", "exp2(2.0 * level_)");
    encode(w, &source, encoding.pi, |w, band| {
        let name = format!("p_fade{band}");
        if width == height {
            w.declare(Float(1), &name, &format!("exp(area * {})", exponent(band, width)));
        } else {
            let both = w.make(Float(2), &format!("{}, {}", exponent(band, width), exponent(band, height)));
            w.declare(Float(2), &name, &format!("exp(area * {both})"));
        }
        Some(name)
    })
}

/// Declares the encoding of the direction `name` (x, y), whose z is `name`_z; the names of its values.
pub fn direction(
    w: &mut Writer,
    architecture: &Architecture,
    name: &str,
    config: &DirectionEncoding,
) -> Vec<String> {
    let encoding = &architecture.model.encoding;
    let whole = format!("{name}_xyz");
    if encoding.components == 3 {
        let value = w.make(Float(3), &format!("{name}, {name}_z"));
        w.declare(Float(3), &whole, &value);
    }
    let source = Source {
        name: if encoding.components == 3 { &whole } else { name },
        components: encoding.components,
        bands: config.bands,
        raw: config.raw,
    };
    let amplitude = (config.amplitude != 1.0).then(|| number(config.amplitude));
    encode(w, &source, encoding.pi, |_, _| amplitude.clone())
}

/// `factor` declares and names what a band's values are multiplied by, if anything.
fn encode(
    w: &mut Writer,
    source: &Source,
    pi: bool,
    mut factor: impl FnMut(&mut Writer, usize) -> Option<String>,
) -> Vec<String> {
    let Source { name, components, .. } = *source;
    let of = Float(components);
    let mut values = Vec::new();
    for band in 0..source.bands {
        let (sine, cosine) = (format!("{name}_sin{band}"), format!("{name}_cos{band}"));
        if band % RESTART == 0 {
            let (mut octave, turn) = (name.to_string(), format!("{name}_turn{band}"));
            if band > 0 {
                octave = format!("{name}_octave{band}");
                w.declare_precise(of, &octave, &format!("{name} * {}", number((1u32 << band) as f32)));
            }
            let reduced = match pi {
                true => format!("{octave} - 2.0 * floor(({octave} + 1.0) * 0.5)"),
                false => format!("neumip_half_turns{components}({octave})"),
            };
            w.declare_precise(of, &turn, &reduced);
            w.declare(of, &sine, &format!("neumip_sin_pi{components}({turn})"));
            w.declare(of, &cosine, &format!("neumip_cos_pi{components}({turn})"));
        } else {
            let (s, c) = (format!("{name}_sin{}", band - 1), format!("{name}_cos{}", band - 1));
            w.declare(of, &sine, &format!("2.0 * {s} * {c}"));
            w.declare(of, &cosine, &format!("1.0 - 2.0 * {s} * {s}"));
        }
        let scaled = factor(w, band);
        for wave in [sine, cosine] {
            let wave = match &scaled {
                None => wave,
                Some(factor) => {
                    let faded = format!("{wave}_scaled");
                    w.declare(of, &faded, &format!("{wave} * {factor}"));
                    faded
                }
            };
            values.extend((0..components).map(|c| format!("{wave}.{}", letter(c))));
        }
    }
    if source.raw {
        values.extend((0..components).map(|c| format!("{name}.{}", letter(c))));
    }
    values
}

/// Numbers of components that sines are taken of.
pub fn sine_widths(architecture: &Architecture) -> Vec<usize> {
    let encoding = &architecture.model.encoding;
    let mut widths = Vec::new();
    if architecture.u_bands() > 0 {
        widths.push(2);
    }
    if encoding.wi.bands + encoding.wo.bands > 0 && !widths.contains(&encoding.components) {
        widths.push(encoding.components);
    }
    widths
}
