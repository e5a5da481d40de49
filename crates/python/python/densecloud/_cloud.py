"""Clouds as Python has them: arrays, and what is told of the whole."""

from __future__ import annotations

import io
import os
import warnings as _warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from . import _densecloud
from ._errors import DensecloudWarning, InvalidInputError

if TYPE_CHECKING:
    from typing import SupportsIndex, TypeAlias

    from numpy.typing import ArrayLike, NDArray

#: What is taken as a cloud: one of ours, an array, or the path of a file.
CloudLike: TypeAlias = "Union[Cloud, ArrayLike, str, os.PathLike[str]]"

_COLORS = ["red", "green", "blue"]
_NORMALS = ["nx", "ny", "nz"]


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
        points: ArrayLike,
        *,
        colors: ArrayLike | None = None,
        normals: ArrayLike | None = None,
        attributes: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        array = np.asarray(points)
        if array.dtype.names is not None or (array.ndim == 2 and array.shape[1] > 3):
            self._take(*_densecloud.read_bytes(_as_file(array), []))
        else:
            self._points = _positions(array)
            self._attributes = {}
            self._origin = _densecloud.Origin(array.dtype == np.float32)
        for name, column in _columns(colors, normals, attributes):
            if name in self._attributes:
                raise InvalidInputError(f"the cloud has an attribute {name!r} already")
            self._attributes[name] = _numbers(name, column, len(self._points))

    def _take(
        self, points: NDArray[np.float64], columns: list[tuple[str, NDArray[Any]]], origin: _densecloud.Origin
    ) -> None:
        self._points, self._origin, self._attributes = points, origin, {}
        for name, column in columns:
            while name in self._attributes:
                name += "_"
            self._attributes[name] = column

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
        return self._stacked(_COLORS)

    @property
    def normals(self) -> NDArray[Any] | None:
        """N x 3; None where there are none."""
        return self._stacked(_NORMALS)

    def _stacked(self, roles: list[str]) -> NDArray[Any] | None:
        names = list(self._attributes)
        places = _densecloud.places(names, roles)
        found = [self._attributes[names[place]] for place in places if place is not None]
        return np.stack(found, axis=1) if len(found) == len(roles) else None

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
        _write(path, self, stacklevel=3)

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


def read_cloud(source: str | os.PathLike[str] | bytes, pairs: list[tuple[str, str]], stacklevel: int) -> Cloud:
    """Reads a file or its bytes, and warns of what a person should know."""
    if isinstance(source, bytes):
        parts = _densecloud.read_bytes(source, pairs)
    else:
        parts = _densecloud.read(os.fspath(source), pairs)
    cloud = Cloud.__new__(Cloud)
    cloud._take(*parts)
    # Its file is named in results that are made of it.
    for array in (cloud._points, *cloud._attributes.values()):
        array.flags.writeable = False
    warn(cloud.warnings, stacklevel)
    return cloud


def result(parts: tuple[Any, Any, _densecloud.Origin, _densecloud.Report], confidence: bool) -> Result:
    """The result that the arrays of an upsampling are."""
    points, columns, origin, report = parts
    made = Result.__new__(Result)
    made._take(points, columns, origin)
    made._report = report
    # What is added last.
    made._confidence = list(made._attributes)[-1] if confidence else None
    return made


def _write(path: str | os.PathLike[str], cloud: Cloud, stacklevel: int) -> None:
    provenance = cloud.provenance if isinstance(cloud, Result) else None
    columns = list(cloud._attributes.items())
    warn(_densecloud.write(os.fspath(path), cloud._points, columns, cloud._origin, provenance), stacklevel)


def warn(told: list[str], stacklevel: int) -> None:
    """Warns of each sentence, as of the caller that many frames above."""
    for sentence in told:
        _warnings.warn(sentence, DensecloudWarning, stacklevel=stacklevel + 1)


def _as_file(array: NDArray[Any]) -> bytes:
    """A table or a structured array as a `.npy` file, which tells what its columns are."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


def _positions(array: NDArray[Any]) -> NDArray[np.float64]:
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidInputError(f"points are an array of N x 3, and this one is of {' x '.join(map(str, array.shape))}")
    if array.dtype.kind not in "fiub":
        raise InvalidInputError(f"points are numbers, and these are {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.float64)


def _columns(
    colors: ArrayLike | None, normals: ArrayLike | None, attributes: Mapping[str, ArrayLike] | None
) -> list[tuple[str, NDArray[Any]]]:
    columns = _parts("colors", colors, [*_COLORS, "alpha"]) + _parts("normals", normals, _NORMALS)
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
