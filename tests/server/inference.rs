//! The Open Inference Protocol.

use std::time::Duration;

use densecloud_backends::ModelName;
use densecloud_cascade::Fake;
use densecloud_cascade::Target;
use densecloud_cloud::Position;
use densecloud_engine::EngineConfig;
use densecloud_server::{Config, Limits, ModelInfo};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::support::{Reply, Scripted, Server, cloud, dense, wait_until};

const INFER: &str = "/v2/models/densecloud/infer";

/// A body, and the length of its JSON where something follows it.
struct Body {
    json: Value,
    binary: Option<Vec<u8>>,
}

impl Body {
    fn of(points: &[Position], datatype: &str, binary: bool, parameters: Value) -> Self {
        let mut input = json!({ "name": "points", "datatype": datatype, "shape": [points.len(), 3] });
        let bytes = bytes(points, datatype);
        if binary {
            input["parameters"] = json!({ "binary_data_size": bytes.len() });
        } else {
            input["data"] = json!(points.as_flattened());
        }
        let json = json!({ "id": "mine", "parameters": parameters, "inputs": [input] });
        Self { json, binary: binary.then_some(bytes) }
    }

    /// The smallest that is fine.
    fn plain() -> Self {
        Self::of(&cloud(100), "FP32", true, json!({ "ratio": 2 }))
    }

    fn bytes(&self) -> (usize, Vec<u8>) {
        let json = self.json.to_string().into_bytes();
        (json.len(), [json, self.binary.clone().unwrap_or_default()].concat())
    }

    /// A request's head, and its body.
    fn request(&self, path: &str) -> Vec<u8> {
        let (header, bytes) = self.bytes();
        let header = self.binary.as_ref().map(|_| format!("inference-header-content-length: {header}\r\n"));
        let head = format!(
            "POST {path} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{}content-length: {}\r\n\r\n",
            header.unwrap_or_default(),
            bytes.len()
        );
        [head.into_bytes(), bytes].concat()
    }

    fn post(&self, server: &Server) -> Reply {
        let mut client = server.connect();
        client.send(&self.request(INFER));
        client.reply()
    }
}

fn bytes(points: &[Position], datatype: &str) -> Vec<u8> {
    let numbers = points.as_flattened().iter();
    match datatype {
        "FP32" => numbers.flat_map(|c| (*c as f32).to_le_bytes()).collect(),
        _ => numbers.flat_map(|c| c.to_le_bytes()).collect(),
    }
}

/// The answer's JSON, and the tensor's numbers as the library would have them.
fn read(reply: &Reply) -> (Value, Vec<u8>) {
    assert_eq!(reply.status, 200, "{}", String::from_utf8_lossy(&reply.body));
    let header = reply.header("inference-header-content-length").map(|n| n.parse().expect("a length"));
    let (json, rest) = reply.body.split_at(header.unwrap_or(reply.body.len()));
    let json: Value = serde_json::from_slice(json).expect("JSON");
    let output = &json["outputs"][0];
    if header.is_some() {
        assert_eq!(output["parameters"]["binary_data_size"], rest.len());
        return (json, rest.to_vec());
    }
    let numbers: Vec<f64> = serde_json::from_value(output["data"].clone()).expect("numbers");
    let (rows, _) = numbers.as_chunks();
    let rest = bytes(rows, output["datatype"].as_str().expect("a datatype"));
    (json, rest)
}

/// The status and the text of an error in the protocol's form.
fn error(reply: &Reply) -> (u16, String) {
    assert_eq!(reply.header("content-type"), Some("application/json"), "{reply:?}");
    assert!(reply.header("x-request-id").is_some());
    assert_eq!(reply.header("retry-after").is_some(), reply.status == 503, "{reply:?}");
    let json: Value = serde_json::from_slice(&reply.body).expect("JSON");
    assert_eq!(json.as_object().map(serde_json::Map::len), Some(1), "{json}");
    (reply.status, json["error"].as_str().expect("an error").to_owned())
}

#[test]
fn the_answer_is_the_librarys_own_result() {
    let server = Server::start(&Scripted::new(), Config::default());
    for (parameters, target, seed) in [
        (json!({ "ratio": 4 }), Target::Ratio(4.0), 0),
        (json!({ "ratio": "2.5", "seed": 7 }), Target::Ratio(2.5), 7),
        (json!({ "points": 1001, "priority": 1, "timeout": 5_000_000 }), Target::Points(1001), 0),
    ] {
        let expected = dense(cloud(300), target, seed);
        for (datatype, binary, binary_out) in
            [("FP32", true, true), ("FP64", true, false), ("FP32", false, true), ("FP64", false, false)]
        {
            let mut body = Body::of(&cloud(300), datatype, binary, parameters.clone());
            body.json["parameters"]["binary_data_output"] = binary_out.into();
            let reply = body.post(&server);
            let (json, found) = read(&reply);
            assert!(found == bytes(&expected, datatype), "{datatype} {binary} {parameters}");
            assert_eq!(json["id"], "mine");
            assert_eq!(json["model_name"], "densecloud");
            assert_eq!(json["model_version"], "1");
            assert_eq!(json["outputs"][0]["name"], "points");
            assert_eq!(json["outputs"][0]["datatype"], datatype);
            assert_eq!(json["outputs"][0]["shape"], json!([expected.len(), 3]));
            assert_eq!(reply.header("inference-header-content-length").is_some(), binary_out);
            assert_eq!(reply.header("content-length").is_some(), binary_out);
            assert_eq!(reply.header("densecloud-points-in"), Some("300"));
            assert_eq!(
                json["parameters"]["provenance"].as_str(),
                reply.header("densecloud-provenance"),
                "told where clients look"
            );
            // The tensor's, whether it came in JSON or in binary.
            let hash = Sha256::digest(bytes(&cloud(300), datatype));
            let hash: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
            assert!(reply.header("densecloud-provenance").expect("a line").contains(&hash), "{reply:?}");
            assert!(reply.header("server-timing").expect("timing").contains("units;dur="));
        }
    }
}

#[test]
fn outputs_are_asked_for_by_name_and_each_says_how_it_comes() {
    let server = Server::start(&Scripted::new(), Config::default());
    for (outputs, whole, binary) in [
        (json!([{ "name": "points", "parameters": { "binary_data": true } }]), false, true),
        (json!([{ "name": "points", "parameters": { "binary_data": false } }]), true, false),
        (json!([{ "name": "points" }]), true, true),
        (json!([]), false, false),
    ] {
        let mut body = Body::plain();
        body.json["outputs"] = outputs.clone();
        body.json["parameters"]["binary_data_output"] = whole.into();
        let (json, _) = read(&body.post(&server));
        assert_eq!(json["outputs"][0]["data"].is_null(), binary, "{outputs}");
    }
}

#[test]
fn bodies_that_other_servers_take_are_taken() {
    let server = Server::start(&Scripted::new(), Config::default());
    let points = cloud(300);
    let expected = bytes(&dense(points.clone(), Target::Ratio(2.0), 0), "FP32");
    type Edit = fn(&mut Value);
    let cases: [Edit; 9] = [
        |_| {},
        |b| b["inputs"][0]["parameters"] = Value::Null,
        |b| b["outputs"] = Value::Null,
        |b| b["id"] = Value::Null,
        |b| b["inputs"][0]["parameters"] = json!({ "content_type": "np" }),
        |b| b["parameters"]["content_type"] = "np".into(),
        |b| b["outputs"] = json!([{ "name": "points", "parameters": { "content_type": "np" } }]),
        |b| b["inputs"][0]["shape"] = json!([1, 300, 3]),
        |b| {
            b["inputs"][0]["shape"] = json!([1, 300, 3]);
            let rows: Vec<Value> =
                b["inputs"][0]["data"].as_array().unwrap().chunks(3).map(|row| json!(row)).collect();
            b["inputs"][0]["data"] = json!([rows]);
        },
    ];
    for (i, edit) in cases.into_iter().enumerate() {
        let mut body = Body::of(&points, "FP32", false, json!({ "ratio": 2 }));
        edit(&mut body.json);
        let (json, found) = read(&body.post(&server));
        assert!(found == expected, "case {i}");
        assert_eq!(json["outputs"][0]["shape"], json!([600, 3]), "case {i}");
    }
    let mut binary = Body::of(&points, "FP32", true, json!({ "ratio": 2 }));
    binary.json["inputs"][0]["shape"] = json!([1, 300, 3]);
    assert!(read(&binary.post(&server)).1 == expected);
    // Four times the points where nothing says how many.
    let expected = bytes(&dense(points.clone(), Target::Ratio(4.0), 7), "FP64");
    for parameters in [Value::Null, json!({}), json!({ "ratio": null }), json!({ "seed": 7 })] {
        let mut body = Body::of(&points, "FP64", false, parameters);
        let seeded = body.json["parameters"]["seed"].is_null();
        let (json, found) = read(&body.post(&server));
        assert_eq!(json["outputs"][0]["shape"], json!([1200, 3]));
        assert!(seeded || found == expected);
        body.json.as_object_mut().unwrap().remove("parameters");
        assert_eq!(read(&body.post(&server)).0["outputs"][0]["shape"], json!([1200, 3]));
    }
}

#[test]
fn the_models_are_listed_and_none_is_loaded_or_unloaded() {
    let backend = Scripted::new();
    backend.shut();
    let sizes = EngineConfig { threads: 2, ..Default::default() };
    let server = Server::start_cold(&backend, sizes, Config::default());
    let index = |body: &str| {
        let reply = server.post("/v2/repository/index", body.as_bytes());
        assert_eq!(reply.status, 200, "{body:?}: {}", reply.text());
        serde_json::from_slice::<Value>(&reply.body).expect("JSON")
    };
    let all = index("");
    assert_eq!((all[0]["name"].as_str(), all[0]["version"].as_str()), (Some("densecloud"), Some("1")));
    assert_eq!(all[0]["state"], "LOADING");
    assert!(all[0]["reason"].as_str().expect("text").contains("being loaded"));
    assert_eq!(index(r#"{"ready":true}"#), json!([]));
    backend.open();
    server.wait_for_ready();
    for body in ["", " ", "{}", "null", r#"{"ready":null}"#, r#"{"ready":true}"#, r#"{"repository_name":""}"#]
    {
        let expected = json!([{ "name": "densecloud", "version": "1", "state": "READY", "reason": "" }]);
        assert_eq!(index(body), expected, "{body:?}");
    }
    for body in ["[]", "{", r#"{"ready":7}"#, r#"{"ready":{}}"#] {
        assert_eq!(error(&server.post("/v2/repository/index", body.as_bytes())).0, 400, "{body:?}");
    }
    // Nothing asks for more, and it would be parsed where all connections are served.
    let (status, why) = error(&server.post("/v2/repository/index", &vec![b' '; (64 << 10) + 1]));
    assert!(status == 400 && why.contains("65536 bytes"), "{status}: {why}");
    assert_eq!(index(&" ".repeat(64 << 10))[0]["state"], "READY");
    let models: Value = serde_json::from_slice(&server.get("/v2/models").body).expect("JSON");
    assert_eq!(models, json!({ "models": ["densecloud"] }));
    for verb in ["load", "unload"] {
        let (status, why) = error(&server.post(&format!("/v2/repository/models/densecloud/{verb}"), b""));
        assert_eq!((status, why.contains("part of this server")), (409, true), "{why}");
        assert_eq!(error(&server.post(&format!("/v2/repository/models/other/{verb}"), b"")).0, 404);
    }
}

#[test]
fn statistics_count_what_was_done_and_how_long_it_took() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    let statistics = |path: &str| -> Value {
        let reply = server.get(path);
        assert_eq!(reply.status, 200, "{path}: {}", reply.text());
        let json: Value = serde_json::from_slice(&reply.body).expect("JSON");
        assert_eq!(json["model_stats"].as_array().map(Vec::len), Some(1), "{path}");
        json["model_stats"][0].clone()
    };
    let paths = ["/v2/models/stats", "/v2/models/densecloud/stats", "/v2/models/densecloud/versions/1/stats"];
    for path in paths {
        let before = statistics(path);
        assert_eq!((&before["name"], &before["version"]), (&json!("densecloud"), &json!("1")));
        assert_eq!((&before["inference_count"], &before["last_inference"]), (&json!(0), &json!(0)));
        assert_eq!(before["batch_stats"], json!([]));
    }
    for _ in 0..2 {
        assert_eq!(Body::plain().post(&server).status, 200);
    }
    let mut wrong = Body::plain();
    wrong.json["parameters"]["ratio"] = 99.into();
    assert_eq!(wrong.post(&server).status, 400);
    backend.shut();
    let mut leaves = server.connect();
    leaves.send(&Body::plain().request(INFER));
    server.wait_for_work();
    drop(leaves);
    wait_until("it has left", || statistics(paths[0])["inference_stats"]["fail"]["count"] == 2);
    backend.open();
    for path in paths {
        let after = statistics(path);
        assert_eq!((&after["inference_count"], &after["execution_count"]), (&json!(2), &json!(2)));
        // This century.
        assert!(after["last_inference"].as_u64().expect("a time") > 946_684_800_000);
        let stats = &after["inference_stats"];
        for (name, count, takes_time) in [
            ("success", 2, true),
            ("fail", 2, true),
            ("queue", 2, false),
            ("compute_input", 2, true),
            ("compute_infer", 2, true),
            ("compute_output", 2, false),
            ("cache_hit", 0, false),
        ] {
            assert_eq!(stats[name]["count"], count, "{name}");
            assert!(stats[name]["ns"].as_u64().expect("a number") > 0 || !takes_time, "{name}: {after}");
        }
        assert_eq!(after["batch_stats"][0]["batch_size"], 1);
        assert_eq!(after["batch_stats"][0]["compute_infer"], stats["compute_infer"]);
    }
    assert_eq!(error(&server.get("/v2/models/other/stats")).0, 404);
    assert_eq!(error(&server.get("/v2/models/densecloud/versions/2/stats")).0, 404);
}

#[test]
fn a_version_may_be_named_and_an_id_be_absent() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut body = Body::plain();
    body.json.as_object_mut().expect("an object").remove("id");
    let mut client = server.connect();
    client.send(&body.request("/v2/models/densecloud/versions/1/infer"));
    let (json, _) = read(&client.reply());
    assert_eq!(json.get("id"), None);
}

#[test]
fn what_was_done_to_the_input_is_told() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut points = cloud(100);
    points.push([f64::NAN, 0.0, 0.0]);
    let reply = Body::of(&points, "FP32", true, json!({ "ratio": 2 })).post(&server);
    let (json, _) = read(&reply);
    assert_eq!(json["outputs"][0]["shape"], json!([200, 3]));
    assert!(json["parameters"]["warnings"].as_str().expect("a warning").contains("NaN"));
    // As Python writes it in JSON, and as JavaScript does.
    for literal in ["NaN", "-Infinity", "null"] {
        let body = Body::of(&cloud(101), "FP64", false, json!({ "ratio": 2 })).json.to_string();
        let (start, rest) = body.split_once("\"data\":[").expect("data");
        let (_, rest) = rest.split_once(',').expect("a number");
        let reply = server.post(INFER, format!("{start}\"data\":[{literal},{rest}").as_bytes());
        let (json, _) = read(&reply);
        assert_eq!(json["outputs"][0]["shape"], json!([200, 3]), "{literal}");
        assert!(json["parameters"]["warnings"].as_str().expect("a warning").contains("NaN"), "{literal}");
    }
    // A quarter of a metre is the step between two 32-bit floats there.
    let far: Vec<Position> = cloud(100).iter().map(|p| p.map(|c| 100.0 * c + 4e6)).collect();
    let (json, _) = read(&Body::of(&far, "FP32", true, json!({ "ratio": 2 })).post(&server));
    assert!(json["parameters"]["warnings"].as_str().expect("a warning").contains("send FP64"));
    let (json, found) = read(&Body::of(&far, "FP64", true, json!({ "ratio": 2 })).post(&server));
    assert_eq!(json["parameters"].get("warnings"), None);
    assert!(found == bytes(&dense(far, Target::Ratio(2.0), 0), "FP64"));
}

#[test]
fn the_server_and_its_model_describe_themselves() {
    let model =
        ModelInfo { name: ModelName { name: "m".into(), sha256: "ab".into() }, provider: "cpu".into() };
    let server = Server::start(&Scripted::new(), Config { model, ..Config::default() });
    let get = |path: &str| -> Value {
        let reply = server.get(path);
        assert_eq!(reply.status, 200, "{path}: {}", reply.text());
        serde_json::from_slice(&reply.body).expect("JSON")
    };
    assert_eq!(get("/v2")["name"], "densecloud");
    let extensions =
        ["binary_tensor_data", "model_configuration", "model_repository", "parameters", "statistics"];
    assert_eq!(get("/v2")["extensions"], json!(extensions));
    assert_eq!(get("/v2/health/live"), json!({ "live": true }));
    assert_eq!(get("/v2/health/ready"), json!({ "ready": true }));
    for model in ["/v2/models/densecloud", "/v2/models/densecloud/versions/1"] {
        let tensor = json!([{ "name": "points", "datatype": "FP32", "shape": [-1, 3] }]);
        let metadata = get(model);
        assert_eq!((&metadata["inputs"], &metadata["outputs"]), (&tensor, &tensor));
        assert_eq!(metadata["versions"], json!(["1"]));
        assert_eq!(get(&format!("{model}/ready"))["ready"], true);
        let config = get(&format!("{model}/config"));
        assert_eq!(config["max_batch_size"], 0);
        assert_eq!(config["parameters"]["sha256"]["string_value"], "ab");
    }
    assert_eq!(server.metric("densecloud_requests_in_flight"), 0.0);
}

#[test]
fn a_server_that_is_not_ready_says_so() {
    let backend = Scripted::new();
    backend.shut();
    let sizes = EngineConfig { threads: 2, ..Default::default() };
    let server = Server::start_cold(&backend, sizes, Config::default());
    assert_eq!(server.get("/v2/health/live").status, 200);
    for path in ["/v2/health/ready", "/v2/models/densecloud/ready"] {
        let (status, why) = error(&server.get(path));
        assert_eq!((status, why.contains("being loaded")), (503, true), "{why}");
    }
    assert_eq!(error(&Body::plain().post(&server)).0, 503);
    backend.open();
    server.wait_for_ready();
    assert_eq!(server.get("/v2/health/ready").status, 200);
}

fn limits() -> Limits {
    Limits { body_bytes: 40_000, points_in: 1000, points_out: 4000, held_bytes: 200_000, ..Limits::default() }
}

#[test]
fn each_kind_of_bad_request_has_its_status_and_says_why() {
    let server = Server::start(&Scripted::new(), Config { limits: limits(), ..Config::default() });
    type Edit = fn(&mut Body);
    let cases: [(Edit, u16, &str); 33] = [
        (|b| b.json["parameters"] = json!({ "ratio": 65 }), 400, "ratio"),
        (|b| b.json["parameters"] = json!({ "ratio": "x" }), 400, "ratio"),
        (|b| b.json["parameters"] = json!({ "ratio": [4] }), 400, "invalid type"),
        (|b| b.json["parameters"] = json!({ "ratio": 2, "points": 500 }), 400, "give one of"),
        (|b| b.json["parameters"] = json!({ "ratio": 2, "colour": 1 }), 400, "colour: unknown"),
        (|b| b.json["parameters"] = json!({ "ration": 2 }), 400, "ration: unknown"),
        (|b| b.json["parameters"] = json!({ "colour": [1] }), 400, "colour: unknown"),
        (|b| b.json["parameters"] = json!({ "ratio": 2, "attributes": "red:drop" }), 400, "unknown"),
        (|b| b.json = json!([]), 400, "JSON"),
        (|b| b.json = json!({ "parameters": { "ratio": 2 } }), 400, "inputs"),
        (|b| b.json["inputs"] = json!([]), 400, "0 inputs"),
        (|b| b.json["inputs"] = json!([b.json["inputs"][0], b.json["inputs"][0]]), 400, "2 inputs"),
        (|b| b.json["inputs"][0]["name"] = "colours".into(), 400, "unknown input"),
        (|b| b.json["inputs"][0]["datatype"] = "FP16".into(), 400, "FP32 or FP64"),
        (|b| b.json["inputs"][0]["datatype"] = "FP64".into(), 400, "take 2400 bytes"),
        (|b| b.json["inputs"][0]["shape"] = json!([3, 100]), 400, "[N, 3]"),
        (|b| b.json["inputs"][0]["shape"] = json!([99, 3]), 400, "take 1188 bytes"),
        (|b| b.json["inputs"][0]["shape"] = json!([2, 50, 3]), 400, "2 clouds"),
        (
            |b| b.json["inputs"][0]["parameters"]["shared_memory_region"] = "x".into(),
            400,
            "shared_memory_region is not supported",
        ),
        (|b| b.json["inputs"][0]["data"] = json!([1, 2, 3]), 400, "both"),
        (|b| b.json["outputs"] = json!([{ "name": "normals" }]), 400, "unknown output"),
        (|b| b.json["outputs"] = json!([{ "name": "points" }, { "name": "points" }]), 400, "2 outputs"),
        (
            |b| b.json["outputs"] = json!([{ "name": "points", "parameters": { "classification": 3 } }]),
            400,
            "classification",
        ),
        (
            |b| b.json["outputs"] = json!([{ "name": "points", "parameters": { "binary_data": 7 } }]),
            400,
            "binary_data is 7",
        ),
        (
            |b| b.json["parameters"] = json!({ "ratio": 2, "binary_data_output": "maybe" }),
            400,
            "binary_data_output is maybe",
        ),
        (|b| b.binary.as_mut().expect("data").truncate(1199), 400, "bytes"),
        (|b| b.binary.as_mut().expect("data").push(0), 400, "bytes"),
        (|b| b.binary = None, 400, "Inference-Header-Content-Length"),
        (|b| *b = Body::of(&cloud(1001), "FP32", true, json!({ "ratio": 2 })), 413, "--max-points-in"),
        (|b| b.json["parameters"] = json!({ "ratio": 41 }), 413, "--max-points-out"),
        (|b| b.binary = Some(vec![0; 40_000]), 413, "--max-body-bytes"),
        (|b| *b = Body::of(&cloud(5), "FP32", true, json!({ "ratio": 2 })), 422, "5"),
        (|b| *b = Body::of(&[], "FP64", false, json!({ "ratio": 2 })), 422, "no finite points"),
    ];
    for (i, (edit, status, part)) in cases.into_iter().enumerate() {
        let mut body = Body::plain();
        edit(&mut body);
        let (found, why) = error(&body.post(&server));
        assert_eq!((found, why.contains(part)), (status, true), "case {i}, {part}: {why}");
    }
    assert_eq!(server.engine.queued_points(), 0);
    assert_eq!(Body::plain().post(&server).status, 200);
}

#[test]
fn unknown_models_paths_and_methods_have_the_protocols_form() {
    let server = Server::start(&Scripted::new(), Config::default());
    for path in [
        "/v2/models/other",
        "/v2/models/other/ready",
        "/v2/models/densecloud/versions/2",
        "/v2/models/densecloud/versions/2/config",
    ] {
        let (status, why) = error(&server.get(path));
        assert_eq!((status, why.contains("there is the model")), (404, true), "{why}");
    }
    assert_eq!(error(&server.get("/v2/nowhere")).0, 404);
    assert_eq!(error(&server.get(INFER)).0, 405);
    let mut client = server.connect();
    client.send(&Body::plain().request("/v2/models/other/infer"));
    assert_eq!(error(&client.reply()).0, 404);
    let mut client = server.connect();
    client.send(&Body::plain().request(&format!("{INFER}?ratio=4")));
    let (status, why) = error(&client.reply());
    assert_eq!((status, why.contains("among the request's")), (400, true), "{why}");
    for (header, status) in [
        ("content-encoding: br", 415),
        ("inference-header-content-length: -1", 400),
        ("inference-header-content-length: 4", 400),
    ] {
        let mut client = server.connect();
        client.send(format!("POST {INFER} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n").as_bytes());
        client.send(format!("{header}\r\ncontent-length: 3\r\n\r\n{{}}\n").as_bytes());
        assert_eq!(error(&client.reply()).0, status, "{header}");
    }
}

#[test]
fn a_tensor_is_judged_by_its_shape_before_it_has_arrived() {
    let server = Server::start(&Scripted::new(), Config { limits: limits(), ..Config::default() });
    for (points, ratio, length, part) in [
        (1001_i64, 2, 39_999, "--max-points-in"),
        (i64::MAX, 2, 39_999, "--max-points-in"),
        (1000, 5, 39_999, "--max-points-out"),
        (1000, 2, 39_999, "the body has 39999 bytes"),
    ] {
        let size = points.unsigned_abs().saturating_mul(12);
        let json = json!({
            "inputs": [{
                "name": "points", "datatype": "FP32", "shape": [points, 3],
                "parameters": { "binary_data_size": size }
            }],
            "parameters": { "ratio": ratio },
        })
        .to_string();
        let mut client = server.connect();
        client.send(format!("POST {INFER} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n").as_bytes());
        let header = json.len();
        let head = format!("inference-header-content-length: {header}\r\ncontent-length: {length}\r\n\r\n");
        client.send(head.as_bytes());
        client.send(json.as_bytes());
        // The client goes no further, so whatever answers has not waited for the rest.
        let (_, why) = error(&client.reply());
        assert!(why.contains(part), "{why}");
    }
}

#[test]
fn a_full_queue_and_a_failure_are_told_as_elsewhere() {
    let backend = Scripted::new();
    let sizes = EngineConfig { threads: 2, queue_points: 300, client_points: 300, ..Default::default() };
    let server = Server::start_cold(&backend, sizes, Config::default());
    server.wait_for_ready();
    backend.shut();
    let mut first = server.connect();
    first.send(&Body::plain().request(INFER));
    server.wait_for_work();
    let (status, why) = error(&Body::plain().post(&server));
    assert_eq!((status, why.contains("--queue-points")), (503, true), "{why}");
    backend.open();
    assert_eq!(first.reply().status, 200);
    server.wait_for_no_work();
    backend.fail();
    let (status, why) = error(&Body::plain().post(&server));
    assert_eq!((status, why.contains("secret")), (500, false), "{why}");
}

#[test]
fn a_deadline_is_told_as_elsewhere() {
    let backend = Scripted::new();
    let mut config = Config::default();
    config.timeouts.request = Duration::from_millis(300);
    let server = Server::start(&backend, config);
    backend.shut();
    let (status, why) = error(&Body::plain().post(&server));
    assert_eq!((status, why.contains("--request-timeout")), (504, true), "{why}");
    backend.open();
    server.wait_for_no_work();
}

#[test]
fn a_client_that_leaves_stops_the_work_and_is_counted() {
    let backend = Scripted::over(Fake::slow(Duration::from_millis(20)));
    let server = Server::start(&backend, Config::default());
    let before = backend.batches();
    let mut client = server.connect();
    client.send(&Body::of(&cloud(1000), "FP32", true, json!({ "ratio": 16 })).request(INFER));
    wait_until("it is being worked on", || backend.batches() > before);
    drop(client);
    server.wait_for_no_work();
    let cancelled = "densecloud_requests_total{interface=\"http\",outcome=\"cancelled\"}";
    wait_until("it is counted", || server.metric(cancelled) == 1.0);
    wait_until("its memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
}
