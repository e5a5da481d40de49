#!/bin/sh
# A small request (2,048 points, 4x) to the server alone, and while large ones (a million points, 4x) are computed.
# `benches/share.sh [RUNS] [THREADS] [LARGE ONES ...]`, by default 9 2 0 1 3; needs `make build` and curl.
set -eu
cd "$(dirname "$0")/.."
runs=${1:-9}
threads=${2:-2}
[ $# -gt 2 ] && shift 2 || set -- 0 1 3
program=${CARGO_TARGET_DIR:-target}/release/densecloud
work=$(mktemp -d)
"$program" sample shape:knot "$work/small.ply" --points 2048
"$program" sample shape:knot "$work/large.ply" --points 1000000 --method uniform
"$program" serve --host 127.0.0.1 --port 18765 --max-points-in 2000000 --max-points-out 20000000 --threads "$threads" >"$work/log" 2>&1 &
server=$!
trap 'kill $server 2>/dev/null; rm -rf "$work"' EXIT
url=http://127.0.0.1:18765
until curl -sf "$url/readyz" >/dev/null; do sleep 0.1; done
post() { curl -sf -o "$1" -w '%{time_total}\n' --data-binary @"$2" -H 'content-type: application/octet-stream' "$url/upsample?ratio=4"; }
for large in "$@"; do
    waiting=""
    for i in $(seq "$large"); do
        post /dev/null "$work/large.ply" >/dev/null &
        waiting="$waiting $!"
    done
    [ "$large" -gt 0 ] && sleep 3
    for run in $(seq "$runs"); do post "$work/out.ply" "$work/small.ply"; done | sort -n | awk -v large="$large" '
        { seconds[NR] = $1 }
        END { printf "beside %d large ones: %.2f s (%.2f to %.2f)\n", large, seconds[int((NR + 1) / 2)], seconds[1], seconds[NR] }'
    for pid in $waiting; do kill "$pid" 2>/dev/null || true; done
    sleep 1
done
