//! Sweeps as bare numbers.

use super::*;

fn floats(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn read_as(bytes: &[u8], name: &str) -> Result<(Cloud, Header), FormatError> {
    let reading = Reading { format: Some(name.parse().expect("a format")), ..Reading::default() };
    let reader = CloudReader::open_as(bytes, Limits::default(), &reading)?;
    let header = reader.header().clone();
    Ok((reader.read()?, header))
}

#[test]
fn four_or_five_numbers_are_a_point() {
    let four = floats(&[1.5, -2.0, 0.25, 0.5, f32::NAN, 4.0, 5.0, 0.0]);
    let (cloud, header) = read_as(&four, "kitti").expect("a cloud");
    assert_eq!(cloud.positions[0], [1.5, -2.0, 0.25]);
    assert!(cloud.positions[1][0].is_nan() && cloud.positions[1][1..] == [4.0, 5.0]);
    assert_eq!(
        cloud.attributes,
        [Attribute { name: "intensity".into(), values: Values::F32(vec![0.5, 0.0]) }]
    );
    assert_eq!((header.format, header.points), (Format::Sweep { ring: false }, None));
    let five = floats(&[1.5, -2.0, 0.25, 36.0, 31.0, 3.0, 4.0, 5.0, 0.0, 0.0]);
    let (cloud, header) = read_as(&five, "nuscenes").expect("a cloud");
    assert_eq!(cloud.positions, [[1.5, -2.0, 0.25], [3.0, 4.0, 5.0]]);
    assert_eq!(cloud.attributes[0].values, Values::F32(vec![36.0, 0.0]));
    assert_eq!(cloud.attributes[1], Attribute { name: "ring".into(), values: Values::F32(vec![31.0, 0.0]) });
    assert_eq!(header.format, Format::Sweep { ring: true });
    assert_eq!(header.format.written(), ply(PlyEncoding::BinaryLittleEndian, Scalar::F32));
}

#[test]
fn what_is_something_else_is_refused() {
    let four = floats(&[1.5, -2.0, 0.25, 0.5, 3.25, 4.0, -5.0, 0.0, 1.0, 1.0, 1.0, 0.1]);
    for (bytes, name, told) in [
        (&four[..47], "kitti", "byte 32: 15 bytes behind 2 points of 16 bytes: this is not KITTI"),
        (&four[..8], "nuscenes", "8 bytes behind 0 points of 20 bytes"),
        (&four[..40], "nuscenes", "byte 0: ring 3.25"),
        (&[][..], "kitti", "no points"),
    ] {
        let error = read_as(bytes, name).expect_err(told).to_string();
        assert!(error.contains(told), "{error}");
    }
    // A multiple of both lengths: as KITTI, coordinates would be intensities.
    let five: Vec<f32> = (0..400).flat_map(|i| [i as f32, -3.0, -1.5, 20.0, (i % 32) as f32]).collect();
    let error = read_as(&floats(&five), "kitti").expect_err("five").to_string();
    assert!(error.contains("these are not the points of KITTI"), "{error}");
    // Nothing tells what it is but the option.
    let error = read(&four).expect_err("unknown").to_string();
    assert!(error.contains("kitti") && error.contains("nuscenes"), "{error}");
}

#[test]
fn limits_hold_and_blocks_are_the_whole() {
    let numbers: Vec<f32> = (0..100_000).flat_map(|i| [i as f32, 0.5, -1.0, (i % 256) as f32]).collect();
    let bytes = floats(&numbers);
    let (whole, _) = read_as(&bytes, "kitti").expect("a cloud");
    assert_eq!(whole.positions.len(), 100_000);
    let reading = Reading { format: Some("kitti".parse().expect("a format")), ..Reading::default() };
    let open = |limits| CloudReader::open_as(&bytes[..], limits, &reading).expect("a header");
    let mut reader = open(Limits::default());
    let (mut block, mut positions): (_, Vec<Position>) = (Block::default(), Vec::new());
    while reader.next_block(1000, &mut block).expect("a block") {
        assert!(block.positions.len() <= 1000);
        positions.extend(&block.positions);
    }
    assert!(positions == whole.positions);
    let limited = open(Limits { max_points: Some(99_999), max_bytes: None }).read();
    assert!(matches!(limited, Err(FormatError::TooManyPoints { limit: 99_999, .. })));
}
