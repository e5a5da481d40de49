"""ONNX files: the same function as PyTorch, with the axes and the metadata that the program expects."""

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from densecloud_training import checkpoint as checkpoints
from densecloud_training import config as configs
from densecloud_training.export import export_model, export_units, main
from densecloud_training.network import CHANNELS, Cascade, Previous, normalise
from densecloud_training.train import Trainer


@pytest.fixture(scope="module", params=[(32, "features"), (32, "space"), (16, "space-shared")], ids=lambda p: p[1])
def exported(request, tmp_path_factory):
    torch.manual_seed(1)
    cascade = Cascade(2, *request.param)
    for parameter in cascade.parameters():
        if parameter.dim() == 1:
            torch.nn.init.normal_(parameter, std=0.1)
    folder = tmp_path_factory.mktemp("units")
    return cascade, export_units(cascade, folder)


@pytest.mark.parametrize("level", [1, 2])
def test_runtime_agrees_with_pytorch(exported, level):
    cascade, paths = exported
    session = onnxruntime.InferenceSession(str(paths[level - 1]), providers=["CPUExecutionProvider"])
    for batch, count, rows in [(1, 312, 700), (3, 312, 312), (2, 33, 5), (1, 100, 1)]:
        points = normalise(torch.randn(batch, count, 3))[0]
        feed, previous = {"points": points.numpy()}, None
        if level > 1:
            indices = torch.randint(0, rows, (batch, count, 5))
            previous = Previous(torch.randn(rows, CHANNELS).half().float(), indices, torch.rand(batch, count, 5) * 0.01)
            feed["previous_features"] = previous.features.half().numpy()
            feed["skip_indices"] = indices.numpy()
            feed["skip_distances"] = previous.distances.numpy()
        with torch.no_grad():
            wanted = cascade.units[level - 1](points, previous)
        dense, features = session.run(["dense", "features"], feed)
        assert dense.shape == (batch, 2 * count, 3) and features.shape == (batch, count, CHANNELS)
        # Of two neighbours that are equally near but for rounding each side may take another: that point's features
        # differ then, and through the patch's mean a trace of it is everywhere.
        assert np.quantile(np.abs(dense - wanted.dense.numpy()), 0.98) < 1e-3
        assert np.quantile(np.abs(features - wanted.features.numpy()), 0.98) < 1e-3


def test_runtime_survives_points_that_coincide_with_previous_ones(exported):
    session = onnxruntime.InferenceSession(str(exported[1][1]), providers=["CPUExecutionProvider"])
    feed = {
        "points": np.random.default_rng(0).normal(size=(1, 40, 3)).astype(np.float32),
        "previous_features": np.zeros((40, CHANNELS), np.float16),
        "skip_indices": np.zeros((1, 40, 5), np.int64),
        "skip_distances": np.zeros((1, 40, 5), np.float32),
    }
    assert all(np.isfinite(output).all() for output in session.run(None, feed))


def test_files_say_what_they_are(exported):
    for number, path in enumerate(exported[1], start=1):
        model = onnx.load(str(path))
        found = {entry.key: entry.value for entry in model.metadata_props}
        assert found == {
            "densecloud.unit": str(number),
            "densecloud.k": str(exported[0].units[0].k),
            "densecloud.channels": "264",
            "densecloud.parameters": "76027",
        }
        assert {entry.domain: entry.version for entry in model.opset_import} == {"": 17, "densecloud": 1}
        operators = ["Neighbours", "EdgeBlock"] + ["BilateralSkip"] * (number > 1)
        assert [function.name for function in model.functions] == operators
        wanted = ["points"] if number == 1 else ["points", "previous_features", "skip_indices", "skip_distances"]
        assert [value.name for value in model.graph.input] == wanted
        assert [value.name for value in model.graph.output] == ["dense", "features"]


def test_random_export_depends_on_its_seed_alone(tmp_path):
    for name, seed in [("a", 3), ("b", 3), ("c", 4)]:
        main(["--random", "--levels", "1", "--seed", str(seed), str(tmp_path / name)])
    a, b, c = ((tmp_path / name / "unit1.onnx").read_bytes() for name in "abc")
    assert a == b and a != c


def test_model_folder_of_a_run_that_has_only_begun(training, tmp_path):
    tomllib = pytest.importorskip("tomllib")
    config = configs.load(configs.CONFIGS / "default.toml")
    trainer = Trainer(config, training, None)
    run = tmp_path / "run"
    checkpoints.save(run / checkpoints.FILE, trainer.state())
    export_model(run, tmp_path / "model", "tiny")
    card = tomllib.loads((tmp_path / "model" / "model.toml").read_text())
    assert card["name"] == "tiny" and card["parameters"] == 304_108
    assert [unit["file"] for unit in card["units"]] == [f"unit{n}.onnx" for n in (1, 2, 3, 4)]
    assert card["neighbours"] == 16
    assert card["training"]["trained_units"] == 1 and "copies of unit 1" in card["training"]["note"]
    assert card["data"][0]["licence"] == "CC0" and sorted(card["data"][0]["shapes"]) == ["ball", "egg"]
    cascade, _, trained = checkpoints.load_cascade(tmp_path / "model")
    assert trained == 1
    first, last = cascade.units[0].state_dict(), cascade.units[3].state_dict()
    assert all(torch.equal(first[name], last[name]) for name in first)
