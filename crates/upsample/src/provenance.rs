//! Where a result comes from, in one line that goes into its file.

use std::fmt::Write;

use crate::attributes::Finish;
use densecloud_backends::ModelName;
use densecloud_cascade::{CascadeOptions, Target};
use densecloud_cloud::Origin;
use densecloud_formats::Reading;

/// What begins a line of provenance among a file's comments.
pub const MARK: &str = "densecloud: ";

/// All that decides a result's points and their values, beside the program and its model.
#[derive(Debug, Clone, Copy)]
pub struct Causes<'a> {
    /// SHA-256 of the input's file, where it is one.
    pub input: Option<[u8; 32]>,
    /// Points in the input, those that are not finite included.
    pub points: u64,
    /// How many points are wanted.
    pub target: Target,
    /// How the cascade is run.
    pub settings: &'a CascadeOptions,
    /// What is done with its points.
    pub finish: &'a Finish,
    /// How the input is read.
    pub reading: &'a Reading,
    /// The most points of a tile, where the cloud is worked on in tiles.
    pub tile_points: Option<u64>,
}

/// The line for a result of these causes, and nothing else, so that the same causes give the same file. `NAME=VALUE` with
/// spaces between.
#[must_use]
pub fn line(model: &ModelName, causes: &Causes<'_>) -> String {
    // In full, so that nobody adds an option without deciding whether it belongs here.
    let Causes { input, points, target, settings, finish, reading, tile_points } = causes;
    let CascadeOptions { seed, overlap, inner, max_displacement, max_distance, polish, spread, quality } =
        settings;
    let Finish {
        rules,
        keep_input,
        min_confidence,
        estimate_normals,
        sensor,
        source_fields: _,
        confidence: _,
    } = finish;
    let Reading { format, axes, separator, decimal, bounds } = reading;
    let mut line = format!(
        "{MARK}version={} model={} model_sha256={}",
        env!("CARGO_PKG_VERSION"),
        // A card may hold any name; a line has no room for white space in it.
        model.name.split_whitespace().collect::<Vec<_>>().join("_"),
        model.sha256
    );
    let mut add = |name: &str, value: &dyn std::fmt::Display| {
        // Writing into a string cannot fail.
        let _ = write!(line, " {name}={value}");
    };
    if let Some(hash) = input {
        add("input_sha256", &hex::encode(hash));
    }
    add("input_points", points);
    match target {
        Target::Ratio(ratio) => add("ratio", ratio),
        Target::Points(points) => add("points", points),
    }
    add("seed", seed);
    add("overlap", overlap);
    add("inner", inner);
    add("max_displacement", max_displacement);
    add("max_distance", max_distance);
    add("polish", polish);
    add("spread", spread);
    add("quality", quality);
    if let Some(points) = tile_points {
        add("tile_points", points);
    }
    if *keep_input {
        add("keep_input", &true);
    }
    if *min_confidence > 0.0 {
        add("min_confidence", min_confidence);
    }
    if *estimate_normals {
        add("normals", &"estimate");
    }
    if let Some([x, y, z]) = sensor {
        add("sensor", &format!("{x},{y},{z}"));
    }
    let rules = rules.to_string();
    if !rules.is_empty() {
        add("attributes", &rules.split_whitespace().collect::<Vec<_>>().join("_"));
    }
    if let Some(axes) = axes {
        add("axes", &axes.to_string().split_whitespace().collect::<Vec<_>>().join("_"));
    }
    if let Some(separator) = separator {
        add("separator", separator);
    }
    if let Some(decimal) = decimal {
        add("decimal", decimal);
    }
    if let Some(format) = format {
        add("format", format);
    }
    if let Some(bounds) = bounds {
        add("bounds", bounds);
    }
    line
}

/// The lines of provenance among a file's comments: one for each time that the cloud was upsampled.
pub fn of(origin: &Origin) -> impl Iterator<Item = &str> {
    origin.comments.iter().filter_map(|comment| comment.strip_prefix(MARK))
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_formats::Decimal;

    #[test]
    fn a_line_tells_what_decides_the_result_and_is_found_again() {
        let model = ModelName { name: "my model".into(), sha256: "12cd".into() };
        let finish = Finish {
            keep_input: true,
            rules: "red:drop,a b:mean".parse().expect("rules"),
            ..Finish::default()
        };
        let settings = CascadeOptions { seed: 5, ..Default::default() };
        let reading = Reading {
            axes: Some("Points 0,2,3".parse().expect("axes")),
            decimal: Some(Decimal::Comma),
            bounds: Some("-1.5,0,3,4e7".parse().expect("a box")),
            ..Reading::default()
        };
        let causes = Causes {
            input: Some([0xAB; 32]),
            points: 7,
            target: Target::Ratio(7.3),
            settings: &settings,
            finish: &finish,
            reading: &reading,
            tile_points: Some(400),
        };
        let made = line(&model, &causes);
        for part in [
            "model=my_model model_sha256=12cd",
            "input_sha256=abababab",
            "input_points=7 ratio=7.3 seed=5",
            "quality=standard tile_points=400 keep_input=true attributes=a_b:mean,red:drop axes=Points_0,2,3 decimal=comma bounds=-1.5,0,3,40000000",
        ] {
            assert!(made.contains(part), "{made}");
        }
        let comments = vec!["made by a scanner".to_owned(), made.clone()];
        let origin = Origin { comments, ..Origin::default() };
        assert_eq!(of(&origin).collect::<Vec<_>>(), [made.strip_prefix(MARK).expect("the mark")]);
    }
}
