//! The description held against the program.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Uri};
use serde_json::{Map, Value};
use tempfile::TempDir;
use tower::ServiceExt;

use super::*;
use crate::admission::deadline::{self, Deadline};
use crate::app::{self, App};
use crate::jobs::document::Document;
use crate::jobs::work;
use crate::problem::every_problem;
use crate::{inference, jobs, testing};
use densecloud::PARAMETERS;
use densecloud_formats::Format;
use densecloud_jobs::State;

fn description() -> Value {
    serde_json::from_str(DESCRIPTION).expect("JSON")
}

fn members(value: &Value) -> &Map<String, Value> {
    value.as_object().expect("an object")
}

fn keys(value: &Value) -> BTreeSet<&str> {
    members(value).keys().map(String::as_str).collect()
}

#[test]
fn paths_and_methods_are_those_of_the_router() {
    let routes: BTreeSet<_> =
        app::routes().iter().map(|route| format!("{} {}", route.method, route.path)).collect();
    let description = description();
    let mut described = BTreeSet::new();
    for (path, item) in members(&description["paths"]) {
        described
            .extend(keys(item).into_iter().filter(|k| *k != "parameters").map(|m| format!("{m} {path}")));
    }
    assert_eq!(routes, described);
}

#[test]
fn parameters_and_media_types_are_those_that_are_read() {
    let description = description();
    let upsample = &description["paths"]["/upsample"]["post"];
    let parameters = upsample["parameters"].as_array().expect("a list");
    let names: Vec<_> = parameters.iter().map(|p| p["name"].as_str().expect("a name")).collect();
    let (header, names) = names.split_last().expect("parameters");
    assert_eq!(header.to_ascii_lowercase(), deadline::HEADER);
    let known = PARAMETERS.iter().map(|parameter| parameter.name);
    let names: BTreeSet<&str> = names.iter().copied().collect();
    assert_eq!(names, known.clone().collect());
    assert_eq!(keys(&upsample["responses"]["200"]["content"]), Format::MEDIA_TYPES.into());
    let form = keys(&description["components"]["schemas"]["Form"]["properties"]);
    assert_eq!(form, known.chain(["cloud"]).collect());
    let request = &description["components"]["schemas"]["InferenceRequest"]["properties"];
    let expected = inference::parameters().map(|parameter| parameter.name);
    let expected = expected.chain(["binary_data_output"]).chain(inference::HINTS);
    assert_eq!(keys(&request["parameters"]["properties"]), expected.collect());
}

#[test]
fn parameters_are_read_within_the_bounds_described() {
    let description = description();
    let described = |path: &str, method: &str, name: &str| {
        let parameters = description["paths"][path][method]["parameters"].as_array().expect("a list");
        let mut parameters = parameters.iter().map(|parameter| schema::resolved(&description, parameter));
        parameters.find(|parameter| parameter["name"] == name).expect(name)["schema"].clone()
    };
    for parameter in &PARAMETERS {
        let (name, schema) = (parameter.name, described("/upsample", "post", parameter.name));
        let checked = schema::check_reader(&schema, |text| parameter.check(text).is_ok());
        assert_eq!(checked, Ok(()), "{name}");
        let default = serde_json::to_value(parameter.default_value()).expect("JSON");
        let is_default = |described: &Value| {
            // As a number, 2 is 2.0.
            *described == default || described.is_number() && described.as_f64() == default.as_f64()
        };
        assert!(schema.get("default").is_none_or(is_default), "{name}: {default}");
        // A form's part and a job's parameter are the same.
        let part = &description["components"]["schemas"]["Form"]["properties"][name];
        assert_eq!(*schema::resolved(&description, part), schema, "{name}");
        assert_eq!(described("/jobs", "post", name), schema, "{name}");
    }
    let page = |name: &str, text: &str| {
        jobs::page_of(&format!("/jobs?{name}={text}").parse().expect("a path")).is_ok()
    };
    for name in ["limit", "before"] {
        assert_eq!(schema::check_reader(&described("/jobs", "get", name), |text| page(name, text)), Ok(()));
    }
    let unsaid = jobs::page_of(&Uri::from_static("/jobs")).expect("a page");
    assert_eq!(described("/jobs", "get", "limit")["default"], unsaid.1);
    let head = |name: &'static str, text: &str| {
        HeaderMap::from_iter([(HeaderName::from_static(name), HeaderValue::from_str(text).expect("a value"))])
    };
    let key = |text: &str| jobs::idempotency_key(&head("idempotency-key", text)).is_ok();
    assert_eq!(schema::check_reader(&described("/jobs", "post", "Idempotency-Key"), key), Ok(()));
    for path in
        ["/upsample", "/jobs", "/v2/models/{model}/infer", "/v2/models/{model}/versions/{version}/infer"]
    {
        let reads = |text: &str| Deadline::of(&head(deadline::HEADER, text), Duration::MAX).is_ok();
        assert_eq!(
            schema::check_reader(&described(path, "post", "X-Request-Timeout"), reads),
            Ok(()),
            "{path}"
        );
    }
}

#[test]
fn problems_have_their_statuses() {
    let all: BTreeSet<String> =
        every_problem().into_iter().map(|(_, status, name)| format!("{status} {name}")).collect();
    let description = description();
    // No operation answers with these: there is none, or a job tells of it.
    let mut described =
        BTreeSet::from(["404 not-found", "405 method-not-allowed", "500 job-gave-up"].map(str::to_owned));
    for item in members(&description["paths"]).values() {
        for operation in ["get", "post", "delete"].iter().filter_map(|method| item.get(method)) {
            for (status, response) in members(&operation["responses"]) {
                let names = response["description"].as_str().expect("text");
                if !status.starts_with(['2', '3']) {
                    described
                        .extend(names.split(", ").map(|name| format!("{status} {}", name.trim_matches('`'))));
                }
            }
        }
    }
    assert_eq!(described, all);
    let types = &description["components"]["schemas"]["Problem"]["properties"]["type"]["enum"];
    let types: BTreeSet<&str> =
        types.as_array().expect("a list").iter().map(|t| t.as_str().expect("text")).collect();
    let names = every_problem().into_iter().map(|(_, _, name)| format!("urn:densecloud:problem:{name}"));
    assert_eq!(types, names.collect::<BTreeSet<_>>().iter().map(String::as_str).collect());
}

#[test]
fn the_description_is_of_this_version_and_its_references_lead_somewhere() {
    let description = description();
    assert_eq!(description["info"]["version"], env!("CARGO_PKG_VERSION"));
    let mut ids = BTreeSet::new();
    for item in members(&description["paths"]).values() {
        for operation in ["get", "post", "delete"].iter().filter_map(|method| item.get(method)) {
            let id = operation["operationId"].as_str().expect("an id");
            assert!(ids.insert(id), "{id} comes twice");
        }
    }
    for reference in DESCRIPTION.split("\"$ref\": \"#").skip(1) {
        let (pointer, _) = reference.split_once('"').expect("an end");
        assert!(description.pointer(pointer).is_some(), "{pointer}");
    }
}

#[test]
fn the_description_says_where_a_proxy_offers_the_server() {
    let at = |prefix: Prefix| -> Value { serde_json::from_str(&description_under(&prefix)).expect("JSON") };
    assert_eq!(at(Prefix::default())["servers"][0]["url"], "/");
    let mut expected = description();
    expected["servers"][0]["url"] = "/clouds/1".into();
    assert_eq!(at(Prefix::of_path("/clouds/1")), expected);
}

#[test]
fn the_page_takes_nothing_from_elsewhere() {
    assert!(!PAGE.contains("://") && !PAGE.contains("src="));
}

#[test]
fn schemas_have_the_members_and_names_that_are_told() {
    let description = description();
    let schemas = &description["components"]["schemas"];
    let problem = &schemas["Problem"];
    let mut told = BTreeSet::new();
    for (one, _, name) in every_problem() {
        let value = one.value("id-1");
        assert_eq!(schema::check(&description, problem, &value), Ok(()), "{name}");
        told.extend(members(&value).keys().cloned());
    }
    assert_eq!(keys(&problem["properties"]), told.iter().map(String::as_str).collect());
    let error = serde_json::json!({ "error": "x" });
    assert_eq!(schema::check(&description, &schemas["InferenceError"], &error), Ok(()));
    let job = serde_json::to_value(Document::with_everything()).expect("JSON");
    assert_eq!(schema::check(&description, &schemas["Job"], &job), Ok(()));
    assert_eq!(keys(&job), keys(&schemas["Job"]["properties"]));
    for member in ["progress", "result"] {
        assert_eq!(keys(&job[member]), keys(&schemas["Job"]["properties"][member]["properties"]), "{member}");
    }
    let states = State::ALL.map(State::name);
    assert_eq!(schemas["Job"]["properties"]["state"]["enum"], serde_json::json!(states));
    let events = &description["paths"]["/jobs/{id}/events"]["get"]["responses"]["200"]["content"];
    let kinds = State::ALL.into_iter().filter(|state| state.is_final()).map(State::name);
    let kinds: Vec<_> = ["progress"].into_iter().chain(kinds).chain(["deleted"]).collect();
    let event = &events["text/event-stream"]["schema"]["properties"]["event"];
    assert_eq!(event["enum"], serde_json::json!(kinds));
}

/// A server without a socket, over a fake model, that keeps jobs and has not begun with them.
struct Server {
    app: Arc<App>,
    router: Router,
    description: Value,
    _folder: TempDir,
}

impl Server {
    fn new() -> Self {
        let (app, folder) = testing::app();
        Self { router: app::router(Arc::clone(&app)), app, description: description(), _folder: folder }
    }

    /// Asks, and holds the answer against the description of the path; gives its status and its body.
    async fn ask(&self, method: &str, path: &str, target: &str, body: &'static str) -> (u16, Vec<u8>) {
        let request =
            Request::builder().method(method).uri(target).header("host", "x").body(Body::from(body));
        let request = request.expect("a request");
        let answer = self.router.clone().oneshot(request).await.expect("an answer");
        let (head, body) = answer.into_parts();
        let body = axum::body::to_bytes(body, 1 << 20).await.expect("a body").to_vec();
        let (status, at) = (head.status.as_u16(), format!("{method} {target}: {}", head.status));
        let operation = &self.description["paths"][path][method.to_ascii_lowercase()];
        let described = operation["responses"].get(status.to_string());
        let described = described.unwrap_or_else(|| panic!("{at}: not described"));
        for name in head.headers.keys().map(HeaderName::as_str) {
            let known = described["headers"]
                .as_object()
                .is_some_and(|headers| headers.keys().any(|described| described.eq_ignore_ascii_case(name)));
            assert!(known || !name.starts_with("densecloud-") && name != "location", "{at}: {name}");
        }
        let Some(content) = described.get("content") else {
            assert!(body.is_empty(), "{at}: a body");
            return (status, body);
        };
        let media_type =
            head.headers["content-type"].to_str().expect("text").split(';').next().expect("a type");
        let schema = &content.get(media_type).unwrap_or_else(|| panic!("{at}: {media_type}"))["schema"];
        if media_type.ends_with("json") {
            let value = serde_json::from_slice(&body).expect("JSON");
            assert_eq!(schema::check(&self.description, schema, &value), Ok(()), "{at}");
        }
        (status, body)
    }

    async fn submit(&self) -> String {
        let (status, body) = self.ask("POST", "/jobs", "/jobs?ratio=2", CLOUD).await;
        assert_eq!(status, 202);
        let job: Value = serde_json::from_slice(&body).expect("JSON");
        job["id"].as_str().expect("an id").to_owned()
    }
}

/// As many points as a patch needs, on no grid.
const CLOUD: &str = include_str!("cloud.xyz");

#[tokio::test(flavor = "multi_thread")]
async fn answers_are_as_described() {
    let server = Server::new();
    let (status, _) = server.ask("POST", "/upsample", "/upsample?ratio=2", CLOUD).await;
    assert_eq!(status, 200);
    let (id, other) = (server.submit().await, server.submit().await);
    // Cancelled before it is begun, then forgotten.
    for expected in [200, 204, 404] {
        let (status, _) = server.ask("DELETE", "/jobs/{id}", &format!("/jobs/{other}"), "").await;
        assert_eq!(status, expected);
    }
    let result = format!("/jobs/{id}/result");
    assert_eq!(server.ask("GET", "/jobs/{id}/result", &result, "").await.0, 409);
    work::start(&server.app).expect("threads");
    // Ends with the job.
    let (status, events) = server.ask("GET", "/jobs/{id}/events", &format!("/jobs/{id}/events"), "").await;
    let events = String::from_utf8(events).expect("text");
    assert!(status == 200 && events.contains("event: done\n"), "{events}");
    for data in events.lines().filter_map(|line| line.strip_prefix("data: ")) {
        let job = &server.description["components"]["schemas"]["Job"];
        let value = serde_json::from_str(data).expect("JSON");
        assert_eq!(schema::check(&server.description, job, &value), Ok(()), "{data}");
    }
    for route in app::routes().into_iter().filter(|route| route.method == "get") {
        let target = route.path.replace("{id}", &id);
        let target = target.replace("{model}", "densecloud").replace("{version}", "1");
        let target = target.replace("{part}", "main.js").replace("{number}", "0");
        let target = target.replace("/estimate", "/estimate?points_in=100&ratio=4");
        assert_eq!(server.ask("GET", route.path, &target, "").await.0, 200, "{target}");
        for (part, status) in [("{id}", 404), ("{model}", 404), ("{part}", 404), ("{number}", 404)]
            .into_iter()
            .filter(|(p, _)| route.path.contains(p))
        {
            let target = route.path.replace(part, "none").replace("{version}", "1");
            assert_eq!(server.ask("GET", route.path, &target, "").await.0, status, "{target}");
        }
    }
    let jobs = server.app.jobs.clone().expect("jobs");
    jobs.stop();
    jobs.join();
}

#[tokio::test]
async fn a_method_that_a_path_has_not_is_told_with_those_that_it_has() {
    let server = Server::new();
    for (path, allowed) in [
        ("/upsample", "POST"),
        ("/jobs", "GET,HEAD,POST"),
        ("/jobs/1", "GET,HEAD,DELETE"),
        ("/v2/models/densecloud/infer", "POST"),
    ] {
        let request = Request::builder().method("PUT").uri(path).header("host", "x").body(Body::empty());
        let request = request.expect("a request");
        let answer = server.router.clone().oneshot(request).await.expect("an answer");
        assert_eq!(answer.status(), 405, "{path}");
        assert_eq!(answer.headers()["allow"], allowed, "{path}");
    }
}
