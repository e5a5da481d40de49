"""The steps of a large work one by one, for many processes or machines that share a folder.

>>> import densecloud, tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     densecloud.write(f"{folder}/scan.ply", [[x, y, 0] for x in range(50) for y in range(50)])
...     tiling = plan(f"{folder}/scan.ply", f"{folder}/work", output="dense.laz", ratio=2, tile_points=1000)
...     parts = [tiling.run(tile) for tile in tiling.not_done()]
...     report = tiling.join(f"{folder}/dense.laz")
>>> sum(parts), report.points_out
(5000, 5000)
"""

from __future__ import annotations

import functools
import os
from concurrent.futures import as_completed
from typing import TYPE_CHECKING

from . import _densecloud, _progress
from ._cloud import warn
from ._densecloud import Report
from ._options import FileOptions, pairs
from ._upsampler import Upsampler, shared

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from typing_extensions import Unpack

__all__ = ["Report", "Tiling", "load", "plan"]


class Tiling:
    """A cloud that is cut into tiles, numbered from 0, in a folder.

    Each is run alone, in any order and by any number of processes at once; run again, it gives the same. `plan` makes
    one, `load` finds one that another process has made.
    """

    def __init__(self, inner: _densecloud.Tiling) -> None:
        self._inner = inner

    def __len__(self) -> int:
        return len(self._inner)

    def __repr__(self) -> str:
        return f"<Tiling: {len(self)} tiles in {self.folder}>"

    @property
    def folder(self) -> str:
        """Where the tiles lie."""
        return os.fspath(self._inner.folder)

    @property
    def report(self) -> Report:
        """What is told of the result, as far as it is known."""
        return self._inner.report

    def points(self, tile: int) -> tuple[int, int, int]:
        """Points of the input, a tile's own and around it, and of its part of the result."""
        own, around, made = self._inner.points(tile)
        return own, around, made

    def not_done(self) -> list[int]:
        """The numbers of the tiles that are not done."""
        return self._inner.not_done()

    def run(self, tile: int, /, *, upsampler: Upsampler | None = None, progress: _progress.ProgressLike = False) -> int:
        """Makes the part of one tile, and gives the points of it.

        Raises InvalidInputError for a tile that there is not, or that cannot be worked on; DensecloudError where the
        tiles are planned for another model or by another version.
        """
        with _progress.heard(progress) as hear:
            return self._inner.run((upsampler or shared())._inner, tile, hear)

    def run_all(
        self,
        executor: Executor,
        /,
        *,
        threads: int = 1,
        model: str | os.PathLike[str] | None = None,
        progress: _progress.ProgressLike = False,
    ) -> None:
        """Makes the parts of all tiles that are not done, on the processes or machines of an executor.

        That is a `concurrent.futures.Executor`: `ProcessPoolExecutor` with the context "spawn", Dask's
        `client.get_executor(retries=3)`, `mpi4py.futures.MPIPoolExecutor`. Its workers see `folder` by the same path,
        and have this package. `threads` is how many each tile is made on; `model` is the folder of the model that the
        tiles are planned for, where it is not the one of the package. What comes out depends on none of it.

        What fails in a worker is raised here, and the tiles that no worker has begun are cancelled; the parts that are
        done stay, and the next call makes the others.
        """
        folder, chosen = os.path.abspath(self.folder), None if model is None else os.path.abspath(model)
        futures = [executor.submit(_run, folder, tile, chosen, threads) for tile in self.not_done()]
        try:
            with _progress.heard(progress) as hear:
                for done, future in enumerate(as_completed(futures), 1):
                    future.result()
                    if hear is not None:
                        hear(done / len(futures), "tiles")
        finally:
            for future in futures:
                future.cancel()

    def join(self, target: str | os.PathLike[str], /) -> Report:
        """Writes the parts of all tiles into one file, in the format that they are planned for.

        Raises DensecloudError, which names the tiles that are not done.
        """
        told = self._inner.join(os.fspath(target))
        warn(told.warnings[len(self.report.warnings) :])
        return told

    def remove(self) -> None:
        """Removes the plan and all parts; what else lies in the folder stays."""
        self._inner.remove()


def plan(
    source: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    /,
    ratio: float | None = None,
    *,
    output: str | os.PathLike[str] | None = None,
    upsampler: Upsampler | None = None,
    **options: Unpack[FileOptions],
) -> Tiling:
    """Cuts the cloud of a file into tiles, in a new or empty folder.

    `output` is the name that the result will have, for its format; without it, the input's. Options are those of
    `densecloud.upsample_file`; `tile_points` says how many points a tile has, about.

    Raises InvalidInputError, OSError.
    """
    asked = pairs(ratio, options, FileOptions)
    name = None if output is None else os.fspath(output)
    inner = (upsampler or shared())._inner
    made = _densecloud.plan(inner, os.fspath(source), os.fspath(folder), name, asked)
    warn(made.report.warnings)
    return Tiling(made)


def load(folder: str | os.PathLike[str], /) -> Tiling:
    """What was planned in a folder, by whichever process.

    Raises DensecloudError where it is broken, and OSError where there is none.
    """
    return Tiling(_densecloud.load(os.fspath(folder)))


def _run(folder: str, tile: int, model: str | None, threads: int) -> int:
    """Makes the part of one tile, in whichever process."""
    return load(folder).run(tile, upsampler=_upsampler(model, threads))


@functools.lru_cache(maxsize=1)
def _upsampler(model: str | None, threads: int) -> Upsampler:
    """The one of this process: a model is loaded once."""
    return Upsampler(model, threads=threads)
