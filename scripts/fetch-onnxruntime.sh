#!/bin/sh
# Fetches ONNX Runtime's shared library into vendor/onnxruntime/, from its Python package and
# checked against a pinned hash, and its licences beside it. Does nothing when it is there already.
set -eu
version=1.31.1
root=$(cd "$(dirname "$0")/.." && pwd)
target="$root/vendor/onnxruntime/libonnxruntime.so"

case "$(uname -s)-$(uname -m)" in
Linux-x86_64)
    platform=manylinux_2_28_x86_64
    hash=fc44112fbe06d7d689c57e11d3862031f64711007e4ee020f8eed5185fd2c1d3 ;;
Linux-aarch64)
    platform=manylinux_2_28_aarch64
    hash=8aa3b76b28c778a2b1dd660d34161adb1d508c9ccd04ff9dc80e26eca5df8467 ;;
*)
    echo "no pinned ONNX Runtime for $(uname -s) on $(uname -m):" \
        "install version $version yourself and set ORT_DYLIB_PATH to its library" >&2
    exit 1 ;;
esac

matches() { [ -f "$1" ] && echo "$hash  $1" | sha256sum --check --status; }
if matches "$target"; then exit 0; fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python=
for candidate in python3 /usr/bin/python3; do
    if "$candidate" -m pip --version >/dev/null 2>&1; then python=$candidate; break; fi
done
if [ -z "$python" ]; then
    # Debian ships Python without pip; a virtual environment brings its own.
    python3 -m venv "$work/venv" || {
        echo "pip is needed to fetch ONNX Runtime: install python3-pip or python3-venv" >&2
        exit 1
    }
    python="$work/venv/bin/python3"
fi
"$python" -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
    --implementation cp --python-version 3.12 --platform "$platform" \
    --dest "$work" "onnxruntime==$version"
"$python" - "$work" <<'PYTHON'
import glob, sys, zipfile
work = sys.argv[1]
(wheel,) = glob.glob(work + "/onnxruntime-*.whl")
with zipfile.ZipFile(wheel) as archive:
    (name,) = [n for n in archive.namelist() if n.startswith("onnxruntime/capi/libonnxruntime.so.")]
    with open(work + "/libonnxruntime.so", "wb") as library:
        library.write(archive.read(name))
    for name in ("LICENSE", "ThirdPartyNotices.txt"):
        with open(work + "/" + name, "wb") as text:
            text.write(archive.read("onnxruntime/" + name))
PYTHON
matches "$work/libonnxruntime.so" || { echo "ONNX Runtime $version: the hash does not match" >&2; exit 1; }
mkdir -p "$(dirname "$target")"
cp "$work/LICENSE" "$work/ThirdPartyNotices.txt" "$(dirname "$target")"
# Renamed into place, so that a reader never sees half a file.
cp "$work/libonnxruntime.so" "$target.$$"
mv "$target.$$" "$target"
