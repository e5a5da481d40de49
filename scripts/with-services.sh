#!/bin/sh
# Runs a command beside the services that some tests need, on free ports and with all they keep in a temporary folder:
#
#   sh scripts/with-services.sh cargo test --workspace -- --include-ignored
#
# The command finds in its environment
#
#   DENSECLOUD_TEST_S3        an S3's endpoint, with the bucket densecloud-test; any credentials will do
#
# All are stopped when it ends, whatever happens. `make venv` makes the environment that they come from.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
python=${DENSECLOUD_VENV:-$root/.venv}/bin/python
work=$(mktemp -d)
services=

stop() {
    status=$?
    trap - EXIT
    # shellcheck disable=SC2086
    [ -z "$services" ] || kill $services 2>/dev/null || true
    wait 2>/dev/null || true
    rm -rf "$work"
    exit "$status"
}
trap stop EXIT
trap 'exit 129' HUP
trap 'exit 130' INT
trap 'exit 143' TERM

# Waits for a file of a service, for a minute.
await() {
    file=$1 log=$2 tries=0
    until [ -s "$file" ]; do
        tries=$((tries + 1))
        if [ "$tries" -gt 600 ]; then
            echo "a service did not start; its log:" >&2
            cat "$log" >&2
            exit 1
        fi
        sleep 0.1
    done
}

start_s3() {
    "$python" -c 'import moto' 2>/dev/null || { echo "moto is missing in $python: run \`make venv\`" >&2; exit 1; }
    "$python" "$root/scripts/s3_stand_in.py" "$work/s3" densecloud-test >"$work/s3.log" 2>&1 &
    services="$services $!"
    await "$work/s3" "$work/s3.log"
    DENSECLOUD_TEST_S3=$(cat "$work/s3")
    export DENSECLOUD_TEST_S3
}

start_s3
"$@"
