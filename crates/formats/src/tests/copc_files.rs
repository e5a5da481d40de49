//! COPC: points in an octree, read whole and by boxes.

use std::collections::BTreeMap;
use std::io::Cursor;

use ::las::copc::{CopcHierarchyVlr, CopcInfoVlr};

use super::*;
use densecloud_cloud::{Crs, Origin};

const LAZ: Format = Format::Las { compressed: true };

/// A hilly square of 4 km, denser in one corner, in UTM coordinates, with a field and an attribute of its own.
fn cloud(points: usize) -> Cloud {
    let position = |i: usize| {
        let (u, v) = ((i as f64 * 0.618_033_988_7).fract(), (i as f64 * 0.754_877_666_2).fract());
        let (x, y) = (4000.0 * u * u, 4000.0 * v);
        [635_000.0 + x, 4_848_000.0 + y, 50.0 * (x / 300.0).sin() * (y / 500.0).cos()]
    };
    let column = |name: &str, values| Attribute { name: name.into(), values };
    let attributes = vec![
        column("intensity", Values::U16((0..points).map(|i| i as u16).collect())),
        column("number", Values::U32((0..points as u32).collect())),
        column("gps_time", Values::F64((0..points).map(|i| 1e9 + i as f64).collect())),
    ];
    let crs = Some(Crs::Wkt("PROJCS[\"WGS 84 / UTM zone 10N\"]".into()));
    let origin = Origin { crs, comments: vec!["made by hand".into()], ..Origin::default() };
    Cloud { positions: (0..points).map(position).collect(), attributes, origin, ..Cloud::default() }
}

fn file(cloud: &Cloud, format: Format) -> Vec<u8> {
    encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

fn within(bytes: &[u8], bounds: &str) -> Result<Cloud, FormatError> {
    let bounds = Some(bounds.parse().expect(bounds));
    CloudReader::open_as(bytes, Limits::default(), &Reading { bounds, ..Reading::default() })?.read()
}

/// All that is known of each point, by the attribute that tells them apart.
fn by_number(cloud: &Cloud) -> BTreeMap<u64, (String, Vec<String>)> {
    let numbers = cloud.attributes.iter().find(|a| a.name == "number").expect("an attribute");
    let told = |i: usize| {
        let values = cloud.attributes.iter().map(|a| format!("{} {}", a.name, a.values.get(i))).collect();
        (numbers.values.get(i) as u64, (format!("{:?}", cloud.positions[i]), values))
    };
    (0..cloud.positions.len()).map(told).collect()
}

#[test]
fn all_that_laz_has_is_in_copc() {
    let cloud = cloud(200_000);
    let (copc, laz) = (file(&cloud, Format::Copc), file(&cloud, LAZ));
    let reader = CloudReader::open(&copc[..], Limits::default()).expect("a header");
    assert_eq!((reader.header().format, reader.header().points), (Format::Copc, Some(200_000)));
    let (copc, laz) = (reader.read().expect("a cloud"), read(&laz).expect("a cloud"));
    assert!(copc.positions != laz.positions, "nodes have an order of their own");
    assert!(by_number(&copc) == by_number(&laz));
    assert_eq!((&copc.origin.crs, &copc.origin.comments), (&cloud.origin.crs, &cloud.origin.comments));
    assert!(copc.warnings().is_empty(), "{:?}", copc.warnings());
    // And back: nothing but the index is lost.
    let again = read(&file(&copc, Format::Copc)).expect("a cloud");
    assert!(by_number(&again) == by_number(&laz));
    let plain = read(&file(&copc, LAZ)).expect("a cloud");
    assert!(plain.positions == copc.positions && plain.attributes == copc.attributes);
    let lost = |format: Format| format.cannot_hold(&copc.attributes, &copc.origin);
    assert_eq!(
        (lost(Format::Copc).len(), lost(LAZ)),
        (0, vec!["the index of the points (COPC or LAX)".to_owned()])
    );
}

#[test]
fn neither_threads_nor_blocks_change_a_byte() {
    let cloud = cloud(150_000);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| file(&cloud, Format::Copc))
    };
    let whole = on(1);
    assert!(on(3) == whole);
    let mut plan = CloudPlan::new(Format::Copc, &cloud.attributes, &cloud.origin);
    plan.see(&cloud.positions, &cloud.attributes, 0).expect("points");
    let mut writer = plan.begin(Vec::new()).expect("a file");
    for (i, positions) in cloud.positions.chunks(7001).enumerate() {
        writer.write_rows(positions, &cloud.attributes, 7001 * i).expect("points");
    }
    assert!(writer.finish().expect("a file") == whole);
    let mut spooled = Vec::new();
    let mut file =
        encode_spooled(Format::Copc, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file");
    std::io::Read::read_to_end(&mut file, &mut spooled).expect("bytes");
    assert!(spooled == whole);
}

#[test]
fn each_node_has_the_points_of_its_space_and_no_more_than_a_few() {
    let bytes = file(&cloud(300_000), Format::Copc);
    let header = ::las::Header::new(Cursor::new(&bytes)).expect("a header");
    let record = |id| move |vlr: &&::las::Vlr| vlr.user_id == "copc" && vlr.record_id == id;
    let first = header.vlrs().iter().next().expect("a record");
    assert!(record(1)(&first), "COPC wants its record first");
    let info = CopcInfoVlr::try_from(first).expect("a record");
    assert_eq!([info.gpstime_minimum, info.gpstime_maximum], [1e9, 1e9 + 299_999.0]);
    let hierarchy = header.evlrs().iter().find(record(1000)).expect("a hierarchy");
    let hierarchy = CopcHierarchyVlr::read_from_with(hierarchy, &info).expect("a hierarchy");
    let how = header.laz_vlr().expect("a record");
    assert!(how.uses_variable_size_chunks() && header.version().minor == 4);
    let (mut points, mut levels, axes) = (0, 0, header.transforms());
    for entry in hierarchy.iter_entries() {
        let entry = entry.expect("an entry");
        let (stride, count) = (how.items_size() as usize, entry.point_count as usize);
        let (from, size) = (entry.offset as usize, entry.byte_size as usize);
        let mut rows = vec![0; stride * count];
        let table = [::laz::laszip::ChunkTableEntry { point_count: count as u64, byte_count: size as u64 }];
        ::laz::par_decompress(&bytes[from..from + size], &mut rows, &how, &table).expect("points");
        let space = entry.key.bounds(&info);
        for row in rows.chunks_exact(stride) {
            let step = |at: usize| i32::from_le_bytes(row[at..at + 4].try_into().expect("four bytes"));
            let [x, y, z] = [axes.x.direct(step(0)), axes.y.direct(step(4)), axes.z.direct(step(8))];
            let is_in = |least: f64, c: f64, greatest: f64| least - 1e-6 <= c && c <= greatest + 1e-6;
            assert!(is_in(space.min.x, x, space.max.x) && is_in(space.min.y, y, space.max.y));
            assert!(is_in(space.min.z, z, space.max.z));
        }
        assert!((1..=50_000).contains(&count), "{count} points");
        (points, levels) = (points + count, levels.max(entry.key.l));
    }
    assert!(points == 300_000 && levels >= 2, "{points} points in {levels} levels");
}

#[test]
fn boxes_have_the_points_that_lie_in_them() {
    let whole = cloud(200_000);
    let (copc, laz) = (file(&whole, Format::Copc), file(&whole, LAZ));
    let text = file(&whole, Format::from_extension("a.csv".as_ref()).expect("text"));
    let mut all = BTreeMap::new();
    for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
        let at = |i: i32, j: i32| format!("{},{}", 635_000 + 1000 * i, 4_848_000 + 1001 * j);
        let bounds = format!("{},{}", at(i, j), at(i + 1, j + 1));
        let mut part = by_number(&within(&copc, &bounds).expect("points"));
        assert!(part == by_number(&within(&laz, &bounds).expect("points")), "{bounds}");
        let others = within(&text, &bounds).expect("points");
        assert_eq!(others.positions.len(), part.len(), "{bounds}");
        let sum = all.len() + part.len();
        all.append(&mut part);
        assert_eq!(all.len(), sum, "a point is in two boxes");
    }
    assert!(all == by_number(&read(&laz).expect("a cloud")));
    let high = within(&copc, "0,0,40,1e9,1e9,1e9").expect("points");
    assert!(!high.positions.is_empty() && high.positions.iter().all(|p| p[2] >= 40.0));
    assert_eq!(
        high.positions.len(),
        read(&laz).expect("a cloud").positions.iter().filter(|p| p[2] >= 40.0).count()
    );
    for bytes in [&copc, &laz, &text] {
        let why = within(bytes, "0,0,1,1").expect_err("nothing is there").to_string();
        assert_eq!(why, "the file holds no points within the bounds");
    }
}

#[test]
fn limits_are_of_the_points_within_the_bounds() {
    let bytes = file(&cloud(60_000), Format::Copc);
    let read = |bounds: &str, most: u64| {
        let reading = Reading { bounds: Some(bounds.parse().expect("a box")), ..Reading::default() };
        let limits = Limits { max_points: Some(most), ..Limits::default() };
        let reader = CloudReader::open_as(&bytes[..], limits, &reading)?;
        assert_eq!(reader.header().points, None);
        reader.read()
    };
    let few = read("635000,4848000,635100,4848100", 60_000).expect("points").positions.len() as u64;
    assert!((1..6000).contains(&few), "{few}");
    assert!(read("635000,4848000,635100,4848100", few).is_ok());
    let error = read("635000,4848000,635100,4848100", few - 1).expect_err("too many");
    assert!(matches!(error, FormatError::TooManyPoints { .. }), "{error}");
}

#[test]
fn only_the_nodes_that_are_needed_are_decompressed() {
    let mut bytes = file(&cloud(300_000), Format::Copc);
    let corner = "638900,4851900,639000,4852000";
    let wanted = within(&bytes, corner).expect("points");
    // What is far from there may be anything.
    let far = within(&bytes, "635000,4848000,635010,4848010").expect("points");
    let header = ::las::Header::new(Cursor::new(&bytes)).expect("a header");
    let info = CopcInfoVlr::try_from(header.vlrs().iter().next().expect("a record")).expect("a record");
    let hierarchy = header.evlrs().iter().find(|vlr| vlr.user_id == "copc").expect("a hierarchy");
    let hierarchy = CopcHierarchyVlr::read_from_with(hierarchy, &info).expect("a hierarchy");
    let first = hierarchy.iter_entries().flatten().find(|e| e.key.l == 2 && e.key.x == 0).expect("a node");
    // Behind the first point and the sizes of the layers.
    let (from, to) = (first.offset as usize + 100, first.offset as usize + first.byte_size as usize);
    bytes[from..to].fill(0xA5);
    assert!(within(&bytes, corner).expect("points").positions == wanted.positions);
    assert!(within(&bytes, "635000,4848000,635010,4848010").is_err_or(&far));
}

trait IsErrOr {
    fn is_err_or(&self, other: &Cloud) -> bool;
}

impl IsErrOr for Result<Cloud, FormatError> {
    fn is_err_or(&self, other: &Cloud) -> bool {
        self.as_ref().is_ok_and(|cloud| cloud.positions != other.positions) || self.is_err()
    }
}

#[test]
fn a_hierarchy_that_contradicts_itself_is_refused_where_it_is_needed() {
    let whole = cloud(60_000);
    let bytes = file(&whole, Format::Copc);
    let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"));
    let (info, page) = (375 + 54, number(375 + 54 + 40) as usize);
    let all = "0,0,1e9,1e9";
    assert_eq!(within(&bytes, all).expect("points").positions.len(), 60_000);
    // Two nodes with each other's points.
    let mut swapped = bytes.clone();
    let (one, other) = (page + 28, page + 32 + 28);
    let counts = [one, other].map(|at| bytes[at..at + 4].to_vec());
    assert!(counts[0] != counts[1]);
    swapped[one..one + 4].copy_from_slice(&counts[1]);
    swapped[other..other + 4].copy_from_slice(&counts[0]);
    let why = within(&swapped, all).expect_err("no hierarchy").to_string();
    assert!(why.contains("other points in a node than the node itself"), "{why}");
    for (at, word, part) in [
        (info + 40, u64::MAX - 8, "not inside the file"),
        (info + 48, 1 << 40, "not inside the file"),
        (page + 16, 1 << 50, "not inside the file"),
        // A page within itself, a negative count, and too few.
        (page + 24, 32 | u64::from(u32::MAX) << 32, "not inside the file"),
        (page + 24, 32 | u64::from(-2_i32 as u32) << 32, "not inside the file"),
        (page + 24, 32, "points, the header counts 60000"),
    ] {
        let mut broken = bytes.clone();
        broken[at..at + 8].copy_from_slice(&word.to_le_bytes());
        let why = within(&broken, all).expect_err("no hierarchy").to_string();
        assert!(why.contains("COPC's hierarchy") && why.contains(part), "{word:x}: {why}");
        assert_eq!(read(&broken).expect("a cloud").positions.len(), 60_000);
    }
}

/// The places of a file that decide how it is read: its header, the beginnings of chunks, the table, and the hierarchy.
fn vital(bytes: &[u8]) -> Vec<usize> {
    let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes")) as usize;
    let data = u32::from_le_bytes(bytes[96..100].try_into().expect("four bytes")) as usize;
    let (page, length) = (number(375 + 54 + 40), number(375 + 54 + 48));
    let chunks = (page..page + length).step_by(32).map(|entry| number(entry + 16));
    let begins = chunks.flat_map(|at| at..at + 120);
    (90..data + 8).chain(begins).chain(number(data)..bytes.len()).collect()
}

#[test]
fn damage_is_an_error_or_harmless() {
    let whole = cloud(60_000);
    let bytes = file(&whole, Format::Copc);
    let (mut read_anyway, mut rng) = (0, densecloud_geometry::Rng::new(7));
    let mut below = |n: usize| rng.below(n as u64) as usize;
    let vital = vital(&bytes);
    for _ in 0..150 {
        let mut broken = bytes.clone();
        for _ in 0..1 + below(3) {
            let at = vital[below(vital.len())];
            broken[at] = [0, 1, 0x7F, 0x80, 0xFF, broken[at] ^ 0x10][below(6)];
        }
        broken.truncate(bytes.len() - [0, 0, 0, 1, 500][below(5)]);
        for bounds in ["635000,4848000,636000,4849000", "-1e12,-1e12,1e12,1e12"] {
            if let Ok(cloud) = within(&broken, bounds) {
                assert!(cloud.attributes.iter().all(|a| a.values.len() == cloud.positions.len()));
                assert!(cloud.positions.len() <= 60_000);
                read_anyway += 1;
            }
        }
    }
    assert!((20..280).contains(&read_anyway), "{read_anyway} of 300");
}

#[test]
fn clouds_of_any_shape_are_written() {
    let at = |positions: Vec<Position>| Cloud { positions, ..Cloud::default() };
    let mut crowd = vec![[5.0, 5.0, 5.0]; 60_000];
    crowd.extend((0..100).map(|i| [f64::from(i), 0.0, 1.0]));
    for cloud in [
        at(vec![[1.0, 2.0, 3.0]]),
        at(vec![[0.0; 3]; 3]),
        at(crowd),
        at((0..70_000).map(|i| [f64::from(i) * 1e-3, 0.0, 0.0]).collect()),
        // A solid.
        at((0..200_000).map(|i| [i % 59, i / 59 % 59, i / 3481].map(f64::from)).collect()),
    ] {
        let back = read(&file(&cloud, Format::Copc)).expect("a cloud");
        let sorted = |cloud: &Cloud| {
            let mut all = cloud.positions.clone();
            all.sort_by(|a, b| a.partial_cmp(b).expect("numbers"));
            all
        };
        let near = |(a, b): (&Position, &Position)| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3);
        assert!(sorted(&back).iter().zip(&sorted(&cloud)).all(near));
        assert_eq!(back.positions.len(), cloud.positions.len());
    }
}

#[test]
fn what_older_point_formats_have_is_kept() {
    let mut cloud = cloud(1000);
    cloud.origin.crs = Some(Crs::Epsg { horizontal: 32_610, vertical: None });
    let old = read(&file(&cloud, LAZ)).expect("a cloud");
    let copc = read(&file(&old, Format::Copc)).expect("a cloud");
    assert!(by_number(&copc) == by_number(&old));
}

#[test]
fn a_code_becomes_well_known_text_or_a_warning() {
    let coded = |horizontal| Some(Crs::Epsg { horizontal, vertical: None });
    let keys = |bytes: &[u8]| bytes.windows(24).any(|w| w == b"GeoTIFF GeoKeyDirectoryT");
    // From LAS, whose records are kept elsewhere, and from a format without any.
    for of_las in [true, false] {
        let with = |horizontal| {
            let mut cloud = cloud(1000);
            cloud.origin.crs = coded(horizontal);
            if of_las { read(&file(&cloud, LAZ)).expect("a cloud") } else { cloud }
        };
        let known = with(32_610);
        assert!(Format::Copc.cannot_hold(&known.attributes, &known.origin).is_empty());
        let bytes = file(&known, Format::Copc);
        let Some(Crs::Wkt(text)) = read(&bytes).expect("a cloud").origin.crs else { panic!("no text") };
        assert!(text.starts_with("PROJCS[\"WGS 84 / UTM zone 10N\",") && !keys(&bytes), "{text}");
        let other = with(2992);
        let lost = Format::Copc.cannot_hold(&other.attributes, &other.origin);
        assert!(matches!(&lost[..], [told] if told.contains("EPSG:2992 is in GeoTIFF's keys")), "{lost:?}");
        let bytes = file(&other, Format::Copc);
        assert_eq!(read(&bytes).expect("a cloud").origin.crs, coded(2992));
        assert!(keys(&bytes));
    }
    // LAS has a place for either.
    let mut cloud = cloud(10);
    cloud.origin.crs = coded(2992);
    assert!(LAZ.cannot_hold(&cloud.attributes, &cloud.origin).is_empty());
}

#[test]
fn names_and_media_types_ask_for_it() {
    for name in ["a.copc.laz", "A.COPC.LAZ", "/b.laz/c.copc.laz"] {
        assert_eq!(Format::of_output(name.as_ref()).expect(name), Some(Format::Copc));
    }
    assert_eq!(Format::of_output("copc.laz".as_ref()).expect("a name"), Some(LAZ));
    assert_eq!(Format::from_media_type("application/vnd.laszip+copc"), Some(Format::Copc));
    assert_eq!(Format::Copc.file_name("dense"), "dense.copc.laz");
    assert!(!Format::Copc.is_named_like(LAZ) && Format::Copc.is_made_in_parts());
}
