"""Turns a sparse, noisy 3D point cloud into a dense one: up to 64 times the points.

>>> import densecloud
>>> dense = densecloud.upsample([[x, y, 0] for x in range(8) for y in range(8)], ratio=4)
>>> dense
<Result: 256 points, no attributes>

The model is inside; ONNX Runtime, which computes it, is a package that this one depends on.
"""

from __future__ import annotations

import signal
import sys

from . import _densecloud, _runtime, tiles
from ._cloud import Cloud, CloudLike, Result
from ._densecloud import Report
from ._errors import DensecloudError, DensecloudWarning, InvalidInputError
from ._files import read, write
from ._measures import evaluate, inspect
from ._options import FileOptions, Making, Options, Reading
from ._upsampler import Upsampler, upsample, upsample_file

__version__ = _densecloud.__version__

__all__ = [
    "Cloud",
    "CloudLike",
    "DensecloudError",
    "DensecloudWarning",
    "FileOptions",
    "InvalidInputError",
    "Making",
    "Options",
    "Reading",
    "Report",
    "Result",
    "Upsampler",
    "evaluate",
    "inspect",
    "read",
    "tiles",
    "upsample",
    "upsample_file",
    "write",
]


def _main() -> int:
    """The program: `densecloud` of the package's scripts."""
    # Python's own would wait for the interpreter.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    library, missing = None, ""
    try:
        library = _runtime.library()
    except DensecloudError as why:
        # Most commands go without.
        missing = str(why)
    return _densecloud.program(["densecloud", *sys.argv[1:]], library, missing)
