//! Square tileable textures of N channels, read bilinearly between texel centres.

/// `side * side` texels, row by row. A side of 1 is a constant.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture<const N: usize> {
    side: usize,
    texels: Vec<[f32; N]>,
}

impl<const N: usize> Texture<N> {
    /// The same value everywhere.
    pub fn constant(value: [f32; N]) -> Self {
        Self { side: 1, texels: vec![value] }
    }

    /// A texture from its texels; None unless there are `side * side` >= 1 of them.
    pub fn new(side: usize, texels: Vec<[f32; N]>) -> Option<Self> {
        (side > 0 && texels.len() == side * side).then_some(Self { side, texels })
    }

    /// Texels a side.
    pub fn side(&self) -> usize {
        self.side
    }

    /// The texels, row by row.
    pub fn texels(&self) -> &[[f32; N]] {
        &self.texels
    }

    /// The value at (x, y) in tile widths, any finite position.
    pub fn at(&self, x: f64, y: f64) -> [f32; N] {
        if self.side == 1 {
            return self.texels[0];
        }
        let split = |p: f64| {
            let place = (p - p.floor()) * self.side as f64 - 0.5;
            let floor = place.floor();
            let first = if floor < 0.0 { self.side - 1 } else { (floor as usize).min(self.side - 1) };
            let second = if first + 1 == self.side { 0 } else { first + 1 };
            (first, second, (place - floor) as f32)
        };
        let ((j0, j1, u), (i0, i1, v)) = (split(x), split(y));
        let texel = |i: usize, j: usize| &self.texels[i * self.side + j];
        let (t00, t10, t01, t11) = (texel(i0, j0), texel(i0, j1), texel(i1, j0), texel(i1, j1));
        // In this form four equal texels give exactly their value.
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        std::array::from_fn(|c| mix(mix(t00[c], t10[c], u), mix(t01[c], t11[c], u), v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_are_exact_and_borders_wrap() {
        let texture = Texture::new(2, vec![[0.0], [1.0], [2.0], [3.0]]).unwrap();
        assert_eq!(texture.at(0.25, 0.25), [0.0]);
        assert_eq!(texture.at(0.75, 0.75), [3.0]);
        assert_eq!(texture.at(0.5, 0.5), [1.5]);
        assert_eq!(texture.at(0.0, 0.25), [0.5]);
        assert_eq!(texture.at(-2.0, 1.25), [0.5]);
        assert!(Texture::new(2, vec![[0.0]; 3]).is_none());
    }
}
