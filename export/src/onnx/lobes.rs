//! Importance sampling of wi: the lobes of a sampler in `prepare.onnx`, and what is done with them in `sample.onnx` and
//! `pdf.onnx`. The maths is that of [`crate::sampler`].

use super::builder::{Builder, Value};
use super::network::Network;
use super::query::Direction;
use super::{Layout, Opset, Port, finish};
use crate::error::{Error, Result};
use crate::precision::Precision;
use crate::sampler::{
    CENTRES, Frame, LOG_SCALES, LOGITS, METADATA_KEY, OUTPUTS_PER_LOBE, SAMPLER_MLP, SHEARS, Sampler,
    SamplerConfig,
};
use std::f32::consts::PI;

/// Values of a lobe: weight, centre b (x, y), matrix A row by row.
pub const LOBE_COLUMNS: usize = 7;

/// The lobes as `prepare.onnx` gives them, the cosine first.
pub(super) fn lobes_port(config: &SamplerConfig) -> Port {
    let meaning = "lobes over wi, the cosine first: weight, centre x and y, matrix row by row";
    let columns = vec![config.lobes.len() + 1, LOBE_COLUMNS];
    Port { name: "lobes", layout: Layout::Queries, columns, meaning }
}

/// Inputs and outputs of `sample.onnx`.
pub fn sample_ports(config: &SamplerConfig) -> (Vec<Port>, Vec<Port>) {
    let xi = port("xi", &[2], "two uniform numbers in [0, 1)");
    let wi = port("wi", &[3], "unit vector to the light; its x and y go to evaluate.onnx");
    (vec![lobes_port(config), xi], vec![wi, port("pdf", &[], "density of wi over solid angle")])
}

/// Inputs and the output of `pdf.onnx`.
pub fn pdf_ports(config: &SamplerConfig) -> (Vec<Port>, Vec<Port>) {
    let wi = port("wi", &[3], "unit vector to the light");
    let pdf = port("pdf", &[], "density of wi over solid angle, 0 on and below the horizon");
    (vec![lobes_port(config), wi], vec![pdf])
}

/// `sample.onnx`: lobes, xi -> wi, pdf.
///
/// # Errors
/// `Config`, naming the tensor or field of an invalid sampler.
pub fn sample_graph(sampler: &Sampler, opset: Opset) -> Result<Vec<u8>> {
    sampler.validate()?;
    let count = sampler.header.config.lobes.len() + 1;
    let (inputs, outputs) = sample_ports(&sampler.header.config);
    let mut b = Builder::new("sample", "neural material: a light direction by importance");
    let (lobes, xi) = (b.input(&inputs[0]), b.input(&inputs[1]));
    b.scope("choice");
    let (first, second) = b.split_in_two("xi", &xi, 1, [1, 1]);
    let first = b.clip("xi.first", &first, 0.0, BELOW_ONE);
    let second = b.clip("xi.second", &second, 0.0, BELOW_ONE);
    let weights = b.split_in_two("lobes.parts", &lobes, 2, [1, LOBE_COLUMNS as i64 - 1]).0;
    let weights = b.squeeze("weights", &weights, &[2]);
    let upto: Vec<f32> = (0..count * count).map(|i| f32::from(i / count <= i % count)).collect();
    let upto = b.floats("upto", &[count, count], &upto);
    let ends = b.node("MatMul", "ends", &[&weights, &upto], &[]);
    // The last lobe ends beyond 1, whatever rounding makes of the sum.
    let beyond: Vec<f32> = (0..count).map(|k| if k + 1 == count { 1.0 } else { 0.0 }).collect();
    let beyond = b.floats("beyond", &[count], &beyond);
    let open_ends = b.add("ends.open", &ends, &beyond);
    let starts = b.sub("starts", &ends, &weights);
    let under = b.node("Less", "under_end", &[&first, &open_ends], &[]);
    let over = b.node("Less", "under_start", &[&first, &starts], &[]);
    let over = b.node("Not", "over_start", &[&over], &[]);
    // Of two lobes that rounding lets overlap the first is taken: the one before which none was under its end.
    let chosen = b.node("And", "chosen", &[&under, &over], &[]);
    let chosen = b.float_of("chosen.float", &chosen);
    let before: Vec<f32> = (0..count * count).map(|i| f32::from(i / count < i % count)).collect();
    let before = b.floats("before", &[count, count], &before);
    let taken = b.node("MatMul", "taken", &[&chosen, &before], &[]);
    let free = b.one_minus("free", &taken);
    let free = b.clip("free.clipped", &free, 0.0, 1.0);
    let chosen = b.mul("chosen.one", &chosen, &free);

    let start = b.mul("start.of", &chosen, &starts);
    let start = b.row_sum("start", &start);
    let weight = b.mul("weight.of", &chosen, &weights);
    let weight = b.row_sum("weight", &weight);
    let weight = b.at_least("weight.positive", &weight, f32::MIN_POSITIVE);
    let rest = b.sub("rest", &first, &start);
    let turn = b.node("Div", "turn", &[&rest, &weight], &[]);
    let turn = b.clip("turn.clipped", &turn, 0.0, 1.0);
    let chosen = b.unsqueeze("chosen.row", &chosen, &[1]);
    let lobe = b.node("MatMul", "lobe.row", &[&chosen, &lobes], &[]);
    let lobe = b.squeeze("lobe", &lobe, &[1]);
    let columns = b.columns("lobe.columns", &lobe, LOBE_COLUMNS);
    let [_, bx, by, a00, a01, a10, a11] = columns.as_slice() else { unreachable!("seven columns") };

    b.scope("direction");
    let below = b.one_minus("xi.below_one", &second);
    let slope2 = b.node("Div", "slope.squared", &[&second, &below], &[]);
    let slope = b.node("Sqrt", "slope", &[&slope2], &[]);
    let angle = b.scale("angle", &turn, 2.0 * PI);
    let (cos, sin) = (b.node("Cos", "cos", &[&angle], &[]), b.node("Sin", "sin", &[&angle], &[]));
    let (tx, ty) = (b.mul("t.x", &slope, &cos), b.mul("t.y", &slope, &sin));
    let mut moved = |name: &str, row: [&Value; 2], centre: &Value| {
        let (x, y) =
            (b.mul(&format!("{name}.from_x"), row[0], &tx), b.mul(&format!("{name}.from_y"), row[1], &ty));
        let sum = b.add(&format!("{name}.turned"), &x, &y);
        b.add(name, &sum, centre)
    };
    let (sx, sy) = (moved("s.x", [a00, a01], bx), moved("s.y", [a10, a11], by));
    let one = b.scalar(1.0);
    let (x2, y2) = (b.mul("s.x.squared", &sx, &sx), b.mul("s.y.squared", &sy, &sy));
    let length2 = b.add("s.squared", &x2, &y2);
    let length2 = b.add("length.squared", &length2, &one);
    let length = b.node("Sqrt", "length", &[&length2], &[]);
    let z = b.node("Div", "z", &[&one, &length], &[]);
    let (x, y) = (b.mul("x", &sx, &z), b.mul("y", &sy, &z));
    let wi = b.concat("wi", &[&x, &y, &z], 1);
    b.output(&outputs[0], &wi);
    let pdf = density(&mut b, &lobes, &wi);
    b.output(&outputs[1], &pdf);
    finish(b, &properties(sampler)?, opset)
}

/// `pdf.onnx`: lobes, wi -> pdf.
///
/// # Errors
/// `Config`, naming the tensor or field of an invalid sampler.
pub fn pdf_graph(sampler: &Sampler, opset: Opset) -> Result<Vec<u8>> {
    sampler.validate()?;
    let (inputs, outputs) = pdf_ports(&sampler.header.config);
    let mut b = Builder::new("pdf", "neural material: density of light directions by importance");
    let (lobes, wi) = (b.input(&inputs[0]), b.input(&inputs[1]));
    let pdf = density(&mut b, &lobes, &wi);
    b.output(&outputs[0], &pdf);
    finish(b, &properties(sampler)?, opset)
}

/// Largest 32-bit float below 1.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// The lobes \[N, lobes + 1, [`LOBE_COLUMNS`]\] that a sampler gives for features \[N, C\] and wo.
pub(super) fn lobes(b: &mut Builder, sampler: &Sampler, features: &Value, wo: &Direction) -> Result<Value> {
    sampler.validate()?;
    let config = &sampler.header.config;
    let count = config.lobes.len();
    b.scope("sampler");
    let input = b.concat("input", &[features, &wo.xy], 1);
    let layers = config.hidden.len() + 1;
    let network = Network::new(&sampler.tensors, SAMPLER_MLP, layers, Precision::Single);
    let outputs = network.run(b, &input, None)?;
    let raw = b.columns("raw", &outputs, OUTPUTS_PER_LOBE * count);
    let mirror = Mirror::new(b, wo, config.min_z);

    let zero = b.scale("zero", &raw[0], 0.0);
    let one = b.scalar(1.0);
    let one = b.add("one", &zero, &one);
    let mut logits = vec![zero.clone()];
    let mut shapes = vec![vec![zero.clone(), zero.clone(), one.clone(), zero.clone(), zero.clone(), one]];
    for (k, frame) in config.lobes.iter().enumerate() {
        b.scope(&format!("lobe{k}"));
        let raw = &raw[OUTPUTS_PER_LOBE * k..][..OUTPUTS_PER_LOBE];
        let mut limited = |name: &str, i: usize, [low, high]: [f32; 2]| b.clip(name, &raw[i], low, high);
        logits.push(limited("logit", 0, LOGITS));
        let centre = [limited("c.x", 1, CENTRES), limited("c.y", 2, CENTRES)];
        let (p, r, q) = (limited("p", 3, LOG_SCALES), limited("r", 4, SHEARS), limited("q", 5, LOG_SCALES));
        let l00 = b.node("Exp", "l.00", &[&p], &[]);
        let l10 = b.mul("l.10", &r, &l00);
        let l11 = b.node("Exp", "l.11", &[&q], &[]);
        let l01 = zero.clone();
        shapes.push(match frame {
            Frame::Surface => [&centre[..], &[l00, l01, l10, l11]].concat(),
            Frame::Mirror => mirror.moved(b, &centre, [&l00, &l10, &l11]),
        });
    }
    b.scope("sampler");
    let logits = b.concat("logits", &logits.iter().collect::<Vec<_>>(), 1);
    let shares = b.node("Softmax", "shares", &[&logits], &[("axis", 1)]);
    let shares = b.scale("shares.scaled", &shares, 1.0 - config.cosine_floor);
    let floor: Vec<f32> = (0..=count).map(|k| if k == 0 { config.cosine_floor } else { 0.0 }).collect();
    let floor = b.floats("sampler.floor", &[count + 1], &floor);
    let weights = b.add("weights", &shares, &floor);
    let weights = b.columns("weight", &weights, count + 1);
    let rows: Vec<Value> = weights
        .iter()
        .zip(&shapes)
        .map(|(weight, shape)| {
            let columns: Vec<&Value> = std::iter::once(weight).chain(shape).collect();
            let row = b.concat("row", &columns, 1);
            b.unsqueeze("row.lobe", &row, &[1])
        })
        .collect();
    Ok(b.concat("lobes", &rows.iter().collect::<Vec<_>>(), 1))
}

/// The frame of mirror lobes: the mirror slope m and T = I + m m^T.
struct Mirror {
    m: [Value; 2],
    t00: Value,
    t01: Value,
    t11: Value,
}

impl Mirror {
    fn new(b: &mut Builder, wo: &Direction, min_z: f32) -> Self {
        let z = wo.z(b, "wo");
        let z = b.at_least("wo.z.least", &z, min_z);
        let slope = b.node("Div", "wo.slope", &[&wo.xy, &z], &[]);
        let slope = b.node("Neg", "mirror.slope", &[&slope], &[]);
        let (x, y) = b.split_in_two("m", &slope, 1, [1, 1]);
        let (xx, t01, yy) = (b.mul("m.xx", &x, &x), b.mul("t.01", &x, &y), b.mul("m.yy", &y, &y));
        let one = b.scalar(1.0);
        Self { m: [x, y], t00: b.add("t.00", &xx, &one), t01, t11: b.add("t.11", &yy, &one) }
    }

    /// Centre and matrix in this frame: m + T c, T L with L = \[\[l00, 0\], \[l10, l11\]\].
    fn moved(&self, b: &mut Builder, centre: &[Value; 2], [l00, l10, l11]: [&Value; 3]) -> Vec<Value> {
        let mut sum = |name: &str, a: [&Value; 2], c: [&Value; 2]| {
            let (first, second) = (b.mul("first", a[0], c[0]), b.mul("second", a[1], c[1]));
            b.add(name, &first, &second)
        };
        let [x, y] = centre;
        let (first, second) = ([&self.t00, &self.t01], [&self.t01, &self.t11]);
        let (tx, ty) = (sum("t.c.x", first, [x, y]), sum("t.c.y", second, [x, y]));
        let (a00, a10) = (sum("a.00", first, [l00, l10]), sum("a.10", second, [l00, l10]));
        let (a01, a11) = (b.mul("a.01", &self.t01, l11), b.mul("a.11", &self.t11, l11));
        let (bx, by) = (b.add("b.x", &self.m[0], &tx), b.add("b.y", &self.m[1], &ty));
        vec![bx, by, a00, a01, a10, a11]
    }
}

/// The density \[N\] of wi \[N, 3\]: the sum over lobes of weight z / (pi |det A| (z^2 + |v|^2)^2), v = A^-1 (wi.xy - b z).
fn density(b: &mut Builder, lobes: &Value, wi: &Value) -> Value {
    b.scope("density");
    let parts = b.split("lobes", lobes, 2, &[1; LOBE_COLUMNS]);
    let parts: Vec<Value> = parts.iter().map(|part| b.squeeze("column", part, &[2])).collect();
    let [weight, bx, by, a00, a01, a10, a11] = parts.as_slice() else { unreachable!("seven columns") };
    let wi = b.columns("wi", wi, 3);
    let [x, y, z] = wi.as_slice() else { unreachable!("three columns") };
    let mut cross = |name: &str, p: [&Value; 2], q: [&Value; 2]| {
        let (first, second) = (b.mul("first", p[0], p[1]), b.mul("second", q[0], q[1]));
        b.sub(name, &first, &second)
    };
    let determinant = cross("determinant", [a00, a11], [a01, a10]);
    let mut away = |name: &str, at: &Value, centre: &Value| {
        let moved = b.mul("centre.moved", centre, z);
        b.sub(name, at, &moved)
    };
    let (dx, dy) = (away("d.x", x, bx), away("d.y", y, by));
    let mut cross = |name: &str, p: [&Value; 2], q: [&Value; 2]| {
        let (first, second) = (b.mul("first", p[0], p[1]), b.mul("second", q[0], q[1]));
        let cross = b.sub(name, &first, &second);
        let v = b.node("Div", "v", &[&cross, &determinant], &[]);
        b.mul("v.squared", &v, &v)
    };
    let vx2 = cross("v.x", [a11, &dx], [a01, &dy]);
    // Row 2 of the adjugate is (-a10, a00).
    let vy2 = cross("v.y", [a00, &dy], [a10, &dx]);
    let z2 = b.mul("z.squared", z, z);
    let sum = b.add("v.squares", &vx2, &vy2);
    let sum = b.add("distance", &sum, &z2);
    let fourth = b.mul("distance.squared", &sum, &sum);
    let size = b.node("Abs", "area", &[&determinant], &[]);
    let below = b.mul("area.times_distance", &size, &fourth);
    let above = b.mul("weight.z", weight, z);
    let above = b.scale("weight.z.over_pi", &above, 1.0 / PI);
    let terms = b.node("Div", "terms", &[&above, &below], &[]);
    let density = b.row_sum("sum", &terms);
    let zero = b.scalar(0.0);
    let up = b.node("Greater", "up", &[z, &zero], &[]);
    let density = b.node("Where", "density", &[&up, &density, &zero], &[]);
    b.squeeze("density.flat", &density, &[1])
}

fn port(name: &'static str, columns: &[usize], meaning: &'static str) -> Port {
    Port { name, layout: Layout::Queries, columns: columns.into(), meaning }
}

fn properties(sampler: &Sampler) -> Result<Vec<(&'static str, String)>> {
    let config = serde_json::to_string(&sampler.header.config).map_err(|e| Error::config(METADATA_KEY, e))?;
    Ok(vec![("neumip.sampler", config)])
}
