#!/bin/sh
# Builds Python's package into out/wheels, and prints the wheel's name:
#
#     sh scripts/build-wheel.sh            # to hand out: for glibc 2.28 and newer where this is Linux
#     sh scripts/build-wheel.sh --here     # for this machine alone, quickly: on what cargo has built for tests
#
# TARGET=aarch64-unknown-linux-gnu builds for arm64, where rustc has that target's standard library (`rustup target add`).
# maturin and zig, which links against the older glibc, come from PyPI into .venv-maturin, the first time.
set -eu
cd "$(dirname "$0")/.."
tools=${DENSECLOUD_MATURIN_VENV:-.venv-maturin}
if ! "$tools/bin/python" -c 'import maturin, ziglang' 2>/dev/null; then
    "${PYTHON:-python3}" -m venv "$tools"
    "$tools/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: maturin==1.16.0 ziglang==0.17.1 >&2
fi
PATH=$PWD/$tools/bin:$PATH
export PATH
out=out/wheels
if [ "${1:-}" = --here ]; then
    out=out/wheels-here
    set -- --profile dev --compatibility linux
else
    # No folder of this machine is named in it.
    RUSTFLAGS="${RUSTFLAGS:-} --remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=cargo --remap-path-prefix=$PWD=."
    export RUSTFLAGS
    set -- --profile "${PROFILE:-dist}"
    if [ "$(uname -s)" = Linux ]; then
        target=${TARGET:-$(uname -m)-unknown-linux-gnu}
        set -- "$@" --target "$target" --zig --compatibility manylinux_2_28
    elif [ -n "${TARGET:-}" ]; then
        set -- "$@" --target "$TARGET"
    fi
fi
rm -rf "$out"
maturin build --manifest-path crates/python/Cargo.toml --locked --out "$out" "$@" >&2
ls "$out"/*.whl
