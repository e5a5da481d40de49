//! What the page asks before it sends anything: what this server is, and what a request would cost.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::Uri;
use serde::Serialize;

use crate::app::App;
use crate::http::asked::{cost, unread};
use crate::http::query;
use crate::points::MOST;
use crate::problem::Problem;
use densecloud::survey::Goal;
use densecloud_formats::Format;

/// What this server is.
#[derive(Debug, Serialize)]
pub(crate) struct About {
    version: &'static str,
    model: String,
    /// Whether it keeps jobs.
    jobs: bool,
    limits: PageLimits,
    formats: Vec<PageFormat>,
    files: Vec<PageFile>,
}

#[derive(Debug, Serialize)]
struct PageLimits {
    body_bytes: u64,
    points_in: u64,
    points_out: u64,
    /// Of one packed answer.
    points_shown: u64,
}

/// A format that is written.
#[derive(Debug, Serialize)]
struct PageFormat {
    media_type: &'static str,
    /// What a file of it may be called.
    name: String,
}

/// A file that the program was started with.
#[derive(Debug, Serialize)]
struct PageFile {
    name: String,
}

/// `GET /about`.
pub(crate) async fn about(State(app): State<Arc<App>>) -> Json<About> {
    let limits = &app.config.limits;
    let format = |media_type| {
        let name = Format::from_media_type(media_type).map(|format| format.file_name("cloud"));
        PageFormat { media_type, name: name.unwrap_or_default() }
    };
    let file = |path: &std::path::PathBuf| PageFile {
        name: path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
    };
    Json(About {
        version: env!("CARGO_PKG_VERSION"),
        model: app.config.model.name.name.clone(),
        jobs: app.jobs.is_some(),
        limits: PageLimits {
            body_bytes: limits.body_bytes,
            points_in: limits.points_in,
            points_out: limits.points_out,
            points_shown: MOST,
        },
        formats: Format::MEDIA_TYPES.iter().copied().map(format).collect(),
        files: app.config.files.iter().map(file).collect(),
    })
}

/// What a request would give and take.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct Estimate {
    points_out: u64,
    /// Alone on the machine; null before anything was measured.
    seconds: Option<f64>,
    /// What waits before it.
    wait: f64,
}

/// `GET /estimate`: of a cloud of so many points (`points_in`), with the options of `POST /upsample`.
pub(crate) async fn estimate(State(app): State<Arc<App>>, uri: Uri) -> Result<Json<Estimate>, Problem> {
    let (of_cloud, pairs): (Vec<_>, Vec<_>) =
        query::pairs(&uri)?.into_iter().partition(|(name, _)| name == "points_in");
    let points = match &of_cloud[..] {
        [(_, value)] => value.parse().ok().filter(|points| *points > 0),
        [] => None,
        _ => return Err(Problem::parameter("points_in", "given twice".into())),
    };
    let points: u64 = points
        .ok_or_else(|| Problem::parameter("points_in", "missing, or not a positive whole number".into()))?;
    let options = query::options_of(&pairs)?;
    if let Goal::Spacing(_) | Goal::Density(_) = options.goal {
        let why = "only reading the cloud tells how many points that are; give ratio or points";
        return Err(Problem::parameter("ratio", why.into()));
    }
    let cost = cost(&options, &unread(points));
    let seconds = app.engine.estimate(cost.times(options.effort())).map(|time| time.as_secs_f64());
    Ok(Json(Estimate { points_out: cost.points_out, seconds, wait: app.engine.backlog().as_secs_f64() }))
}
