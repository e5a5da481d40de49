"""Synthetic shapes in the prepared form, so that no test needs meshes, a network, or the Rust program."""

import json

import numpy as np
import pytest
import torch

from densecloud_training import clouds
from densecloud_training.clouds import level_size, validation_names


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)
    torch.manual_seed(0)


def ladder(shape: int, levels: int) -> list:
    """Random points on a sphere (shape 0) or an ellipsoid, at each size of the ladder."""
    random = np.random.default_rng(shape)
    axes = np.array([1.0, 1.0 - 0.2 * shape, 1.0 - 0.3 * shape])
    found = []
    for level in range(levels):
        points = random.normal(size=(level_size(level), 3))
        points = points / np.linalg.norm(points, axis=1, keepdims=True) * axes
        found.append(np.round((points + 1) * (65535 / 2)).astype(np.uint16))
    return found


@pytest.fixture(scope="session")
def prepared(tmp_path_factory):
    """A prepared file of two training shapes and one validation shape, up to 5,000 points."""
    path = tmp_path_factory.mktemp("data") / "clouds.npz"
    shapes = [ladder(shape, 4) for shape in range(3)]
    meta = {
        "names": ["ball", "egg", validation_names()[0]],
        "faces": [5000, 20000, 10000],
        "sources": [{"source": "made here", "licence": "CC0"}] * 3,
        "levels": [level_size(level) for level in range(4)],
    }
    arrays = {f"level{k}": np.stack([shape[k] for shape in shapes]) for k in range(4)}
    np.savez(path, meta=json.dumps(meta), **arrays)
    return path


@pytest.fixture
def training(prepared) -> clouds.Clouds:
    return clouds.load(prepared, torch.device("cpu"), held_out=False)
