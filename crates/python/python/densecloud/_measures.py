"""What clouds are like, and how near one is to another."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any

from . import _densecloud
from ._cloud import CloudLike
from ._options import Reading
from ._upsampler import as_cloud

if TYPE_CHECKING:
    from typing_extensions import Unpack


def inspect(
    cloud: CloudLike,
    /,
    *,
    sample: int = 20_000,
    ratio: float = 4.0,
    source: CloudLike | None = None,
    **reading: Unpack[Reading],
) -> dict[str, Any]:
    """Tells what a cloud is like, and what upsampling it would take: what `densecloud inspect --json` prints.

    `sample` is how many points are measured. `source` is the cloud that this one was made of: tells how many points are
    far from it. `ratio` is for the cost. Lengths are in the cloud's units, shares from 0 to 1; what could not be
    measured is None.

    >>> import numpy as np
    >>> grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), [0.0]), axis=-1).reshape(-1, 3)
    >>> told = inspect(grid)
    >>> told["points"], told["spacing"]["median"], told["upsampling"]["points"]
    (81, 1.0, 324)

    Raises InvalidInputError and OSError.
    """
    path = os.fspath(cloud) if isinstance(cloud, (str, os.PathLike)) else None
    whole = as_cloud(cloud, None, None, reading)
    points = None if source is None else _positions(source, reading)
    columns = list(whole._attributes.items())
    told = _densecloud.inspect(whole._points, columns, whole._origin, path, sample, ratio, points)
    return dict(json.loads(told))


def evaluate(
    cloud: CloudLike,
    reference: CloudLike,
    /,
    *,
    mesh: str | os.PathLike[str] | None = None,
    tolerance: float = 0.01,
    **reading: Unpack[Reading],
) -> dict[str, dict[str, float | None]]:
    """Scores a dense cloud against a dense sample of the true surface, as `densecloud evaluate` does.

    `mesh` is the path of the true surface (.ply, .off). `tolerance` is that of the F-score, in radii of the reference.
    `published` are the field's own scores: each cloud in its own unit sphere, Chamfer and Hausdorff distances squared.
    `corrected` have one scale for both, the radius of the reference.

    >>> square = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    >>> scores = evaluate(square, square)
    >>> scores["published"]["chamfer"], scores["corrected"]["f_score"]
    (0.0, 1.0)

    Raises InvalidInputError and OSError.
    """
    surface = None if mesh is None else os.fspath(mesh)
    points, others = _positions(cloud, reading), _positions(reference, reading)
    return dict(json.loads(_densecloud.evaluate(points, others, surface, tolerance)))


def _positions(cloud: CloudLike, reading: Any) -> Any:
    """The points alone; what is said of reading is for files."""
    is_file = isinstance(cloud, (str, os.PathLike))
    return as_cloud(cloud, None, None, reading if is_file else {})._points
