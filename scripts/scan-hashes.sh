#!/bin/sh
# SHA-256 of what the program makes of real scans, to hold one build against another: a line `NAME SHA256` a case.
# `scan-hashes.sh PROGRAM SCANS DENSE OUT.txt`: two folders of scans, and the file to write, which `diff` compares with another's.
# A case whose scan is missing, or that fails, ends it. Needs GNU coreutils; a few minutes on two cores.
set -eu
[ $# -eq 4 ] || { echo "usage: $0 PROGRAM SCANS DENSE OUT.txt" >&2; exit 64; }
program=$1 scans=$2 dense=$3 out=$4
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# scan INPUT EXTENSION [OPTION ...]: the file, and the provenance beside it where there is one.
scan() {
    input=$1 extension=$2
    shift 2
    rm -f "$work"/*
    "$program" upsample "$input" "$work/out.$extension" --quiet "$@" || { echo "$input: failed" >&2; exit 1; }
    sum=$(cat "$work"/out.* | sha256sum | cut -d ' ' -f 1)
    name="$(basename "$input"):$extension:$(echo "$*" | tr ' ' '&')"
    echo "$name $sum"
}

{
    scan "$scans/cgal_building.ply" ply --ratio 4
    scan "$scans/cgal_building.ply" e57 --ratio 1.5 --seed 3 --keep-input
    scan "$scans/cgal_oni.pwn" ply --ratio 16
    scan "$scans/cgal_oni.pwn" pwn --ratio 2 --source-fields
    scan "$scans/cgal_poste_france.xyz" xyz --ratio 4
    scan "$scans/cgal_poste_france.xyz" laz --ratio 7.3 --seed 1
    scan "$scans/pcl_lamppost.pcd" pcd --ratio 4
    scan "$scans/pcl_milk.pcd" pcd --ratio 4 --normals estimate
    scan "$scans/pcl_milk.pcd" npy --ratio 2 --no-polish
    scan "$scans/pcl_region_growing_tutorial.pcd" pcd --ratio 1.5
    scan "$scans/pdal_1.2-with-color.copc.laz" laz --ratio 4 --keep-input --source-fields
    scan "$scans/pdal_1.2-with-color.las" las --ratio 16
    scan "$scans/pdal_autzen_trim.las" las --ratio 1.5
    scan "$scans/pdal_autzen_trim.laz" laz --ratio 2 --attributes intensity:nearest --seed 9
    scan "$scans/pdal_autzen_trim.laz" csv --ratio 1
    scan "$dense/ouster_os0_128.ply" ply --ratio 1.5
    scan "$dense/ouster_os1_128.ply" pcd --ratio 2 --overlap 3 --inner 1
} >"$out.part"
mv "$out.part" "$out"
