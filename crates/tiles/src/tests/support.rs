//! Clouds, and works on them.

use std::path::Path;
use std::sync::Arc;

use crate::{Folder, Input, Large, TilesError, Tiling, Watch, Work, plan};
use densecloud::Options;
use densecloud::backends::ModelName;
use densecloud_cascade::{Fake, LevelRunner, Patchwise, Silent};
use densecloud_cloud::{Attribute, Cloud, Position, Values};
use densecloud_formats::{CloudReader, Format, Limits, encode};
use densecloud_geometry::Rng;

pub(super) fn format(name: &str) -> Format {
    Format::from_extension(name.as_ref()).expect("a format")
}

/// A bumpy square far from the origin, with a colour, a time and a class.
pub(super) fn ground(n: u32, seed: u64) -> Cloud {
    let mut rng = Rng::new(seed);
    let positions: Vec<Position> = (0..n)
        .map(|_| {
            let (x, y) = (rng.f64() * 40.0, rng.f64() * 40.0);
            [5e5 + x, 4e6 + y, 100.0 + (0.3 * x).sin() + (0.2 * y).cos()]
        })
        .collect();
    let of = |name: &str, values: Values| Attribute { name: name.into(), values };
    let attributes = vec![
        of("red", Values::U8((0..n).map(|i| (i * 7 % 256) as u8).collect())),
        of("green", Values::U8((0..n).map(|i| (i * 5 % 256) as u8).collect())),
        of("blue", Values::U8((0..n).map(|i| (i * 3 % 256) as u8).collect())),
        of("gps_time", Values::F64((0..n).map(|i| 1e6 + f64::from(i) / 8.0).collect())),
        of("tree", Values::F32((0..n).map(|i| (i % 9) as f32).collect())),
    ];
    Cloud { positions, attributes, ..Cloud::default() }
}

pub(super) fn bytes(cloud: &Cloud, name: &str) -> Vec<u8> {
    let format = Format::of_result(Some(format(name)), Format::TEXT, true);
    let format = format.fine_enough([[0.0; 3], [1e7; 3]], 1e-3);
    encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &cloud.origin).expect("a file")
}

pub(super) fn read(bytes: &[u8]) -> Cloud {
    CloudReader::open(bytes, Limits::default()).expect("a header").read().expect("a cloud")
}

pub(super) fn options(pairs: &[(&str, &str)], wanted: &str) -> Options {
    Options { format: Some(format(wanted)), ..Options::parse(pairs).expect("options") }
}

pub(super) fn large(bytes: &[u8], tile_points: u64) -> Large<'_> {
    let reader = CloudReader::open(bytes, Limits::default()).expect("a header");
    match Input::read(reader, tile_points).expect("a cloud") {
        Input::Large(large) => *large,
        Input::Small(cloud, _) => panic!("{} points are few", cloud.positions.len()),
    }
}

/// All but the input of a work.
pub(super) struct Bench {
    pub(super) options: Options,
    pub(super) model: ModelName,
    pub(super) runner: Arc<dyn LevelRunner>,
    pub(super) tile_points: u64,
    pub(super) watch: Box<dyn Watch>,
}

impl Bench {
    pub(super) fn new(tile_points: u64, pairs: &[(&str, &str)], wanted: &str) -> Self {
        let runner = Arc::new(Patchwise::new(Arc::new(Fake::new())));
        let model = ModelName { name: "fake".into(), sha256: "00".into() };
        Self { options: options(pairs, wanted), model, runner, tile_points, watch: Box::new(Silent) }
    }

    pub(super) fn work(&self) -> Work<'_> {
        Work {
            options: &self.options,
            model: &self.model,
            runner: &*self.runner,
            tile_points: self.tile_points,
            watch: &*self.watch,
        }
    }

    pub(super) fn plan(&self, input: &[u8], folder: &Folder) -> Result<Tiling, TilesError> {
        plan(large(input, self.tile_points), &self.work(), folder)
    }

    /// All of it, in a folder inside of that one.
    pub(super) fn dense(&self, input: &[u8], parent: &Path) -> Result<Vec<u8>, TilesError> {
        let folder = Folder::temporary(parent)?;
        let tiling = self.plan(input, &folder)?;
        tiling.run_all(&self.work())?;
        joined(&tiling)
    }
}

pub(super) fn joined(tiling: &Tiling) -> Result<Vec<u8>, TilesError> {
    let mut bytes = Vec::new();
    tiling.join()?.write(&mut bytes)?;
    Ok(bytes)
}

pub(super) fn entries(folder: &Path) -> usize {
    std::fs::read_dir(folder).expect("a folder").count()
}
