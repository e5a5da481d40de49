#!/bin/sh
# Runs a command beside the services that some tests need, on free ports and with all they keep in a temporary folder:
#
#   sh scripts/with-services.sh cargo test --workspace -- --include-ignored
#
# The command finds in its environment
#
#   DENSECLOUD_TEST_S3        an S3's endpoint, with the bucket densecloud-test; any credentials will do
#   DENSECLOUD_TEST_POSTGRES  a Postgres' address, whose user may do anything; PGPASSWORD has the password
#
# All are stopped when it ends, whatever happens. `make venv` makes the environment that they come from; a Postgres of the
# system is taken where there is one.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
python=${DENSECLOUD_VENV:-$root/.venv}/bin/python
work=$(mktemp -d)
services= postgres=

stop() {
    status=$?
    trap - EXIT
    # shellcheck disable=SC2086
    [ -z "$services" ] || kill $services 2>/dev/null || true
    # At once, whoever is still connected.
    [ -z "$postgres" ] || kill -INT "$postgres" 2>/dev/null || true
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

start_postgres() {
    port=$("$python" -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
    chmod 711 "$work"
    # What a crash of the machine would lose does not matter here.
    sh "$root/scripts/postgres.sh" "$work/postgres" "$port" -c fsync=off -c max_connections=300 >"$work/postgres.log" 2>&1 &
    postgres=$!
    await_postgres
    DENSECLOUD_TEST_POSTGRES="postgres://test@127.0.0.1:$port/postgres?sslmode=disable"
    PGPASSWORD=test
    export DENSECLOUD_TEST_POSTGRES PGPASSWORD
}

# Its file of the process says when it is there.
await_postgres() {
    tries=0
    until grep -q ready "$work/postgres/postmaster.pid" 2>/dev/null; do
        tries=$((tries + 1))
        if [ "$tries" -gt 600 ]; then
            echo "Postgres did not start; its log:" >&2
            cat "$work/postgres.log" >&2
            exit 1
        fi
        sleep 0.1
    done
}

start_s3
start_postgres
"$@"
