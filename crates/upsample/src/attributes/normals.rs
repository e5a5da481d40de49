//! Normals that are estimated from a result's points, on the side that its source or the sensor tells.

use super::finish::Finish;
use super::plan::normal_of;
use densecloud_cloud::{Attribute, Frame, Origin, Point, Position, Sensors, Values};
use densecloud_geometry::estimate_normals;

/// Neighbours that a normal is made of.
const NEIGHBOURS: usize = 16;

/// Where the sensor stood that saw a point.
pub(super) struct Stood<'a> {
    /// For all points.
    once: Option<Position>,
    /// For those of each scan, with the place of the attribute that numbers the scans.
    each: Option<(&'a Sensors, usize)>,
}

impl<'a> Stood<'a> {
    /// As the options say, else as the source does, for points of these attributes.
    pub(super) fn of(how: &Finish, source: &'a Origin, attributes: &[Attribute]) -> Self {
        let number = |sensors: &Sensors| attributes.iter().position(|a| a.name == sensors.attribute);
        let each = source.sensors.as_deref().and_then(|sensors| Some((sensors, number(sensors)?)));
        Self { once: how.sensor.or(source.sensor), each }
    }

    fn at(&self, attributes: &[Attribute], row: usize) -> Option<Position> {
        self.once.or_else(|| {
            let (sensors, number) = self.each?;
            sensors.of(attributes[number].values.get(row))
        })
    }
}

/// Puts estimated normals in the place of those that are there, or beside the other attributes. The first
/// `kept` rows stay where there are some. `rim`: further points of the surface.
pub(super) fn normals(
    positions: &[Position],
    rim: &[Position],
    kept: usize,
    attributes: &mut Vec<Attribute>,
    stood: &Stood<'_>,
) -> Option<()> {
    let frame = Frame::fit(positions).ok()?;
    let points: Vec<Point> = positions.iter().chain(rim).map(|p| frame.to_local(*p)).collect();
    let mut normals = estimate_normals(&points, NEIGHBOURS);
    normals.truncate(positions.len());
    drop(points);
    let there = normal_of(attributes);
    for (i, normal) in normals.iter_mut().enumerate() {
        let side: [f64; 3] = match (there, stood.at(attributes, i)) {
            (Some(axes), _) => axes.map(|a| attributes[a].values.get(i)),
            (None, Some(sensor)) => std::array::from_fn(|a| sensor[a] - positions[i][a]),
            (None, None) => continue,
        };
        if (0..3).map(|a| side[a] * f64::from(normal[a])).sum::<f64>() < 0.0 {
            *normal = normal.map(|c| -c);
        }
    }
    if there.is_none() {
        // Parts of a normal that is not whole.
        attributes.retain(|a| !["nx", "ny", "nz"].contains(&a.name.as_str()));
    }
    for (a, name) in ["nx", "ny", "nz"].into_iter().enumerate() {
        let axis = normals.iter().map(|n| f64::from(n[a]));
        match there {
            Some(axes) => {
                let values = &mut attributes[axes[a]].values;
                let own: Vec<f64> = (0..kept).map(|i| values.get(i)).collect();
                *values = Values::from_f64(values.kind(), own.into_iter().chain(axis.skip(kept)));
            }
            None => {
                let values = Values::F32(axis.map(|c| c as f32).collect());
                attributes.push(Attribute { name: name.into(), values });
            }
        }
    }
    Some(())
}
