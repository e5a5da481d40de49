#!/bin/sh
# A large cloud in tiles on this machine: sh loop.sh IN WORK OUT [options of `densecloud tiles plan`]
#
# IN and OUT are clouds, WORK is a new folder; each may be an address such as s3://bucket/path. PARALLEL tiles are worked on at
# once (2).
set -eu
input=$1 work=$2 output=$3
shift 3

tiles=$(densecloud tiles plan "$input" "$work" --for "$output" "$@")
seq 0 $((tiles - 1)) | xargs -P "${PARALLEL:-2}" -n 1 densecloud tiles run "$work"
densecloud tiles join "$work" "$output"
