//! The packed form of a cloud: a head in JSON, then blocks of little-endian numbers, as a graphics card takes them.
//!
//! ```text
//! u32 "DCP1", u32 length of the head, the head in JSON (spaces at its end make its length a multiple of four)
//! blocks: u32 points, then f32 x, y, z of each about the anchor; u8 red, green, blue, 255 of each, if there are colours;
//!         f32 of each point, for each column
//! ```

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use axum::Extension;
use axum::body::Bytes;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::asked::{Asked, PACKED};
use super::sample::Sample;
use crate::admission::budget::Held;
use crate::app::App;
use crate::connection::record::Points;
use crate::http::download::blocks;
use crate::problem::Problem;
use densecloud_cloud::{Crs, Kind, Position, Role, column_of, roles_of};
use densecloud_formats::{Block, CloudReader, ColumnName, Ending, Format};

/// `DCP1`.
const MAGIC: u32 = u32::from_le_bytes(*b"DCP1");
/// Points that are read at a time.
const READ: usize = 1 << 16;
/// Points of a block that is sent.
const SENT: usize = 1 << 16;
/// Columns that are sent, at most.
const COLUMNS: usize = 24;

/// The head.
#[derive(Debug, Serialize)]
struct Head {
    /// In the file, but for those without a place.
    points: u64,
    sent: u64,
    anchor: Position,
    least: Position,
    greatest: Position,
    colours: bool,
    columns: Vec<Column>,
    format: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    crs: Option<String>,
    warnings: Vec<String>,
}

/// A column that is sent.
#[derive(Debug, Serialize)]
struct Column {
    name: String,
    /// What it tells, by this program's name for that.
    role: Option<&'static str>,
    least: f32,
    greatest: f32,
}

/// Blocking work: reads a cloud and begins to send its points. `left` says that nobody waits any more.
pub(super) fn answer(
    app: &App,
    mut reader: CloudReader<'_>,
    asked: &Asked,
    left: &Arc<AtomicBool>,
) -> Result<Response, Problem> {
    let mut held = app.budget.hold(0).ok_or_else(|| app.held_full())?;
    let (mut sample, mut block) = (Sample::new(asked.limit, asked.order), Block::default());
    while reader.next_block(READ, &mut block)? {
        if left.load(Ordering::Relaxed) {
            return Err(Problem::Interrupted("the client has left".into()));
        }
        sample.take(&block);
        let more = sample.bytes().saturating_sub(held.bytes());
        if !held.grow(more) {
            return Err(app.held_full());
        }
    }
    let format = reader.header().format;
    let ending = reader.finish()?;
    Ok(Packed::new(sample, format, ending).response(held))
}

/// What is sent of a sample.
struct Packed {
    head: Head,
    sample: Sample,
    rows: Vec<u32>,
    colour: Option<Colour>,
    /// Places of the columns that are sent, in the sample.
    columns: Vec<usize>,
}

impl Packed {
    fn new(mut sample: Sample, format: Format, ending: Ending) -> Self {
        let rows = sample.sort();
        let names: Vec<String> = ending.columns.iter().map(name_of).collect();
        let colour = Colour::of(&names, &ending.columns, &sample.columns);
        let (columns, told) = columns(&names, &sample.columns);
        let head = Head {
            points: sample.seen - sample.nowhere,
            sent: rows.len() as u64,
            anchor: sample.anchor.unwrap_or_default(),
            least: sample.least,
            greatest: sample.greatest,
            colours: colour.is_some(),
            columns: told,
            format: format.kind(),
            crs: ending.origin.crs.as_ref().map(Crs::name),
            warnings: warnings(&sample, &ending),
        };
        Self { head, sample, rows, colour, columns }
    }

    /// Bytes of a point.
    fn row(&self) -> usize {
        12 + if self.colour.is_some() { 4 } else { 0 } + 4 * self.columns.len()
    }

    fn start(&self) -> Vec<u8> {
        // Cannot fail: names and numbers.
        let mut head = serde_json::to_vec(&self.head).unwrap_or_default();
        head.resize(head.len().next_multiple_of(4), b' ');
        [&MAGIC.to_le_bytes(), &(head.len() as u32).to_le_bytes(), &head[..]].concat()
    }

    fn block(&self, rows: &[u32]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(4 + rows.len() * self.row());
        bytes.extend((rows.len() as u32).to_le_bytes());
        let of = |row: &u32| self.sample.positions[*row as usize];
        bytes.extend(rows.iter().flat_map(of).flat_map(f32::to_le_bytes));
        if let Some(colour) = &self.colour {
            bytes.extend(rows.iter().flat_map(|row| colour.at(&self.sample.columns, *row as usize)));
        }
        for column in &self.columns {
            let column = &self.sample.columns[*column];
            bytes.extend(rows.iter().flat_map(|row| column[*row as usize].to_le_bytes()));
        }
        bytes
    }

    fn response(self, held: Held) -> Response {
        let start = self.start();
        let length = start.len() + self.rows.len().div_ceil(SENT) * 4 + self.rows.len() * self.row();
        let points = Points { read: self.head.points, made: self.head.sent };
        let headers =
            [(header::CONTENT_TYPE, PACKED.to_owned()), (header::CONTENT_LENGTH, length.to_string())];
        let (mut start, mut next) = (Some(start), 0);
        let body = blocks(held, move || {
            if let Some(start) = start.take() {
                return Ok(Some(start.into()));
            }
            let rows = &self.rows[next..self.rows.len().min(next + SENT)];
            next += rows.len();
            Ok((!rows.is_empty()).then(|| Bytes::from(self.block(rows))))
        });
        (headers, Extension(points), body).into_response()
    }
}

/// The name of a column; of one that is not kept, none.
fn name_of(column: &Option<ColumnName>) -> String {
    column.as_ref().map(|column| column.name.clone()).unwrap_or_default()
}

fn warnings(sample: &Sample, ending: &Ending) -> Vec<String> {
    let mut warnings = ending.notes.clone();
    if !ending.dropped_properties.is_empty() {
        warnings.push(format!("not read: {}", ending.dropped_properties.join(", ")));
    }
    if sample.nowhere > 0 {
        warnings.push(format!("{} points with coordinates that are not finite are left out", sample.nowhere));
    }
    warnings
}

/// What nobody colours points by, or what colours are made of.
fn is_shown(role: Option<Role>) -> bool {
    use Role::*;
    !matches!(
        role,
        Some(
            Red | Green
                | Blue
                | Alpha
                | HarmonicRed
                | HarmonicGreen
                | HarmonicBlue
                | Harmonic
                | RotationW
                | RotationX
                | RotationY
                | RotationZ
                | LogScaleX
                | LogScaleY
                | LogScaleZ
                | Time
                | Id
        )
    )
}

/// The columns that are sent, by their places, and what is told of them: those that tell points apart.
fn columns(names: &[String], columns: &[Vec<f32>]) -> (Vec<usize>, Vec<Column>) {
    let roles = roles_of(names);
    let one = |place: usize| {
        let (least, greatest) = range(columns.get(place)?);
        let is_sent = !names[place].is_empty() && is_shown(roles[place]) && least < greatest;
        let column =
            Column { name: names[place].clone(), role: roles[place].map(Role::name), least, greatest };
        is_sent.then_some((place, column))
    };
    (0..names.len()).filter_map(one).take(COLUMNS).unzip()
}

/// The least and the greatest number.
fn range(column: &[f32]) -> (f32, f32) {
    let finite = column.iter().filter(|value| value.is_finite());
    finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(least, most), value| {
        (least.min(*value), most.max(*value))
    })
}

/// How colours are made of columns.
struct Colour {
    parts: [usize; 3],
    /// What numbers are multiplied by, and what is added then.
    factor: f32,
    shift: f32,
}

/// The value of the constant spherical harmonic, by which splats tell their colours.
const HARMONIC: f32 = 0.282_094_8;

impl Colour {
    /// Of columns of these names, where there are three of a colour.
    fn of(names: &[String], columns: &[Option<ColumnName>], values: &[Vec<f32>]) -> Option<Self> {
        let places = |roles: [Role; 3]| {
            let [red, green, blue] = roles.map(|role| column_of(names, role));
            Some([red?, green?, blue?])
        };
        if let Some(parts) = places([Role::Red, Role::Green, Role::Blue]) {
            let kind = columns[parts[0]].as_ref()?.kind;
            let most = parts.iter().filter_map(|part| values.get(*part)).map(|part| range(part).1);
            return Some(Self { parts, factor: factor(kind, most.fold(0.0, f32::max)), shift: 0.0 });
        }
        let parts = places([Role::HarmonicRed, Role::HarmonicGreen, Role::HarmonicBlue])?;
        Some(Self { parts, factor: 255.0 * HARMONIC, shift: 127.5 })
    }

    fn at(&self, columns: &[Vec<f32>], row: usize) -> [u8; 4] {
        // Saturates, and makes 0 of NaN.
        let [red, green, blue] =
            self.parts.map(|part| (columns[part][row] * self.factor + self.shift).round() as u8);
        [red, green, blue, 255]
    }
}

/// What makes a colour from 0 to 255 of one of this type, whose greatest part is `most`.
fn factor(kind: Kind, most: f32) -> f32 {
    match kind {
        Kind::U8 => 1.0,
        kind if kind.is_float() && most <= 1.0 => 255.0,
        _ if most <= 255.0 => 1.0,
        _ => 255.0 / 65_535.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::asked::{As, Order};
    use crate::testing;
    use densecloud_formats::{Limits, Reading};

    fn asked(limit: usize) -> Asked {
        Asked { reading: Reading::default(), limit, order: Order::File, shape: As::Packed }
    }

    /// The head of an answer, and what follows it.
    async fn sent(text: &str, limit: usize) -> (serde_json::Value, Vec<u8>) {
        let (app, _folder) = testing::app();
        let reader = CloudReader::open(text.as_bytes(), Limits::default()).expect("a cloud");
        let answer =
            answer(&app, reader, &asked(limit), &Arc::default()).unwrap_or_else(|why| panic!("{why}"));
        let told: usize =
            answer.headers()["content-length"].to_str().expect("text").parse().expect("a length");
        let body = axum::body::to_bytes(answer.into_body(), usize::MAX).await.expect("a body");
        assert_eq!(body.len(), told);
        assert_eq!(app.budget.used(), 0);
        let length = u32::from_le_bytes(body[4..8].try_into().expect("four")) as usize;
        assert_eq!((&body[..4], length % 4), (&b"DCP1"[..], 0));
        (serde_json::from_slice(&body[8..8 + length]).expect("JSON"), body[8 + length..].to_vec())
    }

    fn floats(bytes: &[u8]) -> Vec<f32> {
        bytes.chunks_exact(4).map(|four| f32::from_le_bytes(four.try_into().expect("four"))).collect()
    }

    #[tokio::test]
    async fn a_cloud_is_packed_about_its_first_point() {
        let text = "x y z red green blue intensity flag\n\
            500000.5 1 2 255 0 7 10 1\n500001.5 1 3 0 255 8 20 1\n500002.5 2 2 1 2 9 15 1\n";
        let (head, bytes) = sent(text, 100).await;
        assert_eq!((&head["points"], &head["sent"], &head["colours"]), (&3.into(), &3.into(), &true.into()));
        assert_eq!(head["anchor"], serde_json::json!([500_000.5, 1.0, 2.0]));
        assert_eq!(head["greatest"], serde_json::json!([500_002.5, 2.0, 3.0]));
        let column =
            serde_json::json!({ "name": "intensity", "role": "intensity", "least": 10.0, "greatest": 20.0 });
        assert_eq!(head["columns"], serde_json::json!([column]), "what is the same everywhere tells nothing");
        assert_eq!(bytes[..4], 3_u32.to_le_bytes());
        assert_eq!(floats(&bytes[4..40]), [0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 2.0, 1.0, 0.0]);
        assert_eq!(bytes[40..52], [255, 0, 7, 255, 0, 255, 8, 255, 1, 2, 9, 255]);
        assert_eq!(floats(&bytes[52..]), [10.0, 20.0, 15.0]);
    }

    #[tokio::test]
    async fn no_more_is_sent_than_is_asked_for_and_in_blocks() {
        let text: String = (0..200_000).map(|i| format!("{i} 1 2\n")).collect();
        let (head, bytes) = sent(&text, 150_000).await;
        assert_eq!((&head["points"], &head["sent"]), (&200_000.into(), &150_000.into()));
        let (mut at, mut counts) = (0, Vec::new());
        while at < bytes.len() {
            let count = u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four")) as usize;
            counts.push(count);
            at += 4 + 12 * count;
        }
        assert_eq!((at, counts), (bytes.len(), vec![SENT, SENT, 150_000 - 2 * SENT]));
    }

    #[test]
    fn colours_are_from_0_to_255_whatever_they_were_told_in() {
        for (kind, most, expected) in [
            (Kind::U8, 1.0, 1.0),
            (Kind::U16, 255.0, 1.0),
            (Kind::U16, 65_535.0, 255.0 / 65_535.0),
            (Kind::F32, 1.0, 255.0),
            (Kind::F64, 200.0, 1.0),
            (Kind::I64, 255.0, 1.0),
        ] {
            assert_eq!(factor(kind, most), expected, "{kind:?} {most}");
        }
        let colour = Colour { parts: [0, 1, 2], factor: 255.0 * HARMONIC, shift: 127.5 };
        assert_eq!(colour.at(&[vec![0.0], vec![9.0], vec![f32::NAN]], 0), [128, 255, 0, 255]);
    }

    #[test]
    fn what_has_no_room_is_refused_and_gives_all_back() {
        let (app, _folder) = testing::app();
        let _rest = app.budget.hold(app.config.limits.held_bytes - 100).expect("room");
        let used = app.budget.used();
        let text = "1 2 3\n".repeat(1000);
        let reader = CloudReader::open(text.as_bytes(), Limits::default()).expect("a cloud");
        let refused = answer(&app, reader, &asked(1000), &Arc::default()).expect_err("no room");
        assert!(matches!(refused, Problem::HeldFull { .. }), "{refused}");
        assert_eq!(app.budget.used(), used);
    }

    #[test]
    fn nobody_reads_on_for_a_client_that_left() {
        let (app, _folder) = testing::app();
        let reader = CloudReader::open("1 2 3\n".as_bytes(), Limits::default()).expect("a cloud");
        let left = Arc::new(AtomicBool::new(true));
        assert!(matches!(answer(&app, reader, &asked(1), &left), Err(Problem::Interrupted(_))));
    }
}
