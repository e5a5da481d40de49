"""Upsamples an array with its colours: `python examples/array.py`. Checked by mypy and pyright."""

from __future__ import annotations

import densecloud
import numpy as np
from numpy.typing import NDArray


def sheet(side: int) -> NDArray[np.float64]:
    """A bent sheet of side x side points."""
    x, y = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    return np.stack([x, y, 0.2 * np.sin(5 * x) * y], axis=-1).reshape(-1, 3)


def sure(dense: densecloud.Result, least: float) -> NDArray[np.float64]:
    """The points that are as likely as that on the surface."""
    if dense.confidence is None:
        raise ValueError("ask for confidence=True")
    return dense.points[dense.confidence >= least]


def main() -> None:
    points = sheet(50)
    colors = (255 * points).astype(np.uint8)
    upsampler = densecloud.Upsampler(threads=2)
    dense = upsampler.upsample(points, ratio=4, colors=colors, quality="best", confidence=True, rules={"red": "mean"})
    print(f"{dense.points_in} -> {len(dense)} points, {len(sure(dense, 0.9))} of them sure")
    made: NDArray[np.uint8] | None = dense.colors
    assert made is not None and made.shape == (len(dense), 3)
    spacing: float = densecloud.inspect(dense)["spacing"]["median"]
    print(f"spacing {spacing:.4f}")


if __name__ == "__main__":
    main()
