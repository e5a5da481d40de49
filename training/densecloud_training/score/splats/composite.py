"""Gaussians on a picture: which pixels each reaches, and what comes of them, front to back.

Only pairs of a Gaussian and a pixel where it covers at least LEAST are looked at, so time goes with those pairs. The
gradient is written out by hand, since a graph over pairs would be slower. The CPU kernels do the same several times
faster where they can be built; the tests hold both against a plain sum over all Gaussians and pixels.
"""

from typing import Any, NamedTuple, Tuple

import numpy as np
import torch

from ... import native
from .view import ranges

LEAST = 1 / 255
MOST = 0.99


class Pairs(NamedTuple):
    """Sorted by pixel, then from front to back: the Gaussian of each pair, the pixel, and from the Gaussian's middle to
    the pixel's; and how many pairs each pixel has."""

    gaussian: np.ndarray
    pixel: np.ndarray
    dx: np.ndarray
    dy: np.ndarray
    counts: np.ndarray


def pairs(centre: np.ndarray, conic: np.ndarray, opacity: np.ndarray, order: np.ndarray, size: int) -> Pairs:
    """All pairs where a Gaussian covers at least LEAST. `centre` [n,2] in pixels, `conic` [n,3] (xx, xy, yy of the
    inverse covariance), `opacity` [n], `order`: indices from front to back, those to be drawn alone."""
    order = order[opacity[order] > LEAST]
    (x, y), (xx, xy, yy) = centre[order].T, conic[order].T
    reach = 2 * np.log(opacity[order] / LEAST)
    tall = np.sqrt(reach * xx / (xx * yy - xy * xy))
    first = np.clip(np.ceil(y - tall - 0.5), 0, size).astype(np.int32)
    last = np.clip(np.floor(y + tall - 0.5) + 1, 0, size).astype(np.int32)
    row_of, row = ranges(np.maximum(last - first, 0))
    row = row + first[row_of]
    # In a row, the ellipse is where xx dx^2 + 2 xy dx dy + yy dy^2 is at most `reach`.
    dy = row + 0.5 - y[row_of]
    half = np.sqrt(np.maximum(reach[row_of] * xx[row_of] - (xx * yy - xy * xy)[row_of] * dy * dy, 0)) / xx[row_of]
    middle = x[row_of] - xy[row_of] / xx[row_of] * dy - 0.5
    left = np.clip(np.ceil(middle - half), 0, size).astype(np.int32)
    right = np.clip(np.floor(middle + half) + 1, 0, size).astype(np.int32)
    span_of, column = ranges(np.maximum(right - left, 0))
    column = column + left[span_of]
    return by_pixel(row_of[span_of], column, row[span_of], order, centre, size)


def by_pixel(
    place: np.ndarray, column: np.ndarray, row: np.ndarray, order: np.ndarray, centre: np.ndarray, size: int
) -> Pairs:
    """Pairs given from front to back, sorted by pixel."""
    pixel = row * size + column
    # A stable sort of 16 bits is by their digits: linear.
    sort = np.argsort(pixel.astype(np.uint16) if size <= 256 else pixel, kind="stable")
    pixel, gaussian = pixel[sort], order[place[sort]]
    x, y = columns(centre)
    dx = (column[sort] + 0.5).astype(centre.dtype) - x[gaussian]
    dy = (row[sort] + 0.5).astype(centre.dtype) - y[gaussian]
    return Pairs(gaussian, pixel, dx, dy, np.bincount(pixel, minlength=size * size))


def composite(
    centre: torch.Tensor,
    conic: torch.Tensor,
    opacity: torch.Tensor,
    colour: torch.Tensor,
    order: np.ndarray,
    size: int,
    behind: np.ndarray,
) -> torch.Tensor:
    """As Composite, by the fastest way at hand."""
    function = native.Splats if native.usable(centre) else Composite
    return function.apply(centre, conic, opacity, colour, order, size, behind)


class Composite(torch.autograd.Function):
    """[size,size,3]: pictures of Gaussians. Takes `centre` [n,2], `conic` [n,3], `opacity` [n], `colour` [n,3] with
    gradients, `order` (indices from front to back), the size and the colour behind all, [3]."""

    @staticmethod
    def forward(ctx: Any, centre, conic, opacity, colour, order, size: int, behind) -> torch.Tensor:  # type: ignore
        values = [tensor.detach().numpy() for tensor in (centre, conic, opacity, colour)]
        found = pairs(*values[:3], order, size)
        conics = tuple(column[found.gaussian] for column in columns(values[1]))
        fall = np.exp(-0.5 * (conics[0] * found.dx**2 + conics[2] * found.dy**2) - conics[1] * found.dx * found.dy)
        raw = values[2][found.gaussian] * fall
        alpha = np.minimum(raw, MOST)
        through, rest = transmittance(alpha, found.counts)
        share = alpha * through
        image = np.stack([summed(found.pixel, share * c[found.gaussian], size * size) for c in columns(values[3])], 1)
        ctx.kept = (found, conics, fall, raw, alpha, through, rest, share, values[3], np.asarray(behind))
        return torch.from_numpy((image + rest[:, None] * behind).astype(values[0].dtype).reshape(size, size, 3))

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> Tuple[Any, ...]:  # type: ignore
        found, conics, fall, raw, alpha, through, rest, share, colour, behind = ctx.kept
        wanted = gradient.numpy().reshape(-1, 3)
        here = [column[found.pixel] for column in columns(wanted)]
        worth = sum(column[found.gaussian] * h for column, h in zip(columns(colour), here))
        after = behind_each(share * worth, found.counts) + np.repeat(rest * (wanted @ behind), found.counts)
        by_alpha = np.where(raw < MOST, through * worth - after / (1 - alpha), 0)
        by_power = by_alpha * raw
        dx, dy = found.dx, found.dy
        centre = by_power * (conics[0] * dx + conics[1] * dy), by_power * (conics[1] * dx + conics[2] * dy)
        conic = -0.5 * by_power * dx * dx, -by_power * dx * dy, -0.5 * by_power * dy * dy
        parts = [*centre, *conic, by_alpha * fall, *(share * h for h in here)]
        sums = np.stack([summed(found.gaussian, part, len(colour)) for part in parts], 1)
        sums = torch.from_numpy(sums.astype(colour.dtype))
        return sums[:, :2], sums[:, 2:5], sums[:, 5], sums[:, 6:], None, None, None


def columns(table: np.ndarray) -> Tuple[np.ndarray, ...]:
    """Of a table [n,k], each on its own: looking up in one is faster than in a table."""
    return tuple(np.ascontiguousarray(column) for column in table.T)


def summed(place: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """[count] f64: the sum of the values of each place."""
    return np.bincount(place, values, count)


def transmittance(alpha: np.ndarray, counts: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """What reaches each pair through those before it, and what each pixel lets through to the end."""
    logs = np.log1p(-alpha.astype(np.float64))
    ends = np.concatenate([[0.0], np.cumsum(logs)])
    first = np.cumsum(counts) - counts
    through = np.exp(ends[:-1] - np.repeat(ends[first], counts))
    return through.astype(alpha.dtype), np.exp(ends[first + counts] - ends[first])


def behind_each(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """For each pair the sum of the values behind it in its pixel."""
    ends = np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])
    last = np.cumsum(counts)
    return (np.repeat(ends[last], counts) - ends[1:]).astype(values.dtype)
