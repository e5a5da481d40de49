#!/bin/sh
# Python's package as people get it: the wheel goes into an empty environment, and its module, its command, its types and its
# documents are tried there. DENSECLOUD_WHEEL names a wheel; else one is built for this machine alone. DENSECLOUD names a program whose
# bytes are to be the same; else it is the package's own.
#
#     sh tests/python/run.sh [arguments of pytest]
set -eu
cd "$(dirname "$0")/../.."
wheel=${DENSECLOUD_WHEEL:-$(sh scripts/build-wheel.sh --here)}
venv=${DENSECLOUD_WHEEL_VENV:-.venv-wheel}
rm -rf "$venv"
"${PYTHON:-python3}" -m venv "$venv"
"$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: "$wheel"
# With nothing else there; the folder it is started in is no part of it. Set by cargo, it would hide the package's own.
unset ORT_DYLIB_PATH
(cd / && "$OLDPWD/$venv/bin/python" -c 'import densecloud; print(densecloud.upsample([[x, y, 0] for x in range(9) for y in range(9)]))')
"$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: -r tests/python/requirements.txt
[ $# -gt 0 ] || set -- tests/python
exec "$venv/bin/python" -m pytest -q -p no:cacheprovider "$@"
