//! Puts ONNX Runtime's library beside the program, and fetches it when it is missing, so that plain `cargo run` and
//! `cargo test` work in a fresh checkout.

use std::env::consts::{ARCH, OS};
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The program is for the machine that builds, or has no library.
const NAME: &str = if cfg!(windows) {
    "onnxruntime.dll"
} else if cfg!(target_os = "macos") {
    "libonnxruntime.dylib"
} else {
    "libonnxruntime.so"
};

fn main() {
    if std::env::var_os("CARGO_FEATURE_PROGRAM").is_none() {
        println!("cargo::rerun-if-changed=build.rs");
        return;
    }
    let root = Path::new("../..");
    let vendor = root.join("vendor/onnxruntime");
    let script = root.join("scripts/fetch-onnxruntime.sh");
    println!("cargo::rerun-if-changed={}", script.display());
    println!("cargo::rerun-if-changed={}", vendor.display());
    println!("cargo::rerun-if-env-changed=ORT_DYLIB_PATH");
    // Building does not need the library, so a failure to get it must not stop the build.
    if let Err(why) = is_for_this_machine()
        .and_then(|()| fetch(&script, &vendor))
        .and_then(|()| put_beside_program(&vendor.join(NAME)))
    {
        println!("cargo::warning=ONNX Runtime was not fetched ({why}); set ORT_DYLIB_PATH before running");
    }
}

/// The script fetches the library of the machine that builds, of no use to a program for another one.
fn is_for_this_machine() -> io::Result<()> {
    let target = |name| std::env::var(name).map_err(io::Error::other);
    let (os, arch) = (target("CARGO_CFG_TARGET_OS")?, target("CARGO_CFG_TARGET_ARCH")?);
    if os == OS && arch == ARCH {
        return Ok(());
    }
    Err(io::Error::other(format!("the program is for {os} on {arch}, this machine is {OS} on {ARCH}")))
}

/// Fetches the library into the checkout, unless it is there.
fn fetch(script: &Path, vendor: &Path) -> io::Result<()> {
    if vendor.join(NAME).exists() {
        return Ok(());
    }
    let output = Command::new("sh").arg(script).output()?;
    if output.status.success() {
        return Ok(());
    }
    Err(io::Error::other(String::from_utf8_lossy(&output.stderr).trim().replace('\n', "; ")))
}

/// The program looks for the library in its own folder, three above this script's own.
fn put_beside_program(library: &Path) -> io::Result<()> {
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or_else(|| io::Error::other("no OUT_DIR"))?);
    let folder = out.ancestors().nth(3).ok_or_else(|| io::Error::other("OUT_DIR is no folder of cargo's"))?;
    let beside = folder.join(NAME);
    if let Err(error) = std::fs::remove_file(&beside)
        && error.kind() != io::ErrorKind::NotFound
    {
        return Err(error);
    }
    let library = library.canonicalize()?;
    std::fs::hard_link(&library, &beside).or_else(|_| std::fs::copy(&library, &beside).map(drop))
}
