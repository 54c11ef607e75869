//! Fully connected layers on values that stay in registers: a function a layer gives four outputs at a time, as dot products
//! of the weight's rows with vectors of four inputs.

use super::writer::{Type, Type::Float, Type::Half, Type::Int, Writer, letter};
use crate::config::{DECODER_MLP, OFFSET_MLP};
use crate::weights::Layer;

/// Up to four inputs that share a vector of every weight's row.
struct Register {
    /// Which vector of the row.
    vector: usize,
    /// Letters of its components.
    lanes: String,
}

/// The inputs of a layer that are known at one time.
pub struct Part<'a> {
    layer: &'a Layer,
    /// What the function's name ends in.
    suffix: &'a str,
    registers: Vec<Register>,
    /// Whether the bias is added.
    biased: bool,
}

impl<'a> Part<'a> {
    /// The whole layer.
    pub fn whole(layer: &'a Layer) -> Self {
        Self::of(layer, "", 0..layer.inputs, true)
    }

    /// Some of the inputs.
    pub fn of(layer: &'a Layer, suffix: &'a str, inputs: impl Iterator<Item = usize>, biased: bool) -> Self {
        let mut registers: Vec<Register> = Vec::new();
        for input in inputs {
            match registers.last_mut() {
                Some(last) if last.vector == input / 4 => last.lanes.push(letter(input)),
                _ => registers.push(Register { vector: input / 4, lanes: letter(input).into() }),
            }
        }
        Self { layer, suffix, registers, biased }
    }

    fn name(&self) -> String {
        let network = match self.layer.network.as_str() {
            OFFSET_MLP => "offset",
            DECODER_MLP => "decoder",
            _ => "sampler",
        };
        format!("neumip_{network}{}{}", self.layer.layer, self.suffix)
    }

    /// The functions: of four outputs, and of those that remain.
    pub fn functions(&self, w: &mut Writer) {
        let (whole, rest) = (self.layer.outputs / 4, self.layer.outputs % 4);
        if w.has_literals() {
            (0..whole)
                .for_each(|group| self.function(w, &format!("{}_{group}", self.name()), 4, Some(group)));
        } else if whole > 0 {
            self.function(w, &self.name(), 4, None);
        }
        if rest > 0 {
            self.function(w, &format!("{}_last", self.name()), rest, Some(whole));
        }
    }

    fn function(&self, w: &mut Writer, name: &str, rows: usize, group: Option<usize>) {
        let (stride, weight, bias) =
            (self.layer.padded_inputs / 4, self.layer.weight / 4, self.layer.bias / 4);
        let mut parameters: Vec<(Type, String)> = match group {
            None => vec![(Int(1), "four".into())],
            Some(_) => Vec::new(),
        };
        let registers = self.registers.iter().enumerate();
        parameters.extend(registers.map(|(k, r)| (Half(r.lanes.len()), format!("x{k}"))));
        w.function(Half(rows), name, &parameters, |w| {
            let (base, start) = match group {
                None => (Some("row"), 0),
                Some(group) => (None, weight + group * 4 * stride),
            };
            if group.is_none() {
                w.declare(Int(1), "row", &format!("four * {} + {weight}", 4 * stride));
            }
            let bias = match (self.biased, group) {
                (false, _) => String::new(),
                (true, None) => format!("{} + ", w.weight(Some("four"), bias, "xyzw")),
                (true, Some(group)) => format!("{} + ", w.weight(None, bias + group, &"xyzw"[..rows])),
            };
            let sums = (0..rows).map(|row| {
                let terms = self.registers.iter().enumerate().map(|(k, register)| {
                    let weight = w.weight(base, start + row * stride + register.vector, &register.lanes);
                    match register.lanes.len() {
                        1 => format!("{weight} * x{k}"),
                        _ => format!("dot({weight}, x{k})"),
                    }
                });
                terms.collect::<Vec<_>>().join(" + ")
            });
            let sums: Vec<String> = sums.collect();
            if rows == 1 {
                w.line(format!("return {bias}{};", sums[0]));
            } else {
                for (row, sum) in sums.iter().enumerate() {
                    w.declare(Half(1), &format!("y{row}"), sum);
                }
                let all: Vec<String> = (0..rows).map(|row| format!("y{row}")).collect();
                let all = w.make(Half(rows), &all.join(", "));
                w.line(format!("return {bias}{all};"));
            }
        });
    }

    /// Declares vectors `prefix`0, ... of the values `inputs` of the part's inputs, in order; their names.
    pub fn gather(&self, w: &mut Writer, prefix: &str, inputs: &[String]) -> Vec<String> {
        let mut rest = inputs;
        let mut names = Vec::new();
        for (k, register) in self.registers.iter().enumerate() {
            let (these, after) = rest.split_at(register.lanes.len().min(rest.len()));
            rest = after;
            let joined = joined(these);
            let value = match joined.as_slice() {
                [one] => one.clone(),
                parts => w.make(Float(these.len()), &parts.join(", ")),
            };
            let of = Half(these.len());
            let value = w.half(these.len(), &value);
            let name = format!("{prefix}{k}");
            w.declare(of, &name, &value);
            names.push(name);
        }
        names
    }

    /// Declares the layer's outputs `prefix`0, ..., four each, of the part's `inputs`; `plus` is added to each, and negative
    /// ones are cut off where it is `rectified`.
    pub fn call(
        &self,
        w: &mut Writer,
        prefix: &str,
        inputs: &[String],
        plus: Option<&str>,
        rectified: bool,
    ) -> Vec<String> {
        let whole = self.layer.outputs / 4;
        let inputs = inputs.join(", ");
        let widths = output_widths(self.layer);
        for (group, width) in widths.iter().enumerate() {
            let mut value = match group < whole {
                true if w.has_literals() => format!("{}_{group}({inputs})", self.name()),
                true => format!("{}({group}, {inputs})", self.name()),
                false => format!("{}_last({inputs})", self.name()),
            };
            if let Some(plus) = plus {
                value = format!("{plus}{group} + {value}");
            }
            if rectified {
                let zero = match width {
                    1 => w.half(1, "0.0"),
                    _ => w.splat(Half(*width), "0.0"),
                };
                value = format!("max({value}, {zero})");
            }
            w.declare(Half(*width), &format!("{prefix}{group}"), &value);
        }
        (0..widths.len()).map(|group| format!("{prefix}{group}")).collect()
    }
}

/// Widths of the vectors that a layer's outputs come in.
pub fn output_widths(layer: &Layer) -> Vec<usize> {
    (0..layer.outputs).step_by(4).map(|first| (layer.outputs - first).min(4)).collect()
}

/// The layers after the first, from its outputs to the last layer's, one name an output.
pub fn rest(w: &mut Writer, layers: &[&Layer], first: Vec<String>, letters: [char; 2]) -> Vec<String> {
    let mut values = first;
    for (k, layer) in layers.iter().enumerate() {
        let last = k + 1 == layers.len();
        let prefix = if last { format!("{}", letters[1]) } else { format!("{}{}_", letters[0], k + 1) };
        values = Part::whole(layer).call(w, &prefix, &values, None, !last);
    }
    let Some(last) = layers.last() else { return values };
    let widths = output_widths(last);
    let each = values.iter().zip(&widths).flat_map(|(value, width)| {
        (0..*width).map(move |k| match width {
            1 => value.clone(),
            _ => format!("{value}.{}", letter(k)),
        })
    });
    each.collect()
}

/// A swizzle, where it is not of all four.
pub fn lanes(letters: &str) -> String {
    if letters == "xyzw" { String::new() } else { format!(".{letters}") }
}

/// Neighbours of one vector as one value: a.x, a.y, b.x becomes a.xy, b.x.
pub fn joined(values: &[String]) -> Vec<String> {
    let mut runs: Vec<(String, String)> = Vec::new();
    for value in values {
        let (base, lane) = value.rsplit_once('.').unwrap_or((value, ""));
        match runs.last_mut() {
            Some((last, lanes)) if last == base && !lane.is_empty() => *lanes += lane,
            _ => runs.push((base.into(), lane.into())),
        }
    }
    let name = |(base, letters): (String, String)| match letters.as_str() {
        "" => base,
        letters => format!("{base}{}", lanes(letters)),
    };
    runs.into_iter().map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_of_one_vector_are_written_as_one_value() {
        let of = |values: &[&str]| joined(&values.iter().map(|v| v.to_string()).collect::<Vec<_>>());
        assert_eq!(of(&["a.x", "a.y", "a.z", "a.w"]), ["a"]);
        assert_eq!(of(&["a.z", "a.w", "b.x", "c"]), ["a.zw", "b.x", "c"]);
        assert_eq!(of(&["c", "c"]), ["c", "c"]);
    }

    #[test]
    fn inputs_keep_their_place_in_the_rows() {
        let layer = Layer {
            network: DECODER_MLP.into(),
            layer: 0,
            inputs: 11,
            outputs: 5,
            padded_inputs: 16,
            padded_outputs: 16,
            weight: 0,
            bias: 256,
        };
        let part = Part::of(&layer, "", (2..5).chain(9..11), true);
        let places: Vec<(usize, &str)> =
            part.registers.iter().map(|r| (r.vector, r.lanes.as_str())).collect();
        assert_eq!(places, [(0, "zw"), (1, "x"), (2, "yz")]);
        assert_eq!(output_widths(&layer), [4, 1]);
    }
}
