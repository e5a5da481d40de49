"""Clouds of laspy, by the bytes of a LAS file: with its scales and offsets, its records and its extra dimensions.

>>> import laspy, numpy as np, densecloud
>>> las = laspy.create(point_format=6, file_version="1.4")
>>> las.xyz = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0), [0.0]), axis=-1).reshape(-1, 3)
>>> las.classification[:] = 2
>>> dense = densecloud.upsample(las, ratio=4).to_laspy()
>>> len(dense.points), dense.header.point_format.id, set(dense.classification.tolist())
(400, 6, {2})
"""

# mypy: disable-error-code="import-not-found, import-untyped"
# pyright: reportMissingImports=false

from __future__ import annotations

import copy
import io
import os
import tempfile
from typing import TYPE_CHECKING, Any

from . import _densecloud
from ._columns import library
from ._errors import InvalidInputError

if TYPE_CHECKING:
    from ._cloud import Cloud
    from ._columns import Parts


def parts_of(las: Any) -> Parts | None:
    """What a `LasData` has."""
    import laspy

    if isinstance(las, (laspy.LasReader, laspy.PackedPointRecord, laspy.LasHeader)):
        raise InvalidInputError(f"a {type(las).__name__} is not a cloud: give the LasData that `laspy.read` gives")
    if not isinstance(las, laspy.LasData):
        return None
    file = io.BytesIO()
    try:
        _without_index(las).write(file, do_compress=False)
    except (laspy.errors.LaspyException, NotImplementedError) as why:
        # It reads more versions than it writes.
        raise InvalidInputError(
            f"laspy writes no file of this LasData ({type(why).__name__}: {why}); `densecloud.read` reads its file"
        ) from why
    return _densecloud.read_bytes(file.getvalue(), [])


def _without_index(las: Any) -> Any:
    """The same without COPC's records, which are of the order in a file, and which laspy does not write."""
    if all(record.user_id != "copc" for record in las.vlrs):
        return las
    header = copy.deepcopy(las.header)
    header.vlrs[:] = [record for record in header.vlrs if record.user_id != "copc"]
    if header.evlrs is not None:
        header.evlrs[:] = [record for record in header.evlrs if record.user_id != "copc"]
    return type(las)(header, las.points)


def points(cloud: Cloud) -> Any:
    """The `LasData` of the file that the cloud would be written to."""
    laspy = library("laspy")
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "cloud.las")
        cloud.write(path)
        return laspy.read(path)
