//! What is asked and what is answered. The conventions of the whole project live here.
//!
//! - u in [0, 1)^2 repeats; texel (row i, column j) has its centre at ((j + 0.5) / W, (i + 0.5) / H).
//!   u is where the view ray meets the reference plane z = 0.
//! - wi points to the light, wo to the viewer, both away from the surface, unit length, z along the normal.
//!   They are stored as (x, y) with z = sqrt(1 - x^2 - y^2). A pair with x^2 + y^2 >= 1 is on or below the horizon,
//!   where every answer is 0; [`project`] folds a downward unit vector to length 2 - sqrt(x^2 + y^2), outside the disc.
//! - level 0 is the finest texel; a footprint of s texels has level log2(s); levels are continuous and are clamped
//!   to what the answerer has.
//! - RGB is linear and is f cos(theta_i) averaged over the footprint: radiance under a distant light that gives
//!   irradiance 1 on a plane facing it.

pub mod grid;

use crate::error::{Error, Result};

/// An H x W grid of queries, row by row. Vectors all have `height * width` entries.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct QueryBuffer {
    height: usize,
    width: usize,
    /// Positions; any finite value, wrapped by the answerer.
    pub u: Vec<[f32; 2]>,
    /// Light directions.
    pub wi: Vec<[f32; 2]>,
    /// View directions.
    pub wo: Vec<[f32; 2]>,
    /// Levels.
    pub level: Vec<f32>,
}

impl QueryBuffer {
    /// A buffer from its parts.
    ///
    /// # Errors
    /// `Config` if a part has not `height * width` entries or a value is not finite.
    pub fn new(
        height: usize,
        width: usize,
        u: Vec<[f32; 2]>,
        wi: Vec<[f32; 2]>,
        wo: Vec<[f32; 2]>,
        level: Vec<f32>,
    ) -> Result<Self> {
        let n = height * width;
        for (field, len) in [("u", u.len()), ("wi", wi.len()), ("wo", wo.len()), ("level", level.len())] {
            if len != n {
                return Err(Error::config(
                    format!("query.{field}"),
                    format!("has {len} entries where height x width is {n}"),
                ));
            }
        }
        for (field, values) in [("u", &u), ("wi", &wi), ("wo", &wo)] {
            if let Some(i) = values.iter().position(|v| !(v[0].is_finite() && v[1].is_finite())) {
                return Err(Error::config(format!("query.{field}[{i}]"), "is not finite"));
            }
        }
        if let Some(i) = level.iter().position(|v| !v.is_finite()) {
            return Err(Error::config(format!("query.level[{i}]"), "is not finite"));
        }
        Ok(Self { height, width, u, wi, wo, level })
    }

    /// The whole tile from texel centre to texel centre of an H x W grid, under one pair of directions.
    pub fn slice(height: usize, width: usize, wi: [f32; 2], wo: [f32; 2], level: f32) -> Self {
        let n = height * width;
        let u = (0..n)
            .map(|k| [((k % width) as f32 + 0.5) / width as f32, ((k / width) as f32 + 0.5) / height as f32])
            .collect();
        Self { height, width, u, wi: vec![wi; n], wo: vec![wo; n], level: vec![level; n] }
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.level.len()
    }

    /// True if nothing is asked.
    pub fn is_empty(&self) -> bool {
        self.level.is_empty()
    }

    /// The queries `start..end` as a buffer of one row.
    pub fn range(&self, start: usize, end: usize) -> Self {
        Self {
            height: 1,
            width: end - start,
            u: self.u[start..end].to_vec(),
            wi: self.wi[start..end].to_vec(),
            wo: self.wo[start..end].to_vec(),
            level: self.level[start..end].to_vec(),
        }
    }
}

/// Linear RGB answers, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RgbImage {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// `height * width` pixels.
    pub pixels: Vec<[f32; 3]>,
}

/// Which queries an answerer can take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Support {
    /// Every query on its own.
    Pointwise,
    /// Only regular grids ([`grid`]), since an answer depends on the queries around it.
    Neighbourhood {
        /// How far away they lie at most, in samples.
        radius: usize,
        /// Texels of the tile, \[height, width\].
        resolution: [usize; 2],
    },
}

impl Support {
    /// The support of a decoder that reads queries within `radius`, or each one alone, on a tile of so many texels.
    pub fn of(radius: Option<usize>, resolution: [usize; 2]) -> Self {
        radius.map_or(Self::Pointwise, |radius| Self::Neighbourhood { radius, resolution })
    }

    /// Checks that an answerer of this kind takes these queries.
    ///
    /// # Errors
    /// `Config`, naming the first query that it refuses and saying what it needs.
    pub fn check(self, queries: &QueryBuffer) -> Result<()> {
        match self {
            Self::Pointwise => Ok(()),
            Self::Neighbourhood { radius, resolution } => {
                grid::parts(queries, radius, resolution).map(|_| ())
            }
        }
    }
}

/// Whatever answers queries: the reference surface, a candle model, fused kernels.
pub trait Reflectance: Sync {
    /// Which queries it can take.
    fn support(&self) -> Support {
        Support::Pointwise
    }

    /// Answers every query of the buffer; the image has the buffer's shape.
    ///
    /// # Errors
    /// Whatever keeps the answerer from answering.
    fn evaluate(&self, queries: &QueryBuffer) -> Result<RgbImage>;
}

/// True above the horizon.
pub fn above_horizon(w: [f32; 2]) -> bool {
    w[0] * w[0] + w[1] * w[1] < 1.0
}

/// The unit vector of a stored direction; z is 0 on or below the horizon.
pub fn unit(w: [f32; 2]) -> [f32; 3] {
    [w[0], w[1], (1.0 - w[0] * w[0] - w[1] * w[1]).max(0.0).sqrt()]
}

/// The stored form of a unit vector; downward ones land outside the unit disc.
pub fn project(w: [f32; 3]) -> [f32; 2] {
    if w[2] > 0.0 {
        return [w[0], w[1]];
    }
    let length = (w[0] * w[0] + w[1] * w[1]).sqrt();
    if length == 0.0 {
        return [2.0, 0.0];
    }
    let scale = (2.0 - length) / length;
    [w[0] * scale, w[1] * scale]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projection_keeps_the_side_of_the_horizon() {
        assert!(above_horizon(project([0.6, 0.0, 0.8])));
        assert!(!above_horizon(project([0.6, 0.0, -0.8])));
        assert!(!above_horizon(project([0.0, 0.0, -1.0])));
        assert!(!above_horizon(project([1.0, 0.0, 0.0])));
    }

    #[test]
    fn poison_is_named() {
        let error = QueryBuffer::new(1, 1, vec![[f32::NAN, 0.0]], vec![[0.0; 2]], vec![[0.0; 2]], vec![0.0]);
        assert!(error.unwrap_err().to_string().contains("query.u[0]"));
        let error = QueryBuffer::new(1, 2, vec![[0.0; 2]], vec![[0.0; 2]], vec![[0.0; 2]], vec![0.0]);
        assert!(error.is_err());
    }
}
