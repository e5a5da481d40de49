"""The CPU kernels of `kernels.cpp`: built by the system's compiler at first use, called through ctypes.

Without a compiler, or with DENSECLOUD_NATIVE=0, everything runs on PyTorch's own operations, several times slower.
"""

import ctypes
import hashlib
import os
import subprocess
import tempfile
import warnings
from functools import cache
from pathlib import Path
from typing import Optional

import torch

SOURCE = Path(__file__).with_name("kernels.cpp")
# The parts of -ffast-math that matter here. As a whole it would link what makes the process flush small numbers to zero
# once the library is loaded, whereupon SciPy's k-d tree crashes.
FAST = ["-fno-math-errno", "-fassociative-math", "-freciprocal-math", "-fno-signed-zeros", "-fno-trapping-math"]
FLAGS = ["-O3", "-march=native", *FAST, "-std=c++17", "-fopenmp", "-shared", "-fPIC"]
GROWTH = 12


@cache
def library() -> Optional[ctypes.CDLL]:
    """The built library, or None. It is kept per source, flags and processor in the user's cache folder."""
    if os.environ.get("DENSECLOUD_NATIVE", "1") == "0":
        return None
    folder = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "densecloud"
    try:
        processor = Path("/proc/cpuinfo").read_text().split("\n\n")[0]
        flags = next((line for line in processor.splitlines() if line.startswith("flags")), processor)
        key = hashlib.sha256(SOURCE.read_bytes() + " ".join(FLAGS).encode() + flags.encode()).hexdigest()[:16]
        target = folder / f"kernels-{key}.so"
        if not target.exists():
            folder.mkdir(parents=True, exist_ok=True)
            # Built beside the final name and renamed, so that two processes can start at once.
            with tempfile.TemporaryDirectory(dir=str(folder)) as scratch:
                built = Path(scratch) / "kernels.so"
                command = [os.environ.get("CXX", "g++"), *FLAGS, str(SOURCE), "-o", str(built)]
                subprocess.run(command, check=True, capture_output=True, text=True)
                os.replace(built, target)
        return ctypes.CDLL(str(target))
    except (OSError, subprocess.CalledProcessError) as error:
        detail = getattr(error, "stderr", "") or error
        warnings.warn(f"CPU kernels could not be built; training on a CPU will be slow: {detail}", stacklevel=2)
        return None


def usable(tensor: torch.Tensor) -> bool:
    """Whether the kernels can take this tensor's place in a computation."""
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32 and library() is not None


def _pointer(tensor: torch.Tensor) -> ctypes.c_void_p:
    return ctypes.c_void_p(tensor.data_ptr())


def _threads() -> ctypes.c_int:
    return ctypes.c_int(torch.get_num_threads())


def neighbours(features: torch.Tensor, k: int) -> torch.Tensor:
    """[B,N,C] -> int32 [B,N,k]: each point's k nearest others."""
    features = features.detach().contiguous()
    batch, count, channels = features.shape
    if not 0 < k < count:
        raise ValueError(f"a patch of {count} points has no {k} other points")
    out = torch.empty(batch, count, k, dtype=torch.int32)
    sizes = (ctypes.c_int64(batch), ctypes.c_int(count), ctypes.c_int(channels), ctypes.c_int(k))
    library().densecloud_neighbours(_pointer(features), *sizes, _pointer(out), _threads())
    return out


def nearest(points: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
    """[B,P,3], [B,Q,3] -> int64 [B,P]: the nearest of `others`."""
    points, others = points.detach().contiguous(), others.detach().contiguous()
    out = torch.empty(points.shape[:2], dtype=torch.int64)
    sizes = (ctypes.c_int64(len(points)), ctypes.c_int(points.shape[1]), ctypes.c_int(others.shape[1]))
    library().densecloud_nearest(_pointer(points), _pointer(others), *sizes, _pointer(out), _threads())
    return out


class EdgeMaxima(torch.autograd.Function):
    """Maxima over the edges of c, b and a, [B,N,36]; see `edge.EdgeBlock.forward` for the terms.

    own_a, own_b, other: [B,N,12], biases included; a_to_b, a_to_c, b_to_c: [12,12] for products from the right.
    """

    @staticmethod
    def forward(ctx, own_a, own_b, other, a_to_b, a_to_c, b_to_c, indices):
        inputs = [tensor.contiguous() for tensor in (own_a, own_b, other, a_to_b, a_to_c, b_to_c)]
        batch, count, k = indices.shape
        out = torch.empty(batch, count, 3 * GROWTH)
        argmax = torch.empty(batch, count, 3 * GROWTH, dtype=torch.uint8)
        sizes = (ctypes.c_int64(batch), ctypes.c_int(count), ctypes.c_int(k))
        pointers = [_pointer(tensor) for tensor in (*inputs, indices)]
        library().densecloud_edge_forward(*pointers, *sizes, _pointer(out), _pointer(argmax), _threads())
        ctx.save_for_backward(*inputs, indices, argmax)
        return out

    @staticmethod
    def backward(ctx, grad_out):
        *inputs, indices, argmax = ctx.saved_tensors
        grad_out = grad_out.contiguous()
        batch, count, k = indices.shape
        per_point = [torch.zeros(batch, count, GROWTH) for _ in range(3)]
        per_matrix = [torch.zeros(batch, GROWTH, GROWTH) for _ in range(3)]
        sizes = (ctypes.c_int64(batch), ctypes.c_int(count), ctypes.c_int(k))
        pointers = [_pointer(tensor) for tensor in (*inputs, indices, argmax, grad_out)]
        targets = [_pointer(tensor) for tensor in (*per_point, *per_matrix)]
        library().densecloud_edge_backward(*pointers, *sizes, *targets, _threads())
        return (*per_point, *(matrix.sum(0) for matrix in per_matrix), None)


class Splats(torch.autograd.Function):
    """Pictures of Gaussians, [size,size,3]; see `score.splats.composite`, whose arguments these are."""

    @staticmethod
    def forward(ctx, centre, conic, opacity, colour, order, size, behind):
        inputs = [tensor.detach().contiguous() for tensor in (centre, conic, opacity, colour)]
        order, behind = torch.as_tensor(order, dtype=torch.int64), torch.as_tensor(behind, dtype=torch.float64)
        image, left = torch.zeros(size, size, 3), torch.ones(size, size, dtype=torch.float64)
        sizes = (ctypes.c_int64(len(order)), ctypes.c_int(size))
        pointers = [_pointer(tensor) for tensor in (*inputs, order)]
        library().densecloud_splats_forward(*pointers, *sizes, _pointer(image), _pointer(left))
        ctx.kept = (inputs, order, size, left, behind)
        return image + (left[..., None] * behind).float()

    @staticmethod
    def backward(ctx, grad_out):
        inputs, order, size, left, behind = ctx.kept
        grad_out, left = grad_out.contiguous(), left.clone()
        after = left * (grad_out.double() @ behind)
        grads = torch.zeros(len(inputs[0]), 9)
        sizes = (ctypes.c_int64(len(order)), ctypes.c_int(size))
        pointers = [_pointer(tensor) for tensor in (*inputs, order)]
        targets = [_pointer(tensor) for tensor in (grad_out, left, after, grads)]
        library().densecloud_splats_backward(*pointers, *sizes, *targets)
        return grads[:, :2], grads[:, 2:5], grads[:, 5], grads[:, 6:], None, None, None
