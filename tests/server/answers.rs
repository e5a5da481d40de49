//! What goes well.

use densecloud_backends::ModelName;
use densecloud_cascade::Target;
use densecloud_cloud::{Attribute, Origin, Values};
use densecloud_formats::{CloudReader, Format, Limits, PcdEncoding, PlyEncoding, Scalar, Separator};
use densecloud_server::{Config, ModelInfo};

use crate::support::{PLY, Reply, Scripted, Server, cloud, dense, encode, encode_result, outcome};

#[test]
fn the_answer_is_the_librarys_own_result_in_the_format_of_the_request() {
    let server = Server::start(&Scripted::new(), Config::default());
    let ply = |encoding, scalar| Format::Ply { encoding, scalar };
    for (format, query, target, seed) in [
        (PLY, "ratio=4", Target::Ratio(4.0), 0),
        (ply(PlyEncoding::BinaryBigEndian, Scalar::F64), "ratio=2.5&seed=7", Target::Ratio(2.5), 7),
        (ply(PlyEncoding::Ascii, Scalar::F32), "points=1001", Target::Points(1001), 0),
        (Format::TEXT, "ratio=16", Target::Ratio(16.0), 0),
        (Format::Npy { scalar: Scalar::F64, fields: false }, "ratio=3", Target::Ratio(3.0), 0),
    ] {
        let reply = server.post(&format!("/upsample?{query}"), &encode(&cloud(300), format));
        assert_eq!(reply.status, 200, "{query}: {}", reply.text());
        let expected = dense(cloud(300), target, seed);
        assert!(reply.body == encode_result(&expected, format, &reply), "{format:?} {query}");
        assert_eq!(reply.header("content-type"), Some(format.media_type()));
        assert_eq!(reply.header("densecloud-points-in"), Some("300"));
        assert_eq!(reply.header("densecloud-points-out"), Some(expected.len().to_string().as_str()));
        assert_eq!(reply.header("densecloud-warning"), None);
        let binary = matches!(
            format,
            Format::Npy { .. }
                | Format::Ply {
                    encoding: PlyEncoding::BinaryBigEndian | PlyEncoding::BinaryLittleEndian,
                    ..
                }
        );
        let length = binary.then(|| reply.body.len().to_string());
        assert_eq!(reply.header("content-length"), length.as_deref(), "told where it is known");
        let timing = reply.header("server-timing").expect("timing");
        for stage in ["upload", "parse", "queue", "seeds", "patches", "units", "resample"] {
            assert!(timing.contains(&format!("{stage};dur=")), "{timing}");
        }
    }
}

#[test]
fn las_and_pcd_are_answered_as_such() {
    let server = Server::start(&Scripted::new(), Config::default());
    let pcd = |encoding| Format::Pcd { encoding, scalar: Scalar::F32 };
    for (format, media) in [
        (Format::Las { compressed: false }, "application/vnd.las"),
        (Format::Las { compressed: true }, "application/vnd.laszip"),
        (pcd(PcdEncoding::Ascii), "application/x-pcd"),
        (pcd(PcdEncoding::Binary), "application/x-pcd"),
        (pcd(PcdEncoding::Compressed), "application/x-pcd"),
    ] {
        let intensity = Attribute { name: "intensity".into(), values: Values::U16((0..300).collect()) };
        let origin = Origin { crs: "EPSG:25832".parse().ok(), ..Origin::default() };
        let body = densecloud_formats::encode(Vec::new(), format, &cloud(300), &[intensity], &origin)
            .expect("a file");
        let reply = server.post("/upsample?ratio=4", &body);
        assert_eq!(reply.status, 200, "{format:?}: {}", reply.text());
        assert_eq!(reply.header("content-type"), Some(media));
        assert_eq!(reply.header("densecloud-warning"), None);
        let cloud =
            CloudReader::open(&body[..], Limits::default()).expect("a header").read().expect("a cloud");
        let origin = cloud.origin.clone();
        let dense = outcome(cloud, Target::Ratio(4.0), 0);
        let mut origin = origin;
        origin.comments.push(reply.header("densecloud-provenance").expect("provenance").to_owned());
        let expected = densecloud_formats::encode(
            Vec::new(),
            format,
            &dense.made.positions,
            &dense.made.attributes,
            &origin,
        );
        assert!(reply.body == expected.expect("a file"), "{format:?}");
        let back = CloudReader::open(&reply.body[..], Limits::default()).expect("a header");
        assert!(back.header().format.is_like(format));
        assert_eq!(back.read().expect("a cloud").origin.crs, origin.crs);
    }
}

#[test]
fn what_was_done_to_the_input_is_told() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut body = String::from(
        "ply\nformat ascii 1.0\nelement vertex 102\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nproperty list uchar int near\nend_header\n",
    );
    let mut points = cloud(100);
    points.extend([points[0], [f64::NAN, 0.0, 0.0]]);
    for [x, y, z] in points {
        body += &format!("{x} {y} {z} 255 1 0\n");
    }
    let reply = server.post("/upsample?ratio=2", body.as_bytes());
    assert_eq!(reply.status, 200, "{}", reply.text());
    let warnings: Vec<_> = reply
        .headers
        .iter()
        .filter(|(name, _)| name == "densecloud-warning")
        .map(|(_, w)| w.as_str())
        .collect();
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(warnings[0].contains("near") && warnings[1].contains("NaN") && warnings[2].contains("coincide"));
    assert_eq!(reply.header("densecloud-points-in"), Some("102"));
    assert_eq!(reply.header("densecloud-points-out"), Some("202"), "twice the finite points");
}

#[test]
fn what_a_ply_file_tells_of_the_whole_is_sent_with_its_length() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut body = String::from(
        "ply\nformat binary_little_endian 1.0\ncomment crs: EPSG:2992\ncomment by hand\n\
         element camera 1\nproperty list uchar short view\nelement vertex 100\nproperty double x\n\
         property double y\nproperty double z\nelement face 1\nproperty list uchar int vertex_index\n\
         end_header\n",
    )
    .into_bytes();
    body.extend([2, 1, 0, 2, 0]);
    body.extend(cloud(100).as_flattened().iter().flat_map(|v| v.to_le_bytes()));
    body.extend([1, 0, 0, 0, 0]);
    let reply = server.post("/upsample?ratio=2", &body);
    assert_eq!(reply.status, 200, "{}", reply.text());
    assert!(reply.header("densecloud-warning").expect("a warning").contains("not carried over: face"));
    assert_eq!(reply.header("content-length"), Some(reply.body.len().to_string().as_str()));
    let result = CloudReader::open(&reply.body[..], Limits::default()).expect("a header").read();
    let result = result.expect("a cloud");
    assert_eq!(result.positions.len(), 200);
    assert_eq!(result.origin.crs.map(|crs| crs.to_string()).as_deref(), Some("EPSG:2992"));
    assert!(result.origin.comments.contains(&"by hand".to_owned()));
    let names: Vec<&str> = result.origin.tables.iter().map(|table| table.name.as_str()).collect();
    assert_eq!(names, ["camera"]);
}

#[test]
fn attributes_are_carried_over_by_their_rules() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut body = String::from(
        "ply\nformat ascii 1.0\nelement vertex 100\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nproperty int label\nend_header\n",
    );
    for (i, [x, y, z]) in cloud(100).into_iter().enumerate() {
        body += &format!("{x} {y} {z} {i} {}\n", 7 * i);
    }
    let reply = server.post("/upsample?ratio=2&attributes=red:nearest", body.as_bytes());
    assert_eq!(reply.status, 200, "{}", reply.text());
    assert!(reply.header("server-timing").expect("timing").contains("attributes;dur="));
    let text = reply.text();
    let (header, rows) = text.split_once("end_header\n").expect("a header");
    assert!(header.ends_with("property uchar red\nproperty int label\n"), "{header}");
    let rows: Vec<&str> = rows.lines().collect();
    assert_eq!(rows.len(), 200);
    for row in rows {
        let fields: Vec<&str> = row.split(' ').collect();
        let [red, label] = [3, 4].map(|i| fields[i].parse::<usize>().expect("a number"));
        assert_eq!(label, 7 * red, "both from the same nearest point");
    }
    let reply = server.post("/upsample?ratio=2&attributes=blue:drop", body.as_bytes());
    assert_eq!(reply.status, 400);
    assert!(reply.text().contains("it has red, label"), "{}", reply.text());
}

#[test]
fn a_result_that_never_fits_is_refused_for_good() {
    let mut config = Config::default();
    config.limits.points_out = 1000;
    config.limits.body_bytes = 4000;
    config.limits.held_bytes = 24_000;
    let server = Server::start(&Scripted::new(), config);
    let mut body = String::from(
        "ply\nformat ascii 1.0\nelement vertex 100\nproperty float x\nproperty float y\nproperty float z\n",
    );
    body += "property double t\nend_header\n";
    for [x, y, z] in cloud(100) {
        body += &format!("{x:.3} {y:.3} {z:.3} 1\n");
    }
    let reply = server.post("/upsample?points=1000", body.as_bytes());
    assert_eq!(reply.status, 413, "{}", reply.text());
    assert!(reply.text().contains("result-too-large"), "{}", reply.text());
    let reply = server.post("/upsample?points=1000&attributes=t:drop", body.as_bytes());
    assert_eq!(reply.status, 200, "as it says: {}", reply.text());
}

#[test]
fn a_body_without_a_length_is_taken_in_pieces() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(100), PLY);
    let mut client = server.connect();
    client.send(b"POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\nconnection: close\r\n");
    client.send(b"transfer-encoding: chunked\r\n\r\n");
    for piece in body.chunks(37) {
        client.send(format!("{:x}\r\n", piece.len()).as_bytes());
        client.send(piece);
        client.send(b"\r\n");
    }
    client.send(b"0\r\n\r\n");
    let reply = client.reply();
    let expected = dense(cloud(100), Target::Ratio(2.0), 0);
    assert!(reply.body == encode_result(&expected, PLY, &reply), "{}", reply.status);
}

#[test]
fn the_accept_header_chooses_the_format() {
    let server = Server::start(&Scripted::new(), Config::default());
    let ask = |accept: &str| {
        let body = encode(&cloud(100), PLY);
        let mut client = server.connect();
        let head = format!(
            "POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\nconnection: close\r\naccept: {accept}\r\n\
             content-length: {}\r\n\r\n",
            body.len()
        );
        client.send(head.as_bytes());
        client.send(&body);
        client.reply()
    };
    let csv = Format::text(Separator::Comma);
    for (accept, format) in
        [("text/csv", csv), ("text/html, */*;q=0.8", PLY), ("text/csv;q=0.1, model/ply", PLY)]
    {
        let reply = ask(accept);
        assert_eq!(
            (reply.status, reply.header("content-type")),
            (200, Some(format.media_type())),
            "{accept}"
        );
        let expected = dense(cloud(100), Target::Ratio(2.0), 0);
        assert!(reply.body == encode_result(&expected, format, &reply), "{accept}");
    }
    let refused = ask("text/html");
    assert_eq!((refused.status, refused.problem_name().as_str()), (406, "not-acceptable"));
    assert_eq!(server.engine.queued_points(), 0);
}

#[test]
fn a_sweep_of_bare_numbers_is_what_the_request_says() {
    let server = Server::start(&Scripted::new(), Config::default());
    let positions = cloud(300);
    // Four, or five, 32-bit floats a point.
    let sweep = |others: &[f32]| -> Vec<u8> {
        let point = |p: &[f64; 3]| [p.map(|c| c as f32).as_slice(), others].concat();
        positions.iter().flat_map(point).flat_map(f32::to_le_bytes).collect()
    };
    for (format, others, names) in [
        ("kitti", &[0.5][..], &["intensity"][..]),
        ("nuscenes", &[36.0, 7.0], &["intensity", "ring"]),
        ("KITTI", &[0.25], &["intensity"]),
    ] {
        let target = format!("/upsample?ratio=4&format={format}&keep_input=true");
        let reply = server.post(&target, &sweep(others));
        assert_eq!(reply.status, 200, "{format}: {}", reply.text());
        assert_eq!(reply.header("content-type"), Some(PLY.media_type()));
        assert_eq!(reply.header("densecloud-points-in"), Some("300"));
        assert_eq!(reply.header("densecloud-points-out"), Some("1200"));
        let reader = CloudReader::open(&reply.body[..], Limits::default()).expect("a header");
        assert_eq!(reader.header().format, PLY);
        let dense = reader.read().expect("a cloud");
        assert_eq!((dense.positions.len(), &dense.positions[..300]), (1200, &positions[..]));
        for ((attribute, name), value) in dense.attributes.iter().zip(names).zip(others) {
            assert_eq!(
                (attribute.name.as_str(), &attribute.values),
                (*name, &Values::F32(vec![*value; 1200]))
            );
        }
        assert_eq!(dense.attributes.len(), names.len());
    }
    let body = sweep(&[0.5]);
    let reply = server.post("/upsample?ratio=4&format=kitti", &body[..body.len() - 1]);
    assert_eq!((reply.status, reply.problem_name().as_str()), (400, "malformed-cloud"), "{}", reply.text());
    let reply = server.post("/upsample?ratio=4", &body);
    assert_eq!((reply.status, reply.problem_name().as_str()), (415, "unsupported-format"));
    assert!(reply.text().contains("--format") && reply.text().contains("kitti"), "{}", reply.text());
}

#[test]
fn the_input_can_be_kept_and_a_spacing_asked_for() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(300), PLY);
    let reply = server.post("/upsample?ratio=4&keep_input=true&source_fields=true", &body);
    let kept = CloudReader::open(&reply.body[..], Limits::default()).unwrap().read().unwrap();
    assert_eq!(kept.positions.len(), 1200);
    assert_eq!(kept.positions[..300], cloud(300));
    assert_eq!(
        kept.attributes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>(),
        ["source_index", "is_generated"]
    );
    // The sphere's area is 4 pi.
    let reply = server.post("/upsample?density=100", &body);
    let points: f64 = reply.header("densecloud-points-out").expect("points").parse().expect("a number");
    assert!((points / 1256.6 - 1.0).abs() < 0.05, "{points}");
    let refused = server.post("/upsample?spacing=1e-9", &body);
    assert_eq!((refused.status, refused.problem_name().as_str()), (422, "impossible-cloud"));
    let config = Config {
        limits: densecloud_server::Limits { points_out: 1000, ..Default::default() },
        ..Config::default()
    };
    let small = Server::start(&Scripted::new(), config);
    let refused = small.post("/upsample?density=100", &body);
    assert_eq!((refused.status, refused.problem_name().as_str()), (413, "too-many-points-out"));
}

#[test]
fn one_connection_serves_one_request_after_another() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut client = server.connect();
    let body = encode(&cloud(100), PLY);
    let expected = dense(cloud(100), Target::Ratio(2.0), 0);
    for _ in 0..3 {
        let head =
            format!("POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n", body.len());
        client.send(head.as_bytes());
        client.send(&body);
        let mut bytes = Vec::new();
        let reply = loop {
            bytes.extend(client.some());
            if let Some(reply) = Reply::parse(&bytes) {
                break reply;
            }
        };
        assert!(reply.body == encode_result(&expected, PLY, &reply));
    }
}

#[test]
fn a_requests_id_comes_back_and_is_made_where_there_is_none() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut client = server.connect();
    client.send(b"GET /nowhere HTTP/1.1\r\nhost: x\r\nconnection: close\r\nx-request-id: mine-7\r\n\r\n");
    let reply = client.reply();
    assert_eq!(reply.header("x-request-id"), Some("mine-7"));
    assert_eq!(reply.problem()["request_id"], "mine-7");
    let made = |reply: Reply| reply.header("x-request-id").expect("an id").to_owned();
    assert_ne!(made(server.get("/healthz")), made(server.get("/healthz")));
}

#[test]
fn metrics_tell_what_happened() {
    let model =
        ModelInfo { name: ModelName { name: "m".into(), sha256: "ab".into() }, provider: "cpu".into() };
    let server = Server::start(&Scripted::new(), Config { model, ..Config::default() });
    server.post("/upsample?ratio=4", &encode(&cloud(100), PLY));
    server.post("/upsample?ratio=99", &encode(&cloud(100), PLY));
    // The last byte is sent before the record is closed.
    let ok = "densecloud_requests_total{interface=\"http\",outcome=\"ok\"}";
    crate::support::wait_until("both are counted", || {
        server.metric(ok) == 1.0
            && server.metric("densecloud_request_duration_seconds_count{interface=\"http\"}") == 2.0
    });
    let page = server.get("/metrics");
    assert_eq!(page.header("content-type"), Some("text/plain; version=0.0.4; charset=utf-8"));
    for (line, value) in [
        ("densecloud_requests_total{interface=\"http\",outcome=\"invalid-parameter\"}", 1.0),
        ("densecloud_stage_duration_seconds_count{stage=\"units\"}", 1.0),
        ("densecloud_stage_duration_seconds_count{stage=\"upload\"}", 1.0),
        ("densecloud_points_in_total", 100.0),
        ("densecloud_points_out_total", 400.0),
        ("densecloud_queue_points", 0.0),
        ("densecloud_held_bytes", 0.0),
        ("densecloud_requests_in_flight", 0.0),
        ("densecloud_model_info{model=\"m\",sha256=\"ab\",provider=\"cpu\"}", 1.0),
    ] {
        assert!(page.text().contains(line), "{line} in\n{}", page.text());
        assert_eq!(server.metric(line), value, "{line}");
    }
}

#[test]
fn the_interface_describes_itself() {
    let files = vec![concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml").into()];
    let server = Server::start(&Scripted::new(), Config { files, ..Config::default() });
    let reply = server.get("/openapi.json");
    assert_eq!((reply.status, reply.header("content-type")), (200, Some("application/json")));
    let description: serde_json::Value = serde_json::from_slice(&reply.body).expect("JSON");
    for (path, item) in description["paths"].as_object().expect("paths") {
        let path = path.replace("{model}", "densecloud").replace("{version}", "1");
        let path = path.replace("{part}", "main.js").replace("{number}", "0");
        let path = path.replace("/estimate", "/estimate?points_in=100&ratio=4");
        let reply = server.get(&path);
        if item["get"].is_null() {
            assert_eq!(reply.status, 405, "{path}");
            continue;
        }
        if path.starts_with("/jobs") {
            assert_eq!((reply.status, reply.problem_name().as_str()), (501, "jobs-off"), "{path}");
            continue;
        }
        let content = item["get"]["responses"]["200"]["content"].as_object().expect("a content");
        assert_eq!(reply.status, 200, "{path}");
        let found = reply.header("content-type").expect("a media type");
        assert!(content.keys().any(|media| found.starts_with(media)), "{path}: {found}");
    }
    let page = server.get("/docs");
    assert!(page.header("content-security-policy").is_some_and(|p| p.starts_with("default-src 'none'")));
    assert!(page.text().contains("openapi.json"));
}
