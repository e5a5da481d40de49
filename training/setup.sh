#!/bin/sh
# Makes the project's virtual environment, .venv at the repository root, for training and its tests.
#
# PyTorch comes from the system's packages where they can be had (150 MB; with OpenBLAS, without which it is 6 times
# slower), else from pip. Run again at will: it does nothing when nothing has changed.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
root=$(dirname "$here")
venv=${DENSECLOUD_VENV:-$root/.venv}
stamp=$venv/.densecloud-setup
wanted=$(cat "$here/setup.sh" "$here/requirements.txt" "$here/requirements-test.txt" "$here/pyproject.toml" | cksum)

if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then
    exit 0
fi

as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        sudo -n "$@"
    else
        return 1
    fi
}

# The system's own interpreter: a `python3` earlier on the path cannot see the system's packages.
system_python=/usr/bin/python3

system_torch() {
    [ -x "$system_python" ] && "$system_python" -c 'import torch, venv, ensurepip' >/dev/null 2>&1
}

if [ "${DENSECLOUD_TORCH:-system}" = system ] && ! system_torch && command -v apt-get >/dev/null 2>&1; then
    packages="python3-torch libopenblas0-pthread python3-venv python3-pip"
    # shellcheck disable=SC2086
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $packages ||
        { as_root apt-get update -q &&
          as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $packages; } ||
        echo "no PyTorch from the system's packages; taking it from pip" >&2
fi

if [ "${DENSECLOUD_TORCH:-system}" = system ] && system_torch; then
    "$system_python" -m venv --clear --system-site-packages "$venv"
    torch=
else
    python=$(command -v python3 || echo "$system_python")
    "$python" -m venv --clear "$venv"
    torch=torch
fi
# numpy: a system PyTorch is compiled against the system's numpy 1, so pip must not bring numpy 2 beside it.
constraint=$venv/constraints.txt
"$venv/bin/python" -c 'import numpy; print("numpy==" + numpy.__version__)' >"$constraint" 2>/dev/null || : >"$constraint"
# shellcheck disable=SC2086
"$venv/bin/python" -m pip install -q --disable-pip-version-check -c "$constraint" \
    -r "$here/requirements-test.txt" $torch
"$venv/bin/python" -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e "$here" 2>/dev/null ||
    "$venv/bin/python" -m pip install -q --disable-pip-version-check --no-deps -e "$here"
printf '%s' "$wanted" >"$stamp"
echo "training's environment is $venv"
