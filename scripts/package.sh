#!/bin/sh
# Packs target/dist/densecloud, ONNX Runtime's library and all licences into out/densecloud-VERSION-MACHINE-linux.tar.gz,
# which runs where it is unpacked:
#
#     sh scripts/build-dist.sh && sh scripts/package.sh
set -eu
cd "$(dirname "$0")/.."
sh scripts/fetch-onnxruntime.sh
program=${CARGO_TARGET_DIR:-target}/dist/densecloud
version=$("$program" --version)
name=densecloud-${version#densecloud }-$(uname -m)-linux
folder=out/$name

rm -rf "$folder"
mkdir -p "$folder/licences"
# The program looks for the library beside itself.
cp "$program" vendor/onnxruntime/libonnxruntime.so "$folder"
cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$folder"
cp -R deploy "$folder"
# The weights are in the program; their card says what they were trained on.
cp models/default/model.toml "$folder"
for text in LICENSE ThirdPartyNotices.txt; do
    cp "vendor/onnxruntime/$text" "$folder/licences/onnxruntime-$text"
done
python3 scripts/licences.py "$folder/licences/crates"
tar -C out --owner=0 --group=0 --sort=name -czf "out/$name.tar.gz" "$name"
echo "out/$name.tar.gz"
