//! Wrapped bilinear lookup positions: texel centres at (i + 0.5) / N.

/// Appends the four texel indices (row-major) and weights of a wrapped bilinear lookup at `u` in an H x W texture,
/// in the order (row 0, column 0), (0, 1), (1, 0), (1, 1). `u` is expected in \[0, 1\].
pub fn bilinear(u: [f32; 2], height: usize, width: usize, index: &mut Vec<u32>, weight: &mut Vec<f32>) {
    let (j, fx) = axis(u[0], width);
    let (i, fy) = axis(u[1], height);
    for (row, wy) in [(i[0], 1.0 - fy), (i[1], fy)] {
        for (column, wx) in [(j[0], 1.0 - fx), (j[1], fx)] {
            index.push((row * width + column) as u32);
            weight.push(wx * wy);
        }
    }
}

fn axis(u: f32, size: usize) -> ([usize; 2], f32) {
    let x = u * size as f32 - 0.5;
    let low = x.floor();
    let first = (low as i64).rem_euclid(size as i64) as usize;
    ([first, (first + 1) % size], x - low)
}

/// u wrapped into \[0, 1\].
pub fn wrap(u: [f32; 2]) -> [f32; 2] {
    [u[0] - u[0].floor(), u[1] - u[1].floor()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_texel_centre_reads_one_texel_and_borders_wrap() {
        let (mut index, mut weight) = (Vec::new(), Vec::new());
        bilinear([2.5 / 5.0, 1.5 / 3.0], 3, 5, &mut index, &mut weight);
        assert_eq!(index[0], 5 + 2);
        assert!((weight[0] - 1.0).abs() < 1e-6);
        index.clear();
        bilinear([0.0, 0.0], 3, 5, &mut index, &mut weight);
        assert_eq!(index, [14, 10, 4, 0]);
        index.clear();
        bilinear([1.0, 1.0], 3, 5, &mut index, &mut weight);
        assert_eq!(index, [14, 10, 4, 0]);
    }
}
