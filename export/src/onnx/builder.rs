//! A graph under construction: nodes in order, constants, and names that say what a value is.

use super::Port;
use super::proto::{self, Extent};
use half::f16;
use std::collections::BTreeMap;

/// A value of the graph: an input, a constant or a node's output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Value(String);

/// Nodes and constants so far. Node and value names start with the scope, as `parallax/mlp.0`.
pub struct Builder {
    graph: proto::Graph,
    scope: String,
    taken: BTreeMap<String, usize>,
}

impl Builder {
    /// An empty graph.
    pub fn new(name: &str, doc: &str) -> Self {
        let graph = proto::Graph { name: name.into(), doc_string: doc.into(), ..Default::default() };
        Self { graph, scope: String::new(), taken: BTreeMap::new() }
    }

    /// Names what follows `scope/...`.
    pub fn scope(&mut self, scope: &str) {
        self.scope = scope.into();
    }

    /// Declares an input.
    pub fn input(&mut self, of: &Port) -> Value {
        self.graph.input.push(port(of));
        Value(of.name.into())
    }

    /// Declares `value` as an output.
    pub fn output(&mut self, of: &Port, value: &Value) {
        self.graph.output.push(port(of));
        self.push("Identity", of.name.into(), &[value], vec![of.name.into()], Vec::new());
    }

    /// A constant of floats, named as given.
    pub fn floats(&mut self, name: &str, shape: &[usize], data: &[f32]) -> Value {
        let raw = data.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(name, proto::FLOAT, shape, raw)
    }

    /// A constant of 16-bit floats, the nearest to the data, named as given.
    pub fn halfs(&mut self, name: &str, shape: &[usize], data: &[f32]) -> Value {
        let raw = data.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
        self.constant(name, proto::FLOAT16, shape, raw)
    }

    /// A constant of 8-bit integers, named as given.
    pub fn bytes(&mut self, name: &str, shape: &[usize], data: impl Iterator<Item = i8>) -> Value {
        self.constant(name, proto::INT8, shape, data.map(|v| v as u8).collect())
    }

    /// A constant of 32-bit integers, named as given.
    pub fn int32s(&mut self, name: &str, shape: &[usize], data: &[i32]) -> Value {
        let raw = data.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(name, proto::INT32, shape, raw)
    }

    /// A float scalar; equal ones are stored once.
    pub fn scalar(&mut self, value: f32) -> Value {
        self.floats(&format!("scalar {value}"), &[], &[value])
    }

    /// A 32-bit integer scalar; equal ones are stored once.
    pub fn int32(&mut self, value: i32) -> Value {
        self.int32s(&format!("int {value}"), &[], &[value])
    }

    /// A 64-bit integer scalar, as sizes are; equal ones are stored once.
    pub fn int64(&mut self, value: i64) -> Value {
        self.constant(&format!("size {value}"), proto::INT64, &[], value.to_le_bytes().to_vec())
    }

    /// The 64-bit axes or sizes that some operators take as an input; equal ones are stored once.
    pub fn axes(&mut self, axes: &[i64]) -> Value {
        let raw = axes.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.constant(&format!("axes {axes:?}"), proto::INT64, &[axes.len()], raw)
    }

    fn constant(&mut self, name: &str, data_type: i32, shape: &[usize], raw_data: Vec<u8>) -> Value {
        if !self.graph.initializer.iter().any(|t| t.name == name) {
            let dims = shape.iter().map(|&side| side as i64).collect();
            self.graph.initializer.push(proto::Tensor { dims, data_type, name: name.into(), raw_data });
        }
        Value(name.into())
    }

    /// A node with one output, called `scope/name` (with a number where that is taken).
    pub fn node(&mut self, op: &str, name: &str, inputs: &[&Value], attributes: &[(&str, i64)]) -> Value {
        self.node_of(op, name, inputs, attributes, &[])
    }

    /// As [`Builder::node`], with attributes that are lists too.
    pub fn node_of(
        &mut self,
        op: &str,
        name: &str,
        inputs: &[&Value],
        attributes: &[(&str, i64)],
        lists: &[(&str, &[i64])],
    ) -> Value {
        let name = self.unique(name);
        let one = |(name, i): &(&str, i64)| proto::Attribute {
            name: (*name).into(),
            i: Some(*i),
            ints: Vec::new(),
            r#type: proto::ATTRIBUTE_INT,
        };
        let list = |(name, ints): &(&str, &[i64])| proto::Attribute {
            name: (*name).into(),
            i: None,
            ints: ints.to_vec(),
            r#type: proto::ATTRIBUTE_INTS,
        };
        let attributes = attributes.iter().map(one).chain(lists.iter().map(list)).collect();
        self.push(op, name.clone(), inputs, vec![name.clone()], attributes);
        Value(name)
    }

    /// Parts of these extents along an axis.
    pub fn split(&mut self, name: &str, value: &Value, axis: i64, extents: &[i64]) -> Vec<Value> {
        let sizes = self.axes(extents);
        let name = self.unique(name);
        let outputs: Vec<String> = (0..extents.len()).map(|k| format!("{name}.{k}")).collect();
        let axis = proto::Attribute {
            name: "axis".into(),
            i: Some(axis),
            ints: Vec::new(),
            r#type: proto::ATTRIBUTE_INT,
        };
        self.push("Split", name, &[value, &sizes], outputs.clone(), vec![axis]);
        outputs.into_iter().map(Value).collect()
    }

    /// Two parts of these extents along an axis.
    pub fn split_in_two(
        &mut self,
        name: &str,
        value: &Value,
        axis: i64,
        extents: [i64; 2],
    ) -> (Value, Value) {
        match self.split(name, value, axis, &extents).as_slice() {
            [first, second] => (first.clone(), second.clone()),
            _ => unreachable!("two extents give two parts"),
        }
    }

    fn push(
        &mut self,
        op: &str,
        name: String,
        inputs: &[&Value],
        output: Vec<String>,
        attribute: Vec<proto::Attribute>,
    ) {
        let input = inputs.iter().map(|v| v.0.clone()).collect();
        self.graph.node.push(proto::Node { input, output, name, op_type: op.into(), attribute });
    }

    fn unique(&mut self, name: &str) -> String {
        let full = if self.scope.is_empty() { name.into() } else { format!("{}/{name}", self.scope) };
        let count = self.taken.entry(full.clone()).or_insert(0);
        *count += 1;
        if *count == 1 { full } else { format!("{full}~{count}") }
    }

    /// The graph's message.
    pub fn finish(self) -> proto::Graph {
        self.graph
    }

    /// a + b.
    pub fn add(&mut self, name: &str, a: &Value, b: &Value) -> Value {
        self.node("Add", name, &[a, b], &[])
    }

    /// a - b.
    pub fn sub(&mut self, name: &str, a: &Value, b: &Value) -> Value {
        self.node("Sub", name, &[a, b], &[])
    }

    /// a * b.
    pub fn mul(&mut self, name: &str, a: &Value, b: &Value) -> Value {
        self.node("Mul", name, &[a, b], &[])
    }

    /// a * factor.
    pub fn scale(&mut self, name: &str, a: &Value, factor: f32) -> Value {
        let factor = self.scalar(factor);
        self.mul(name, a, &factor)
    }

    /// 1 - a.
    pub fn one_minus(&mut self, name: &str, a: &Value) -> Value {
        let one = self.scalar(1.0);
        self.sub(name, &one, a)
    }

    /// floor(a).
    pub fn floor(&mut self, name: &str, a: &Value) -> Value {
        self.node("Floor", name, &[a], &[])
    }

    /// a - floor(a / period) * period, of whole numbers.
    pub fn wrap(&mut self, name: &str, a: &Value, period: &Value) -> Value {
        // Engines divide by multiplying with the reciprocal, and 47 times 1 / 47 is less than 1: from the middle between
        // two whole numbers no rounding reaches the next turn.
        let half = self.scalar(0.5);
        let middle = self.add(&format!("{name}.middle"), a, &half);
        let ratio = self.node("Div", &format!("{name}.ratio"), &[&middle, period], &[]);
        let turns = self.floor(&format!("{name}.turns"), &ratio);
        let whole = self.mul(&format!("{name}.whole"), &turns, period);
        self.sub(name, a, &whole)
    }

    /// a, no less than low.
    pub fn at_least(&mut self, name: &str, a: &Value, low: f32) -> Value {
        let low = self.scalar(low);
        self.node("Clip", name, &[a, &low], &[])
    }

    /// a within \[low, high\].
    pub fn clip(&mut self, name: &str, a: &Value, low: f32, high: f32) -> Value {
        let (low, high) = (self.scalar(low), self.scalar(high));
        self.node("Clip", name, &[a, &low, &high], &[])
    }

    /// Joins along an axis; one part is passed through.
    pub fn concat(&mut self, name: &str, parts: &[&Value], axis: i64) -> Value {
        match parts {
            [one] => (*one).clone(),
            _ => self.node("Concat", name, parts, &[("axis", axis)]),
        }
    }

    /// The columns \[N, 1\] of a matrix.
    pub fn columns(&mut self, name: &str, value: &Value, count: usize) -> Vec<Value> {
        self.split(name, value, 1, &vec![1; count])
    }

    /// Removes axes of extent 1.
    pub fn squeeze(&mut self, name: &str, a: &Value, axes: &[i64]) -> Value {
        let axes = self.axes(axes);
        self.node("Squeeze", name, &[a, &axes], &[])
    }

    /// Inserts axes of extent 1.
    pub fn unsqueeze(&mut self, name: &str, a: &Value, axes: &[i64]) -> Value {
        let axes = self.axes(axes);
        self.node("Unsqueeze", name, &[a, &axes], &[])
    }

    /// Row sums \[N, 1\] of a matrix.
    pub fn row_sum(&mut self, name: &str, a: &Value) -> Value {
        let axes = self.axes(&[1]);
        self.node("ReduceSum", name, &[a, &axes], &[("keepdims", 1)])
    }

    /// The integer part as 32-bit integers.
    pub fn int32_of(&mut self, name: &str, a: &Value) -> Value {
        self.node("Cast", name, &[a], &[("to", i64::from(proto::INT32))])
    }

    /// The same values as 32-bit floats.
    pub fn float_of(&mut self, name: &str, a: &Value) -> Value {
        self.node("Cast", name, &[a], &[("to", i64::from(proto::FLOAT))])
    }

    /// Rows of a table.
    pub fn gather(&mut self, name: &str, table: &Value, rows: &Value) -> Value {
        self.node("Gather", name, &[table, rows], &[("axis", 0)])
    }
}

fn port(of: &Port) -> proto::ValueInfo {
    let named = of.layout.extents().iter().map(|name| Extent::Named((*name).into()));
    let extents = named.chain(of.columns.iter().map(|&c| Extent::Fixed(c as i64)));
    let dim = extents.map(|extent| proto::Dimension { extent: Some(extent) }).collect();
    proto::ValueInfo {
        name: of.name.into(),
        r#type: Some(proto::Type {
            tensor_type: Some(proto::TensorType {
                elem_type: proto::FLOAT,
                shape: Some(proto::Shape { dim }),
            }),
        }),
        doc_string: of.meaning.into(),
    }
}
