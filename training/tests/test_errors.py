"""What a command cannot use ends it with one line that names it, never with a trace."""

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from densecloud_training.errors import run_command

MODEL = Path(__file__).resolve().parents[2] / "models" / "default"


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    """A folder of files that are none of what the commands read."""
    folder = tmp_path_factory.mktemp("wrong")
    (folder / "text.npz").write_text("no archive\n")
    np.savez(folder / "other.npz", points=np.zeros((3, 3)))
    np.save(folder / "array.npz.npy", np.zeros(3))
    (folder / "checkpoint.pt").write_text("no checkpoint\n")
    torch.save([1, 2], folder / "list.pt")
    (folder / "log.jsonl").write_text("no log\n")
    (folder / "config.toml").write_text("unit = 3\n")
    (folder / "half.toml").write_text("[unit\n")
    (folder / "words.xyz").write_text("a b c\n")
    (folder / "few.xyz").write_text("0 0 0\n1 0 0\n")
    (folder / "empty").mkdir()
    return folder


@pytest.mark.parametrize(
    "arguments, message",
    [
        ("train --data {}/none.npz --out {}/run", "{}/none.npz: No such file"),
        ("train --data {}/text.npz --out {}/run", "text.npz: not a file of prepared clouds"),
        ("train --data {}/other.npz --out {}/run", "other.npz: not a file of prepared clouds"),
        ("train --data {}/array.npz.npy --out {}/run", "array.npz.npy: not a file of prepared clouds"),
        ("train --data {}/none.npz --out {}/run --config nope", "nor one of the package's own: default, paper"),
        ("train --data {}/none.npz --out {}/run --config {}/config.toml", "config.toml: not a config"),
        ("train --data {}/none.npz --out {}/run --config {}/half.toml", "half.toml: not a config"),
        ("train --data {}/none.npz --out {}/run --start-from {}", "checkpoint.pt: not a checkpoint"),
        ("train --data {}/none.npz --out {}/run --start-from {}/list.pt", "list.pt: checkpoint version None"),
        ("export {}/none {}/model", "{}/none: No such file"),
        ("plot {} {}/plot.png", "log.jsonl: not the log of a run"),
        ("prepare {}/none {}/clouds.npz", "{}/none: No such file"),
        ("prepare {}/empty {}/clouds.npz", "empty has no .off or .ply files"),
        ("adapt {}/none.xyz --out {}/model", "{}/none.xyz: No such file"),
        ("adapt {}/few.xyz --out {}/empty", "empty is there already"),
        ("adapt {}/few.xyz --out {}/model --minutes 0", "--minutes 0: must be above 0"),
        ("adapt {}/few.xyz --out {}/model --start-from {}/empty", "{}/empty/checkpoint.pt: No such file"),
        ("cascade {model} {}/words.xyz {}/out.xyz", "words.xyz: not columns of numbers"),
        ("cascade {model} {}/few.xyz {}/out.xyz", "2 points are too few"),
    ],
)
def test_unusable_input(wrong, monkeypatch, arguments, message):
    command, *rest = arguments.replace("{model}", str(MODEL)).replace("{}", str(wrong)).split()
    monkeypatch.setattr(sys, "argv", [command, *rest])
    main = importlib.import_module(f"densecloud_training.{command}").main
    with pytest.raises(SystemExit) as ended:
        run_command(main)
    assert str(ended.value).startswith("failed: ")
    assert message.replace("{}", str(wrong)) in str(ended.value)


def test_scores_of_a_missing_benchmark(wrong):
    command = [sys.executable, "-m", "densecloud_training.score", "peers", "--program", "true"]
    command += ["--benchmark", str(wrong), "--out", str(wrong / "scores")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (1, f"failed: {wrong}/mesh: No such file or directory\n")
