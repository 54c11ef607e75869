//! One program, spelled in four languages: declarations, constructors, structs and functions by method; arithmetic, swizzles
//! and the functions whose names agree are written as they are.

use super::bindings::{Storage, WEIGHTS_WIDTH};
use super::{Language, Mode};

/// Types of values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Type {
    /// 32-bit numbers: a scalar or 2 to 4 components.
    Float(usize),
    /// What the networks compute with: 32-bit numbers, or fewer bits in the fast mode.
    Half(usize),
    /// Integers.
    Int(usize),
    /// Of ours.
    Struct(&'static str),
}

use Type::{Float, Half, Int, Struct};

/// The text so far.
pub struct Writer<'a> {
    pub language: Language,
    pub mode: Mode,
    pub storage: Storage,
    literals: Option<&'a [f32]>,
    text: String,
    depth: usize,
}

impl<'a> Writer<'a> {
    pub fn new(language: Language, mode: Mode, storage: Storage, literals: Option<&'a [f32]>) -> Self {
        Self { language, mode, storage, literals, text: String::new(), depth: 0 }
    }

    pub fn finish(self) -> String {
        self.text
    }

    /// A line of code, or an empty one.
    pub fn line(&mut self, line: impl AsRef<str>) {
        let line = line.as_ref();
        if !line.is_empty() {
            self.text.extend(std::iter::repeat_n("    ", self.depth));
            self.text += line;
        }
        self.text.push('\n');
    }

    /// Comments, a line each.
    pub fn comment(&mut self, text: impl AsRef<str>) {
        for line in text.as_ref().lines() {
            self.line(format!("// {line}").trim_end());
        }
    }

    pub fn is_exact(&self) -> bool {
        self.mode == Mode::Exact
    }

    /// How a type is called.
    pub fn name(&self, of: Type) -> String {
        let half = |n: usize, scalar: &str, vector: &str| {
            if n == 1 { scalar.into() } else { format!("{vector}{n}") }
        };
        match (of, self.language) {
            (Struct(name), _) => name.into(),
            (Half(n), _) if self.is_exact() => self.name(Float(n)),
            (Half(n), Language::GlslEs) => half(n, "mediump float", "mediump vec"),
            (Half(n), Language::Glsl) => self.name(Float(n)),
            (Half(n), Language::Wgsl | Language::Hlsl) => half(n, "NeumipHalf", "NeumipHalf"),
            (Float(1), Language::Wgsl) => "f32".into(),
            (Int(1), Language::Wgsl) => "i32".into(),
            (Float(1), _) => "float".into(),
            (Int(1), _) => "int".into(),
            (Float(n), Language::Wgsl) => format!("vec{n}<f32>"),
            (Int(n), Language::Wgsl) => format!("vec{n}<i32>"),
            (Float(n), Language::Hlsl) => format!("float{n}"),
            (Int(n), Language::Hlsl) => format!("int{n}"),
            (Float(n), _) => format!("vec{n}"),
            (Int(n), _) => format!("ivec{n}"),
        }
    }

    /// A value of a type from parts that fill it, or from one value of as many components.
    pub fn make(&self, of: Type, parts: &str) -> String {
        let name = self.name(of);
        format!("{}({parts})", name.trim_start_matches("mediump "))
    }

    /// All components the same.
    pub fn splat(&self, of: Type, value: &str) -> String {
        match (of, self.language) {
            (Float(1) | Int(1), _) => value.into(),
            (Half(_), Language::Hlsl) if !self.is_exact() => format!("({}){value}", self.name(of)),
            (Float(n) | Half(n) | Int(n), Language::Hlsl) => self.make(of, &vec![value; n].join(", ")),
            _ => self.make(of, value),
        }
    }

    /// A value as the networks compute with it, from `n` 32-bit numbers.
    pub fn half(&self, n: usize, value: &str) -> String {
        match (self.mode, self.language) {
            (Mode::Fast, Language::Wgsl | Language::Hlsl) => self.make(Half(n), value),
            _ => value.into(),
        }
    }

    /// `n` 32-bit numbers from a value as the networks compute with it.
    pub fn float(&self, n: usize, value: &str) -> String {
        match (self.mode, self.language) {
            (Mode::Fast, Language::Wgsl | Language::Hlsl) => self.make(Float(n), value),
            _ => value.into(),
        }
    }

    /// A named value.
    pub fn declare(&mut self, of: Type, name: &str, value: &str) {
        match self.language {
            Language::Wgsl => self.line(format!("let {name} = {value};")),
            _ => self.line(format!("{} {name} = {value};", self.name(of))),
        }
    }

    /// As [`Self::declare`], of a value whose roundings matter: no compiler may rearrange or fuse its operations, where the
    /// language has a word for that.
    pub fn declare_precise(&mut self, of: Type, name: &str, value: &str) {
        match (self.language, self.mode) {
            (Language::Glsl, Mode::Exact) => {
                self.line(format!("NEUMIP_PRECISE {} {name} = {value};", self.name(of)));
            }
            (Language::Hlsl, Mode::Exact) => {
                self.line(format!("precise {} {name} = {value};", self.name(of)));
            }
            _ => self.declare(of, name, value),
        }
    }

    /// A named value that is assigned later.
    pub fn variable(&mut self, of: Type, name: &str) {
        match self.language {
            Language::Wgsl => self.line(format!("var {name}: {};", self.name(of))),
            _ => self.line(format!("{} {name};", self.name(of))),
        }
    }

    /// A struct.
    pub fn structure(&mut self, name: &str, fields: &[(Type, String)]) {
        self.line(format!("struct {name} {{"));
        for (of, field) in fields {
            match self.language {
                Language::Wgsl => self.line(format!("    {field}: {},", self.name(*of))),
                _ => self.line(format!("    {} {field};", self.name(*of))),
            }
        }
        self.line(if self.language == Language::Wgsl { "}" } else { "};" });
        self.line("");
    }

    /// A function and its body.
    pub fn function(
        &mut self,
        returns: Type,
        name: &str,
        parameters: &[(Type, String)],
        body: impl FnOnce(&mut Self),
    ) {
        let each = parameters.iter().map(|(of, parameter)| match self.language {
            Language::Wgsl => format!("{parameter}: {}", self.name(*of)),
            _ => format!("{} {parameter}", self.name(*of)),
        });
        let each = each.collect::<Vec<_>>().join(", ");
        let returns = self.name(returns);
        match self.language {
            Language::Wgsl => self.line(format!("fn {name}({each}) -> {returns} {{")),
            _ => self.line(format!("{returns} {name}({each}) {{")),
        }
        self.depth += 1;
        body(self);
        self.depth -= 1;
        self.line("}");
        self.line("");
    }

    /// `yes` where the condition holds, else `no`; both are evaluated.
    pub fn choose(&self, condition: &str, yes: &str, no: &str) -> String {
        match self.language {
            Language::Wgsl => format!("select({no}, {yes}, {condition})"),
            _ => format!("({condition} ? {yes} : {no})"),
        }
    }

    /// True where weights are numbers in the source.
    pub fn has_literals(&self) -> bool {
        self.literals.is_some()
    }

    /// Components of a vector of four weights, `at` vectors after `base`.
    pub fn weight(&self, base: Option<&str>, at: usize, letters: &str) -> String {
        if let Some(block) = self.literals {
            let lane = |letter| "xyzw".find(letter).unwrap_or(0);
            let values = letters.chars().map(|l| number(block.get(4 * at + lane(l)).copied().unwrap_or(0.0)));
            let values: Vec<String> = values.collect();
            return match values.as_slice() {
                [one] => self.half(1, one),
                all => self.make(Half(all.len()), &all.join(", ")),
            };
        }
        let index = match (base, at) {
            (None, at) => format!("{at}"),
            (Some(base), 0) => base.into(),
            (Some(base), at) => format!("{base} + {at}"),
        };
        let lanes = super::network::lanes(letters);
        match (self.storage, self.language) {
            (Storage::Texture, _) => {
                let shift = WEIGHTS_WIDTH.ilog2();
                let last = WEIGHTS_WIDTH - 1;
                format!(
                    "texelFetch(neumip_weights, ivec2(({index}) & {last}, ({index}) >> {shift}), 0){lanes}"
                )
            }
            (_, Language::Hlsl) => self.half(letters.len(), &format!("neumip_weights[{index}]{lanes}")),
            _ => format!("neumip_weights[{index}]{lanes}"),
        }
    }

    /// The name of linear interpolation.
    pub fn mix(&self) -> &'static str {
        if self.language == Language::Hlsl { "lerp" } else { "mix" }
    }

    /// `value` divided by 2 to the power of `by`, both integers, not below 1.
    pub fn halved(&self, value: usize, by: &str) -> String {
        match self.language {
            Language::Wgsl => format!("max({value} >> u32({by}), 1)"),
            _ => format!("max({value} >> {by}, 1)"),
        }
    }
}

/// A number as a literal of every language: shortest digits that give the same 32 bits.
pub fn number(value: f32) -> String {
    match value.abs() {
        0.0 => "0.0".into(),
        a if (1e-4..1e7).contains(&a) => format!("{value:?}"),
        _ => {
            let text = format!("{value:e}");
            let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
            let point = if digits.contains('.') { "" } else { ".0" };
            format!("{digits}{point}e{exponent}")
        }
    }
}

/// The `k`-th letter of a vector.
pub fn letter(k: usize) -> char {
    ['x', 'y', 'z', 'w'][k % 4]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_are_the_same_numbers_and_have_a_point() {
        let mut values =
            vec![0.0, -0.0, 1.0, -25.0, 0.1, 1e-5, 123_456.79, 1.5e7, -3.4e38, f32::MIN_POSITIVE];
        values.extend((0..4000).map(|k| f32::from_bits(0x0100_0000 + k * 500_009)));
        for value in values.into_iter().filter(|v| v.is_finite()) {
            let text = number(value);
            assert_eq!(text.parse::<f32>().unwrap(), value, "{text}");
            assert!(text.contains('.') && text.bytes().all(|b| b"0123456789.e-".contains(&b)), "{text}");
        }
    }

    #[test]
    fn a_declaration_is_spelled_four_times() {
        let spelled = Language::ALL.map(|language| {
            let mut w = Writer::new(language, Mode::Fast, Storage::Constants, None);
            w.declare(Half(3), "x", &w.splat(Half(3), "0.0"));
            w.finish()
        });
        let expected = [
            "mediump vec3 x = vec3(0.0);\n",
            "vec3 x = vec3(0.0);\n",
            "let x = NeumipHalf3(0.0);\n",
            "NeumipHalf3 x = (NeumipHalf3)0.0;\n",
        ];
        assert_eq!(spelled, expected);
    }
}
