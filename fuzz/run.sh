#!/bin/sh
# Fuzzes every reader for SECONDS each (default 600), from seeds that the program writes itself. Needs
# cargo-fuzz and a nightly compiler:
#
#     cargo install cargo-fuzz && rustup toolchain install nightly
#     sh fuzz/run.sh [SECONDS [TARGET ...]]
#
# A finding ends its target and lies in fuzz/artifacts/TARGET; make a test of it in crates/formats/src/tests/findings.rs.
set -eu
cd "$(dirname "$0")/.."
seconds=${1:-600}
[ $# -gt 0 ] && shift
targets=${*:-ply text las pcd npy e57 off mesh ptx colmap kitti}
program=${DENSECLOUD:-target/release/densecloud}
seeds=fuzz/seeds
mkdir -p "$seeds"
"$program" sample shape:knot "$seeds/small.ply" --points 60
for to in small.xyz small.csv small.las small.laz small.copc.laz small.pcd small.npy small.e57; do
    "$program" upsample "$seeds/small.ply" "$seeds/$to" --ratio 1 --source-fields --normals estimate --quiet
done
printf 'X;Y;Z;GPS Time\n3,5;4;5;6\n1;2,5;3;7\n' > "$seeds/comma.csv"
printf '2\n1 2 3 -5 9 8 7\n4 5 6 -6 9 8 7\n1\n7 8 9 -7 6 5 4\n' > "$seeds/two.xyz"
printf 'sep=,\n"","Points:0","Points:1","Points:2","a, b"\n"1","2.5","3","","x"\n2,3,4,NA,"y ""z"""\n' > "$seeds/quoted.csv"
printf 'OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n' > "$seeds/small.off"
printf 'v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n' > "$seeds/small.obj"
printf '3\n1\n1 2 3\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n1 2 3 1\n1 2 3 0.5 7 8 9\n0 0 0 0.5 0 0 0\n' > "$seeds/small.ptx"
printf '4 5 6 0.5 7 8 9\n' >> "$seeds/small.ptx"
cat "$seeds/small.ptx" "$seeds/small.ptx" > "$seeds/two.ptx"
mkdir -p "$seeds/colmap"
for to in points3D.txt points3D.bin; do
    "$program" upsample "$seeds/small.ply" "$seeds/colmap/$to" --ratio 1 --quiet
done
# 20 points at the origin.
head -c 320 /dev/zero > "$seeds/small.kitti"
for target in $targets; do
    case $target in
        ply | mesh) own="$seeds/*.ply $seeds/*.off" ;;
        text) own="$seeds/*.xyz $seeds/*.csv $seeds/*.obj" ;;
        las) own="$seeds/*.las $seeds/*.laz" ;;
        colmap) own="$seeds/colmap/*" ;;
        *) own="$seeds/*.$target" ;;
    esac
    mkdir -p "fuzz/corpus/$target"
    # shellcheck disable=SC2086
    cp $own "fuzz/corpus/$target"
    echo "== $target"
    # No input above 16 KiB may take 64 MiB at once, or 512 in all.
    cargo +nightly fuzz run "$target" -- -max_total_time="$seconds" -max_len=16384 -timeout=10 \
        -malloc_limit_mb=64 -rss_limit_mb=512 -print_final_stats=1 2>&1 | tee "fuzz/$target.log" |
        grep -E "^stat::|DONE|SUMMARY|panicked|ERROR"
done
