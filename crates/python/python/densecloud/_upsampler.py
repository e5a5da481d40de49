"""Making clouds dense."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from . import _densecloud, _progress, _runtime
from ._cloud import Cloud, CloudLike, Result, read_cloud, result, warn
from ._densecloud import Report
from ._errors import InvalidInputError
from ._options import FileOptions, Making, Options, Reading, pairs, split

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from typing_extensions import Unpack


class Upsampler:
    """A loaded model, and threads to run it on, for many clouds. Any number of threads of Python may share one.

    `model` is the folder of another model than the one inside the package. `threads` is one a processor where nobody
    says. What comes out does not depend on the threads.

    >>> import numpy as np
    >>> upsampler = Upsampler(threads=1)
    >>> grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0), [0.0]), axis=-1).reshape(-1, 3)
    >>> [len(upsampler.upsample(grid * scale, ratio=2)) for scale in (1, 10)]
    [128, 128]

    Raises DensecloudError where ONNX Runtime or the model cannot be loaded.
    """

    def __init__(self, model: str | os.PathLike[str] | None = None, *, threads: int | None = None) -> None:
        if threads is not None and threads < 1:
            raise InvalidInputError(f"threads: {threads} is not a positive whole number")
        folder = None if model is None else os.fspath(model)
        self._inner = _densecloud.Upsampler(_runtime.library(), folder, threads or 0)

    @property
    def model(self) -> str:
        """The model's name."""
        return self._inner.model[0]

    @property
    def model_sha256(self) -> str:
        """The SHA-256 of the model's weights, in hexadecimal digits."""
        return self._inner.model[1]

    @property
    def threads(self) -> int:
        """How many threads it works on."""
        return self._inner.threads

    def upsample(
        self,
        cloud: CloudLike,
        /,
        ratio: float | None = None,
        *,
        colors: ArrayLike | None = None,
        attributes: Mapping[str, ArrayLike] | None = None,
        progress: _progress.ProgressLike = False,
        **options: Unpack[Options],
    ) -> Result:
        """Makes a cloud dense. See `densecloud.upsample`."""
        # All names are known before any file is read.
        pairs(ratio, options, Options)
        making, reading = split(options)
        asked = pairs(ratio, making, Making)
        cloud = as_cloud(cloud, colors, attributes, reading)
        columns = list(cloud._attributes.items())
        with _progress.heard(progress) as hear:
            made = self._inner.upsample(cloud._points, columns, cloud._origin, asked, hear)
        dense = result(made, bool(options.get("confidence")))
        known = set(cloud.warnings)
        warn([told for told in dense.warnings if told not in known])
        return dense

    def upsample_file(
        self,
        source: str | os.PathLike[str],
        target: str | os.PathLike[str],
        /,
        ratio: float | None = None,
        *,
        temp_dir: str | os.PathLike[str] | None = None,
        resume: bool = False,
        progress: _progress.ProgressLike = False,
        **options: Unpack[FileOptions],
    ) -> Report:
        """Makes a file of a file, of any size. See `densecloud.upsample_file`."""
        asked = pairs(ratio, options, FileOptions)
        folder = None if temp_dir is None else os.fspath(temp_dir)
        with _progress.heard(progress) as hear:
            told = _densecloud.upsample_file(
                self._inner, os.fspath(source), os.fspath(target), asked, folder, resume, hear
            )
        warn(told.warnings)
        return told


def as_cloud(
    cloud: CloudLike,
    colors: ArrayLike | None,
    attributes: Mapping[str, ArrayLike] | None,
    reading: Mapping[str, Any],
) -> Cloud:
    """What a caller gives as a cloud."""
    if isinstance(cloud, (str, os.PathLike)):
        cloud = read_cloud(cloud, pairs(None, reading, Reading))
    elif reading:
        raise InvalidInputError(f"{', '.join(reading)}: how a file is read; this is a cloud already")
    if not isinstance(cloud, Cloud):
        return Cloud(cloud, colors=colors, attributes=attributes)
    if colors is not None or attributes is not None:
        raise InvalidInputError("colors and attributes are for arrays; this cloud has its own")
    return cloud


_LOCK = threading.Lock()
_SHARED: list[Upsampler] = []


def shared() -> Upsampler:
    """The one for calls that name none, on all processors; loaded at the first."""
    with _LOCK:
        if not _SHARED:
            _SHARED.append(Upsampler())
        return _SHARED[0]


def upsample(
    cloud: CloudLike,
    /,
    ratio: float | None = None,
    *,
    colors: ArrayLike | None = None,
    attributes: Mapping[str, ArrayLike] | None = None,
    progress: _progress.ProgressLike = False,
    **options: Unpack[Options],
) -> Result:
    """Makes a cloud dense: `ratio` times the points, from 1 to 64, 4 where nobody says.

    `cloud` is an array of N x 3 of any numbers, a structured array or a table with further columns, a `Cloud`, one of
    Open3D, PyVista, trimesh or laspy, or the path of a file. `colors` (N x 3) and `attributes` (by name, N numbers
    each) are carried over to the new points. `options` are those of the program, by the same names:
    `help(densecloud.Options)` has all of them. Instead of a ratio, `points`, `spacing` or `density` say how dense the
    result shall be.

    Points come out in the coordinates of the input, as 64-bit floats: exactly as many as were asked for, but for
    `min_confidence`. The same input, options and seed give the same on any number of threads. Cost: a core makes some
    45,000 points a second, in 250 to 310 bytes of memory a point out.

    `progress` shows a bar on standard error, or is called with what is done, from 0 to 1, and the name of the stage.
    Other threads of Python go on meanwhile, and Ctrl-C stops the work.

    >>> import numpy as np
    >>> x, y = np.meshgrid(np.linspace(0, 1, 10), np.linspace(0, 1, 10))
    >>> sheet = np.stack([x, y, 0.1 * np.sin(6 * x)], axis=-1).reshape(-1, 3)
    >>> dense = upsample(sheet, ratio=4, colors=np.full((100, 3), [200, 100, 50], np.uint8), confidence=True)
    >>> dense.points.shape, dense.colors.dtype, dense.colors[0].tolist()
    ((400, 3), dtype('uint8'), [200, 100, 50])
    >>> bool((dense.confidence >= 0).all() and (dense.confidence <= 1).all())
    True

    Raises InvalidInputError, a ValueError, where the cloud or an option cannot be; MemoryError where the result would
    not fit; OSError for files; DensecloudError where ONNX Runtime fails. What a person should know comes as a
    DensecloudWarning, and is in `warnings` of the result.
    """
    return shared().upsample(cloud, ratio, colors=colors, attributes=attributes, progress=progress, **options)


def upsample_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    /,
    ratio: float | None = None,
    *,
    temp_dir: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: _progress.ProgressLike = False,
    **options: Unpack[FileOptions],
) -> Report:
    """Makes a file of a file, as the program does: the same bytes, of any size.

    A cloud of more than 400,000 points, or than `tile_points`, is worked on in tiles, in memory that does not grow with
    it; they lie in `temp_dir`, else in the system's folder for temporary files. With `resume`, what is done stays there
    where the work is stopped, and the same call goes on with it.

    The format is the one that the name of `target` asks for. The file is there whole or not at all. What comes back
    tells `points_in`, `points_out`, `provenance` and `warnings`; these also come as DensecloudWarning.

    >>> import tempfile
    >>> from densecloud import write
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write(f"{folder}/sparse.ply", [[x, y, 0] for x in range(9) for y in range(9)])
    ...     report = upsample_file(f"{folder}/sparse.ply", f"{folder}/dense.laz", ratio=2)
    >>> report.points_in, report.points_out
    (81, 162)

    Raises what `densecloud.upsample` does.
    """
    return shared().upsample_file(source, target, ratio, temp_dir=temp_dir, resume=resume, progress=progress, **options)
