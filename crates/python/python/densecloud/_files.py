"""Files of all formats that the program knows."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from ._cloud import Cloud, CloudLike, read_cloud
from ._options import Reading, pairs
from ._upsampler import as_cloud

if TYPE_CHECKING:
    from typing import IO

    from typing_extensions import Unpack


def read(source: str | os.PathLike[str] | bytes | IO[bytes], /, **reading: Unpack[Reading]) -> Cloud:
    """Reads a cloud from a path, an open file, or the bytes of one.

    PLY, LAS, LAZ, COPC, E57, PCD, NumPy, COLMAP, PTX, OFF, OBJ, text, and sweeps of lidars. The content tells which;
    where it leaves a doubt, `axes`, `separator`, `decimal` and `format` say how it is to be read. `bounds` takes a part
    of the cloud.

    >>> cloud = read(b"x y z intensity\\n0 0 0 7\\n1 0 0 8\\n")
    >>> cloud.attributes["intensity"].tolist()
    [7, 8]

    Raises InvalidInputError, which names the line and the column of what cannot be understood, and OSError.
    """
    if not isinstance(source, (str, os.PathLike, bytes)):
        source = source.read()
    return read_cloud(source, pairs(None, reading, Reading))


def write(path: str | os.PathLike[str], cloud: CloudLike, /) -> None:
    """Writes a cloud, in the format that the name asks for: .ply, .las, .laz, .copc.laz, .e57, .pcd, .npy, or text.

    The file is there whole or not at all. What the format has no place for is told by a DensecloudWarning; where it has
    none for comments, a result's provenance is written beside it (`.provenance.txt`).

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write(f"{folder}/cloud.ply", [[0, 0, 0], [1, 0, 0]])
    ...     read(f"{folder}/cloud.ply")
    <Cloud: 2 points, no attributes>

    Raises InvalidInputError where the format cannot hold it, and OSError.
    """
    as_cloud(cloud, None, None, {}).write(path)
