"""What the tests of the package share: clouds, and the program."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("DENSECLOUD", str(Path(sys.executable).parent / "densecloud"))


def sphere(points: int) -> np.ndarray:
    """Even points of a sphere of 10 m about a point in UTM coordinates."""
    i = np.arange(points)
    z = 1.0 - (2 * i + 1) / points
    r, angle = np.sqrt(1 - z * z), i * 2.399963229728653
    return np.array([465_123.25, 5_204_987.5, 812.125]) + 10 * np.stack(
        [r * np.cos(angle), r * np.sin(angle), z], axis=1
    )


#: Whose clouds are taken and given, and whose cluster makes tiles.
LIBRARIES = ["open3d", "pyvista", "trimesh", "laspy", "dask"]


def library(name):
    """Another library: a missing one is a failure, but for those that DENSECLOUD_WITHOUT says have no wheel here."""
    if name in os.environ.get("DENSECLOUD_WITHOUT", "").split():
        pytest.skip(f"{name} has no wheel for this Python")
    return importlib.import_module(name)


@pytest.fixture
def densecloud_program():
    """Runs the program; gives what it printed."""

    def run(*arguments, code=0):
        command = [PROGRAM, *map(str, arguments)]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=600)
        assert done.returncode == code, done.stderr
        return done.stdout if code == 0 else done.stderr

    return run
