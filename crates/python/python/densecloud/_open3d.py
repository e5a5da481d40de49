"""Clouds of Open3D: those of `open3d.geometry`, and those of tensors.

>>> import open3d, numpy as np, densecloud
>>> grid = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0), [0.0]), axis=-1).reshape(-1, 3)
>>> cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(grid))
>>> _ = cloud.paint_uniform_color([1.0, 0.5, 0.0])
>>> dense = densecloud.upsample(cloud, ratio=4).to_open3d()
>>> len(dense.points), np.asarray(dense.colors)[0].tolist()
(400, [1.0, 0.5, 0.0])
"""

# mypy: disable-error-code="import-not-found, import-untyped"
# pyright: reportMissingImports=false

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ._columns import COLORS, NORMALS, Taken, drawable, library, shares, tables
from ._errors import InvalidInputError

if TYPE_CHECKING:
    from ._cloud import Cloud
    from ._columns import Parts


def parts_of(cloud: Any) -> Parts | None:
    """What a cloud of either kind has; of a device, it is copied from there."""
    import open3d

    if isinstance(cloud, open3d.t.geometry.PointCloud):
        return _parts_of_tensors(cloud)
    if isinstance(cloud, open3d.geometry.PointCloud):
        return _parts_of_vectors(cloud)
    if isinstance(cloud, (open3d.geometry.TriangleMesh, open3d.t.geometry.TriangleMesh)):
        raise InvalidInputError(
            "a TriangleMesh is a surface, not a cloud: `mesh.sample_points_uniformly(10_000)` has points on it"
        )
    return None


def _parts_of_vectors(cloud: Any) -> Parts:
    taken = Taken()
    if cloud.has_colors():
        taken.add("colors", cloud.colors, COLORS)
    if cloud.has_normals():
        taken.add("normals", cloud.normals, NORMALS)
    if cloud.has_covariances():
        taken.lose("covariances")
    return taken.parts(cloud.points)


def _parts_of_tensors(cloud: Any) -> Parts:
    taken, named = Taken(), {"colors": COLORS, "normals": NORMALS}
    if "positions" not in cloud.point:
        raise InvalidInputError("the PointCloud has no positions")
    # Their own order is by no rule.
    for name in sorted(name for name in cloud.point if name != "positions"):
        taken.add(name, cloud.point[name].cpu().numpy(), named.get(name))
    return taken.parts(cloud.point.positions.cpu().numpy())


def vectors(cloud: Cloud) -> tuple[Any, list[str]]:
    """The `open3d.geometry.PointCloud`, and the names of what it has no place for."""
    open3d = library("open3d")
    table = tables(cloud, "colors", "normals")
    lost: list[str] = []
    made = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.points.copy()))
    colors, normals = table.pop("colors", None), table.pop("normals", None)
    if colors is not None and colors.ndim == 2:
        made.colors = open3d.utility.Vector3dVector(shares(colors)[:, :3])
        lost += ["opacity"] * (colors.shape[1] == 4)
    if normals is not None and normals.ndim == 2:
        made.normals = open3d.utility.Vector3dVector(normals.astype(np.float64))
    return made, [*lost, *table]


def tensors(cloud: Cloud) -> tuple[Any, list[str]]:
    """The `open3d.t.geometry.PointCloud`, with positions of 64 bits, and the names of what it has no place for."""
    open3d = library("open3d")
    made = open3d.t.geometry.PointCloud(open3d.core.Tensor(cloud.points.copy()))
    for name, table in tables(cloud, "colors", "normals").items():
        ready = drawable(table) if name == "colors" else table
        made.point[name] = open3d.core.Tensor(np.ascontiguousarray(ready.reshape(len(cloud), -1)))
    return made, []
