"""Clouds of other libraries. None is loaded but by whoever has a cloud of it, or asks for one."""

# mypy: disable-error-code="import-not-found, import-untyped"
# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _laspy, _open3d, _pyvista, _trimesh

if TYPE_CHECKING:
    from typing import TypeAlias, Union

    import laspy
    import open3d
    import pyvista
    import trimesh

    from ._columns import Parts

    #: Clouds of other libraries that are taken.
    ForeignCloud: TypeAlias = Union[
        laspy.LasData,
        open3d.geometry.PointCloud,
        open3d.t.geometry.PointCloud,
        pyvista.PointSet,
        pyvista.PolyData,
        trimesh.PointCloud,
    ]

_LIBRARIES: dict[str, Callable[[Any], Parts | None]] = {
    "laspy": _laspy.parts_of,
    "open3d": _open3d.parts_of,
    "pyvista": _pyvista.parts_of,
    "trimesh": _trimesh.parts_of,
}


def parts_of(thing: object) -> Parts | None:
    """What a cloud of another library has; None where it is none.

    Raises InvalidInputError for what is such a library's, but no cloud.
    """
    # Their arrays are of classes of their own.
    if isinstance(thing, np.ndarray):
        return None
    for kind in type(thing).__mro__:
        parts = _LIBRARIES.get(kind.__module__.partition(".")[0])
        if parts is not None:
            return parts(thing)
    return None
