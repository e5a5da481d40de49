use axum::response::IntoResponse;
use tonic::Code;
use tonic_types::StatusExt;

use super::*;

/// One of each, with its status and its name.
pub(crate) fn every_problem() -> Vec<(Problem, u16, &'static str)> {
    let second = Duration::from_millis(1500);
    let busy =
        |own| Problem::Refused(Refusal::Busy { own, waiting: second, limit: second, retry_after: second });
    vec![
        (Problem::NotFound, 404, "not-found"),
        (Problem::UnknownModel("x".into()), 404, "unknown-model"),
        (Problem::FixedModel, 409, "fixed-model"),
        (Problem::MalformedRequest("x".into()), 400, "malformed-request"),
        (Problem::MethodNotAllowed, 405, "method-not-allowed"),
        (Problem::LengthRequired, 411, "length-required"),
        (Problem::TransferCoding("x".into()), 501, "unknown-transfer-coding"),
        (Problem::Stripped, 400, "stripped-body"),
        (Problem::parameter("ratio", "missing".into()), 400, "invalid-parameter"),
        (Problem::Interrupted("x".into()), 400, "interrupted-body"),
        (Problem::Malformed("x".into()), 400, "malformed-cloud"),
        (Problem::NotAcceptable { wanted: "x".into() }, 406, "not-acceptable"),
        (Problem::UploadStalled { limit: second }, 408, "upload-stalled"),
        (Problem::BodyTooLarge { limit: 5 }, 413, "body-too-large"),
        (Problem::TooManyPointsIn { points: 9, limit: 5 }, 413, "too-many-points-in"),
        (Problem::TooManyPointsOut { points: 9, limit: 5 }, 413, "too-many-points-out"),
        (Problem::ResultTooLarge { points: 9, bytes: 99, limit: 5 }, 413, "result-too-large"),
        (Problem::UnsupportedFormat("x".into()), 415, "unsupported-format"),
        (Problem::UnsupportedEncoding("gzip".into()), 415, "unsupported-encoding"),
        (Problem::Impossible("x".into()), 422, "impossible-cloud"),
        (Problem::WarmingUp, 503, "warming-up"),
        (Problem::Draining, 503, "draining"),
        (
            Problem::Refused(Refusal::Full { wanted: 1, queued: 5, limit: 5, retry_after: second }),
            503,
            "queue-full",
        ),
        (Problem::HeldFull { used: 4, limit: 5 }, 503, "memory-full"),
        (Problem::TempFull { used: 4, limit: 5 }, 503, "temp-full"),
        (Problem::TempSpace("no room".into()), 507, "temp-space"),
        (Problem::Deadline { limit: second, spent: "x".into() }, 504, "deadline"),
        (Problem::Unauthorized("x"), 401, "unauthorized"),
        (Problem::CrossSite, 403, "cross-site"),
        (busy(false), 503, "queue-long"),
        (busy(true), 429, "client-time"),
        (
            Problem::Refused(Refusal::Share { wanted: 1, used: 5, limit: 5, retry_after: second }),
            429,
            "client-share",
        ),
        (
            Problem::Refused(Refusal::Late { needed: second, left: second, retry_after: second }),
            503,
            "too-late",
        ),
        (Problem::Refused(Refusal::TooBig { bytes: 9, limit: 5 }), 507, "too-big-for-memory"),
        (Problem::OutOfMemory(9), 507, "out-of-memory"),
        (Problem::JobsFull { queued: 5, limit: 5, retry_after: second }, 503, "jobs-full"),
        (Problem::ClientJobs { queued: 5, limit: 5, retry_after: second }, 429, "client-jobs"),
        (Problem::JobsOff, 501, "jobs-off"),
        (Problem::NoJob("x".into()), 404, "no-such-job"),
        (Problem::JobNotDone { state: "queued" }, 409, "job-not-done"),
        (Problem::KeyReused, 422, "idempotency-key-reused"),
        (Problem::Range { length: 5 }, 416, "range-not-satisfiable"),
        (Problem::JobDisk { used: 5, wanted: 1, limit: 5 }, 507, "job-disk-full"),
        (Problem::JobsBusy("x"), 503, "jobs-busy"),
        (Problem::DiskFull("x".into()), 507, "disk-full"),
        (Problem::GaveUp { attempts: 3, tile: None }, 500, "job-gave-up"),
        (Problem::Internal("secret".into()), 500, "internal"),
    ]
}

async fn document(problem: &Problem) -> serde_json::Value {
    let bytes = axum::body::to_bytes(problem.body("id-1"), 10_000).await.expect("a body");
    serde_json::from_slice(&bytes).expect("JSON")
}

#[tokio::test]
async fn the_table() {
    let mut names = std::collections::BTreeSet::new();
    for (problem, status, name) in every_problem() {
        let body = document(&problem).await;
        assert_eq!(body["status"], status, "{problem:?}");
        assert_eq!(body["type"], format!("urn:densecloud:problem:{name}"));
        assert_eq!(body["request_id"], "id-1");
        assert!(!body["title"].as_str().expect("a title").is_empty());
        assert!(names.insert(name), "{name} names two problems");
        assert_eq!(problem.outcome(), name);
        let response = problem.into_response();
        assert_eq!(response.status().as_u16(), status);
        assert_eq!(response.headers()["content-type"], "application/problem+json");
        assert_eq!(response.headers().contains_key("retry-after"), matches!(status, 429 | 503));
        assert_eq!(response.headers().contains_key("www-authenticate"), status == 401);
    }
}

#[test]
fn every_problem_has_a_grpc_status_with_the_same_words() {
    for (problem, status, name) in every_problem() {
        let grpc = problem.grpc("id-1");
        let expected = match status {
            500 => Code::Internal,
            503 => Code::Unavailable,
            413 | 507 => Code::ResourceExhausted,
            408 | 504 => Code::DeadlineExceeded,
            501 | 405 => Code::Unimplemented,
            _ => grpc.code(),
        };
        assert_eq!(grpc.code(), expected, "{name}");
        assert!(
            grpc.code() != Code::Unknown && (status < 500) == (grpc.code() != Code::Internal) || status > 500
        );
        let details = grpc.get_error_details();
        let info = details.error_info().expect("info");
        assert_eq!(info.reason.to_lowercase().replace('_', "-"), name);
        assert_eq!(info.metadata.get("setting").map(String::as_str), problem.row().setting);
        assert_eq!(details.request_info().expect("info").request_id, "id-1");
        assert_eq!(details.retry_info().is_some(), matches!(status, 429 | 503), "{name}");
        assert!(!grpc.message().contains("secret"));
    }
    let manual = include_str!("../../../../docs/grpc.md");
    let rows = manual.lines().filter(|line| line.starts_with("| `"));
    let rows: Vec<Vec<&str>> = rows.map(|row| row.split('|').map(str::trim).collect()).collect();
    for (problem, status, name) in
        every_problem().into_iter().filter(|(_, status, _)| ![404, 409, 416].contains(status))
    {
        let row = rows.iter().find(|row| row[2].split(", ").any(|s| s == status.to_string()));
        let code = row.unwrap_or_else(|| panic!("no row for {name}"))[1].replace(['_', '`'], "");
        assert_eq!(code, format!("{:?}", problem.grpc("").code()).to_uppercase(), "{name}");
    }
    let long = Problem::parameter("attributes", "x".repeat(100_000)).grpc("id-1");
    assert!(long.details().len() + long.message().len() < 8000, "it fits into headers");
}

#[test]
fn the_manual_has_the_same_table() {
    let manual = include_str!("../../../../docs/http.md");
    for (problem, status, name) in every_problem() {
        let row = manual.lines().find(|line| line.starts_with(&format!("| {status} | `{name}` |")));
        let row = row.unwrap_or_else(|| panic!("no row for {status} {name}"));
        let setting = problem.row().setting.map_or("| |".into(), |setting| format!("| `{setting}` |"));
        assert!(row.ends_with(&setting), "{row}");
    }
}

#[tokio::test]
async fn a_limit_is_told_with_its_number_and_the_setting_that_lifts_it() {
    for (problem, _, name) in every_problem() {
        let row = problem.row();
        if let Some(setting) = row.setting {
            assert!(problem.to_string().contains(setting), "{name}: {problem}");
            assert_eq!(document(&problem).await["setting"], setting);
        }
        assert!(problem.limit().is_none() || row.setting.is_some(), "{name} has a limit but no setting");
    }
    assert_eq!(document(&Problem::TooManyPointsIn { points: 9, limit: 5 }).await["limit"], 5);
    assert_eq!(document(&Problem::parameter("ratio", "x".into())).await["parameter"], "ratio");
}

#[tokio::test]
async fn what_failed_inside_stays_inside() {
    let body = document(&Problem::Internal("/srv/secret".into())).await;
    assert!(!body.to_string().contains("secret"), "{body}");
}

#[test]
fn inner_errors_find_their_place_in_the_table() {
    use densecloud_cascade::{BackendError, CascadeError};
    use densecloud_cloud::FrameError;
    use densecloud_engine::EngineError;
    use densecloud_formats::{FormatError, Place};
    let name = |problem: Problem| problem.row().name;
    for (error, expected) in [
        (FormatError::Unrecognised { found: "a ZIP file".into() }, "unsupported-format"),
        (FormatError::Malformed { at: Place::Line(3), why: "x".into() }, "malformed-cloud"),
        (FormatError::Truncated { at: Place::Byte(3), why: "x".into() }, "malformed-cloud"),
        (FormatError::TooManyPoints { points: 9, limit: 5 }, "too-many-points-in"),
        (FormatError::TooLarge { bytes: 9, limit: 5 }, "body-too-large"),
        (FormatError::Empty("points"), "impossible-cloud"),
        (FormatError::WrongCount { promised: 1, written: 2 }, "internal"),
    ] {
        let text = error.to_string();
        assert_eq!(name(error.into()), expected, "{text}");
    }
    let run = BackendError::Run { unit: 1, why: "x".into() };
    for (error, expected) in [
        (CascadeError::Ratio(99.0), "invalid-parameter"),
        (CascadeError::Points { wanted: 1, from: 9 }, "impossible-cloud"),
        (CascadeError::TooFewPoints { distinct: 1, duplicates: 0, needed: 33 }, "impossible-cloud"),
        (CascadeError::TooManyDuplicates { distinct: 1, total: 99 }, "impossible-cloud"),
        (CascadeError::Frame(FrameError::Degenerate), "impossible-cloud"),
        (CascadeError::Backend(run), "internal"),
        (CascadeError::OutOfMemory(9), "out-of-memory"),
        (CascadeError::Cancelled, "draining"),
    ] {
        let text = error.to_string();
        assert_eq!(name(Problem::from_engine(EngineError::Cascade(error))), expected, "{text}");
    }
    let full = Refusal::Full { wanted: 1, queued: 5, limit: 5, retry_after: SOON };
    assert_eq!(Problem::from_engine(full.into()).retry_after(), Some(SOON));
    assert_eq!(name(Problem::from_engine(EngineError::Internal("x".into()))), "internal");
}

#[test]
fn retry_after_rounds_up_to_whole_seconds() {
    for (millis, seconds) in [(0, "1"), (1, "1"), (1000, "1"), (1001, "2"), (90_000, "90")] {
        let retry_after = Duration::from_millis(millis);
        let full = Problem::Refused(Refusal::Full { wanted: 1, queued: 5, limit: 5, retry_after });
        let response = full.into_response();
        assert_eq!(response.headers()["retry-after"], seconds, "{millis} ms");
    }
}
