#!/bin/sh
# Formats and the server against other programs: files that they write are read here, and files written here by
# them; Triton's client, one generated from the gRPC contract, a browser and schemathesis talk to the server;
# and files of deploy/ by the schemas of those who read them.
# Their packages come from PyPI into .venv-interop at the repository root, about 2 GB, the first time.
# The page is tested where a Chromium or Chrome is installed (`apt-get install chromium`; CHROMIUM names another).
#
#     sh tests/interop/run.sh [arguments of pytest]
set -eu
cd "$(dirname "$0")/../.."
venv=${DENSECLOUD_INTEROP_VENV:-.venv-interop}
if ! "$venv/bin/python" -c 'import compose_spec, grpc_health, grpc_reflection, grpc_status, grpc_tools, kubernetes_validate, laspy, lazrs, numpy, open3d, openapi_spec_validator, pandas, PIL, playwright, plyfile, pye57, pypcd4, pytest, schemathesis, trimesh, tritonclient.http, yaml' 2>/dev/null; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --only-binary :all: -r tests/interop/requirements.txt
fi
if [ -z "${DENSECLOUD:-}" ]; then
    sh scripts/fetch-onnxruntime.sh
    cargo build --release
fi
exec "$venv/bin/python" -m pytest -q tests/interop "$@"
