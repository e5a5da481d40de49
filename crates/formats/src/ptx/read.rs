//! Reading scans.

use std::sync::Arc;

use super::super::columns::TextColumn;
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::text::{next_token, parse_f64, shown};
use super::super::{Format, FormatError, Header, Limits};
use densecloud_cloud::{Kind, Origin, Position, Sensors, Values};

/// What a line may tell beside the position, in its order.
const OTHERS: [&str; 4] = ["intensity", "red", "green", "blue"];

/// The attribute that tells where the colour is absent.
const FLAG: &str = "color_invalid";

/// The attribute that numbers the scans.
const SCAN: &str = "scan";

/// The scans of a file, one after another.
pub(super) struct PtxPoints {
    limits: Limits,
    scan: Scan,
    /// The scans before.
    sensors: Vec<Option<Position>>,
    others: [TextColumn; OTHERS.len()],
    /// How many of the others any scan has.
    told: usize,
    /// Points given.
    given: u64,
    /// Lines that are no points, since nothing came back.
    empty: u64,
    /// Points without a colour.
    colourless: u64,
}

/// The scan that is being read.
struct Scan {
    columns: u64,
    rows: u64,
    pose: Pose,
    sensor: Position,
    /// Lines read.
    line: u64,
    /// Numbers a line, once the first one is read.
    width: Option<usize>,
}

/// Where a scan's points are, by rows: the axes of the scan, then its origin.
struct Pose([Position; 4]);

impl PtxPoints {
    /// Reads the first scan's header.
    pub(super) fn open(source: &mut Source<'_>, limits: Limits) -> Result<(Self, Header), FormatError> {
        let scan = Scan::open(source)?.ok_or(FormatError::Empty("points"))?;
        let points = Self {
            limits,
            scan,
            sensors: Vec::new(),
            others: std::array::from_fn(|_| TextColumn::new()),
            told: 0,
            given: 0,
            empty: 0,
            colourless: 0,
        };
        // How many of a scan's lines are points, its header does not say.
        let header = Header {
            format: Format::Ptx,
            points: None,
            attributes: Vec::new(),
            dropped_properties: Vec::new(),
        };
        Ok((points, header))
    }

    /// Goes on to the next scan; false at the end of the file.
    fn next_scan(&mut self, source: &mut Source<'_>) -> Result<bool, FormatError> {
        let Some(next) = Scan::open(source)? else { return Ok(false) };
        let last = std::mem::replace(&mut self.scan, next);
        self.sensors.push(Some(last.sensor));
        Ok(true)
    }

    /// Reads a line of a scan.
    fn next(&mut self, source: &mut Source<'_>, to: &mut Block) -> Result<(), FormatError> {
        let number = self.sensors.len();
        let Some(line) = source.next_line()? else {
            return Err(FormatError::truncated(source.line(), self.scan.missing(number)));
        };
        let line = source.bytes(line);
        if line.iter().all(u8::is_ascii_whitespace) {
            return Ok(());
        }
        self.put(line, to).map_err(|why| FormatError::malformed(source.line(), why))?;
        self.limits.check_points(self.given)
    }

    /// Appends the point of a line, unless nothing came back there.
    fn put(&mut self, mut line: &[u8], to: &mut Block) -> Result<(), String> {
        let mut fields = [b"".as_slice(); 3 + OTHERS.len()];
        let mut numbers = [0.0; 3 + OTHERS.len()];
        let mut width = 0;
        while let Some(token) = next_token(&mut line) {
            if let (Some(field), Some(number)) = (fields.get_mut(width), numbers.get_mut(width)) {
                *field = token;
                *number = parse_f64(token).ok_or_else(|| format!("{} is not a number", shown(token)))?;
            }
            width += 1;
        }
        self.scan.check(width, self.sensors.len())?;
        self.scan.line += 1;
        let [x, y, z, _, colour @ ..] = numbers;
        if [x, y, z] == [0.0; 3] {
            self.empty += 1;
            return Ok(());
        }
        self.told = self.told.max(width - 3);
        let has_colour = colour != [0.0; 3];
        self.colourless += u64::from(!has_colour);
        for (i, (column, field)) in self.others.iter_mut().zip(&fields[3..]).enumerate() {
            let is_absent = i > 0 && field.is_empty();
            column.push(&mut to.columns[i], if is_absent { b"0" } else { field });
        }
        if let [.., Values::U8(flags), Values::I64(scans)] = to.columns.as_mut_slice() {
            flags.push(u8::from(!has_colour));
            scans.push(self.sensors.len() as i64);
        }
        to.positions.push(self.scan.pose.apply([x, y, z]));
        self.given += 1;
        Ok(())
    }

    /// What the file tells of the sensors.
    fn origin(&self) -> Origin {
        let last = Some(self.scan.sensor);
        if self.sensors.is_empty() {
            return Origin { sensor: last, ..Origin::default() };
        }
        let places = self.sensors.iter().copied().chain([last]).collect();
        let sensors = Sensors { attribute: SCAN.to_owned(), places };
        Origin { sensors: Some(Arc::new(sensors)), ..Origin::default() }
    }
}

impl Points for PtxPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if to.columns.is_empty() {
            to.columns = self.others.iter().map(TextColumn::empty).collect();
            to.columns.extend([Kind::U8, Kind::I64].map(Values::new));
        }
        let end = to.positions.len().saturating_add(rows);
        while to.positions.len() < end {
            if !self.scan.is_done() {
                self.next(source, to)?;
            } else if !self.next_scan(source)? {
                break;
            }
        }
        Ok(())
    }

    fn finish(self: Box<Self>, _source: &mut Source<'_>) -> Result<Ending, FormatError> {
        let others = OTHERS.iter().zip(&self.others).enumerate().map(|(i, (name, column))| {
            let kind = column.kind().filter(|_| i < self.told)?;
            Some(ColumnName { name: (*name).to_owned(), kind })
        });
        // A colour of 0 0 0 stands for none.
        let is_flagged = self.told == OTHERS.len() && self.colourless > 0;
        let flag = is_flagged.then(|| ColumnName { name: FLAG.to_owned(), kind: Kind::U8 });
        let last = self.sensors.len() as i64;
        let scan = TextColumn::Whole { lowest: 0, highest: last }.kind().filter(|_| last > 0);
        let scan = scan.map(|kind| ColumnName { name: SCAN.to_owned(), kind });
        let mut notes = Vec::new();
        if self.empty > 0 {
            let (empty, all) = (self.empty, self.empty + self.given);
            notes.push(format!("{empty} of {all} points are 0 0 0, where nothing came back: left out"));
        }
        let origin = self.origin();
        Ok(Ending {
            columns: others.chain([flag, scan]).collect(),
            dropped_properties: Vec::new(),
            notes,
            origin,
        })
    }
}

impl Scan {
    /// Reads a header; none at the end of the file.
    fn open(source: &mut Source<'_>) -> Result<Option<Self>, FormatError> {
        let Some([columns]) = numbers(source, "a scan's number of columns")? else { return Ok(None) };
        let [rows] = need(source, "a scan's number of rows")?;
        let counts = [columns, rows].map(count);
        let ([Some(columns), Some(rows)], Some(_)) =
            (counts, counts[0].zip(counts[1]).and_then(|(columns, rows)| columns.checked_mul(rows)))
        else {
            let why = format!("a scan of {columns} columns and {rows} rows");
            return Err(FormatError::malformed(source.line(), why));
        };
        let place = need(source, "the scanner's place")?;
        for axis in ["x", "y", "z"] {
            let _: Position = need(source, &format!("the scanner's {axis} axis"))?;
        }
        let mut pose = [[0.0; 4]; 4];
        for (row, number) in pose.iter_mut().zip(1..) {
            *row = need(source, &format!("row {number} of the scan's matrix"))?;
        }
        let pose = Pose::of(pose).map_err(|why| FormatError::malformed(source.line(), why))?;
        // A scan is in the scanner's own coordinates, so the scanner is at the origin; unless it is in the others' already.
        let sensor = if pose.is_nothing() { place } else { pose.0[3] };
        Ok(Some(Self { columns, rows, pose, sensor, line: 0, width: None }))
    }

    fn is_done(&self) -> bool {
        // The product is known to fit.
        self.line == self.columns * self.rows
    }

    fn missing(&self, number: usize) -> String {
        let Self { columns, rows, line, .. } = self;
        format!("scan {number} counts {columns} x {rows} points, and {line} are there")
    }

    /// Whether a line of that many numbers is one of the scan's.
    fn check(&mut self, width: usize, number: usize) -> Result<(), String> {
        match self.width {
            None if matches!(width, 3 | 4 | 7) => self.width = Some(width),
            None => {
                return Err(format!(
                    "{}; a point has 3, 4 with an intensity, or 7 with a colour behind that",
                    numbers_of(width)
                ));
            }
            Some(first) if width != first => {
                let missing = self.missing(number);
                let found = numbers_of(width);
                return Err(format!("{found} where the scan's other points have {first}: {missing}"));
            }
            Some(_) => {}
        }
        Ok(())
    }
}

impl Pose {
    /// From the file's rows.
    fn of(rows: [[f64; 4]; 4]) -> Result<Self, &'static str> {
        if !rows.as_flattened().iter().all(|number| number.is_finite()) {
            return Err("the scan's matrix has a number that is not finite");
        }
        if rows.map(|row| row[3]) != [0.0, 0.0, 0.0, 1.0] {
            return Err("the last numbers of the four rows of a scan's matrix must be 0 0 0 1: \
                        its last row is where the scan's origin is");
        }
        let [x, y, z, _] = rows;
        let cross = |a: usize, b: usize| y[a] * z[b] - y[b] * z[a];
        if x[0] * cross(1, 2) + x[1] * cross(2, 0) + x[2] * cross(0, 1) == 0.0 {
            return Err("the scan's matrix makes a plane, a line or a point of every scan");
        }
        Ok(Self(rows.map(|[a, b, c, _]| [a, b, c])))
    }

    /// Whether it leaves all points where they are.
    fn is_nothing(&self) -> bool {
        self.0 == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    }

    /// A position as a row times the matrix.
    fn apply(&self, [x, y, z]: Position) -> Position {
        let [along_x, along_y, along_z, origin] = self.0;
        std::array::from_fn(|a| x * along_x[a] + y * along_y[a] + z * along_z[a] + origin[a])
    }
}

/// The next line that is not blank, which must hold exactly `N` numbers; none at the end of the file.
fn numbers<const N: usize>(source: &mut Source<'_>, what: &str) -> Result<Option<[f64; N]>, FormatError> {
    let line = loop {
        let Some(line) = source.next_line()? else { return Ok(None) };
        // Some programs end a text with Ctrl-Z.
        if !source.bytes(line.clone()).iter().all(|b| b.is_ascii_whitespace() || *b == 0x1A) {
            break line;
        }
    };
    let mut rest = source.bytes(line.clone());
    let mut numbers = [0.0; N];
    let mut found = 0;
    while let Some(token) = next_token(&mut rest) {
        match (numbers.get_mut(found), parse_f64(token)) {
            (Some(number), Some(value)) => *number = value,
            _ => found = N,
        }
        found += 1;
    }
    if found == N {
        return Ok(Some(numbers));
    }
    let why = format!("{} where {what} was expected", shown(source.bytes(line).trim_ascii()));
    Err(FormatError::malformed(source.line(), why))
}

fn need<const N: usize>(source: &mut Source<'_>, what: &str) -> Result<[f64; N], FormatError> {
    let missing = |source: &Source<'_>| FormatError::truncated(source.line(), format!("{what} is missing"));
    numbers(source, what)?.ok_or_else(|| missing(source))
}

fn numbers_of(width: usize) -> String {
    format!("{width} number{}", if width == 1 { "" } else { "s" })
}

/// A number of columns or rows. Less than 2^53, so that it is exactly what stands there.
fn count(number: f64) -> Option<u64> {
    const MOST: f64 = 9e15;
    let is_count = number.fract() == 0.0 && (0.0..MOST).contains(&number);
    is_count.then_some(number as u64)
}
