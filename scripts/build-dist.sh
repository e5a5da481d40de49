#!/bin/sh
# Builds the program that is handed out: profile `dist`, and no folder of this machine named in it. `sh scripts/build-dist.sh`
set -eu
cd "$(dirname "$0")/.."
program=${CARGO_TARGET_DIR:-target}/dist/densecloud
cargo_home=${CARGO_HOME:-$HOME/.cargo}
# Names of source files, in what a panic says, begin with the crate.
RUSTFLAGS="${RUSTFLAGS:-} --remap-path-prefix=$cargo_home=cargo --remap-path-prefix=$PWD=." \
    cargo build --profile dist --locked --package densecloud-cli
for folder in "$cargo_home" "$PWD"; do
    if grep -qF "$folder/" "$program"; then
        echo "$program names $folder, a folder of this machine" >&2
        exit 1
    fi
done
