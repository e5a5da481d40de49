"""Clouds of PyVista: points with arrays.

>>> import pyvista, numpy as np, densecloud
>>> cloud = pyvista.PolyData(np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0), [0.0]), axis=-1).reshape(-1, 3))
>>> cloud["height"] = cloud.points[:, 2]
>>> dense = densecloud.upsample(cloud, ratio=4).to_pyvista()
>>> dense.n_points, dense.array_names
(400, ['height'])
"""

# mypy: disable-error-code="import-not-found, import-untyped"
# pyright: reportMissingImports=false

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ._columns import Taken, drawable, library, tables
from ._errors import InvalidInputError

if TYPE_CHECKING:
    import pyvista

    from ._cloud import Cloud
    from ._columns import Parts


def parts_of(cloud: Any) -> Parts | None:
    """What a `PointSet` or a `PolyData` of points has."""
    import pyvista

    if not isinstance(cloud, pyvista.DataObject):
        return None
    if not isinstance(cloud, (pyvista.PointSet, pyvista.PolyData)) or _has_cells(cloud):
        raise InvalidInputError(
            f"a {type(cloud).__name__} with cells is not a cloud: `pyvista.PolyData(mesh.points)` has its points"
        )
    taken = Taken()
    for name, array in cloud.point_data.items():
        taken.add(name, array)
    for what, arrays in [("cell data", cloud.cell_data), ("field data", cloud.field_data)]:
        taken.lose(*(f"{what} {name}" for name in arrays))
    return taken.parts(cloud.points)


def _has_cells(cloud: Any) -> bool:
    """Whether it is more than points and a vertex at each."""
    return bool(cloud.n_cells != getattr(cloud, "n_verts", 0))


def points(cloud: Cloud) -> pyvista.PolyData:
    """The `PolyData`, with coordinates of 64 bits."""
    made: pyvista.PolyData = library("pyvista").PolyData(cloud.points.copy())
    for name, table in tables(cloud, "RGB", "Normals").items():
        if name == "RGB" and table.ndim == 2:
            made.point_data["RGBA" if table.shape[1] == 4 else name] = drawable(table)
        else:
            made.point_data[name] = table
    return made
