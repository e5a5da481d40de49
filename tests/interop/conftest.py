"""What the tests against other programs share: the program, and a cloud with everything on it."""

import contextlib
import json
import os
import pathlib
import re
import subprocess
import threading

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
PROGRAM = os.environ.get("DENSECLOUD", str(TARGET / "release" / "densecloud"))


@pytest.fixture
def upsample():
    """Runs `densecloud upsample INPUT OUTPUT ...`; gives what it said on standard error."""

    def run(source, result, *arguments, fails=False):
        command = [PROGRAM, "upsample", str(source), str(result), *map(str, arguments)]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=600)
        assert (done.returncode != 0) == fails, done.stderr
        return done.stderr

    return run


@pytest.fixture
def inspect():
    """Runs `densecloud inspect INPUT ... --json`; gives what it tells."""

    def run(source, *arguments):
        command = [PROGRAM, "inspect", str(source), "--json", *map(str, arguments)]
        return json.loads(subprocess.run(command, check=True, capture_output=True, text=True, timeout=600).stdout)

    return run


@contextlib.contextmanager
def serving(*options, port=0):
    """The address of a `densecloud serve`, on a port that the system chooses or this one, for as long as needed."""
    command = [PROGRAM, "serve", "--port", str(port), *map(str, options)]
    # Its log names the port, and then that it is ready; it is read on so that the pipe stays empty.
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    address = None
    for line in process.stderr:
        if listening := re.search(r"address=(\S+)", line):
            address = listening[1]
        if "ready" in line:
            break
    rest = threading.Thread(target=process.stderr.read, daemon=True)
    rest.start()
    try:
        assert address, "it has started"
        yield address
    finally:
        process.terminate()
        assert process.wait(60) == 0


@pytest.fixture
def sphere():
    """1,500 even points of a sphere of 10 m about a point in UTM coordinates, and their normals."""
    i = np.arange(1500)
    z = 1.0 - (2 * i + 1) / len(i)
    r, angle = np.sqrt(1 - z * z), i * 2.399963229728653
    normals = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    return np.array([465_123.25, 5_204_987.5, 812.125]) + 10 * normals, normals


def assert_on_sphere(points, tolerance=0.15):
    """The points lie on the sphere of `sphere` and cover it."""
    directions = (points - np.array([465_123.25, 5_204_987.5, 812.125])) / 10
    radii = np.linalg.norm(directions, axis=1)
    assert np.abs(radii - 1).max() < tolerance, np.abs(radii - 1).max()
    for axis in range(3):
        assert directions[:, axis].min() < -0.9
        assert directions[:, axis].max() > 0.9
