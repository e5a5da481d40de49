//! Generates the gRPC interface's code from `proto/`.

use std::path::Path;

use prost::Message;

/// Writes the messages, client and server into `OUT_DIR`, and beside them the descriptor that
/// reflection shows. In Rust alone: nobody needs to install `protoc`.
fn main() {
    const CONTRACT: &str = "../../proto/densecloud/v1/densecloud.proto";
    println!("cargo::rerun-if-changed={CONTRACT}");
    let out = std::env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let descriptor = protox::compile([CONTRACT], ["../../proto"]).unwrap_or_else(|error| panic!("{error:?}"));
    std::fs::write(Path::new(&out).join("densecloud.bin"), descriptor.encode_to_vec())
        .expect("OUT_DIR can be written");
    tonic_prost_build::configure().bytes(".").compile_fds(descriptor).expect("the contract becomes Rust");
}
