//! What an autoscaler asks the database, by `deploy/kubernetes/scaler.yaml`.

use super::records::{claim, put};
use super::*;

/// The query, for the tables of a schema.
fn query(schema: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/kubernetes/scaler.yaml");
    let text = std::fs::read_to_string(path).expect("a file");
    let scaler: serde_json::Value = serde_saphyr::from_str(&text).expect("YAML");
    let query = scaler["spec"]["triggers"][0]["metadata"]["query"].as_str().expect("a query");
    query.replace(" densecloud.", &format!(" {schema}."))
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_scaler_counts_the_steps_that_wait_and_those_at_work() {
    let bench = Bench::of(engine::Engine::Postgres);
    let (records, query) = (bench.postgres(bench.port(), "kind", BOUNDS), query(&bench.schema()));
    let steps = || records.ask(&query);
    assert_eq!(steps(), 0);
    put(&records, &job("large", None, b"abc"), 0);
    put(&records, &job("small", None, b"abc"), 1);
    assert_eq!(steps(), 2);
    let plan = claim(&records, 2);
    assert_eq!(steps(), 2, "one is at work");
    assert!(records.split(&plan, "plan", &[1; 3], 100).expect("no fault"));
    assert_eq!(steps(), 4, "three tiles, and the small one");
    let leases: Vec<_> = (0..4).map(|_| claim(&records, 3)).collect();
    assert_eq!(steps(), 4, "all are at work");
    let small = leases.iter().find(|lease| lease.step == Step::Whole).expect("its turn");
    assert!(records.failed(small, &Failure::Crashed, 4).expect("no fault"));
    assert_eq!(steps(), 3);
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_scaler_counts_a_join_once_its_tiles_are_done() {
    let bench = Bench::of(engine::Engine::Postgres);
    let (records, query) = (bench.postgres(bench.port(), "kind", BOUNDS), query(&bench.schema()));
    let steps = || records.ask(&query);
    put(&records, &job("large", None, b"abc"), 0);
    let plan = claim(&records, 1);
    assert!(records.split(&plan, "plan", &[1; 2], 100).expect("no fault"));
    for left in [2, 1] {
        assert_eq!(steps(), left);
        let tile = claim(&records, 2);
        assert!(records.tile_done(&tile, &format!("part {left}"), 1).expect("no fault"));
    }
    assert_eq!(steps(), 1, "to be joined");
    let join = claim(&records, 3);
    assert_eq!((join.step, steps()), (Step::Join, 1));
    assert!(records.done(&join, &records::made(2), 4).expect("no fault"));
    assert_eq!(steps(), 0);
}
