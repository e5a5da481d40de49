//! The server inside another program, on a port that the system chooses, until a future says stop.
//!
//! ```sh
//! cargo run --release --example server
//! ```

use std::error::Error;
use std::sync::Arc;

use densecloud_backends::{Model, OnnxBackend};
use densecloud_engine::{Engine, EngineConfig};
use densecloud_server::{Config, ModelInfo};
use tokio::net::TcpListener;

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let listener = TcpListener::bind(("127.0.0.1", 0)).await?;
    println!("POST clouds to http://{}/upsample?ratio=4; Ctrl-C ends it", listener.local_addr()?);
    serve(listener, async { drop(tokio::signal::ctrl_c().await) }).await
}

/// Serves until `stop` is done; requests at work then are finished.
pub(crate) async fn serve(
    listener: TcpListener,
    stop: impl Future<Output = ()>,
) -> Result<(), Box<dyn Error>> {
    let model = Model::embedded()?;
    let name = model.name();
    let engine = Engine::with_backend(Arc::new(OnnxBackend::new(Arc::new(model))?), EngineConfig::default())?;
    let model = ModelInfo { name, provider: engine.provider().to_owned() };
    Ok(densecloud_server::run(listener, engine, Config { model, ..Config::default() }, stop).await?)
}
