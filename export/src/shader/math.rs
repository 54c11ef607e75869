//! Elementary functions whose error is known: those of a graphics processor may be off by 1e-3.

use super::Language;
use super::writer::{Type::Float, Type::Int, Writer, number};

/// sin(pi x) = x (S0 + S1 x^2 + ...) for |x| <= 1/2, within 5e-9 before rounding: least maximum, by Lawson's weights.
const SINE: [f32; 5] = [3.141_592_5, -5.167_707, 2.550_031_4, -0.598_045_2, 0.077_220_13];
/// 1/2!, 1/3!, ...: e^x - 1 - x for |x| <= ln 2 / 2, within 5e-9.
const EXPONENTIAL: [f32; 6] = [0.5, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0, 1.0 / 5040.0];
/// ln 2 in two parts; up to 2^8 times the first is exact.
const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];

/// neumip_sin_piN and neumip_cos_piN of `components` numbers in [-1, 1].
pub fn sines(w: &mut Writer, components: usize) {
    let of = Float(components);
    if !w.is_exact() {
        for name in ["sin", "cos"] {
            w.function(of, &format!("neumip_{name}_pi{components}"), &[(of, "x".into())], |w| {
                let pi = number(std::f32::consts::PI);
                w.line(format!("return {name}({pi} * x);"));
            });
        }
        return;
    }
    w.comment("sin(pi x) for |x| <= 1/2.");
    w.function(of, &format!("neumip_sine{components}"), &[(of, "x".into())], |w| {
        w.declare(of, "y", "x * x");
        let [s0, s1, s2, s3, s4] = SINE.map(plus);
        w.line(format!(
            "return x * ((((y * {}{s3}) * y{s2}) * y{s1}) * y{s0});",
            s4.trim_start_matches(" + ")
        ));
    });
    w.comment("sin(pi x) and cos(pi x) for |x| <= 1: folding to a quarter rounds nothing that matters.");
    w.function(of, &format!("neumip_sin_pi{components}"), &[(of, "x".into())], |w| {
        w.line(format!("return neumip_sine{components}(max(min(x, 1.0 - x), -1.0 - x));"));
    });
    w.function(of, &format!("neumip_cos_pi{components}"), &[(of, "x".into())], |w| {
        w.line(format!("return neumip_sine{components}(0.5 - abs(x));"));
    });
}

/// neumip_half_turnsN: angles in radians, up to 2^20, as multiples of pi within [-1, 1].
pub fn half_turns(w: &mut Writer, components: usize) {
    use std::f64::consts::PI;
    /// Angles are taken apart at multiples of this.
    const FAR: f64 = 256.0;
    let of = Float(components);
    // n FAR = n c1 pi + n c2 pi (mod 2 pi): c1 has 11 bits, so n c1 is exact for n of 12 bits.
    let cycle = FAR / PI % 2.0;
    let c1 = (cycle * 1024.0).round() / 1024.0;
    let c2 = cycle - c1;
    // 2 pi in parts of 11 bits: near / (2 pi) is below 2^5.
    let a1 = (2.0 * PI * 256.0).floor() / 256.0;
    let a2 = ((2.0 * PI - a1) * 1_048_576.0).floor() / 1_048_576.0;
    let a3 = 2.0 * PI - a1 - a2;
    let n = |value: f64| number(value as f32);
    w.function(of, &format!("neumip_half_turns{components}"), &[(of, "angle".into())], |w| {
        w.declare_precise(of, "far", &format!("floor(angle * {} + 0.5)", n(1.0 / FAR)));
        w.declare_precise(of, "near", &format!("angle - far * {}", n(FAR)));
        w.declare_precise(of, "turns", &format!("floor(near * {} + 0.5)", n(0.5 / PI)));
        let rest = format!("((near - turns * {}) - turns * {}) - turns * {}", n(a1), n(a2), n(a3));
        w.declare_precise(of, "rest", &rest);
        w.declare_precise(of, "cycles", &format!("far * {}", n(c1)));
        let sum =
            format!("(cycles - 2.0 * floor(cycles * 0.5)) + (far * {} + rest * {})", n(c2), n(1.0 / PI));
        w.declare_precise(of, "sum", &sum);
        w.line("return sum - 2.0 * floor((sum + 1.0) * 0.5);");
    });
}

/// neumip_exp_minus_one of three numbers.
pub fn exp_minus_one(w: &mut Writer) {
    let of = Float(3);
    if !w.is_exact() {
        w.function(of, "neumip_exp_minus_one", &[(of, "x".into())], |w| w.line("return exp(x) - 1.0;"));
        return;
    }
    w.comment("e^x - 1 = 2^n (e^r - 1) + (2^n - 1): nothing cancels near 0.");
    w.function(of, "neumip_exp_minus_one", &[(of, "x".into())], |w| {
        let bounded = format!("clamp(x, {}, {})", w.splat(of, "-87.0"), w.splat(of, "88.0"));
        w.declare(of, "b", &bounded);
        w.declare(of, "n", &format!("floor(b * {} + 0.5)", number(std::f32::consts::LOG2_E)));
        w.declare_precise(of, "r", &format!("(b - n * {}){} * n", number(LN_2[0]), plus(-LN_2[1])));
        let tail = EXPONENTIAL.iter().rev().fold(String::new(), |sum, c| match sum.is_empty() {
            true => number(*c),
            false => format!("({sum} * r{})", plus(*c)),
        });
        w.declare(of, "e", &format!("r + r * r * {tail}"));
        let (integers, splat) = (w.make(Int(3), "n"), w.splat(Int(3), "127"));
        let scale = match w.language {
            Language::Wgsl => format!("bitcast<vec3<f32>>(({integers} + {splat}) << vec3<u32>(23u))"),
            Language::Hlsl => format!("asfloat(({integers} + {splat}) << 23)"),
            _ => format!("intBitsToFloat(({integers} + {splat}) << 23)"),
        };
        w.declare(of, "scale", &scale);
        w.line("return e * scale + (scale - 1.0);");
    });
}

/// A number to add, with its sign.
fn plus(value: f32) -> String {
    if value < 0.0 { format!(" - {}", number(-value)) } else { format!(" + {}", number(value)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the polynomial of sin(pi x) may be off: three roundings of values up to 1.
    const SINE_ERROR: f64 = 2.5e-7;
    /// What that of e^x - 1 may be off, relative to |x|.
    const EXPONENTIAL_ERROR: f64 = 2.5e-7;

    fn sine(x: f32, moved: f32) -> f32 {
        let y = x * x;
        let [s0, s1, s2, s3, s4] = SINE;
        x * ((((y * s4 + s3) * y + s2 + moved) * y + s1) * y + s0)
    }

    fn exponential(r: f32, moved: f32) -> f32 {
        let tail = EXPONENTIAL.iter().rev().fold(0.0, |sum, c| sum * r + c);
        r + r * r * (tail + moved)
    }

    #[test]
    fn polynomials_follow_float64_and_a_moved_coefficient_is_noticed() {
        let sines = |moved: f32| {
            let points = (-1000..=1000).map(|k| k as f32 / 2000.0);
            let errors = points
                .map(|x| (f64::from(sine(x, moved)) - (std::f64::consts::PI * f64::from(x)).sin()).abs());
            errors.fold(0.0, f64::max)
        };
        assert!(sines(0.0) < SINE_ERROR, "{:e}", sines(0.0));
        assert!(sines(1e-4) > SINE_ERROR);
        let exponentials = |moved: f32| {
            let points = (1..=1000).flat_map(|k| [k, -k]).map(|k| k as f32 * 0.000_346_57);
            let errors = points.map(|r| {
                let exact = f64::from(r).exp_m1();
                (f64::from(exponential(r, moved)) - exact).abs() / exact.abs()
            });
            errors.fold(0.0, f64::max)
        };
        assert!(exponentials(0.0) < EXPONENTIAL_ERROR, "{:e}", exponentials(0.0));
        assert!(exponentials(1e-4) > EXPONENTIAL_ERROR);
    }
}
