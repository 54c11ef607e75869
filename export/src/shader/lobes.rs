//! neumip_lobes, neumip_sample and neumip_pdf: the sampler's mixture ([`crate::sampler`]).

use super::network::{Part, rest};
use super::writer::{Type::Float, Type::Struct, Writer, number};
use crate::sampler::{
    CENTRES, Frame, LOG_SCALES, LOGITS, OUTPUTS_PER_LOBE, SAMPLER_MLP, SHEARS, SamplerConfig,
};
use crate::weights::{Layer, Layout};

/// Least squared z of a cosine-distributed direction, 2^-24: a draw of exactly 1 would lie on the horizon.
const LEAST_SQUARE: f32 = f32::EPSILON / 2.0;

pub fn functions(w: &mut Writer, sampler: &SamplerConfig, layout: &Layout) {
    let layers: Vec<&Layer> = layout.network(SAMPLER_MLP).collect();
    layers.iter().for_each(|layer| Part::whole(layer).functions(w));
    let count = sampler.lobes.len();
    let mut fields = vec![(Float(1), "cosine".to_string())];
    for k in 0..count {
        fields.extend([
            (Float(1), format!("weight{k}")),
            (Float(4), format!("map{k}")),
            (Float(2), format!("centre{k}")),
        ]);
    }
    w.comment(
        "Lobes over wi, by weight: a cosine lobe, and cosine lobes whose slopes t became [map.xy; map.zw] t + centre.",
    );
    w.structure("NeumipLobes", &fields);
    w.comment("The lobes of a prepared query.");
    w.function(
        Struct("NeumipLobes"),
        "neumip_lobes",
        &[(Struct("NeumipPrepared"), "prepared".into())],
        |w| lobes(w, sampler, &layers),
    );
    density(w, count);
    sample(w, count);
}

fn lobes(w: &mut Writer, sampler: &SamplerConfig, layers: &[&Layer]) {
    let mut inputs: Vec<String> = (0..sampler.features)
        .map(|c| format!("prepared.features{}.{}", c / 4, super::writer::letter(c)))
        .collect();
    inputs.extend(["prepared.wo.x".into(), "prepared.wo.y".into()]);
    let first = Part::whole(layers[0]);
    let inputs = first.gather(w, "x", &inputs);
    let hidden = first.call(w, "h0_", &inputs, None, true);
    let outputs = rest(w, &layers[1..], hidden, ['h', 'y']);
    let value = |w: &Writer, lobe: usize, k: usize, bounds: [f32; 2]| {
        let value = w.float(1, &outputs[OUTPUTS_PER_LOBE * lobe + k]);
        format!("clamp({value}, {}, {})", number(bounds[0]), number(bounds[1]))
    };
    let of = Float(1);
    if sampler.lobes.contains(&Frame::Mirror) {
        w.declare(of, "wo_z", "sqrt(max(0.0, 1.0 - dot(prepared.wo, prepared.wo)))");
        w.declare(Float(2), "mirror", &format!("-prepared.wo / max(wo_z, {})", number(sampler.min_z)));
    }
    let mut largest = "0.0".to_string();
    for k in 0..sampler.lobes.len() {
        let logit = value(w, k, 0, LOGITS);
        w.declare(of, &format!("logit{k}"), &logit);
        largest = format!("max({largest}, logit{k})");
    }
    w.declare(of, "largest", &largest);
    w.declare(of, "share", "exp(-largest)");
    let mut total = "share".to_string();
    for k in 0..sampler.lobes.len() {
        w.declare(of, &format!("share{k}"), &format!("exp(logit{k} - largest)"));
        total += &format!(" + share{k}");
    }
    w.declare(of, "scale", &format!("{} / ({total})", number(1.0 - sampler.cosine_floor)));
    w.variable(Struct("NeumipLobes"), "lobes");
    w.line(format!("lobes.cosine = {} + share * scale;", number(sampler.cosine_floor)));
    for (k, frame) in sampler.lobes.iter().enumerate() {
        w.line(format!("lobes.weight{k} = share{k} * scale;"));
        let (x, y) = (value(w, k, 1, CENTRES), value(w, k, 2, CENTRES));
        let [p, r, q] =
            [(3, LOG_SCALES), (4, SHEARS), (5, LOG_SCALES)].map(|(i, bounds)| value(w, k, i, bounds));
        let centre = w.make(Float(2), &format!("{x}, {y}"));
        w.declare(Float(2), &format!("c{k}"), &centre);
        w.comment("[left.x 0; left.y right]");
        w.declare(of, &format!("width{k}"), &format!("exp({p})"));
        let left = w.make(Float(2), &format!("width{k}, {r} * width{k}"));
        w.declare(Float(2), &format!("left{k}"), &left);
        w.declare(of, &format!("right{k}"), &format!("exp({q})"));
        match frame {
            Frame::Surface => {
                let map = w.make(Float(4), &format!("left{k}.x, 0.0, left{k}.y, right{k}"));
                w.line(format!("lobes.map{k} = {map};"));
                w.line(format!("lobes.centre{k} = c{k};"));
            }
            Frame::Mirror => {
                // T v = v + mirror (mirror . v), for the columns of L and for the centre.
                let image = format!("left{k} + mirror * dot(mirror, left{k})");
                w.declare(Float(2), &format!("image{k}"), &image);
                let unit = w.make(Float(2), "0.0, 1.0");
                w.declare(
                    Float(2),
                    &format!("other{k}"),
                    &format!("right{k} * ({unit} + mirror * mirror.y)"),
                );
                let map = w.make(Float(4), &format!("image{k}.x, other{k}.x, image{k}.y, other{k}.y"));
                w.line(format!("lobes.map{k} = {map};"));
                w.line(format!("lobes.centre{k} = mirror + c{k} + mirror * dot(mirror, c{k});"));
            }
        }
    }
    w.line("return lobes;");
}

fn density(w: &mut Writer, count: usize) {
    w.comment("The density of one lobe over solid angle, for wi above the horizon.");
    let parameters = [(Float(4), "map".into()), (Float(2), "centre".into()), (Float(3), "wi".into())];
    w.function(Float(1), "neumip_lobe_pdf", &parameters, |w| {
        w.declare(Float(1), "area", "map.x * map.w - map.y * map.z");
        w.declare(Float(2), "d", "wi.xy - centre * wi.z");
        let v = w.make(Float(2), "map.w * d.x - map.y * d.y, map.x * d.y - map.z * d.x");
        w.declare(Float(2), "v", &format!("{v} / area"));
        w.declare(Float(1), "s", "wi.z * wi.z + dot(v, v)");
        w.line(format!("return wi.z / ({} * abs(area) * s * s);", number(std::f32::consts::PI)));
    });
    w.comment("The density over solid angle with which neumip_sample draws the unit vector wi; 0 on and below the horizon.");
    let parameters = [(Struct("NeumipLobes"), "lobes".into()), (Float(3), "wi".into())];
    w.function(Float(1), "neumip_pdf", &parameters, |w| {
        w.declare(
            Float(1),
            "sum0",
            &format!("lobes.cosine * wi.z * {}", number(std::f32::consts::FRAC_1_PI)),
        );
        for k in 0..count {
            let lobe = format!("lobes.weight{k} * neumip_lobe_pdf(lobes.map{k}, lobes.centre{k}, wi)");
            w.declare(Float(1), &format!("sum{}", k + 1), &format!("sum{k} + {lobe}"));
        }
        let answer = w.choose("wi.z > 0.0", &format!("sum{count}"), "0.0");
        w.line(format!("return {answer};"));
    });
}

fn sample(w: &mut Writer, count: usize) {
    w.comment(
        "A direction wi (x, y, z) and its density (w) from two uniform numbers in [0, 1): the first chooses the lobe and, by \
         what is left of it, an angle; the second a length.",
    );
    let parameters = [(Struct("NeumipLobes"), "lobes".into()), (Float(2), "xi".into())];
    w.function(Float(4), "neumip_sample", &parameters, |w| {
        let weight = |k: usize| match k {
            0 => "lobes.cosine".to_string(),
            _ => format!("lobes.weight{}", k - 1),
        };
        w.declare(Float(1), "rest0", "xi.x");
        for k in 0..count {
            w.declare(Float(1), &format!("rest{}", k + 1), &format!("rest{k} - {}", weight(k)));
        }
        let mut map = format!("lobes.map{}", count - 1);
        let mut centre = format!("lobes.centre{}", count - 1);
        let (mut rest, mut share) = (format!("rest{count}"), weight(count));
        for k in (0..count).rev() {
            let (map_before, centre_before) = match k {
                0 => (w.make(Float(4), "1.0, 0.0, 0.0, 1.0"), w.make(Float(2), "0.0, 0.0")),
                _ => (format!("lobes.map{}", k - 1), format!("lobes.centre{}", k - 1)),
            };
            let condition = format!("rest{k} < {}", weight(k));
            map = w.choose(&condition, &map_before, &map);
            centre = w.choose(&condition, &centre_before, &centre);
            rest = w.choose(&condition, &format!("rest{k}"), &rest);
            share = w.choose(&condition, &weight(k), &share);
        }
        w.declare(Float(4), "map", &map);
        w.declare(Float(2), "centre", &centre);
        w.declare(Float(1), "rest", &rest);
        w.declare(Float(1), "share", &share);
        w.declare(Float(1), "part", "min(rest / share, 1.0)");
        w.comment("A point of the unit disc and its height on the hemisphere.");
        w.declare(Float(1), "turn", "2.0 * (part - step(0.5, part))");
        let circle = w.make(Float(2), "neumip_cos_pi1(turn), neumip_sin_pi1(turn)");
        w.declare(Float(2), "disc", &format!("sqrt(xi.y) * {circle}"));
        w.declare(Float(1), "z", &format!("sqrt(max(1.0 - xi.y, {}))", number(LEAST_SQUARE)));
        let moved = w.make(Float(2), "map.x * disc.x + map.y * disc.y, map.z * disc.x + map.w * disc.y");
        w.declare(Float(2), "slope", &format!("{moved} + centre * z"));
        let wi = w.make(Float(3), "slope, z");
        w.declare(Float(3), "wi", &format!("normalize({wi})"));
        let answer = w.make(Float(4), "wi, neumip_pdf(lobes, wi)");
        w.line(format!("return {answer};"));
    });
}
