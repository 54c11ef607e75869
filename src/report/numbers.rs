//! Numbers as a reader wants them.

/// Three significant digits; plain where that is short, otherwise with an exponent.
pub(crate) fn significant(value: f64) -> String {
    if !value.is_finite() {
        return "not finite".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    // Rounding to three digits first, so that 9.999 counts as 10.0 and not as 10.00.
    let scientific = format!("{value:.2e}");
    let Some((mantissa, exponent)) = scientific.split_once('e') else { return scientific };
    let (Ok(mantissa), Ok(exponent)) = (mantissa.parse::<f64>(), exponent.parse::<i32>()) else {
        return scientific;
    };
    match exponent {
        -4..=1 => format!("{value:.*}", (2 - exponent) as usize),
        2..=5 => format!("{:.0}", mantissa * 10f64.powi(exponent)),
        _ => scientific,
    }
}

/// [`significant`] without the zeros at its end.
pub(crate) fn short(value: f64) -> String {
    let text = significant(value);
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, ""));
    if !mantissa.contains('.') {
        return text;
    }
    let mantissa = mantissa.trim_end_matches('0').trim_end_matches('.');
    if exponent.is_empty() { mantissa.into() } else { format!("{mantissa}e{exponent}") }
}

/// [`significant`], or a dash.
pub(crate) fn optional(value: Option<f64>, show: impl Fn(f64) -> String) -> String {
    value.map_or_else(|| "\u{2013}".into(), show)
}

/// Digits in groups of three.
pub(crate) fn count(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// Bytes in decimal units.
pub(crate) fn bytes(value: u64) -> String {
    let size = value as f64;
    match value {
        0..1_000 => format!("{value} B"),
        1_000..1_000_000 => format!("{} kB", significant(size / 1e3)),
        1_000_000..1_000_000_000 => format!("{} MB", significant(size / 1e6)),
        _ => format!("{} GB", significant(size / 1e9)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_digits() {
        for (value, text) in [
            (0.0, "0"),
            (1.0, "1.00"),
            (9.996, "10.0"),
            (0.123_45, "0.123"),
            (0.001_234, "0.00123"),
            (1.234e-6, "1.23e-6"),
            (12.345, "12.3"),
            (999.6, "1000"),
            (1234.5, "1230"),
            (-0.5, "-0.500"),
            (2.5e7, "2.50e7"),
            (f64::NAN, "not finite"),
        ] {
            assert_eq!(significant(value), text);
        }
    }

    #[test]
    fn short_ones_end_in_no_zero() {
        assert_eq!([0.5, 100.0, 1e-7, 0.25, 20.0].map(short), ["0.5", "100", "1e-7", "0.25", "20"]);
        assert_eq!(short(f64::NAN), "not finite");
    }

    #[test]
    fn counts_and_bytes() {
        assert_eq!([count(7), count(1_000), count(1_048_576)], ["7", "1,000", "1,048,576"]);
        assert_eq!([bytes(999), bytes(12_345), bytes(1_500_000)], ["999 B", "12.3 kB", "1.50 MB"]);
        assert_eq!(optional(None, significant), "\u{2013}");
    }
}
