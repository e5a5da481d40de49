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
# The optional libraries, the tests of which are left out where this Python has no wheel of one.
DENSECLOUD_WITHOUT=
for extra in open3d pyvista trimesh laspy dask; do
    if told=$("$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: "$wheel[$extra]" 2>&1); then
        continue
    elif printf '%s' "$told" | grep -q 'No matching distribution'; then
        echo "this Python has no wheel of $extra: its tests are left out" >&2
        DENSECLOUD_WITHOUT="$DENSECLOUD_WITHOUT $extra"
    else
        printf '%s\n' "$told" >&2
        exit 1
    fi
done
export DENSECLOUD_WITHOUT
"$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: -r tests/python/requirements.txt
[ $# -gt 0 ] || set -- tests/python
exec "$venv/bin/python" -m pytest -q -p no:cacheprovider "$@"
