//! The naive lookup: each query is answered at the nearest whole level.

use crate::error::Result;
use crate::query::{QueryBuffer, Reflectance, RgbImage};

/// Whoever answers, asked at whole levels.
pub(super) struct Rounded<'a>(pub &'a dyn Reflectance);

impl Reflectance for Rounded<'_> {
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
        let mut whole = queries.clone();
        // Half a level goes to the coarser one, as round() does.
        whole.level.iter_mut().for_each(|level| *level = level.round());
        self.0.evaluate(&whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Level;

    impl Reflectance for Level {
        fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage> {
            let pixels = queries.level.iter().map(|level| [*level; 3]).collect();
            Ok(RgbImage { height: queries.height(), width: queries.width(), pixels })
        }
    }

    #[test]
    fn levels_are_rounded_to_the_nearest() {
        let of = |level: f32| {
            let queries = QueryBuffer::slice(1, 1, [0.0; 2], [0.0; 2], level);
            Rounded(&Level).evaluate(&queries).unwrap().pixels[0][0]
        };
        assert_eq!([of(0.4), of(0.5), of(2.6)], [0.0, 1.0, 3.0]);
    }
}
