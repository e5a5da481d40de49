"""Clouds as Python has them: arrays, and what is told of the whole."""

# mypy: disable-error-code="import-not-found, import-untyped"
# pyright: reportMissingImports=false

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Union, overload

import numpy as np

from . import _densecloud, _foreign, _laspy, _open3d, _pyvista, _trimesh
from ._columns import COLORS, NORMALS
from ._errors import DensecloudWarning, InvalidInputError

if TYPE_CHECKING:
    from typing import SupportsIndex, TypeAlias

    import laspy
    import open3d
    import pyvista
    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from ._foreign import ForeignCloud

#: What is taken as a cloud: one of ours, an array, one of another library, or the path of a file.
CloudLike: TypeAlias = "Union[Cloud, ArrayLike, ForeignCloud, str, os.PathLike[str]]"

_PACKAGE = os.path.dirname(__file__)


class Cloud:
    """A point cloud: positions, and numbers of each point.

    `points` is an array of N x 3, in any unit. `colors` is one of N x 3, or of N x 4 with opacity: bytes, 16-bit
    numbers, or floats from 0 to 1. `normals` is one of N x 3. `attributes` has an array of N numbers for each name.

    >>> cloud = Cloud([[0, 0, 0], [1, 0, 0], [0, 1, 0]], attributes={"height": [7.0, 8.0, 9.0]})
    >>> len(cloud)
    3
    >>> cloud[cloud.attributes["height"] > 7.5].points
    array([[1., 0., 0.],
           [0., 1., 0.]])

    A structured array has its coordinates by their names, as a file of it would:

    >>> import numpy as np
    >>> rows = np.zeros(3, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "u2")])
    >>> list(Cloud(rows).attributes)
    ['intensity']
    """

    __slots__ = ("_points", "_attributes", "_origin")

    _points: NDArray[np.float64]
    _attributes: dict[str, NDArray[Any]]
    _origin: _densecloud.Origin

    def __init__(
        self,
        points: ArrayLike | ForeignCloud,
        *,
        colors: ArrayLike | None = None,
        normals: ArrayLike | None = None,
        attributes: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        foreign = _foreign.parts_of(points)
        if foreign is not None:
            self._take(*foreign)
            warn(self.warnings)
        else:
            self._take_array(_array(points))
        for name, column in _columns(colors, normals, attributes):
            if name in self._attributes:
                raise InvalidInputError(f"the cloud has an attribute {name!r} already")
            self._attributes[name] = _numbers(name, column, len(self._points))

    def _take_array(self, array: NDArray[Any]) -> None:
        if array.dtype.names is not None or (array.ndim == 2 and array.shape[1] > 3):
            self._take(*_densecloud.read_bytes(_as_file(array), []))
        else:
            self._take(_positions(array), [], _densecloud.Origin(array.dtype == np.float32))

    def _take(
        self, points: NDArray[np.float64], columns: list[tuple[str, NDArray[Any]]], origin: _densecloud.Origin
    ) -> None:
        self._points, self._origin, self._attributes = points, origin, {}
        for name, column in columns:
            while name in self._attributes:
                name += "_"
            self._attributes[name] = _numbers(name, column, len(points))
        # Its file is named in results that are made of it.
        if origin.sha256 is not None:
            for array in (self._points, *self._attributes.values()):
                array.flags.writeable = False

    @property
    def points(self) -> NDArray[np.float64]:
        """Positions, N x 3, in the units of the input. Those of a file cannot be changed: make another `Cloud`."""
        return self._points

    @property
    def attributes(self) -> Mapping[str, NDArray[Any]]:
        """By its name, what else is known of each point: N numbers."""
        return MappingProxyType(self._attributes)

    @property
    def colors(self) -> NDArray[Any] | None:
        """Red, green and blue, N x 3, in the type and the range of the input; None where there are no colors."""
        return self._stacked(COLORS)

    @property
    def normals(self) -> NDArray[Any] | None:
        """N x 3; None where there are none."""
        return self._stacked(NORMALS)

    def _stacked(self, roles: list[str]) -> NDArray[Any] | None:
        found = self._named(roles)
        return np.stack([self._attributes[name] for name in found], axis=1) if found else None

    def _named(self, roles: list[str]) -> list[str]:
        """The names of the attributes that mean these; none where one is missing."""
        names = list(self._attributes)
        found = [names[place] for place in _densecloud.places(names, roles) if place is not None]
        return found if len(found) == len(roles) else []

    @property
    def format(self) -> str:
        """The format of its file; of arrays, the one that it would have."""
        return self._origin.format

    @property
    def crs(self) -> str | None:
        """The coordinate system, as the file tells it: WKT, or GeoTIFF's keys."""
        return self._origin.crs

    @property
    def comments(self) -> list[str]:
        """The file's comments, a line each."""
        return self._origin.comments

    @property
    def sensor(self) -> tuple[float, float, float] | None:
        """Where the sensor stood, in the file's coordinates."""
        return self._origin.sensor

    @property
    def warnings(self) -> list[str]:
        """What a person should know about how it was read, a sentence each."""
        return self._origin.warnings

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes a file, in the format that its name asks for. See `densecloud.write`."""
        provenance = self.provenance if isinstance(self, Result) else None
        columns = list(self._attributes.items())
        warn(_densecloud.write(os.fspath(path), self._points, columns, self._origin, provenance))

    @overload
    def to_open3d(self, *, tensors: Literal[False] = False) -> open3d.geometry.PointCloud: ...

    @overload
    def to_open3d(self, *, tensors: Literal[True]) -> open3d.t.geometry.PointCloud: ...

    def to_open3d(self, *, tensors: bool = False) -> object:
        """An `open3d.geometry.PointCloud`: points, colors from 0 to 1, normals.

        With `tensors`, an `open3d.t.geometry.PointCloud` (N x 3 positions of 64 bits) that has all attributes.

        What it has no place for is told by a DensecloudWarning. Raises ImportError, with how to install Open3D.
        """
        made, lost = _open3d.tensors(self) if tensors else _open3d.vectors(self)
        self._tell("an Open3D cloud without tensors", lost)
        return made

    def to_pyvista(self) -> pyvista.PolyData:
        """A `pyvista.PolyData` of points (N x 3, 64 bits), with an array for each attribute.

        Colors are `RGB` or `RGBA`, of bytes or from 0 to 1, as `mesh.plot(scalars="RGB", rgb=True)` draws them; normals
        are `Normals`.

        What it has no place for is told by a DensecloudWarning. Raises ImportError, with how to install PyVista.
        """
        self._tell("PyVista", [])
        return _pyvista.points(self)

    def to_trimesh(self) -> trimesh.PointCloud:
        """A `trimesh.PointCloud`: points, colors of bytes, and in its `metadata` the other attributes by their names.

        What it has no place for is told by a DensecloudWarning. Raises ImportError, with how to install trimesh.
        """
        made, lost = _trimesh.points(self)
        self._tell("trimesh", lost)
        return made

    def to_laspy(self) -> laspy.LasData:
        """A `laspy.LasData`: what `write` would put into a LAS file, read from there.

        Coordinates are whole numbers of a scale: that of the LAS file that the cloud came in, else one that is fine for
        its spacing. What LAS has no place for is told by a DensecloudWarning. Raises ImportError, with how to install
        laspy.
        """
        return _laspy.points(self)

    def _tell(self, library: str, lost: list[str]) -> None:
        """Warns of what another library's cloud has no place for."""
        lost = lost + ["the coordinate system"] * (self.crs is not None)
        if lost:
            warn([f"{library} has no place for {', '.join(lost)}"])

    def __len__(self) -> int:
        return len(self._points)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if dtype is None or np.dtype(dtype) == self._points.dtype:
            return self._points.copy() if copy else self._points
        return self._points.astype(dtype)

    def __getitem__(self, rows: slice | SupportsIndex | ArrayLike) -> Cloud:
        """The points of a slice, a mask or indices, as a cloud of its own."""
        chosen = rows if isinstance(rows, slice) else np.atleast_1d(np.asarray(rows))
        cloud = Cloud.__new__(Cloud)
        cloud._points = np.ascontiguousarray(self._points[chosen])
        cloud._attributes = {name: np.ascontiguousarray(column[chosen]) for name, column in self._attributes.items()}
        cloud._origin = self._origin.changed()
        return cloud

    def __repr__(self) -> str:
        names = ", ".join(self._attributes) or "no attributes"
        return f"<{type(self).__name__}: {len(self)} points, {names}>"


class Result(Cloud):
    """A dense cloud: positions, what is known of each point, and how it came about."""

    __slots__ = ("_report", "_confidence")

    _report: _densecloud.Report
    _confidence: str | None

    @property
    def confidence(self) -> NDArray[np.float32] | None:
        """Of each point, from 0 to 1, how likely it lies within one spacing of the surface, where `confidence=True`."""
        return None if self._confidence is None else self._attributes[self._confidence]

    @property
    def source_index(self) -> NDArray[np.uint32] | None:
        """Of each point, the row of the input's point that is nearest, where `source_fields=True`."""
        return self._attributes.get("source_index")

    @property
    def is_generated(self) -> NDArray[np.bool_] | None:
        """Of each point, whether it is new, where `source_fields=True`."""
        generated = self._attributes.get("is_generated")
        return None if generated is None else generated.astype(np.bool_)

    @property
    def warnings(self) -> list[str]:
        """What a person should know about how the cloud was read and made dense, a sentence each."""
        return self._report.warnings

    @property
    def provenance(self) -> str:
        """Which program, model, settings and input made it: what its file has among its comments."""
        return self._report.provenance

    @property
    def points_in(self) -> int:
        """Points in the input, those that are not finite included."""
        return self._report.points_in


def read_cloud(source: str | os.PathLike[str] | bytes, pairs: list[tuple[str, str]]) -> Cloud:
    """Reads a file or its bytes, and warns of what a person should know."""
    if isinstance(source, bytes):
        parts = _densecloud.read_bytes(source, pairs)
    else:
        parts = _densecloud.read(os.fspath(source), pairs)
    cloud = Cloud.__new__(Cloud)
    cloud._take(*parts)
    warn(cloud.warnings)
    return cloud


def result(parts: tuple[Any, Any, _densecloud.Origin, _densecloud.Report], confidence: bool) -> Result:
    """The result that the arrays of an upsampling are."""
    points, columns, origin, report = parts
    made = Result.__new__(Result)
    # No file has it yet.
    made._take(points, columns, origin.changed())
    made._report = report
    # What is added last.
    made._confidence = list(made._attributes)[-1] if confidence else None
    return made


def warn(told: list[str]) -> None:
    """Warns of each sentence, as of whoever called the package."""
    frame, above = sys._getframe(1), 2
    while frame.f_back is not None and os.path.dirname(frame.f_code.co_filename) == _PACKAGE:
        frame, above = frame.f_back, above + 1
    for sentence in told:
        warnings.warn(sentence, DensecloudWarning, stacklevel=above)


def _as_file(array: NDArray[Any]) -> bytes:
    """A table or a structured array as a `.npy` file, which tells what its columns are."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


def _array(points: object) -> NDArray[Any]:
    array = np.asarray(points)
    if array.ndim == 0 and array.dtype == object:
        raise InvalidInputError(f"a {type(points).__name__} is not a cloud: points are an array of N x 3")
    return array


def _positions(array: NDArray[Any]) -> NDArray[np.float64]:
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidInputError(f"points are an array of N x 3, and this one is of {' x '.join(map(str, array.shape))}")
    if array.dtype.kind not in "fiub":
        raise InvalidInputError(f"points are numbers, and these are {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.float64)


def _columns(
    colors: ArrayLike | None, normals: ArrayLike | None, attributes: Mapping[str, ArrayLike] | None
) -> list[tuple[str, NDArray[Any]]]:
    columns = _parts("colors", colors, [*COLORS, "alpha"]) + _parts("normals", normals, NORMALS)
    if attributes is not None and not isinstance(attributes, Mapping):
        raise TypeError("attributes are arrays by their names; how new points come by them is said by `rules`")
    return columns + [(name, np.asarray(column)) for name, column in (attributes or {}).items()]


def _parts(what: str, array: ArrayLike | None, names: list[str]) -> list[tuple[str, NDArray[Any]]]:
    if array is None:
        return []
    table = np.asarray(array)
    if table.ndim != 2 or table.shape[1] not in (3, len(names)):
        raise InvalidInputError(f"{what} are an array of N x 3, and this one is of {' x '.join(map(str, table.shape))}")
    return [(name, table[:, place]) for place, name in enumerate(names[: table.shape[1]])]


def _numbers(name: str, column: NDArray[Any], points: int) -> NDArray[Any]:
    """A column in a type that files have."""
    if column.shape != (points,):
        shape = " x ".join(map(str, column.shape))
        raise InvalidInputError(f"attribute {name!r} has values of {shape}, and there are {points} points")
    if column.dtype == np.bool_:
        column = column.astype(np.uint8)
    elif column.dtype == np.float16:
        column = column.astype(np.float32)
    if column.dtype.kind not in "fiu" or column.dtype.itemsize > 8:
        raise InvalidInputError(f"attribute {name!r} is of {column.dtype}; numbers of up to 64 bits are carried over")
    return np.ascontiguousarray(column, dtype=column.dtype.newbyteorder("="))
