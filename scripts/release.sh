#!/bin/sh
# All files of a release for this machine's kind, in out/release: a tarball, a Debian package, a bill of materials and sums.
# cargo-cyclonedx is built from crates.io, once.
set -eu
cd "$(dirname "$0")/.."

# All that has a time in it takes this one.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}
export SOURCE_DATE_EPOCH
version=0.5.9
cyclonedx=vendor/cyclonedx/bin/cargo-cyclonedx
rm -rf out/release
sh scripts/build-dist.sh
sh scripts/package.sh
if command -v dpkg-deb > /dev/null; then
    sh scripts/package-debian.sh
fi
if ! "$cyclonedx" cyclonedx --version 2>/dev/null | grep -q "$version\$"; then
    cargo install --locked --version "$version" --root vendor/cyclonedx cargo-cyclonedx
fi
# It writes beside the manifest, of each binary of the workspace.
"$cyclonedx" cyclonedx --manifest-path crates/cli/Cargo.toml --format json --describe binaries --target "$(rustc -vV | sed -n 's/^host: //p')"
mv crates/cli/densecloud_bin.cdx.json "out/release/densecloud-$(uname -m)-linux.cdx.json"
find crates -name '*.cdx.json' -delete
cd out/release
find . -maxdepth 1 -type f ! -name SHA256SUMS -printf '%f\n' | LC_ALL=C sort | xargs sha256sum > SHA256SUMS
cat SHA256SUMS
