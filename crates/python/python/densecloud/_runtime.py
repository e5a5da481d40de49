"""Where ONNX Runtime's library lies: in the package of that name, without importing it."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import re
import sys
from pathlib import Path

from ._errors import DensecloudError

#: The oldest version that has what is asked of it.
OLDEST = (1, 24)

_INSTALL = f'pip install "onnxruntime>={OLDEST[0]}.{OLDEST[1]}"'


def library() -> Path:
    """The path of ONNX Runtime's library; ORT_DYLIB_PATH names another.

    Raises DensecloudError, which says what to install, where there is none or it is too old.
    """
    if named := os.environ.get("ORT_DYLIB_PATH"):
        return Path(named)
    found = next(iter(_libraries()), None)
    if found is None:
        raise DensecloudError(f"ONNX Runtime is missing: {_INSTALL}")
    version = _version(found)
    if version and version < OLDEST:
        told = ".".join(map(str, version))
        raise DensecloudError(f"ONNX Runtime {told} is too old: {_INSTALL} ({found})")
    return found


def _libraries() -> list[Path]:
    spec = importlib.util.find_spec("onnxruntime")
    folders = (spec.submodule_search_locations if spec else None) or []
    return [path for folder in folders for path in sorted(Path(folder, "capi").glob(_pattern()))]


def _pattern() -> str:
    if sys.platform == "win32":
        return "onnxruntime.dll"
    # The name of the providers' own library has no dot there.
    return "libonnxruntime.*dylib" if sys.platform == "darwin" else "libonnxruntime.so*"


def _version(path: Path) -> tuple[int, ...] | None:
    """As the file's name has it, else the package's."""
    told = re.search(r"(\d+\.\d+(\.\d+)*)", path.name)
    try:
        text = told[1] if told else importlib.metadata.version("onnxruntime")
    except importlib.metadata.PackageNotFoundError:
        return None
    return tuple(int(part) for part in re.findall(r"\d+", text)[:3])
