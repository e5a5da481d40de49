#!/bin/sh
# The whole cascade, 16x on 5,000 points: this program against straightforward PyTorch with the same
# weights, overlap and threads, in its own operations (no kernels of ours). `benches/compare.sh [RUNS]
# [THREADS]`; needs `make build venv`.
set -eu
cd "$(dirname "$0")/.."
runs=${1:-3}
threads=${2:-2}
program=${CARGO_TARGET_DIR:-target}/release/densecloud
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
.venv/bin/python -m pip install -q --disable-pip-version-check fpsample
"$program" sample shape:knot "$work/in.xyz" --points 5000

torch() {
    DENSECLOUD_NATIVE=0 .venv/bin/python -m densecloud_training.cascade models/default "$work/in.xyz" "$work/torch.xyz" \
        --ratio 16 --threads "$threads" --inner 0.3 --fps "$1"
}
for run in $(seq "$runs"); do
    echo "run $run: densecloud"
    "$program" upsample "$work/in.xyz" "$work/out.xyz" --ratio 16 --threads "$threads"
    echo "run $run: PyTorch, farthest point sampling by the fpsample package"
    torch fpsample
done
echo "once: PyTorch, plain farthest point sampling"
torch plain
echo "once: PyTorch, the same in PyTorch's usual tensor form"
torch tensor
