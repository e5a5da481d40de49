//! A cloud in another format.

use axum::Extension;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};

use crate::app::App;
use crate::connection::compress::AsIs;
use crate::connection::record::Points;
use crate::http::download::{self, Dense, result_bytes};
use crate::http::upsample::visible;
use crate::problem::Problem;
use densecloud::survey::{GLANCE, Survey};
use densecloud_cloud::{Cloud, bytes_a_point};
use densecloud_formats::{CloudReader, Format};

/// Bytes of a number of an attribute, at most.
const WIDEST: u64 = 8;

/// Blocking work: reads a cloud, and begins to send it as a file of this kind.
pub(super) fn answer(app: &App, reader: CloudReader<'_>, wanted: Format) -> Result<Response, Problem> {
    let header = reader.header();
    let input = header.format.written();
    let mut held = app.budget.hold(0).ok_or_else(|| app.held_full())?;
    let needs = |points: u64, a_point: u64| result_bytes(points, a_point, wanted);
    // Where the header tells it; else it is known when it has been read.
    let early = needs(header.points.unwrap_or_default(), WIDEST * header.attributes.len() as u64);
    if !held.grow(early) {
        return Err(app.held_full());
    }
    let mut cloud = reader.read()?;
    let points = cloud.positions.len() as u64;
    let all = needs(points, bytes_a_point(&cloud.attributes));
    if !held.grow(all.saturating_sub(early)) {
        return Err(app.held_full());
    }
    let (format, warnings) = prepared(&mut cloud, input, wanted);
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, visible(format.media_type()));
    let name = format!("attachment; filename=\"{}\"", format.file_name("cloud"));
    headers.insert(header::CONTENT_DISPOSITION, visible(&name));
    for warning in &warnings {
        headers.append("densecloud-warning", visible(warning));
    }
    if let Some(length) = format.encoded_len(points, &cloud.attributes, &cloud.origin) {
        headers.insert(header::CONTENT_LENGTH, length.into());
    }
    let Cloud { positions, attributes, origin, .. } = cloud;
    let body = download::body(Dense { positions, attributes, origin }, format, held);
    let mut response = (headers, Extension(Points { read: points, made: points }), body).into_response();
    if format.is_packed() {
        response.extensions_mut().insert(AsIs);
    }
    Ok(response)
}

/// Makes a cloud ready for another format; gives that, fine enough, and what a person should know.
fn prepared(cloud: &mut Cloud, input: Format, wanted: Format) -> (Format, Vec<String>) {
    let mut warnings = cloud.warnings();
    let mut format = Format::of_result(Some(wanted), input, !cloud.attributes.is_empty());
    if let Ok(survey) = Survey::of(&cloud.positions, GLANCE) {
        format = format.fine_enough(survey.bounds, survey.result_spacing(cloud.positions.len() as u64));
    }
    warnings.extend(input.adapt(&mut cloud.attributes, format));
    let lost = format.cannot_hold(&cloud.attributes, &cloud.origin);
    if !lost.is_empty() {
        warnings.push(format!("the format has no place for {}", lost.join(", ")));
    }
    for (from, to) in format.renamed(&cloud.attributes, &cloud.origin) {
        warnings.push(format!("{from:?} is {to:?} in the file"));
    }
    (format, warnings)
}
