#!/bin/sh
# Packs target/dist/densecloud, ONNX Runtime's library, completions, manual pages and all licences into
# out/release/densecloud-VERSION-MACHINE-linux.tar.gz, which runs where it is unpacked:
#
#     sh scripts/build-dist.sh && sh scripts/package.sh
#
# The same program gives the same bytes: files have the time of the last commit, or SOURCE_DATE_EPOCH.
set -eu
cd "$(dirname "$0")/.."
sh scripts/fetch-onnxruntime.sh
program=${CARGO_TARGET_DIR:-target}/dist/densecloud
version=$("$program" --version)
name=densecloud-${version#densecloud }-$(uname -m)-linux
folder=out/release/$name
time=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}

rm -rf "$folder"
mkdir -p "$folder/licences" "$folder/completions"
# The program looks for the library beside itself.
cp "$program" vendor/onnxruntime/libonnxruntime.so "$folder"
cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$folder"
cp -R deploy "$folder"
# The weights are in the program; their card says what they were trained on.
cp models/default/model.toml "$folder"
for shell in bash zsh fish powershell elvish; do
    "$program" completions "$shell" > "$folder/completions/densecloud.$shell"
done
"$program" man --dir "$folder/man/man1"
for text in LICENSE ThirdPartyNotices.txt; do
    cp "vendor/onnxruntime/$text" "$folder/licences/onnxruntime-$text"
done
python3 scripts/licences.py "$folder/licences/crates"
tar -C out/release --owner=0 --group=0 --numeric-owner --mode=u=rwX,go=rX --sort=name --mtime="@$time" -cf - "$name" |
    gzip -9n > "out/release/$name.tar.gz"
echo "out/release/$name.tar.gz"
