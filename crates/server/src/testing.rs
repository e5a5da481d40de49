//! A server without a socket, for tests.

use std::sync::Arc;

use tempfile::TempDir;

use crate::Config;
use crate::app::App;
use densecloud_cascade::Fake;
use densecloud_engine::{Engine, EngineConfig};
use densecloud_jobs::{Jobs, Settings};

/// A server that is ready, over a fake model; it keeps jobs in a folder and has not begun with them.
pub(crate) fn app() -> (Arc<App>, TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let engine = Engine::with_backend(Arc::new(Fake::new()), EngineConfig::default()).expect("an engine");
    let jobs = Arc::new(Jobs::open(Settings::new(folder.path().to_owned())).expect("a store"));
    let file = folder.path().join("cloud.xyz");
    std::fs::write(&file, "1 2 3\n").expect("a file");
    let config = Config { files: vec![file], ..Config::default() };
    let app = Arc::new(App::new(engine, config, Some(jobs)).expect("an app"));
    app.readiness.ready();
    (app, folder)
}
