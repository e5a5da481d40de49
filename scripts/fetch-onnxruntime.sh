#!/bin/sh
# Fetches ONNX Runtime's shared library into vendor/onnxruntime/, from its Python package and
# checked against a pinned hash, and its licences beside it. Does nothing when it is there already.
set -eu
version=1.31.1
root=$(cd "$(dirname "$0")/.." && pwd)

library=libonnxruntime.so
case "$(uname -s)-$(uname -m)" in
Linux-x86_64)
    platform=manylinux_2_28_x86_64
    hash=fc44112fbe06d7d689c57e11d3862031f64711007e4ee020f8eed5185fd2c1d3 ;;
Linux-aarch64)
    platform=manylinux_2_28_aarch64
    hash=8aa3b76b28c778a2b1dd660d34161adb1d508c9ccd04ff9dc80e26eca5df8467 ;;
Darwin-arm64)
    platform=macosx_14_0_arm64
    library=libonnxruntime.dylib
    hash=d586cbe89effc085a09d3341b3cfbd5c322517f9d397aeb20814af21433f2b36 ;;
# As Git's shell has it.
MINGW*-x86_64 | MSYS*-x86_64)
    platform=win_amd64
    library=onnxruntime.dll
    hash=e45f61e50d8650885452be538a00bb14a715e46a1bc3691000ce947e89ed0306 ;;
*)
    echo "no pinned ONNX Runtime for $(uname -s) on $(uname -m):" \
        "install version $version yourself and set ORT_DYLIB_PATH to its library" >&2
    exit 1 ;;
esac

target="$root/vendor/onnxruntime/$library"

# macOS has the second.
sum() { if command -v sha256sum > /dev/null; then sha256sum "$1"; else shasum -a 256 "$1"; fi; }
matches() { [ -f "$1" ] && [ "$(sum "$1" | cut -c1-64)" = "$hash" ]; }
if matches "$target"; then exit 0; fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python=
for candidate in python3 /usr/bin/python3 python; do
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
"$python" - "$work" "$library" <<'PYTHON'
import glob, re, sys, zipfile
work, library = sys.argv[1:]
wanted = re.compile(r"onnxruntime/capi/(libonnxruntime\.so\.|libonnxruntime\..*\.dylib$|onnxruntime\.dll$)")
(wheel,) = glob.glob(work + "/onnxruntime-*.whl")
with zipfile.ZipFile(wheel) as archive:
    (name,) = [n for n in archive.namelist() if wanted.match(n)]
    with open(work + "/" + library, "wb") as file:
        file.write(archive.read(name))
    for name in ("LICENSE", "ThirdPartyNotices.txt"):
        with open(work + "/" + name, "wb") as text:
            text.write(archive.read("onnxruntime/" + name))
PYTHON
matches "$work/$library" || { echo "ONNX Runtime $version: the hash does not match" >&2; exit 1; }
mkdir -p "$(dirname "$target")"
cp "$work/LICENSE" "$work/ThirdPartyNotices.txt" "$(dirname "$target")"
# Renamed into place, so that a reader never sees half a file.
cp "$work/$library" "$target.$$"
mv "$target.$$" "$target"
