"""Where a training step's time goes: `train --profile STEPS`."""

from typing import Callable, Dict, List

import torch
from torch.profiler import ProfilerActivity, profile, record_function

# Labels in `Trainer.train_step`, in order.
PARTS = ("draw patches", "forward", "loss", "backward", "optimiser")

# What PyTorch's operations are part of, by the start of their names; the first match counts.
KINDS = {
    "edge blocks (kernels)": ("EdgeMaxima",),
    "products": ("aten::mm", "aten::addmm", "aten::bmm", "aten::baddbmm"),
    "selection": ("aten::topk", "aten::argmin", "aten::max", "aten::sort"),
    "gathering": ("aten::gather", "aten::index", "aten::scatter"),
}


def part(name: str) -> record_function:
    """A labelled part of a step; free when nobody measures."""
    return record_function(name)


def report(step: Callable[[], object], steps: int, device: torch.device) -> List[str]:
    """Runs `steps` steps and returns a table: the share of each part, and of each kind of operation."""
    activities = [ProfilerActivity.CPU] + ([ProfilerActivity.CUDA] if device.type == "cuda" else [])
    for _ in range(3):
        step()
    with profile(activities=activities) as measured:
        for _ in range(steps):
            step()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
    averages = measured.key_averages()
    # On a GPU the parts are launched, not computed, while their label is open: there, operations tell more.
    totals = {entry.key: entry.cpu_time_total for entry in averages if entry.key in PARTS}
    whole = sum(totals.values()) or 1.0
    lines = ["part of a step            share"]
    lines += [f"{name:24} {100 * totals.get(name, 0.0) / whole:5.1f} %" for name in PARTS]
    times: Dict[str, float] = {}
    for entry in averages:
        if entry.key in PARTS:
            continue
        kind = next((kind for kind, starts in KINDS.items() if entry.key.startswith(starts)), "everything else")
        times[kind] = times.get(kind, 0.0) + _own_time(entry, device)
    whole = sum(times.values()) or 1.0
    lines += ["", "kind of operation         share"]
    lines += [f"{kind:24} {100 * time / whole:5.1f} %" for kind, time in sorted(times.items(), key=lambda kv: -kv[1])]
    return lines


def _own_time(entry, device: torch.device) -> float:
    if device.type != "cuda":
        return entry.self_cpu_time_total
    return getattr(entry, "self_device_time_total", None) or getattr(entry, "self_cuda_time_total", 0.0)
