//! Pictures of both clouds, from several sides.

use std::borrow::Cow;

use densecloud_cloud::{Attribute, Cloud, Position};
use densecloud_geometry::{Rng, indices};

use crate::evaluate::picture::{Axis, PictureError, Settings, Shade, Subject, View, render};

/// Pixels of the picture of one cloud.
const SIZE: (u32, u32) = (560, 420);
/// Points drawn of a cloud: more would not be told apart.
const MOST: usize = 1_500_000;
/// Points of the input in the picture from nearby; of a cloud with few more there is none.
const NEARBY: usize = 1500;
/// Where one looks from, and what that is called: degrees about the vertical axis and above the horizon.
const SIDES: [(&str, f64, f64); 3] =
    [("From the front", 30.0, 25.0), ("From behind", 210.0, 25.0), ("From above", 0.0, 89.0)];

/// A picture of the input, left, and of the result, right, by one camera.
#[derive(Debug)]
pub(crate) struct Sight {
    /// Where one looks from.
    pub(super) name: &'static str,
    /// A PNG file.
    pub(super) png: Vec<u8>,
}

/// Draws both from all sides, and a part from nearby: that about `centre`. In their own colours where both have them.
///
/// # Errors
/// There is nothing to draw.
pub(super) fn sights(
    input: &Cloud,
    output: &Cloud,
    centre: Option<Position>,
    up: Axis,
) -> Result<Vec<Sight>, PictureError> {
    let (input_all, output_all) = (thinned(input), thinned(output));
    let draw = |input: &Cloud, output: &Cloud, (name, azimuth, elevation): (&'static str, f64, f64)| {
        let subjects = [Subject::of(input), Subject::of(output)];
        let has_colours = subjects.iter().all(|s| s.colours.is_some());
        let settings = Settings {
            width: SIZE.0,
            height: SIZE.1,
            shade: if has_colours { Shade::Colour } else { Shade::Normals },
            view: View { azimuth, elevation, up },
            point_size: None,
        };
        let mut png = Vec::new();
        let image = render(&subjects, &settings)?;
        // Memory takes all that is written.
        let _ = image.write_png(&mut png);
        Ok::<_, PictureError>(Sight { name, png })
    };
    let mut sights: Vec<Sight> =
        SIDES.iter().map(|side| draw(&input_all, &output_all, *side)).collect::<Result<_, _>>()?;
    if let Some((input, output)) = centre.and_then(|centre| nearby(input, output, centre)) {
        sights.push(draw(&input, &output, ("From nearby", SIDES[0].1, SIDES[0].2))?);
    }
    Ok(sights)
}

/// A random part of a cloud that is too large to be drawn whole.
fn thinned(cloud: &Cloud) -> Cow<'_, Cloud> {
    let share = MOST as f64 / cloud.positions.len().max(1) as f64;
    if share >= 1.0 {
        return Cow::Borrowed(cloud);
    }
    let mut random = Rng::new(0);
    Cow::Owned(part(cloud, |_| random.f64() < share))
}

/// What lies in a cube about a place that holds so many points of the input.
fn nearby(input: &Cloud, output: &Cloud, centre: Position) -> Option<(Cloud, Cloud)> {
    // Of a coordinate that is no number, infinite.
    let along = |p: &Position, a: usize| {
        Some((p[a] - centre[a]).abs()).filter(|d| !d.is_nan()).unwrap_or(f64::INFINITY)
    };
    let off = |p: &Position| (0..3).map(|a| along(p, a)).fold(0.0, f64::max);
    let mut offs: Vec<f64> = input.positions.iter().map(off).filter(|d| d.is_finite()).collect();
    if offs.len() < 2 * NEARBY {
        return None;
    }
    let reach = *offs.select_nth_unstable_by(NEARBY, f64::total_cmp).1;
    let inside = |p: &Position| off(p) <= reach;
    Some((part(input, inside), part(output, inside)))
}

/// The points that are `wanted`, and their values.
fn part(cloud: &Cloud, mut wanted: impl FnMut(&Position) -> bool) -> Cloud {
    let rows: Vec<u32> =
        indices(cloud.positions.len()).filter(|i| wanted(&cloud.positions[*i as usize])).collect();
    let column = |a: &Attribute| Attribute { name: a.name.clone(), values: a.values.gather(&rows) };
    Cloud {
        positions: rows.iter().map(|i| cloud.positions[*i as usize]).collect(),
        attributes: cloud.attributes.iter().map(column).collect(),
        ..Cloud::default()
    }
}
