//! The sRGB transfer function (IEC 61966-2-1), both ways.

/// Linear light, clamped to \[0, 1\], as sRGB in \[0, 1\].
pub fn encoded(linear: f32) -> f32 {
    let x = linear.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// The same as 8 bits.
pub fn encode(linear: f32) -> u8 {
    (encoded(linear) * 255.0).round() as u8
}

/// Linear light of an sRGB value in \[0, 1\].
pub fn decode(value: f32) -> f32 {
    let v = f64::from(value);
    (if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_meet_published_values() {
        assert_eq!([encode(-1.0), encode(0.0), encode(1.0), encode(7.0)], [0, 0, 255, 255]);
        assert_eq!([encode(0.214), encode(0.5), encode(0.002)], [127, 188, 7]);
        assert_eq!([decode(0.0), decode(1.0)], [0.0, 1.0]);
        // Mid grey 188 / 255 is half the light, to the three digits in which it is usually quoted.
        assert!((decode(188.0 / 255.0) - 0.5029).abs() < 1e-4);
        assert!((0..=255).all(|v| encode(decode(v as f32 / 255.0)) == v as u8));
    }
}
