//! What the interface is, for programs (`GET /openapi.json`) and for people (`GET /docs`).
//!
//! The description is a file, `docs/openapi.json`, so that it can be read and compared without a server;
//! tests hold it against the program.

use axum::http::header;
use axum::response::IntoResponse;

const DESCRIPTION: &str = include_str!("../../../../docs/openapi.json");
const PAGE: &str = include_str!("docs.html");

/// What the page may load and run: itself, and what this server answers.
const POLICY: &str =
    "default-src 'none'; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'";

/// `GET /openapi.json`.
pub(crate) async fn openapi() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json")], DESCRIPTION)
}

/// `GET /docs`.
pub(crate) async fn docs() -> impl IntoResponse {
    let headers =
        [(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, POLICY)];
    (headers, PAGE)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use serde_json::{Map, Value};

    use super::*;
    use crate::admission::deadline;
    use crate::inference;
    use crate::problem::every_problem;
    use densecloud::PARAMETERS;
    use densecloud_formats::Format;

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
    fn paths_and_methods_are_those_of_the_routers() {
        let mut routes = BTreeSet::new();
        for source in [include_str!("../app.rs"), include_str!("../inference/mod.rs")] {
            for route in source.split(".route(\"").skip(1) {
                let (path, handler) = route.split_once("\", ").expect("a path and its handler");
                let (handlers, _) = handler.split_once('\n').expect("the end of a line");
                for method in ["get", "post", "delete"].iter().filter(|m| handlers.contains(&format!("{m}(")))
                {
                    routes.insert(format!("{method} {path}"));
                }
            }
        }
        let description = description();
        let mut described = BTreeSet::new();
        for (path, item) in members(&description["paths"]) {
            described
                .extend(keys(item).into_iter().filter(|k| *k != "parameters").map(|m| format!("{m} {path}")));
        }
        assert_eq!(routes, described);
        assert!(routes.len() > 10, "{routes:?}");
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
        let expected = inference::parameters().map(|parameter| parameter.name).chain([
            "binary_data_output",
            "priority",
            "timeout",
        ]);
        assert_eq!(keys(&request["parameters"]["properties"]), expected.collect());
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
                        described.extend(
                            names.split(", ").map(|name| format!("{status} {}", name.trim_matches('`'))),
                        );
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
    fn the_page_takes_nothing_from_elsewhere() {
        assert!(!PAGE.contains("://") && !PAGE.contains("src="));
    }
}
