#!/bin/sh
# Beside the classical tools: 5,000 Poisson-disk points of a mesh to 80,000, seconds of the whole program and metrics.
# `benches/classical/run.sh MESH [RUNS]` (a PLY or OFF mesh); needs `make build`, GNU time, a C++ compiler and the
# packages libcgal-dev and libpcl-dev.
set -eu
mesh=$(realpath "$1")
runs=${2:-3}
cd "$(dirname "$0")/../.."
program=${CARGO_TARGET_DIR:-target}/release/densecloud
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
c++ -O3 -march=native -DNDEBUG -DCGAL_EIGEN3_ENABLED -I/usr/include/eigen3 benches/classical/cgal.cpp \
    -o "$work/cgal" -lgmp -lmpfr
# Without -march=native, as PCL's package is built: Eigen would lay memory out otherwise.
c++ -O3 -DNDEBUG -I/usr/include/eigen3 -I"$(ls -d /usr/include/pcl-* | head -1)" benches/classical/pcl.cpp \
    -o "$work/pcl" -lpcl_surface -lpcl_search -lpcl_kdtree -lpcl_features -lpcl_common -lflann_cpp -llz4
"$program" sample "$mesh" "$work/in.xyz" --points 5000
"$program" sample "$mesh" "$work/reference.xyz" --points 80000 --seed 1
for run in $(seq "$runs"); do
    /usr/bin/time -a -o "$work/densecloud_1" -f %e "$program" upsample "$work/in.xyz" "$work/densecloud_1.xyz" \
        --points 80000 --threads 1 --quiet
    /usr/bin/time -a -o "$work/densecloud_2" -f %e "$program" upsample "$work/in.xyz" "$work/densecloud_2.xyz" \
        --points 80000 --threads 2 --quiet
    for tool in cgal pcl; do
        /usr/bin/time -a -o "$work/$tool.time" -f %e "$work/$tool" "$work/in.xyz" "$work/$tool.xyz" 80000
    done
done
mv "$work/densecloud_1" "$work/densecloud_1.time"
mv "$work/densecloud_2" "$work/densecloud_2.time"
for tool in densecloud_1 densecloud_2 cgal pcl; do
    echo "$tool: seconds $(sort -n "$work/$tool.time" | tr '\n' ' ')"
    "$program" evaluate --pred "$work/$tool.xyz" --reference "$work/reference.xyz" --mesh "$mesh" --quiet
done
