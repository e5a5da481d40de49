//! What the server and its model are, as clients of the protocol ask.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use serde_json::{Value, json};

use super::{Datatype, MODEL, Named, TENSOR, VERSION, check_model};
use crate::app::App;
use crate::problem::Problem;

/// What runs it, as Triton names such things.
const PLATFORM: &str = "onnxruntime_onnx";

/// `GET /v2`.
pub(super) async fn server() -> Json<Value> {
    Json(json!({
        "name": "densecloud",
        "version": env!("CARGO_PKG_VERSION"),
        "extensions":
            ["binary_tensor_data", "model_configuration", "model_repository", "parameters", "statistics"],
    }))
}

/// `GET /v2/models`.
pub(super) async fn models() -> Json<Value> {
    Json(json!({ "models": [MODEL] }))
}

/// `GET /v2/models/densecloud`. The protocol has room for one type of number only, so FP64 is not named.
pub(super) async fn model(named: Named) -> Result<Json<Value>, Problem> {
    check_model(&named)?;
    let tensor = json!({ "name": TENSOR, "datatype": Datatype::F32.name(), "shape": [-1, 3] });
    Ok(Json(json!({
        "name": MODEL,
        "versions": [VERSION],
        "platform": PLATFORM,
        "inputs": [tensor],
        "outputs": [tensor],
    })))
}

/// `GET /v2/models/densecloud/config`: what Triton's extension asks for, as far as there is such a thing
/// here.
pub(super) async fn config(State(app): State<Arc<App>>, named: Named) -> Result<Json<Value>, Problem> {
    check_model(&named)?;
    let tensor = json!({ "name": TENSOR, "data_type": "TYPE_FP32", "dims": [-1, 3] });
    let model = &app.config.model;
    let text = |value: &str| json!({ "string_value": value });
    Ok(Json(json!({
        "name": MODEL,
        "platform": PLATFORM,
        "backend": "densecloud",
        "version_policy": { "latest": { "num_versions": 1 } },
        // No dimension of its own for batches: a request is a cloud.
        "max_batch_size": 0,
        "input": [tensor],
        "output": [tensor],
        "parameters": {
            "model": text(&model.name.name),
            "sha256": text(&model.name.sha256),
            "provider": text(&model.provider),
            "max_points_in": text(&app.config.limits.points_in.to_string()),
            "max_points_out": text(&app.config.limits.points_out.to_string()),
        },
    })))
}
