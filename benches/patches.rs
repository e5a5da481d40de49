//! How many patches the first level of a cloud takes, for each one that a seed was chosen for: the others cover what lies
//! in none of these.
//!
//! `cargo bench --bench patches -- FILE ...`, of any format. No unit is run.

use densecloud_backends::Model;
use densecloud_cascade::{
    BackendError, CascadeError, CascadeOptions, FeatureTable, LevelInput, LevelOutput, LevelRunner, Observer,
    Silent, Target, UnitShape, upsample,
};
use densecloud_formats::read_cloud_file;

fn main() {
    let counting = Counting(Model::embedded().expect("a model").shape());
    println!("file: points on surfaces, patches seeded, patches in all, their ratio");
    for file in std::env::args().skip(1).filter(|arg| !arg.starts_with("--")) {
        print!("{file}: ");
        let positions = read_cloud_file(file.as_ref()).expect("a cloud").0.positions;
        let ended = upsample(&positions, Target::Ratio(2.0), &CascadeOptions::default(), &counting, &Silent);
        println!("{}", ended.expect_err("no unit was run"));
    }
}

/// Ends the cascade where units would run, with the counts as its reason.
struct Counting(UnitShape);

impl LevelRunner for Counting {
    fn shape(&self) -> UnitShape {
        self.0
    }

    fn units(&self) -> usize {
        1
    }

    fn provider(&self) -> &str {
        "none"
    }

    fn run_level(
        &self,
        level: &LevelInput<'_>,
        _: Option<&FeatureTable>,
        _: &dyn Observer,
    ) -> Result<LevelOutput, CascadeError> {
        let (points, patches) = (level.points.len(), level.patches.count());
        let overlap = CascadeOptions::default().overlap;
        let seeded = (overlap * points as f64 / self.0.patch_size as f64).ceil();
        let why = format!("{points}, {seeded}, {patches}, {:.3}", patches as f64 / seeded);
        Err(BackendError::Start { why }.into())
    }
}
