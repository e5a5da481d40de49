//! The page of a report.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use maud::{DOCTYPE, Markup, html};
use serde_json::Value;

use super::histogram::Histogram;
use super::rings::Ring;
use super::{FAR, LOST, Making, Report};
use crate::commands::short;

const STYLE: &str = include_str!("page.css");
/// Nothing is loaded and nothing runs: names and comments of a file are text, whatever they hold.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'";
/// Size of a chart, in its own units.
const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 180.0;
/// Place below a chart for its numbers.
const FOOT: f64 = 22.0;
/// Bars between two numbers below a chart.
const TICK: usize = 10;

pub(super) fn page(report: &Report<'_>) -> String {
    let [input, output] = report.names;
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                title { (output) " of " (input) " — densecloud" }
                style { (maud::PreEscaped(STYLE)) }
            }
            body {
                h1 { (output) " of " (input) }
                (figures(report))
                (warnings(&report.warnings))
                section {
                    h2 { "Before and after" }
                    p { "Left the input, right the result, by one camera." }
                    @for sight in &report.sights {
                        figure {
                            img alt=(sight.name) src=(format!("data:image/png;base64,{}", BASE64_STANDARD.encode(&sight.png)));
                            figcaption { (sight.name) }
                        }
                    }
                }
                section.charts {
                    (charts(report))
                }
                (rings(report))
                (origin(report))
            }
        }
    };
    markup.into_string()
}

/// The numbers of both, side by side.
fn figures(report: &Report<'_>) -> Markup {
    let rows: [(&str, &[&str]); 9] = [
        ("points", &["points"]),
        ("NaN or infinite", &["non_finite"]),
        ("spacing, median", &["spacing", "median"]),
        ("density, median, points a square unit", &["density", "median"]),
        ("surface, square units", &["area"]),
        ("unevenness (0.15 even, 0.5 random)", &["unevenness"]),
        ("noise", &["noise"]),
        ("share that stands alone", &["isolated"]),
        ("share off any surface", &["off_surface"]),
    ];
    html! {
        section {
            table {
                thead { tr { th {} th { "input" } th { "result" } } }
                tbody {
                    @for (name, path) in rows {
                        tr { th { (name) } td { (number(&report.input, path)) } td { (number(&report.output, path)) } }
                    }
                    tr { th { "format" } td { (text(&report.input, "format")) } td { (text(&report.output, "format")) } }
                }
            }
            @if let Some(making) = &report.making { (time(making)) }
        }
    }
}

fn time(making: &Making) -> Markup {
    let total = making.stages.iter().map(|(_, seconds)| seconds).sum::<f64>().max(f64::MIN_POSITIVE);
    html! {
        p {
            "Made in " (short(making.seconds)) " s"
            @for (i, (stage, seconds)) in making.stages.iter().enumerate() {
                (if i == 0 { ": " } else { ", " }) (stage) " " (format!("{:.0} %", 100.0 * seconds / total))
            }
            "."
        }
    }
}

fn warnings(warnings: &[String]) -> Markup {
    html! {
        section {
            h2 { "Warnings" }
            @if warnings.is_empty() { p { "None." } }
            ul { @for warning in warnings { li { (warning) } } }
        }
    }
}

fn charts(report: &Report<'_>) -> Markup {
    html! {
        @if let Some(spacing) = &report.spacing {
            (chart("Spacing", "Distance to the nearest neighbour, in the cloud's units.", spacing))
        }
        (chart("Displacement", &distances(["result", "input"], report.far, FAR), &report.displacement))
        (chart("Coverage", &distances(["input", "result"], report.lost, LOST), &report.coverage))
        @match &report.confidence {
            Some(confidence) => (chart("Confidence", "How sure the result is of a point: 1 sure, 0 a guess.", confidence)),
            None => figure {
                h2 { "Confidence" }
                p { "The result does not tell; " code { "upsample --confidence" } " adds it." }
            },
        }
    }
}

/// What distances from one cloud to the other are, and which share of them is beyond the chart.
fn distances([from, to]: [&str; 2], share: f64, limit: f64) -> String {
    format!(
        "From a point of the {from} to the nearest of the {to}, in the input's spacings there. {:.2} % are further than \
         {limit} and in the last bar.",
        100.0 * share
    )
}

fn chart(name: &str, caption: &str, histogram: &Histogram) -> Markup {
    let both = [("input", &histogram.input), ("output", &histogram.output)];
    let highest =
        both.iter().filter_map(|(_, s)| s.as_ref()).flatten().fold(f64::MIN_POSITIVE, |m, s| m.max(*s));
    let bars = histogram.edges.len() - 1;
    html! {
        figure {
            h2 { (name) }
            svg viewBox=(format!("0 0 {WIDTH} {}", HEIGHT + FOOT)) role="img" aria-label=(name) {
                @for (class, shares) in both {
                    @if let Some(shares) = shares { path class=(class) d=(outline(shares, highest)) {} }
                }
                @for bar in (0..=bars).step_by(TICK) {
                    text x=(WIDTH * bar as f64 / bars as f64) y=(HEIGHT + FOOT - 6.0) text-anchor=(anchor(bar, bars)) {
                        (short(histogram.edges[bar]))
                    }
                }
            }
            figcaption { (caption) (legend(histogram)) }
        }
    }
}

fn legend(histogram: &Histogram) -> Markup {
    html! {
        @if histogram.input.is_some() { " " span.input { "■ input" } }
        @if histogram.output.is_some() { " " span.output { "■ result" } }
    }
}

/// So that no number is cut.
fn anchor(bar: usize, bars: usize) -> &'static str {
    match bar {
        0 => "start",
        _ if bar == bars => "end",
        _ => "middle",
    }
}

/// The bars as one path.
fn outline(shares: &[f64], highest: f64) -> String {
    let mut path = format!("M0 {HEIGHT}");
    for (i, share) in shares.iter().enumerate() {
        let y = HEIGHT * (1.0 - share / highest);
        path += &format!("V{y:.1}H{:.1}", WIDTH * (i + 1) as f64 / shares.len() as f64);
    }
    path + &format!("V{HEIGHT}Z")
}

/// How much denser each distance has become.
fn rings(report: &Report<'_>) -> Markup {
    let density = |d: Option<f64>| d.map_or("–".into(), short);
    let times = |ring: &Ring| ring.ratio().map_or("–".into(), |ratio| format!("{ratio:.2}"));
    html! {
        section {
            h2 { "Density by distance" }
            p { "Median points a square unit, by the distance " (report.place()) "." }
            table {
                thead { tr { th { "from" } th { "to" } th { "input" } th { "result" } th { "times denser" } } }
                tbody {
                    @for ring in &report.rings.rings {
                        tr {
                            td { (short(ring.near)) } td { (short(ring.far)) }
                            td { (density(ring.input)) } td { (density(ring.output)) } td { (times(ring)) }
                        }
                    }
                }
            }
        }
    }
}

/// Where both come from.
fn origin(report: &Report<'_>) -> Markup {
    let made: Vec<&str> =
        report.output["provenance"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    html! {
        section {
            h2 { "Where it comes from" }
            @if made.is_empty() { p { "The result's file does not tell what made it." } }
            @for line in made { p { code { (line) } } }
            @for (name, side) in [("Input", &report.input), ("Result", &report.output)] {
                p {
                    (name) ": " (text(side, "format"))
                    @if let Some(hash) = side["sha256"].as_str() { ", SHA-256 " code { (hash) } }
                    @if let Some(crs) = side["crs"].as_str() { ", coordinates in " code { (crs) } }
                }
            }
            p { "Report of densecloud " (env!("CARGO_PKG_VERSION")) "." }
        }
    }
}

/// A number of an inspection; a dash where it has none.
fn number(inspection: &Value, path: &[&str]) -> String {
    let value = path.iter().fold(inspection, |value, name| &value[*name]);
    match (value.as_u64(), value.as_f64()) {
        (Some(whole), _) => whole.to_string(),
        (_, Some(number)) => short(number),
        _ => "–".into(),
    }
}

fn text<'a>(inspection: &'a Value, name: &str) -> &'a str {
    inspection[name].as_str().unwrap_or("–")
}
