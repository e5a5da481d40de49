//! `densecloud upsample --server`: the same work, done by a server.

use std::time::Instant;

use serde_json::Map;

use super::events::Made;
use super::remote::{Expected, Server, Show, media_type};
use super::upsample::{PROVENANCE, UpsampleArgs};
use super::{CliError, files};
use densecloud::Options;
use densecloud_formats::Format;

/// Sends the input, and writes what comes back: the bytes that the work here would have written.
pub(super) fn run(args: &UpsampleArgs, options: &Options, url: &str) -> Result<Made, CliError> {
    refuse_what_is_ours(args)?;
    let server = Server::new(url, args.key.as_deref())?;
    let show = Show { quiet: args.quiet };
    let start = Instant::now();
    let accept = options.format.map_or("*/*", Format::media_type).to_owned();
    let headers = [("accept", accept)];
    let answer =
        server.upload("/upsample", &options.pairs(), &headers, &args.input, Expected::Cloud, &show)?;
    let text = |name: &str| {
        answer.headers().get(name).and_then(|value| value.to_str().ok()).unwrap_or_default().to_owned()
    };
    let warnings = answer.headers().get_all("densecloud-warning").iter();
    let warnings: Vec<_> = warnings.map(|one| String::from_utf8_lossy(one.as_bytes()).into_owned()).collect();
    super::warn(&warnings, args.quiet);
    let (points_in, points_out) = (text("densecloud-points-in"), text("densecloud-points-out"));
    let (provenance, format) = (text("densecloud-provenance"), Format::from_media_type(media_type(&answer)));
    server.save(answer, &args.output, &show)?;
    if format.is_some_and(|format| !format.holds_comments()) && files::is_kept(&args.output) {
        let beside = files::beside(&args.output, PROVENANCE);
        files::write(&beside, |sink| Ok(writeln!(sink, "{provenance}")?))?;
    }
    let seconds = start.elapsed().as_secs_f64();
    show.note(&format!("{points_in} -> {points_out} points in {seconds:.1} s (on {url})"));
    Ok(Made {
        format: format.map(|format| format.to_string()).unwrap_or_default(),
        points_in: points_in.parse().ok(),
        points_out: points_out.parse().ok(),
        tiles: None,
        stages: Map::new(),
        warnings,
        provenance,
    })
}

/// The command's parser refuses the other options that a server does not take; these two may come from the
/// environment, where they mean no harm unless they change the result.
fn refuse_what_is_ours(args: &UpsampleArgs) -> Result<(), CliError> {
    let usage = |why: &str| Err(CliError::Usage(why.to_owned()));
    if args.engine.model.is_some() {
        return usage("--model (or DENSECLOUD_MODEL) names a model here; a server has its own: leave it out");
    }
    if args.engine.threads != 0 && std::env::var_os("DENSECLOUD_THREADS").is_none() {
        return usage("--threads says nothing to a server; leave it out");
    }
    Ok(())
}
