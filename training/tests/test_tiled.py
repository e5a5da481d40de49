"""The same clouds in one piece and in tiles."""

import numpy as np
import pytest

from densecloud_training.score import tiled
from densecloud_training.score.program import Program
from densecloud_training.score.real import SCANS


def test_each_way_has_its_options_and_no_tile_is_too_small():
    ways = tiled.ways(60_000)
    assert ways["whole"] == ["--tile-points", "60000"]
    assert ways["7 tiles"] == ["--tile-points", "8572"]
    assert ways["60 tiles"] == ["--tile-points", "1000"]
    assert ways["whole, seed 2"][-2:] == ["--seed", "2"]
    assert tiled.ways(3000)["60 tiles"] == ["--tile-points", "1000"]


class Repeating(Program):
    """Gives the input as it is."""

    def run(self, *arguments: object) -> str:
        np.save(arguments[2], np.load(arguments[1]))
        return ""


def test_chosen_scans_are_scored_in_each_way(tmp_path, monkeypatch):
    monkeypatch.setattr(tiled, "SCANNED", (tmp_path.joinpath(SCANS[0].file).stem,))
    for scan in SCANS[:2]:
        (tmp_path / scan.file).write_bytes(b"")
        (tmp_path / "real").mkdir(exist_ok=True)
        points = np.random.default_rng(1).random((400, 3))
        np.save(tmp_path / "real" / f"{(tmp_path / scan.file).stem}.npy", points)
    (tmp_path / "tiles").mkdir()
    rows = tiled.scans(Repeating("none"), [tmp_path], tmp_path)
    assert [row[:2] for row in rows] == [[tiled.SCANNED[0], way] for way in tiled.ways(100)]
    assert all(row[2:] == rows[0][2:] and len(row) == 2 + len(tiled.COLUMNS) for row in rows)
    shapes = [["whole", "1 / 2 / 3", "4", "5", "6", "7"]]
    text = tiled.text(shapes, rows)
    assert "60 tiles" in text and "1 / 2 / 3" in text
    with pytest.raises(ValueError, match="cells"):
        tiled.text([["whole"]], rows)
