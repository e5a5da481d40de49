"""Clouds of trimesh: points with colors of bytes; other numbers of each point are among the metadata.

>>> import trimesh, numpy as np, densecloud
>>> grid = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0), [0.0]), axis=-1).reshape(-1, 3)
>>> cloud = trimesh.PointCloud(grid, colors=np.full((100, 4), 200, np.uint8))
>>> dense = densecloud.upsample(cloud, ratio=4).to_trimesh()
>>> dense.vertices.shape, dense.colors[0].tolist()
((400, 3), [200, 200, 200, 200])
"""

# mypy: disable-error-code="import-not-found, import-untyped"
# pyright: reportMissingImports=false

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ._columns import COLORS, NORMALS, Taken, library, shares, tables
from ._errors import InvalidInputError

if TYPE_CHECKING:
    import trimesh

    from ._cloud import Cloud
    from ._columns import Parts


def parts_of(cloud: Any) -> Parts | None:
    """What a `PointCloud` has."""
    import trimesh

    if isinstance(cloud, trimesh.Trimesh):
        raise InvalidInputError(
            "a Trimesh is a surface, not a cloud: `trimesh.PointCloud(mesh.sample(10_000))` has points on it"
        )
    if isinstance(cloud, trimesh.Scene):
        raise InvalidInputError("a Scene is not a cloud: give one of its `geometry`")
    return _parts_of_points(cloud) if isinstance(cloud, trimesh.PointCloud) else None


def _parts_of_points(cloud: Any) -> Parts:
    taken, named, rows = Taken(), {"normals": NORMALS}, len(cloud.vertices)
    if len(cloud.colors) == rows:
        taken.add("colors", cloud.colors, [*COLORS, "alpha"])
    for name, value in cloud.metadata.items():
        if isinstance(value, np.ndarray) and value.shape[:1] == (rows,):
            taken.add(str(name), value, named.get(name))
        else:
            taken.lose(f"metadata {name}")
    return taken.parts(cloud.vertices)


def points(cloud: Cloud) -> tuple[trimesh.PointCloud, list[str]]:
    """The `PointCloud`, and the names of what it has no place for."""
    table, lost = tables(cloud, "colors", "normals"), []
    colors = table.pop("colors", None)
    made: trimesh.PointCloud = library("trimesh").PointCloud(cloud.points.copy(), metadata=table)
    if colors is not None and colors.ndim == 2:
        bytes_ = np.rint(255 * shares(colors))
        made.colors = bytes_.astype(np.uint8)
        if not np.allclose(bytes_ / 255, shares(colors), rtol=0, atol=1e-6):
            lost.append("more than 8 bits of colors")
    return made, lost
