//! A form (`multipart/form-data`) in place of a body and a query: its file is the cloud, its other fields are
//! the parameters, in any order.

use std::sync::atomic::{AtomicU64, Ordering};

use axum::http::{HeaderMap, Uri, header};
use densecloud::{Options, Parameter};
use densecloud_engine::Cost;
use densecloud_formats::{Header, Reading};
use densecloud_tiles::TILE_POINTS;
use futures::stream;
use multer::{Field, Multipart};

use crate::app::App;
use crate::connection::decode::Coding;
use crate::http::asked::cost;
use crate::http::upload::{Arrival, HeaderCheck, Received, Upload};
use crate::http::{filename, query};
use crate::problem::Problem;

/// What a request asks for and the cloud that it brought, however it brought them.
pub(crate) struct Asking {
    pub(crate) options: Options,
    pub(crate) received: Received,
    /// What the result's name has of the file's, where that has one.
    pub(crate) name: Option<String>,
}

/// The field that holds the cloud, where a form has no file.
const CLOUD: &str = "cloud";
/// Bytes that a form may have beside its file's: names, values, boundaries. The parser keeps the head of a part
/// until it is complete.
const BESIDE: u64 = 1 << 20;

impl Asking {
    /// Receives a request: a query and a cloud, or a form. `known` hears the cost as soon as the cloud's header
    /// tells them, where it does; of a form whose parameters are yet to come, the fewest that may come out.
    ///
    /// # Errors
    /// See [`Upload::receive`] and [`query::options_of`]; and [`Problem::MalformedRequest`] for what is no form.
    pub(crate) async fn receive(
        upload: &mut Upload,
        uri: &Uri,
        headers: &HeaderMap,
        app: &App,
        mut known: impl FnMut(Cost) -> Result<(), Problem>,
    ) -> Result<Self, Problem> {
        if let Some(kind) = form(headers) {
            return Self::receive_form(upload, uri, headers, &kind, app, known).await;
        }
        let options = query::options(uri)?;
        let known = |header: &Header| known(cost(&options, header));
        let received = upload.receive_file(headers, app, &options.reading, known).await?;
        Ok(Self { options, received, name: None })
    }

    async fn receive_form(
        upload: &mut Upload,
        uri: &Uri,
        headers: &HeaderMap,
        kind: &str,
        app: &App,
        mut known: impl FnMut(Cost) -> Result<(), Problem>,
    ) -> Result<Self, Problem> {
        let boundary = multer::parse_boundary(kind).map_err(malformed)?;
        if Coding::of(headers)? != Coding::Identity {
            let why = "a form is not compressed as a whole; compress its file, and give that part a Content-Encoding";
            return Err(Problem::MalformedRequest(why.into()));
        }
        upload.check_length(app.config.limits.body_bytes.saturating_add(BESIDE), app)?;
        let mut pairs = query::pairs(uri)?;
        // Arrived, less what of it was the file's.
        let beside = AtomicU64::new(0);
        let stall = app.config.timeouts.stall;
        let pieces = stream::try_unfold(upload, |upload| async {
            // The parser takes all that is ready before it looks at any of it; so that this is never more than a
            // piece, another is not ready at once.
            tokio::task::yield_now().await;
            let Some(piece) = upload.next(stall).await? else { return Ok(None) };
            let length = piece.len() as u64;
            if beside.fetch_add(length, Ordering::Relaxed).saturating_sub(length) > BESIDE {
                let why = format!("the form has more than {BESIDE} bytes beside its file");
                return Err(Problem::MalformedRequest(why));
            }
            Ok(Some((piece, upload)))
        });
        let mut form = Multipart::new(pieces, boundary);
        let (mut received, mut stem) = (None, None);
        while let Some(field) = form.next_field().await.map_err(malformed)? {
            let name = field.name().unwrap_or_default().to_owned();
            let file = file_name(&field);
            if name == CLOUD || file.is_some() {
                if received.is_some() {
                    return Err(Problem::parameter(&name, "a second file; a form has one cloud".into()));
                }
                let cloud = receive_file(field, &pairs, &beside, app, &mut known).await?;
                // As browsers send it where no file was chosen.
                if file.as_deref() != Some("") || cloud.length() > 0 {
                    (received, stem) = (Some(cloud), file.as_deref().and_then(filename::stem));
                }
            } else {
                let value = field.text().await.map_err(malformed)?;
                add(&mut pairs, name, value)?;
            }
        }
        let received = received.ok_or_else(|| {
            Problem::parameter(
                CLOUD,
                "missing; the form needs a file, such as curl's -F cloud=@scan.ply".into(),
            )
        })?;
        Ok(Self { options: query::options_of(&pairs)?, received, name: stem })
    }
}

/// The name of a field's file, where it has one.
fn file_name(field: &Field<'_>) -> Option<String> {
    let disposition = field.headers().get(header::CONTENT_DISPOSITION);
    let extended = disposition.and_then(|value| filename::extended(value.to_str().ok()?));
    extended.or_else(|| field.file_name().map(str::to_owned))
}

/// The content type, where it is a form's.
fn form(headers: &HeaderMap) -> Option<String> {
    let kind = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    let essence = kind.split(';').next().unwrap_or_default().trim();
    essence.eq_ignore_ascii_case("multipart/form-data").then(|| kind.to_owned())
}

/// Adds a field, judged at once, since the file may be long in coming. Browsers send the fields that were left
/// empty too: they say nothing.
fn add(pairs: &mut Vec<(String, String)>, name: String, value: String) -> Result<(), Problem> {
    if pairs.iter().any(|(earlier, _)| *earlier == name) {
        return Err(Problem::parameter(&name, "given twice".into()));
    }
    // One that is empty and known says nothing.
    if !value.is_empty() || Parameter::named(&name).is_none() {
        let pair = (name, value);
        Options::parse(std::slice::from_ref(&pair))?;
        pairs.push(pair);
    }
    Ok(())
}

async fn receive_file(
    mut field: Field<'_>,
    pairs: &[(String, String)],
    beside: &AtomicU64,
    app: &App,
    mut known: impl FnMut(Cost) -> Result<(), Problem>,
) -> Result<Received, Problem> {
    // Parameters that follow the file are judged when they come.
    let options = query::options_of(pairs).ok();
    // A field that says how the file is read may follow it, too.
    let reading =
        options.as_ref().map(|options| &options.reading).filter(|reading| **reading != Reading::default());
    let mut check = HeaderCheck::new(app, reading, |header: &Header| {
        let points = header.points.unwrap_or_default();
        let least = Cost::new(points, points).in_parts(TILE_POINTS);
        known(options.as_ref().map_or(least, |options| cost(options, header)))
    });
    let mut arrival = Arrival::begin(Coding::of(field.headers())?, Some(&app.config.temp_dir()), app)?;
    while let Some(piece) = field.chunk().await.map_err(malformed)? {
        beside.fetch_sub(piece.len() as u64, Ordering::Relaxed);
        arrival = arrival.add(piece, |bytes, new| check.judge(bytes, new)).await?;
    }
    arrival.finish()
}

/// A problem of ours comes back from the parser in an error of its own.
fn malformed(error: multer::Error) -> Problem {
    match error {
        multer::Error::StreamReadFailed(error) => match error.downcast::<Problem>() {
            Ok(problem) => *problem,
            Err(error) => Problem::Interrupted(error.to_string()),
        },
        multer::Error::IncompleteFieldData { .. }
        | multer::Error::IncompleteHeaders
        | multer::Error::IncompleteStream => Problem::Interrupted(format!("the form: {error}")),
        error => Problem::MalformedRequest(format!("the form: {error}")),
    }
}
