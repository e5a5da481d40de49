#!/bin/sh
# Instructions that the hot paths take, counted by valgrind (callgrind), which no noise of the machine changes:
# 16x of 500 points on one thread. `benches/instructions.sh`; needs `make build` and valgrind; two minutes.
set -eu
cd "$(dirname "$0")/.."
program=${CARGO_TARGET_DIR:-target}/release/densecloud
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$program" sample shape:knot "$work/in.ply" --points 500
valgrind --tool=callgrind --callgrind-out-file="$work/counts" \
    "$program" upsample "$work/in.ply" "$work/out.ply" --ratio 16 --threads 1 --quiet >/dev/null 2>&1
echo "million instructions, share, where"
callgrind_annotate --auto=no --threshold=100 "$work/counts" | awk '
    { gsub(",", "", $1) }
    /PROGRAM TOTALS/ { total = $1 }
    /^ *[0-9]/ && !/PROGRAM TOTALS/ {
        where = "the rest"
        if (/libonnxruntime/) where = "ONNX Runtime"
        else if (/operators\/edge_block|EdgeBlock/) where = "edge blocks"
        else if (/operators\/neighbours|NearestOthers/) where = "neighbours in a patch"
        else if (/operators\/skip|BilateralSkip/) where = "skip"
        else if (/kdtree/) where = "k-d tree"
        else if (/farthest/) where = "farthest point sampling"
        else if (/mls|normals/) where = "surface fits and normals"
        else if (/cascade/) where = "the rest of the cascade"
        count[where] += $1
    }
    END {
        for (where in count) printf "%.0f %.1f%% %s\n", count[where] / 1e6, 100 * count[where] / total, where | "sort -rn"
        close("sort -rn")
        printf "%.0f 100%% all\n", total / 1e6
    }'
