//! Generates the gRPC interface's code from `proto/`, and fetches ONNX Runtime's library when it is
//! missing, so that plain `cargo run` and `cargo test` work in a fresh checkout.

use std::path::Path;
use std::process::Command;

use prost::Message;

fn main() {
    generate_grpc();
    fetch_onnxruntime();
}

/// Writes the messages, client and server into `OUT_DIR`, and beside them the descriptor that
/// reflection shows. In Rust alone: nobody needs to install `protoc`.
fn generate_grpc() {
    const CONTRACT: &str = "proto/densecloud/v1/densecloud.proto";
    println!("cargo::rerun-if-changed={CONTRACT}");
    let out = std::env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let descriptor = protox::compile([CONTRACT], ["proto"]).unwrap_or_else(|error| panic!("{error:?}"));
    std::fs::write(Path::new(&out).join("densecloud.bin"), descriptor.encode_to_vec())
        .expect("OUT_DIR can be written");
    tonic_prost_build::configure().bytes(".").compile_fds(descriptor).expect("the contract becomes Rust");
}

fn fetch_onnxruntime() {
    let root = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR");
    let vendor = Path::new(&root).join("vendor/onnxruntime");
    let script = Path::new(&root).join("scripts/fetch-onnxruntime.sh");
    println!("cargo::rustc-env=DENSECLOUD_VENDOR={}", vendor.display());
    println!("cargo::rerun-if-changed={}", script.display());
    println!("cargo::rerun-if-changed={}", vendor.display());
    println!("cargo::rerun-if-env-changed=ORT_DYLIB_PATH");

    if vendor.join("libonnxruntime.so").exists() {
        return;
    }
    // Building does not need the library, so a failure to get it must not stop the build.
    let why = match Command::new("sh").arg(&script).output() {
        Ok(output) if output.status.success() => return,
        Ok(output) => String::from_utf8_lossy(&output.stderr).trim().replace('\n', "; "),
        Err(error) => error.to_string(),
    };
    println!("cargo::warning=ONNX Runtime was not fetched ({why}); set ORT_DYLIB_PATH before running");
}
