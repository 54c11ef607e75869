//! Axes: from values to places, and the round numbers beside them.

use super::metric::Unit;

/// Values beyond these have no place on a logarithm's axis; no error and no cost comes near.
const LEAST: f64 = 1e-100;
const MOST: f64 = 1e100;
/// Numbers beside an axis: more than, and about at most.
const FEW: usize = 3;
const MANY: usize = 8;

/// An axis from `from` to `to` units of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axis {
    log: bool,
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

/// True for a value that an axis can show.
pub(super) fn drawable(value: f64, log: bool) -> bool {
    if log { (LEAST..MOST).contains(&value) } else { value.abs() < MOST }
}

impl Axis {
    /// An axis with room for all values, of which there is at least one and all are [`drawable`]; a factor of 2 at
    /// least where it is a logarithm.
    pub(super) fn around(values: impl Iterator<Item = f64>, log: bool, [from, to]: [f64; 2]) -> Self {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if log {
            let widen = (2.0 / (high / low)).max(1.0).sqrt();
            let margin = widen * (high / low).powf(0.07).max(1.08);
            (low / margin, high * margin)
        } else {
            let margin = (0.07 * (high - low)).max(1e-3 * high.abs()).max(1e-6);
            (low - margin, high + margin)
        };
        Self { log, low, high, from, to }
    }

    /// Where a value stands.
    pub(super) fn place(&self, value: f64) -> f64 {
        let part = if self.log {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        self.from + part * (self.to - self.from)
    }

    /// Round values along it.
    pub(super) fn ticks(&self) -> Vec<f64> {
        let inside = |v: &f64| (self.low..=self.high).contains(v);
        if !self.log {
            return linear_ticks(self.low, self.high).into_iter().filter(inside).collect();
        }
        let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let step = (decades.clone().count() / MANY).max(1);
        let of = |mantissas: &[f64]| -> Vec<f64> {
            let all =
                decades.clone().step_by(step).flat_map(|d| mantissas.iter().map(move |m| decimal(*m, d)));
            all.filter(inside).collect()
        };
        let divisions: [&[f64]; 3] = [&[1.0], &[1.0, 2.0, 5.0], &[1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0]];
        let ticks = divisions.into_iter().map(of).find(|ticks| ticks.len() > FEW);
        ticks.unwrap_or_else(|| of(&[1.0, 1.2, 1.5, 1.7, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]))
    }
}

/// `mantissa` x 10^`exponent`, rounded once.
fn decimal(mantissa: f64, exponent: i32) -> f64 {
    format!("{mantissa}e{exponent}").parse().unwrap_or(f64::NAN)
}

fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / (MANY as f64 - 2.0);
    let exponent = rough.log10().floor() as i32;
    let steps = [1.0, 2.0, 5.0, 10.0].map(|m| decimal(m, exponent));
    let step = steps.into_iter().find(|s| *s >= rough).unwrap_or(rough);
    // Far from zero the steps may be finer than the numbers.
    if !(step > 0.0 && (low / step).abs() < 1e9) {
        return Vec::new();
    }
    ((low / step).ceil() as i64..=(high / step).floor() as i64).map(|k| decimal(k as f64, 0) * step).collect()
}

/// A number beside an axis.
pub(super) fn tick_text(value: f64, unit: Unit) -> String {
    match unit {
        Unit::Bytes => bytes(value),
        Unit::Plain => short(value),
    }
}

/// At most four digits, without zeros at the end; an exponent below a thousandth and from a million on.
pub(super) fn short(value: f64) -> String {
    let scientific = format!("{value:.3e}");
    let Some((mantissa, exponent)) = scientific.split_once('e') else { return scientific };
    let (mantissa, exponent) = (trimmed(mantissa), exponent.parse::<i32>().unwrap_or(0));
    match (value == 0.0, exponent) {
        (true, _) => "0".into(),
        (_, -3..0) => trimmed(&format!("{value:.*}", (3 - exponent) as usize)).into(),
        (_, 0..3) => trimmed(&format!("{value:.*}", (3 - exponent) as usize)).into(),
        (_, 3..6) => grouped(value),
        _ => format!("{mantissa}e{exponent}"),
    }
}

fn trimmed(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

/// A whole number with its digits in groups of three.
pub(super) fn grouped(value: f64) -> String {
    let digits = format!("{:.0}", value.abs());
    let mut out = String::from(if value < 0.0 { "-" } else { "" });
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// Bytes in decimal units.
pub(super) fn bytes(value: f64) -> String {
    match value {
        v if v < 1e3 => format!("{} B", short(v)),
        v if v < 1e6 => format!("{} kB", short(v / 1e3)),
        v if v < 1e9 => format!("{} MB", short(v / 1e6)),
        v => format!("{} GB", short(v / 1e9)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places are computed by logarithms of rounded quotients.
    const PLACE: f64 = 1e-9;

    #[test]
    fn places_follow_the_logarithm() {
        let axis = Axis { log: true, low: 1.0, high: 100.0, from: 50.0, to: 250.0 };
        assert!((axis.place(10.0) - 150.0).abs() < PLACE);
        assert!((axis.place(10.1) - 150.0).abs() > PLACE);
        let axis = Axis { log: false, ..axis };
        assert!((axis.place(50.5) - 150.0).abs() < PLACE);
    }

    #[test]
    fn ticks_are_few_round_and_inside() {
        for i in 0..300 {
            for log in [true, false] {
                let low = 1.03f64.powi(i - 150);
                let axis = Axis::around([low, low * 1.01f64.powi(i)].into_iter(), log, [0.0, 1.0]);
                let ticks = axis.ticks();
                assert!((2..=MANY + 2).contains(&ticks.len()), "{log} {axis:?}: {ticks:?}");
                assert!(ticks.iter().all(|t| (0.0..=1.0).contains(&axis.place(*t))));
                assert!(ticks.iter().all(|t| short(*t).len() < 9), "{ticks:?}");
            }
        }
        let one = Axis::around(std::iter::once(0.0), false, [0.0, 1.0]);
        assert!(one.place(0.0).is_finite());
        let far = Axis::around([1e-100, 0.99e100].into_iter(), true, [0.0, 1.0]);
        assert!((2..30).contains(&far.ticks().len()), "{:?}", far.ticks());
        assert!(drawable(1e-100, true) && ![0.0, -1.0, 1e101, f64::NAN].iter().any(|v| drawable(*v, true)));
        assert!(drawable(-1.0, false) && !drawable(f64::NAN, false) && !drawable(f64::INFINITY, false));
    }

    #[test]
    fn numbers_are_short() {
        let texts = [0.0, 0.5, 12.5, 1500.0, 200_000.0, 2e-4, 0.002, 1e7, 1.5].map(short);
        assert_eq!(texts, ["0", "0.5", "12.5", "1,500", "200,000", "2e-4", "0.002", "1e7", "1.5"]);
        assert_eq!([500.0, 2e3, 1.5e6, 3e9].map(bytes), ["500 B", "2 kB", "1.5 MB", "3 GB"]);
        assert_eq!(grouped(262_144.0), "262,144");
    }
}
