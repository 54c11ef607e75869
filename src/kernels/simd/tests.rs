//! Every operation of every instruction set against plain scalars.

use super::*;
use half::f16;

const LANES: usize = 16;

/// Applies an operation to 16 pairs of values, lanes at a time.
struct Apply<'a>(&'a [f32; LANES], &'a [f32; LANES]);

/// Results by operation.
type Results = Vec<(&'static str, [f32; LANES])>;

impl Work for Apply<'_> {
    type Output = Results;

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Results {
        let mut all: Results = Vec::new();
        macro_rules! each {
            ($name:literal, |$a:ident, $b:ident| $value:expr) => {
                let mut out = [0.0; LANES];
                for at in (0..LANES).step_by(S::LANES) {
                    let ($a, $b) = (s.load(&self.0[at..]), s.load(&self.1[at..]));
                    s.store(&mut out[at..], $value);
                }
                all.push(($name, out));
            };
        }
        each!("add", |a, b| s.add(a, b));
        each!("sub", |a, b| s.sub(a, b));
        each!("mul", |a, b| s.mul(a, b));
        each!("div", |a, b| s.div(a, b));
        each!("fma", |a, b| s.fma(a, b, s.splat(0.5)));
        each!("max", |a, b| s.max(a, b));
        each!("min", |a, b| s.min(a, b));
        each!("sqrt", |a, _b| s.sqrt(s.mul(a, a)));
        each!("floor", |a, _b| s.floor(a));
        each!("select", |a, b| s.select(s.greater(a, b), a, s.splat(7.0)));
        each!("float", |a, _b| s.float(s.truncate(a)));
        each!("int", |a, b| {
            let sum = s.int_add(s.int_mul(s.truncate(a), s.int(3)), s.truncate(b));
            s.float(s.int_xor(s.int_and(sum, s.int(0xff)), s.int_up::<2>(s.int(1))))
        });
        each!("int less, larger, smaller", |a, b| {
            let (a, b) = (s.truncate(a), s.truncate(b));
            s.float(s.int_sub(s.int_up::<4>(s.int_max(a, b)), s.int_min(a, b)))
        });
        each!("int select", |a, b| s.float(s.int_select(s.greater(a, b), s.truncate(a), s.int(7))));
        each!("both", |a, b| s.select(s.both(s.greater(a, b), s.greater(b, s.splat(0.0))), a, b));
        each!("either", |a, b| s.select(s.either(s.greater(a, b), s.greater(b, s.splat(0.0))), a, b));
        each!("gather", |a, b| {
            let at = s.int_and(s.truncate(s.mul(b, b)), s.int(15));
            s.add(s.gather(self.0, at), s.mul(s.splat(0.0), a))
        });
        each!("gather pairs", |a, b| {
            let at = s.int_and(s.truncate(s.mul(b, b)), s.int(15));
            let (near, far) = s.gather_pairs(self.0, at);
            s.add(s.sub(near, s.add(far, far)), s.mul(s.splat(0.0), a))
        });
        each!("bits", |a, _b| s.as_float(s.int_up::<1>(s.int_down::<1>(s.bits(a)))));
        let mut rows = [s.splat(0.0); 5];
        for (i, row) in rows.iter_mut().enumerate() {
            *row = s.mul(s.load(self.0), s.splat(i as f32));
        }
        let mut five = [0.0; 5];
        s.sums(&rows, &mut five);
        let mut out = [0.0; LANES];
        for i in 0..5 {
            let lanes: f32 = self.0[..S::LANES].iter().map(|x| x * i as f32).sum();
            out[i] = five[i] - lanes;
        }
        all.push(("sums less the lanes", out));
        all
    }
}

fn values(scale: f32) -> [f32; LANES] {
    std::array::from_fn(|i| scale * ((i * 7 % LANES) as f32 - 7.3))
}

fn expected(a: &[f32; LANES], b: &[f32; LANES]) -> Results {
    let zip = |f: fn(f32, f32) -> f32| std::array::from_fn(|i| f(a[i], b[i]));
    vec![
        ("add", zip(|a, b| a + b)),
        ("sub", zip(|a, b| a - b)),
        ("mul", zip(|a, b| a * b)),
        ("div", zip(|a, b| a / b)),
        ("fma", zip(|a, b| a * b + 0.5)),
        ("max", zip(f32::max)),
        ("min", zip(f32::min)),
        ("sqrt", zip(|a, _| a.abs())),
        ("floor", zip(|a, _| a.floor())),
        ("select", zip(|a, b| if a > b { a } else { 7.0 })),
        ("float", zip(|a, _| a.trunc())),
        ("int", zip(|a, b| (((a as i32 * 3 + b as i32) & 0xff) ^ 4) as f32)),
        (
            "int less, larger, smaller",
            zip(|a, b| ((a as i32).max(b as i32) * 16 - (a as i32).min(b as i32)) as f32),
        ),
        ("int select", zip(|a, b| if a > b { a.trunc() } else { 7.0 })),
        ("both", zip(|a, b| if a > b && b > 0.0 { a } else { b })),
        ("either", zip(|a, b| if a > b || b > 0.0 { a } else { b })),
        ("gather", b.map(|b| a[(b * b) as usize & 15])),
        (
            "gather pairs",
            b.map(|b| {
                let at = ((b * b) as usize & 15).min(LANES - 2);
                a[at] - 2.0 * a[at + 1]
            }),
        ),
        ("bits", zip(|a, _| f32::from_bits(a.to_bits() & !1))),
        ("sums less the lanes", [0.0; LANES]),
    ]
}

/// A rounding of values up to 100.
const ROUNDING: f32 = 2e-5;

#[test]
fn every_operation_of_every_set_and_a_changed_value_is_noticed() {
    let (a, b) = (values(1.0), values(-0.37));
    let agrees = |got: &Results, want: &Results| {
        got.iter().zip(want).all(|((name, got), (also, want))| {
            assert_eq!(name, also);
            got.iter().zip(want).all(|(g, w)| (g - w).abs() < ROUNDING)
        })
    };
    for isa in Isa::all() {
        let got = dispatch(isa, Apply(&a, &b));
        let want = expected(&a, &b);
        for (pair, other) in got.iter().zip(&want) {
            assert!(agrees(&vec![*pair], &vec![*other]), "{} {pair:?} {other:?}", isa.name());
        }
        let mut moved = a;
        moved[3] += 0.01;
        assert!(!agrees(&dispatch(isa, Apply(&moved, &b)), &want));
    }
}

struct Texels<'a>(&'a [[f32; TEXEL]; TEXEL]);

impl Work for Texels<'_> {
    type Output = [[f32; TEXEL]; TEXEL];

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> Self::Output {
        let mut rows = [s.texel_splat(0.0); TEXEL];
        for (row, from) in rows.iter_mut().zip(self.0) {
            let (plain, half) = (s.texel_load(from), s.texel_load_half(&from.map(f16::from_f32)));
            let twice = s.texel_sub(s.texel_fma(plain, s.texel_splat(2.0), half), plain);
            *row = s.texel_mul(s.texel_add(twice, plain), s.texel_splat(0.5));
        }
        let mut out = [[0.0; TEXEL]; TEXEL];
        for (to, row) in out.iter_mut().zip(s.transpose(rows)) {
            s.texel_store(to, row);
        }
        out
    }
}

#[test]
fn texels_are_read_added_and_transposed() {
    let texels: [[f32; TEXEL]; TEXEL] = std::array::from_fn(|i| std::array::from_fn(|j| (i * 8 + j) as f32));
    for isa in Isa::all() {
        let got = dispatch(isa, Texels(&texels));
        for i in 0..TEXEL {
            for j in 0..TEXEL {
                assert_eq!(got[j][i], 1.5 * texels[i][j], "{}", isa.name());
            }
        }
    }
}

struct Poison;

impl Work for Poison {
    type Output = [bool; 4];

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> [bool; 4] {
        let lane = |v: S::F| {
            let mut out = [0.0; LANES];
            s.store(&mut out, v);
            out[0]
        };
        let nan = s.splat(f32::NAN);
        [
            lane(s.max(nan, s.splat(2.0))) == 2.0,
            lane(s.min(nan, s.splat(2.0))) == 2.0,
            lane(s.select(s.greater(nan, s.splat(0.0)), s.splat(1.0), s.splat(3.0))) == 3.0,
            lane(s.floor(s.splat(-1e30))) == -1e30,
        ]
    }
}

#[test]
fn what_is_no_number_takes_the_second_branch() {
    for isa in Isa::all() {
        assert_eq!(dispatch(isa, Poison), [true; 4], "{}", isa.name());
    }
}

struct Outside;

impl Work for Outside {
    type Output = [bool; 4];

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> [bool; 4] {
        let lane = |v: S::F| {
            let mut out = [0.0; LANES];
            s.store(&mut out, v);
            out[S::LANES - 1]
        };
        let few = [3.0, 4.0, 5.0];
        let (near, far) = s.gather_pairs(&few, s.int(-1));
        [
            lane(s.gather(&few, s.int(i32::MAX))) == 5.0,
            lane(s.gather(&few, s.int(-7))) == 5.0,
            [lane(near), lane(far)] == [4.0, 5.0],
            s.mask_bits(s.greater(s.splat(1.0), s.splat(0.0))) == ((1_u64 << S::LANES) - 1) as u32,
        ]
    }
}

#[test]
fn indices_beyond_a_slice_read_its_end() {
    for isa in Isa::all() {
        assert_eq!(dispatch(isa, Outside), [true; 4], "{}", isa.name());
    }
}

/// Bits of a mask that is true for the lanes below the limit.
struct Bits(f32);

impl Work for Bits {
    type Output = [u32; 2];

    #[inline(always)]
    fn run<S: Simd>(self, s: S) -> [u32; 2] {
        let numbers: [f32; LANES] = std::array::from_fn(|i| i as f32);
        let below = s.greater(s.splat(self.0), s.load(&numbers));
        [s.mask_bits(below), (1 << (self.0 as usize).min(S::LANES)) - 1]
    }
}

#[test]
fn bits_of_a_mask_are_its_lanes() {
    for isa in Isa::all() {
        for limit in 0..LANES {
            let [got, want] = dispatch(isa, Bits(limit as f32));
            assert_eq!(got, want, "{} {limit}", isa.name());
        }
    }
}

#[test]
fn names_are_known_and_others_refused() {
    assert_eq!(Isa::named("portable").unwrap().name(), "portable");
    assert!(Isa::named("sse9").unwrap_err().contains("use avx512, avx2 or portable"));
    assert!(Isa::all().contains(&Isa::named("portable").unwrap()));
}
