//! What all targets do with the bytes that the fuzzer makes.

use densecloud_formats::{CloudReader, Decimal, Format, Limits, Reading, Separator, encode, read_mesh};

/// Panics that the readers catch themselves, of libraries under them, are no findings.
pub fn quiet() {
    std::panic::set_hook(Box::new(|_| ()));
}

/// Reads a cloud from bytes that begin with `magic`, whatever they began with before. What can be read must
/// be of one length, and must come back from a file of its own format.
///
/// # Panics
/// When that does not hold: a finding.
pub fn cloud(magic: &[u8], data: &[u8], mend: fn(&mut Vec<u8>)) {
    let mut bytes = data.to_vec();
    bytes.resize(bytes.len().max(magic.len()), 0);
    bytes[..magic.len()].copy_from_slice(magic);
    mend(&mut bytes);
    read(&bytes, &Reading::default());
}

/// As [`cloud`], and what lies in a box, by the file's index where it has one.
///
/// # Panics
/// As [`cloud`].
pub fn cloud_and_window(magic: &[u8], data: &[u8]) {
    cloud(magic, data, as_is);
    let mut bytes = data.to_vec();
    bytes.resize(bytes.len().max(magic.len()), 0);
    bytes[..magic.len()].copy_from_slice(magic);
    read(&bytes, &Reading { bounds: "-0.5,-0.5,0.25,1e6".parse().ok(), ..Reading::default() });
}

/// Reads text, in the way and the encoding that its last byte asks for, where this does not end a line.
///
/// # Panics
/// As [`cloud`].
pub fn text(data: &[u8]) {
    let Some((&way, text)) = data.split_last().filter(|(last, _)| **last != b'\n') else {
        return read(data, &Reading::default());
    };
    let separators = [Separator::Comma, Separator::Semicolon, Separator::Tab, Separator::Space, Separator::Bar];
    let axes = ["1,2,3", "3,1,2", "x,y,z"];
    let reading = Reading {
        separator: separators.get(usize::from(way & 7)).copied(),
        decimal: [None, Some(Decimal::Point), Some(Decimal::Comma), None][usize::from(way >> 3 & 3)],
        axes: axes.get(usize::from(way >> 5 & 3)).and_then(|axes| axes.parse().ok()),
        format: "text".parse().ok(),
        bounds: None,
    };
    if way < 128 {
        return read(text, &reading);
    }
    let units = text.chunks(2).map(|pair| pair.iter().fold(0, |unit, byte| unit << 8 | u16::from(*byte)));
    let units = std::iter::once(0xFEFF).chain(units);
    read(&units.flat_map(u16::to_le_bytes).collect::<Vec<_>>(), &reading);
}

/// Reads a cloud as each of the formats of these names, which need not be recognised.
///
/// # Panics
/// As [`cloud`].
pub fn cloud_as(names: &[&str], data: &[u8]) {
    for name in names {
        let reading = Reading { format: name.parse().ok(), ..Reading::default() };
        assert!(reading.format.is_some(), "{name}");
        read(data, &reading);
    }
}

fn read(bytes: &[u8], reading: &Reading) {
    let limits = Limits { max_points: Some(1 << 20), max_bytes: Some(1 << 22) };
    let Ok(reader) = CloudReader::open_as(bytes, limits, reading) else { return };
    let format = reader.header().format.written();
    let Ok(cloud) = reader.read() else { return };
    let points = cloud.positions.len();
    for attribute in &cloud.attributes {
        assert_eq!(attribute.values.len(), points, "{}", attribute.name);
    }
    // Not every number has a place in every format: an infinite coordinate has none in LAS.
    let Ok(file) = encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin) else { return };
    if let Some(length) = format.encoded_len(points as u64, &cloud.attributes, &cloud.origin) {
        assert_eq!(length, file.len() as u64, "{format}");
    }
    // Odd coordinates are not recognised without a title.
    let said = matches!(format, Format::Colmap { .. }).then(|| "colmap".parse().expect("a name"));
    let reading = Reading { format: said, ..Reading::default() };
    let again = CloudReader::open_as(&file[..], Limits::default(), &reading).and_then(CloudReader::read);
    assert_eq!(again.expect("our own file").positions.len(), points, "{format}");
}

/// Reads a mesh.
pub fn mesh(data: &[u8]) {
    let _ = read_mesh(data);
}

/// Nothing to mend.
pub fn as_is(_: &mut Vec<u8>) {}

/// Gives an E57 file whole pages and the right checksums (CRC-32C, big-endian, in the last 4 bytes of each):
/// without them no change would get past the first page.
pub fn mend_pages(bytes: &mut Vec<u8>) {
    const PAGE: usize = 1024;
    bytes.resize(bytes.len().max(48).next_multiple_of(PAGE), 0);
    let length = bytes.len() as u64;
    bytes[16..24].copy_from_slice(&length.to_le_bytes());
    bytes[40..48].copy_from_slice(&(PAGE as u64).to_le_bytes());
    for page in bytes.chunks_exact_mut(PAGE) {
        let (data, sum) = page.split_at_mut(PAGE - 4);
        sum.copy_from_slice(&crc32c(data).to_be_bytes());
    }
}

fn crc32c(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0x82F6_3B78 } else { c >> 1 })
    })
}
