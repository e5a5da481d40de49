//! Reading, as text and as records.

use super::super::columns::TextColumn;
use super::super::first_bytes::ENOUGH;
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::text::{next_token, parse_f64, shown};
use super::super::{Format, FormatError, Header, Limits, Place};
use super::ids::Keys;
use super::{COLOUR, ERROR, ID, NO_ERROR, RECORD, SIGHTING, TITLE, has_title};
use densecloud_cloud::{Kind, Origin, Position, Values};

/// COLMAP's mark for a point that there is not; keys end below.
const NO_KEY: u64 = u64::MAX;

/// The points of a file.
pub(super) struct ColmapPoints {
    limits: Limits,
    /// How many records there are by the count before them; none in text.
    claimed: Option<u64>,
    /// The line of a comment that counts the points of text, and the count.
    counted: Option<(u64, u64)>,
    given: u64,
    /// How many of them have a track.
    tracks: u64,
    lowest: u64,
    highest: u64,
    keys: Keys,
    origin: Origin,
}

/// A point without its track.
struct Record {
    key: u64,
    position: Position,
    colour: [u8; 3],
    error: f64,
    /// How many images it is seen in.
    sightings: u64,
}

impl ColmapPoints {
    /// Reads the count, if there is one.
    pub(super) fn open(source: &mut Source<'_>, limits: Limits) -> Result<(Self, Header), FormatError> {
        let head = source.peek(ENOUGH)?;
        let binary = !has_title(head) && super::super::known::is_binary(head);
        let claimed = if binary { Some(count(source)?) } else { None };
        limits.check_points(claimed.unwrap_or(0))?;
        let bytes = claimed.map_or(0, |points| points.saturating_mul(RECORD as u64));
        limits.check_bytes(bytes)?;
        let names = [ID].into_iter().chain(COLOUR).chain([ERROR]);
        let header = Header {
            format: Format::Colmap { binary },
            points: claimed,
            attributes: names.map(str::to_owned).collect(),
            dropped_properties: Vec::new(),
        };
        let points = Self {
            limits,
            claimed,
            counted: None,
            given: 0,
            tracks: 0,
            lowest: u64::MAX,
            highest: 0,
            keys: Keys::default(),
            origin: Origin::default(),
        };
        Ok((points, header))
    }

    fn next(&mut self, source: &mut Source<'_>) -> Result<Option<Record>, FormatError> {
        let Some(claimed) = self.claimed else { return self.next_line(source) };
        if self.given == claimed {
            return Ok(None);
        }
        let missing = |at: Place, given: u64| {
            FormatError::truncated(at, format!("the file counts {claimed} points, and {given} are there"))
        };
        let at = source.offset();
        let Some(bytes) = source.take(RECORD)? else { return Err(missing(at, self.given)) };
        let record = Record::of_bytes(bytes);
        if record.key > i64::MAX as u64 {
            return Err(FormatError::malformed(at, format!("{} is no POINT3D_ID", record.key)));
        }
        if !source.skip(record.sightings.saturating_mul(SIGHTING))? {
            let at = source.offset();
            let why = format!("a track of {} images, and no more points of {claimed}", record.sightings);
            return Err(FormatError::truncated(at, why));
        }
        Ok(Some(record))
    }

    /// Reads the next line that is a point.
    fn next_line(&mut self, source: &mut Source<'_>) -> Result<Option<Record>, FormatError> {
        while let Some(range) = source.next_line()? {
            let line = source.bytes(range).trim_ascii();
            if let Some(comment) = line.strip_prefix(b"#") {
                self.note(comment, source.line_number());
            } else if !line.is_empty() {
                let record = Record::of_line(line);
                return record.map(Some).map_err(|why| FormatError::malformed(source.line(), why));
            }
        }
        Ok(None)
    }

    /// Keeps a comment that is none of those that COLMAP writes itself. Only the first that counts points is COLMAP's.
    fn note(&mut self, comment: &[u8], line: u64) {
        let text = String::from_utf8_lossy(comment);
        let usual = ["3D point list", TITLE, "Number of points:"];
        if let Some(count) = count_of(&text) {
            self.counted.get_or_insert((line, count));
        } else if !usual.iter().any(|word| text.trim_start().starts_with(word)) {
            self.origin.comment(&text);
        }
    }

    /// Holds text to its count: it is all that tells a file that was cut between two lines.
    fn check_count(&self, end: Place) -> Result<(), FormatError> {
        match self.counted {
            Some((line, count)) if count > self.given => {
                let why = format!("line {line} counts {count} points, and {} are there", self.given);
                Err(FormatError::truncated(end, why))
            }
            Some((line, count)) if count < self.given => {
                let why = format!(
                    "it counts {count} points, and {} follow; if they are meant to, correct or remove this line",
                    self.given
                );
                Err(FormatError::malformed(Place::Line(line), why))
            }
            _ => Ok(()),
        }
    }

    fn put(&mut self, record: &Record, to: &mut Block) {
        to.positions.push(record.position);
        for (i, column) in to.columns.iter_mut().enumerate() {
            match (i, column) {
                // As checked.
                (0, Values::I64(keys)) => keys.push(record.key as i64),
                (1..=3, Values::U8(colour)) => colour.push(record.colour[i - 1]),
                (_, Values::F64(errors)) if record.error == NO_ERROR => errors.push(f64::NAN),
                (_, Values::F64(errors)) => errors.push(record.error),
                _ => {}
            }
        }
        self.keys.push(record.position, record.key);
        self.lowest = self.lowest.min(record.key);
        self.highest = self.highest.max(record.key);
        self.tracks += u64::from(record.sightings > 0);
        self.given += 1;
    }
}

impl Points for ColmapPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if to.columns.is_empty() {
            to.columns = [Kind::I64, Kind::U8, Kind::U8, Kind::U8, Kind::F64].map(Values::new).into();
        }
        for _ in 0..rows {
            let Some(record) = self.next(source)? else { break };
            self.put(&record, to);
            self.limits.check_points(self.given)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>, source: &mut Source<'_>) -> Result<Ending, FormatError> {
        source.expect_end("the points that the file counts")?;
        self.check_count(source.line())?;
        // As checked.
        let keys = TextColumn::Whole { lowest: self.lowest as i64, highest: self.highest as i64 };
        let kinds = [keys.kind().unwrap_or(Kind::I64), Kind::U8, Kind::U8, Kind::U8, Kind::F64];
        let names = [ID].into_iter().chain(COLOUR).chain([ERROR]);
        let columns = names.zip(kinds).map(|(name, kind)| Some(ColumnName { name: name.to_owned(), kind }));
        let mut dropped_properties = Vec::new();
        if self.tracks > 0 {
            dropped_properties.push(format!("the tracks of {} points", self.tracks));
        }
        let origin = Origin { extra: Some(self.keys.finish()), ..self.origin };
        Ok(Ending { columns: columns.collect(), dropped_properties, notes: Vec::new(), origin })
    }
}

impl Record {
    /// From [`RECORD`] bytes.
    fn of_bytes(bytes: &[u8]) -> Self {
        let word = |at: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&bytes[at..at + 8]);
            u64::from_le_bytes(word)
        };
        Self {
            key: word(0),
            position: [8, 16, 24].map(|at| f64::from_bits(word(at))),
            colour: [bytes[32], bytes[33], bytes[34]],
            error: f64::from_bits(word(35)),
            sightings: word(43),
        }
    }

    fn of_line(mut line: &[u8]) -> Result<Self, String> {
        let mut field = |what: &str| {
            let field = next_token(&mut line);
            field.ok_or_else(|| {
                format!("no {what}; a point has POINT3D_ID, X, Y, Z, R, G, B, ERROR and its track")
            })
        };
        let key = field("POINT3D_ID")?;
        let number = whole(key).filter(|key| *key <= i64::MAX as u64);
        let key = number.ok_or_else(|| format!("{} is no POINT3D_ID", shown(key)))?;
        let mut real = |what: &str| {
            let text = field(what)?;
            parse_f64(text).ok_or_else(|| format!("{} is not a number ({what})", shown(text)))
        };
        let position = [real("X")?, real("Y")?, real("Z")?];
        let mut colour = [0; 3];
        for (byte, what) in colour.iter_mut().zip(["R", "G", "B"]) {
            let number = real(what)?;
            *byte = number as u8;
            if f64::from(*byte) != number {
                return Err(format!("{number} is not a whole number from 0 to 255 ({what})"));
            }
        }
        let error = real("ERROR")?;
        let mut entries = 0;
        while let Some(entry) = next_token(&mut line) {
            if whole(entry).is_none() {
                return Err(format!("{} is not a whole number (TRACK)", shown(entry)));
            }
            entries += 1;
        }
        if entries % 2 != 0 {
            return Err(format!("a track of {entries} numbers; it has two for each image"));
        }
        Ok(Self { key, position, colour, error, sightings: entries / 2 })
    }

    /// Whether these are numbers that a reconstruction has.
    fn is_usual(&self) -> bool {
        let is_coordinate = |c: &f64| *c == 0.0 || (1e-12..1e12).contains(&c.abs());
        let is_error = self.error == NO_ERROR || (0.0..1e6).contains(&self.error);
        self.key < 1 << 48 && self.position.iter().all(is_coordinate) && is_error && self.sightings < 1 << 20
    }
}

/// Whether bytes are a count and records, by two of them at least, or one whose track fills all that is looked at:
/// their keys, errors and tracks leave no doubt.
pub(super) fn are_records(head: &[u8]) -> bool {
    let Some((count, mut rest)) = head.split_at_checked(8) else { return false };
    let count = u64::from_le_bytes(count.try_into().unwrap_or_default());
    let mut found = 0;
    while let Some((record, after)) = rest.split_at_checked(RECORD) {
        let record = Record::of_bytes(record);
        if found == count || !record.is_usual() {
            return false;
        }
        found += 1;
        // Less than 2^23.
        rest = after.get((record.sightings * SIGHTING) as usize..).unwrap_or_default();
    }
    let least = if head.len() < ENOUGH { 2 } else { 1 };
    found >= least && count <= u64::from(u32::MAX)
}

fn count(source: &mut Source<'_>) -> Result<u64, FormatError> {
    let at = source.offset();
    let bytes = source.take(8)?.ok_or_else(|| FormatError::truncated(at, "no count of points"))?;
    Ok(u64::from_le_bytes(bytes.try_into().unwrap_or_default()))
}

fn whole(token: &[u8]) -> Option<u64> {
    std::str::from_utf8(token).ok()?.parse().ok().filter(|key| *key != NO_KEY)
}

/// The count in a comment as COLMAP writes it: `Number of points: 2, mean track length: 1.5`.
fn count_of(comment: &str) -> Option<u64> {
    let (count, length) =
        comment.trim().strip_prefix("Number of points: ")?.split_once(", mean track length: ")?;
    length.parse::<f64>().ok()?;
    count.parse().ok()
}
