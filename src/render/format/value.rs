//! Values that are written as one number or three.

use serde::{Deserialize, Deserializer, Serialize};

/// Linear RGB; written as three numbers, or one for all three.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rgb(pub [f32; 3]);

/// A factor an axis; written as three numbers, or one for all three.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scale(pub [f64; 3]);

impl Default for Scale {
    fn default() -> Self {
        Self([1.0; 3])
    }
}

/// Three numbers or one for all three.
struct OneOrThree;

impl<'de> serde::de::Visitor<'de> for OneOrThree {
    type Value = [f64; 3];

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("a number or three numbers")
    }

    fn visit_f64<E>(self, v: f64) -> std::result::Result<[f64; 3], E> {
        Ok([v; 3])
    }

    fn visit_i64<E>(self, v: i64) -> std::result::Result<[f64; 3], E> {
        Ok([v as f64; 3])
    }

    fn visit_u64<E>(self, v: u64) -> std::result::Result<[f64; 3], E> {
        Ok([v as f64; 3])
    }

    fn visit_seq<A: serde::de::SeqAccess<'de>>(self, sequence: A) -> std::result::Result<[f64; 3], A::Error> {
        Deserialize::deserialize(serde::de::value::SeqAccessDeserializer::new(sequence))
    }
}

impl<'de> Deserialize<'de> for Rgb {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        Ok(Self(deserializer.deserialize_any(OneOrThree)?.map(|v| v as f32)))
    }
}

impl<'de> Deserialize<'de> for Scale {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        Ok(Self(deserializer.deserialize_any(OneOrThree)?))
    }
}
