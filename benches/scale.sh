#!/bin/sh
# Time and memory of the whole program against the number of points: 4x of uniform random points on the built-in knot.
# `benches/scale.sh [RUNS] [THREADS] [POINTS ...]`, by default 3 2 5000 20000 100000 1000000; needs `make build` and
# GNU time. RATIO=16 for another ratio.
set -eu
cd "$(dirname "$0")/.."
runs=${1:-3}
threads=${2:-2}
[ $# -gt 2 ] && shift 2 || set -- 5000 20000 100000 1000000
ratio=${RATIO:-4}
program=${CARGO_TARGET_DIR:-target}/release/densecloud
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
echo "points in, ratio, seconds: median (min to max) of $runs, microseconds a point in, peak MB, bytes a point out"
for points in "$@"; do
    "$program" sample shape:knot "$work/in.ply" --points "$points" --method uniform
    for run in $(seq "$runs"); do
        /usr/bin/time -a -o "$work/$points" -f "%e %M" \
            "$program" upsample "$work/in.ply" "$work/out.ply" --ratio "$ratio" --threads "$threads" --quiet
    done
    sort -n "$work/$points" | awk -v points="$points" -v ratio="$ratio" '
        { seconds[NR] = $1; if ($2 > peak) peak = $2 }
        END {
            median = seconds[int((NR + 1) / 2)]
            printf "%d %s %.2f (%.2f to %.2f) %.1f %.0f %.0f\n", points, ratio, median, seconds[1], seconds[NR],
                1e6 * median / points, peak / 1000, 1024 * peak / (points * ratio)
        }'
done
