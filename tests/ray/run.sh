#!/bin/sh
# deploy/ray/densecloud_ray.py on a local cluster of three nodes, one of which is killed on the way, over an S3 stand-in.
# Ray (79 MB) comes from PyPI into .venv-ray at the repository root, the first time.
#
#     sh tests/ray/run.sh [arguments of pytest]
set -eu
cd "$(dirname "$0")/../.."
venv=${DENSECLOUD_RAY_VENV:-.venv-ray}
if ! "$venv/bin/python" -c 'import moto, pytest, ray' 2>/dev/null; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --only-binary :all: -r tests/ray/requirements.txt
fi
if [ -z "${DENSECLOUD:-}" ]; then
    sh scripts/fetch-onnxruntime.sh
    cargo build --release
fi
exec "$venv/bin/python" -m pytest -q -s -p no:cacheprovider tests/ray "$@"
