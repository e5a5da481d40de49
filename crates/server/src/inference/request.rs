//! An inference request: JSON that describes tensors, and holds their numbers or is followed by them.

use std::fmt;

use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error, SeqAccess, Visitor};
use serde_json::value::RawValue;
use sha2::{Digest, Sha256};

use super::bounded::{Few, Parameters, or_null};
use super::reply::Reply;
use super::{Datatype, TENSOR, options};
use crate::problem::Problem;
use densecloud::Options;
use densecloud_cloud::Position;

/// A request that fits the model.
#[derive(Debug)]
pub(super) struct Request<'a> {
    /// Points in, as its shape claims.
    pub(super) points: u64,
    /// Whether its shape has one dimension more, of one cloud.
    batched: bool,
    pub(super) options: Options,
    /// What its answer must know of it.
    pub(super) reply: Reply,
    data: Data<'a>,
}

/// Where the numbers are.
#[derive(Debug)]
enum Data<'a> {
    /// In the JSON, not yet looked at.
    Json(&'a RawValue),
    /// After it: so many bytes.
    Binary(u64),
}

/// Parameters of a request that other servers have and that ask for nothing which could be done here: what a scheduler,
/// a codec or a stateful model would go by. Any others are refused, so that none of ours is misspelt unnoticed.
pub(crate) const HINTS: [&str; 7] =
    ["content_type", "headers", "priority", "sequence_end", "sequence_id", "sequence_start", "timeout"];

/// Whether the output shall be binary.
const BINARY: &str = "binary_data_output";

fn is_hint(name: &str) -> bool {
    HINTS.contains(&name) || name.starts_with("triton_")
}

/// What a tensor's parameters ask for that would change what is sent, and where to.
const UNSUPPORTED: [&str; 4] =
    ["classification", "shared_memory_byte_size", "shared_memory_offset", "shared_memory_region"];

/// The JSON. What the protocol has beside, and what is unknown, is passed over.
#[derive(Deserialize)]
struct Document<'a> {
    #[serde(default)]
    id: Option<String>,
    #[serde(default, deserialize_with = "or_null")]
    parameters: Parameters,
    #[serde(borrow)]
    inputs: Few<Input<'a>>,
    #[serde(default, deserialize_with = "or_null")]
    outputs: Few<Output>,
}

#[derive(Deserialize)]
struct Input<'a> {
    name: String,
    shape: Few<i64>,
    datatype: String,
    #[serde(default, deserialize_with = "or_null")]
    parameters: Parameters,
    #[serde(borrow, default)]
    data: Option<&'a RawValue>,
}

#[derive(Deserialize)]
struct Output {
    name: String,
    #[serde(default, deserialize_with = "or_null")]
    parameters: Parameters,
}

fn malformed(why: impl Into<String>) -> Problem {
    Problem::MalformedRequest(why.into())
}

/// A body's JSON, and what comes after it: all is JSON where no header's length says otherwise.
pub(super) fn split(body: &[u8], header: Option<usize>) -> Result<(&[u8], &[u8]), Problem> {
    let header = header.unwrap_or(body.len());
    body.split_at_checked(header).ok_or_else(|| {
        malformed(format!(
            "the body has {} bytes, but Inference-Header-Content-Length says {header}",
            body.len()
        ))
    })
}

/// What JSON has no words for, as Python writes it all the same, as null; nothing where there is none.
///
/// Points with such coordinates are left out, and that is told; the other tokens of JSON have no capitals.
pub(super) fn without_literals(json: &[u8]) -> Option<Vec<u8>> {
    const LITERALS: [&[u8]; 3] = [b"NaN", b"-Infinity", b"Infinity"];
    let (mut text, mut rest, mut quoted, mut found) = (Vec::with_capacity(json.len()), json, false, false);
    while let [byte, more @ ..] = rest {
        let literal = LITERALS.into_iter().find(|literal| !quoted && rest.starts_with(literal));
        if let Some(literal) = literal {
            text.extend_from_slice(b"null");
            (rest, found) = (&rest[literal.len()..], true);
            continue;
        }
        text.push(*byte);
        rest = more;
        match (*byte, more) {
            (b'"', _) => quoted = !quoted,
            (b'\\', [escaped, more @ ..]) if quoted => {
                text.push(*escaped);
                rest = more;
            }
            _ => {}
        }
    }
    found.then_some(text)
}

/// Reads the JSON, but no numbers of a tensor.
///
/// # Errors
/// [`Problem::MalformedRequest`], or [`Problem::Parameter`].
pub(super) fn read(json: &[u8]) -> Result<Request<'_>, Problem> {
    let document: Document<'_> =
        serde_json::from_slice(json).map_err(|error| malformed(format!("the request's JSON: {error}")))?;
    let Document { id, parameters: mut pairs, inputs, outputs } = document;
    let count = inputs.0.len();
    let Ok([input]) = <[Input<'_>; 1]>::try_from(inputs.0) else {
        return Err(malformed(format!("there are {count} inputs; there must be one, {TENSOR:?}")));
    };
    let datatype = check_tensor(&input)?;
    let (points, batched) = check_shape(&input.shape.0)?;
    let data = place(&input, points.saturating_mul(3 * datatype.width() as u64))?;
    let binary = pairs.find(BINARY)?.map_or(Ok(false), |value| switch(BINARY, value))?;
    let binary = check_outputs(outputs.0)?.unwrap_or(binary);
    pairs.ignore(|name| name == BINARY || is_hint(name));
    let reply = Reply { id, datatype, binary };
    Ok(Request { points, batched, options: options(&pairs)?, reply, data })
}

fn check_tensor(input: &Input<'_>) -> Result<Datatype, Problem> {
    if input.name != TENSOR {
        return Err(malformed(format!("unknown input {:?}; there is {TENSOR:?}", input.name)));
    }
    let unknown = || malformed(format!("input {TENSOR:?} is {:?}; it may be FP32 or FP64", input.datatype));
    Datatype::of(&input.datatype).ok_or_else(unknown)
}

/// Points in a tensor of this shape, and whether it is a batch of one cloud.
fn check_shape(shape: &[i64]) -> Result<(u64, bool), Problem> {
    match shape {
        [points, 3] if *points >= 0 => Ok((points.unsigned_abs(), false)),
        [1, points, 3] if *points >= 0 => Ok((points.unsigned_abs(), true)),
        [clouds, _, 3] if *clouds > 1 => Err(malformed(format!(
            "input {TENSOR:?} has the shape {shape:?}: {clouds} clouds; send each in a request of its own"
        ))),
        _ => Err(malformed(format!(
            "input {TENSOR:?} has the shape {shape:?}; it must be [N, 3] or [1, N, 3]"
        ))),
    }
}

/// Where the numbers of this input are, which take so many bytes in binary.
fn place<'a>(input: &Input<'a>, bytes: u64) -> Result<Data<'a>, Problem> {
    check_supported("input", &input.parameters)?;
    let size = input.parameters.find("binary_data_size")?;
    match (size, input.data) {
        (Some(size), None) if size.parse() == Ok(bytes) => Ok(Data::Binary(bytes)),
        (Some(size), None) => Err(malformed(format!(
            "input {TENSOR:?}: binary_data_size is {size}, but its shape and datatype take {bytes} bytes"
        ))),
        (None, Some(data)) => Ok(Data::Json(data)),
        (None, None) => Err(malformed(format!("input {TENSOR:?} has neither data nor binary_data_size"))),
        (Some(_), Some(_)) => Err(malformed(format!("input {TENSOR:?} has both data and binary_data_size"))),
    }
}

/// Refuses what may not be passed over; the rest are hints, such as how a client's codec sees the tensor.
fn check_supported(what: &str, parameters: &Parameters) -> Result<(), Problem> {
    match parameters.names().find(|name| UNSUPPORTED.contains(name)) {
        Some(name) => Err(malformed(format!("{what} {TENSOR:?}: {name} is not supported"))),
        None => Ok(()),
    }
}

/// A member that is true or false.
pub(super) fn switch(name: &str, value: &str) -> Result<bool, Problem> {
    value.parse().map_err(|_| malformed(format!("{name} is {value}; it must be true or false")))
}

/// Whether the output shall be binary, where the request says so of it.
fn check_outputs(outputs: Vec<Output>) -> Result<Option<bool>, Problem> {
    if outputs.len() > 1 {
        return Err(malformed(format!("there are {} outputs; there is one, {TENSOR:?}", outputs.len())));
    }
    let Some(Output { name, parameters }) = outputs.into_iter().next() else { return Ok(None) };
    if name != TENSOR {
        return Err(malformed(format!("unknown output {name:?}; there is {TENSOR:?}")));
    }
    check_supported("output", &parameters)?;
    parameters.find("binary_data")?.map(|value| switch("binary_data", value)).transpose()
}

impl Request<'_> {
    /// Bytes that follow the JSON.
    pub(super) fn binary_bytes(&self) -> u64 {
        match self.data {
            Data::Json(_) => 0,
            Data::Binary(bytes) => bytes,
        }
    }

    /// The points, of which `binary` is what followed the JSON. O(points).
    ///
    /// # Errors
    /// [`Problem::MalformedRequest`] where there are not as many as the shape says.
    pub(super) fn positions(&self, binary: &[u8]) -> Result<Vec<Position>, Problem> {
        if binary.len() as u64 != self.binary_bytes() {
            return Err(malformed(format!(
                "{} bytes follow the request's JSON; it describes {}, and Inference-Header-Content-Length tells \
                 where they begin",
                binary.len(),
                self.binary_bytes()
            )));
        }
        match self.data {
            Data::Binary(_) => Ok(match self.reply.datatype {
                Datatype::F32 => little_endian(binary, |bytes| f64::from(f32::from_le_bytes(bytes))),
                Datatype::F64 => little_endian(binary, f64::from_le_bytes),
            }),
            Data::Json(data) => {
                // Cannot be too many: the shape has been checked against the limits.
                let mut numbers = Numbers { found: Vec::new(), most: self.points.saturating_mul(3) };
                let mut deserializer = serde_json::Deserializer::from_str(data.get());
                List { numbers: &mut numbers, batched: self.batched }
                    .deserialize(&mut deserializer)
                    .map_err(|error| malformed(format!("input {TENSOR:?}: data: {error}")))?;
                numbers.positions(self.reply.datatype)
            }
        }
    }

    /// The SHA-256 of the tensor in binary, however it came.
    pub(super) fn hash(&self, positions: &[Position]) -> [u8; 32] {
        let mut hash = Sha256::new();
        for number in positions.as_flattened() {
            match self.reply.datatype {
                Datatype::F32 => hash.update((*number as f32).to_le_bytes()),
                Datatype::F64 => hash.update(number.to_le_bytes()),
            }
        }
        hash.finalize().into()
    }
}

/// Numbers of `N` bytes as positions.
fn little_endian<const N: usize>(bytes: &[u8], number: impl Fn([u8; N]) -> f64) -> Vec<Position> {
    let (numbers, _) = bytes.as_chunks::<N>();
    let (rows, _) = numbers.as_chunks::<3>();
    rows.iter().map(|row| row.map(&number)).collect()
}

/// The numbers of a list in JSON, as many as its shape allows.
struct Numbers {
    found: Vec<f64>,
    most: u64,
}

impl Numbers {
    fn positions(self, datatype: Datatype) -> Result<Vec<Position>, Problem> {
        let found = self.found.len() as u64;
        if found != self.most {
            return Err(malformed(format!(
                "input {TENSOR:?}: data has {found} numbers, its shape {}",
                self.most
            )));
        }
        let (rows, _) = self.found.as_chunks::<3>();
        if datatype == Datatype::F64 {
            return Ok(rows.to_vec());
        }
        let rows: Vec<Position> = rows.iter().map(|row| row.map(|c| f64::from(c as f32))).collect();
        if rows.as_flattened().iter().any(|c| c.is_infinite()) {
            return Err(malformed(format!("input {TENSOR:?}: a number in data does not fit into FP32")));
        }
        Ok(rows)
    }

    fn push<E: Error>(&mut self, number: f64) -> Result<(), E> {
        if self.found.len() as u64 == self.most {
            return Err(E::custom(format_args!("more than the {} numbers of its shape", self.most)));
        }
        self.found.push(number);
        Ok(())
    }
}

/// All of `data`: numbers one after the other, or in rows of three; of a batch also one list of these.
struct List<'a> {
    numbers: &'a mut Numbers,
    batched: bool,
}
/// A number, a row or, where there may be, a list of rows.
struct Element<'a> {
    numbers: &'a mut Numbers,
    rows: bool,
}

/// What an [`Element`] was.
#[derive(PartialEq, Eq)]
enum Found {
    Number,
    List,
}

impl<'de> DeserializeSeed<'de> for List<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for List<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of numbers, or of rows of three")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<(), A::Error> {
        while sequence.next_element_seed(Element { numbers: self.numbers, rows: self.batched })?.is_some() {}
        Ok(())
    }
}

impl<'de> DeserializeSeed<'de> for Element<'_> {
    type Value = Found;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Found, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Element<'_> {
    type Value = Found;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number or a row of three")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Found, E> {
        self.numbers.push(value).map(|()| Found::Number)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Found, E> {
        self.visit_f64(value as f64)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Found, E> {
        self.visit_f64(value as f64)
    }

    /// As JavaScript writes NaN.
    fn visit_unit<E: Error>(self) -> Result<Found, E> {
        self.visit_f64(f64::NAN)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Found, A::Error> {
        let (mut row, mut rows) = (0, 0);
        if self.rows {
            while let Some(found) =
                sequence.next_element_seed(Element { numbers: self.numbers, rows: false })?
            {
                *(if found == Found::Number { &mut row } else { &mut rows }) += 1;
            }
        } else {
            while let Some(number) = sequence.next_element::<Option<f64>>()? {
                self.numbers.push(number.unwrap_or(f64::NAN))?;
                row += 1;
            }
        }
        match (row, rows) {
            (3, 0) => Ok(Found::List),
            (0, _) if self.rows => Ok(Found::List),
            (_, 0) => Err(A::Error::custom(format_args!("a row of {row} numbers, not 3"))),
            _ => Err(A::Error::custom(format_args!("a row of {row} numbers and lists"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A request whose input is this, after its name.
    fn request(input: &str) -> String {
        format!(r#"{{"parameters":{{"ratio":4}},"inputs":[{{"name":"points",{input}}}]}}"#)
    }

    fn positions(input: &str) -> Result<Vec<Position>, String> {
        let json = request(input);
        let request = read(json.as_bytes()).map_err(|problem| problem.to_string())?;
        request.positions(b"").map_err(|problem| problem.to_string())
    }

    #[test]
    fn numbers_come_flat_or_in_rows() {
        let expected = Ok(vec![[1.0, 2.5, -3.0], [0.1, 1e-300, 6.0]]);
        assert_eq!(positions(r#""datatype":"FP64","shape":[2,3],"data":[1,2.5,-3,0.1,1e-300,6]"#), expected);
        assert_eq!(
            positions(r#""data":[[1,2.5,-3],[0.1,1e-300,6]],"shape":[2,3],"datatype":"FP64""#),
            expected
        );
        let single = positions(r#""datatype":"FP32","shape":[1,3],"data":[0.1,16777217,1]"#);
        assert_eq!(single, Ok(vec![[f64::from(0.1_f32), 16_777_216.0, 1.0]]), "as FP32 has them");
    }

    #[test]
    fn a_batch_of_one_cloud_is_that_cloud_however_its_data_are_nested() {
        let expected = Ok(vec![[1.0, 2.5, -3.0], [0.1, 4.0, 6.0]]);
        for data in ["[1,2.5,-3,0.1,4,6]", "[[1,2.5,-3],[0.1,4,6]]", "[[[1,2.5,-3],[0.1,4,6]]]"] {
            let input = format!(r#""datatype":"FP64","shape":[1,2,3],"data":{data}"#);
            assert_eq!(positions(&input), expected, "{data}");
        }
        for (shape, data, part) in [
            ("[2,1,3]", "[1,2,3,4,5,6]", "2 clouds"),
            ("[1,2,3]", "[[[1,2],[3,4,5,6]]]", "a row of 2"),
            ("[1,2,3]", "[[1,2,[3,4,5],6]]", "a row of 3 numbers and lists"),
            ("[1,2,3]", "[[[[1,2,3]],[4,5,6]]]", "expected f64"),
            ("[2,2,3]", "[]", "2 clouds"),
            ("[1,1,2,3]", "[1,2,3,4,5,6]", "[1, N, 3]"),
        ] {
            let input = format!(r#""datatype":"FP64","shape":{shape},"data":{data}"#);
            let why = positions(&input).expect_err(data);
            assert!(why.contains(part), "{data}: {why}");
        }
    }

    #[test]
    fn coordinates_that_are_none_are_nan() {
        let data = r#""datatype":"FP32","shape":[3,3],"data":[[1,2,null],[NaN,-Infinity,4],[5,6,Infinity]]"#;
        let json = request(data).replace("{\"ratio\":4}", r#"{"ratio":4,"content_type":"\"NaN\\"}"#);
        let text = without_literals(json.as_bytes()).expect("literals");
        let points = read(&text).expect("a request").positions(b"").expect("points");
        let finite: Vec<_> = points.iter().map(|point| point.map(f64::is_finite)).collect();
        assert_eq!(finite, [[true, true, false], [false, false, true], [true, true, false]]);
        assert!(String::from_utf8_lossy(&text).contains(r#""\"NaN\\""#), "within quotes it is text");
        let flat = positions(r#""datatype":"FP64","shape":[1,3],"data":[1,null,3]"#).expect("points");
        assert!(flat[0][1].is_nan() && flat[0][2] == 3.0);
        for json in ["", "[1]", r#"{"NaN":"Infinity"}"#, r#"["\\"]"#, r#"["\"NaN"]"#] {
            assert_eq!(without_literals(json.as_bytes()), None, "{json}");
        }
    }

    #[test]
    fn what_is_null_is_absent_and_hints_are_passed_over() {
        let plain = request(r#""datatype":"FP64","shape":[1,3],"data":[1,2,3]"#);
        let plain = read(plain.as_bytes()).expect("a request").options;
        for (of_request, of_input, of_output) in [
            ("null", "null", "null"),
            (
                r#"{"content_type":"np","headers":{"a":["b"]}}"#,
                r#"{"content_type":"np"}"#,
                r#"{"content_type":null}"#,
            ),
            (r#"{"sequence_id":7,"sequence_start":true,"priority":null}"#, r#"{"any":[{}]}"#, "{}"),
            (r#"{"ratio":4,"triton_enable_empty_final_response":true,"seed":null}"#, "{}", r#"{"any":1}"#),
        ] {
            let json = format!(
                r#"{{"id":null,"parameters":{of_request},"inputs":[{{"name":"points","datatype":"FP64","shape":[1,3],
                   "parameters":{of_input},"data":[1,2,3]}}],"outputs":[{{"name":"points","parameters":{of_output}}}]}}"#
            );
            let read = read(json.as_bytes()).unwrap_or_else(|problem| panic!("{json}: {problem}"));
            assert_eq!((&read.options, read.reply.id), (&plain, None), "{json}");
        }
        let outputs =
            r#"{"inputs":[{"name":"points","datatype":"FP64","shape":[1,3],"data":[1,2,3]}],"outputs":null}"#;
        assert!(read(outputs.as_bytes()).is_ok());
    }

    #[test]
    fn numbers_must_be_as_many_as_the_shape_says() {
        for (input, part) in [
            (r#""datatype":"FP32","shape":[2,3],"data":[1,2,3]"#, "3 numbers, its shape 6"),
            (r#""datatype":"FP32","shape":[1,3],"data":[1,2,3,4]"#, "more than the 3"),
            (r#""datatype":"FP32","shape":[2,3],"data":[[1,2],[3,4,5,6]]"#, "a row of 2"),
            (r#""datatype":"FP32","shape":[1,3],"data":[[[1,2,3]]]"#, "expected f64"),
            (r#""datatype":"FP32","shape":[1,3],"data":["1",2,3]"#, "expected a number"),
            (r#""datatype":"FP32","shape":[1,3],"data":[1e39,2,3]"#, "does not fit into FP32"),
            (r#""datatype":"FP32","shape":[1,3],"data":7"#, "a list of numbers"),
            (r#""datatype":"FP32","shape":[1,3]"#, "neither"),
            (r#""datatype":"FP16","shape":[1,3],"data":[1,2,3]"#, "FP32 or FP64"),
            (r#""datatype":"FP32","shape":[3],"data":[1,2,3]"#, "[N, 3]"),
            (r#""datatype":"FP32","shape":[-1,3],"data":[]"#, "[N, 3]"),
            (r#""datatype":"FP32","shape":[1,3],"parameters":{"binary_data_size":11}"#, "take 12 bytes"),
            (r#""datatype":"FP32","shape":[1,3],"parameters":{"binary_data_size":12}"#, "0 bytes follow"),
            (
                r#""datatype":"FP32","shape":[1,3],"parameters":{"binary_data_size":[12]},"data":[1,2,3]"#,
                "a list",
            ),
            (r#""datatype":"FP32","shape":[1,3],"parameters":{"binary_data_size":12},"data":[1]"#, "both"),
            (r#""datatype":"FP32","shape":[1,3],"parameters":{"shared_memory_region":"x"}"#, "not supported"),
        ] {
            let why = positions(input).expect_err(input);
            assert!(why.contains(part), "{input}: {why}");
        }
    }

    #[test]
    fn a_shape_without_end_reserves_nothing() {
        let json = request(&format!(r#""datatype":"FP64","shape":[{},3],"data":[1,2,3]"#, i64::MAX));
        let request = read(json.as_bytes()).expect("a request");
        assert_eq!(request.points, i64::MAX as u64);
        assert!(request.positions(b"").is_err());
    }
}
