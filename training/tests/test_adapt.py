"""Fine-tuning on one's own scan: what is drawn from it, what decides, and what is left behind."""

import random
import tomllib
from pathlib import Path

import numpy as np
import pytest
import torch

from densecloud_training import adapt, own_scan, scan_patches, verdict
from densecloud_training import checkpoint as checkpoints
from densecloud_training import clouds as cloud_sets
from densecloud_training import config as configs
from densecloud_training.errors import InputError
from densecloud_training.export import export_model
from densecloud_training.own_scan import OwnScan
from densecloud_training.patches import Batch
from densecloud_training.scan_patches import Mixed, ScanPatches
from densecloud_training.score.program import Program, ProgramError
from densecloud_training.train import Trainer


def room(points: int = 5_200, seed: int = 0) -> np.ndarray:
    """Random points of a floor and a wall, with noise of a millimetre, far from the origin as maps are."""
    numbers = np.random.default_rng(seed)
    flat = numbers.random((points, 2)) * [4.0, 2.0]
    wall = numbers.random(points) < 0.4
    found = np.stack([flat[:, 0], np.where(wall, 2.0, flat[:, 1]), np.where(wall, flat[:, 1], 0.0)], 1)
    return found + numbers.normal(scale=1e-3, size=found.shape) + [5e5, 4e6, 100.0]


def grid(lines: int = 80, places: int = 80) -> OwnScan:
    """A scan in lines, each the same distance from the next, denser along than across."""
    line, place = (axis.ravel() for axis in np.mgrid[:lines, :places])
    points = np.stack([line * 0.1, place * 0.04, 0.02 * np.sin(line * 0.3)], 1)
    return OwnScan("grid", points, np.stack([line, place], 1))


@pytest.mark.parametrize(
    "points, message",
    [
        (np.zeros((1, 3)), "all points are the same one"),
        (room(4_999), "4,999 distinct points; adapting needs 5,000"),
        (np.outer(np.arange(6_000), [1.0, 2.0, 3.0]) + 5e5, "all points lie on a line"),
        (np.random.default_rng(0).random((6_000, 3)), "no surface around 100 %"),
    ],
)
def test_a_scan_that_teaches_nothing_is_refused(points, message):
    with pytest.raises(InputError, match=f"scan.ply: .*{message}"):
        own_scan.check(OwnScan("scan", points), Path("scan.ply"))


def test_a_scan_of_surface_is_not_refused():
    own_scan.check(OwnScan("room", room()), Path("room.ply"))


def test_lines_and_places_are_counted_from_0():
    ring = np.repeat([7.0, 3.0, 5.0, 9.0], 3)
    column = np.tile([10, 30, 20], 4)
    found = own_scan.scan_lines({"x": ring, "ring": ring, "column": column})
    assert found.tolist() == [[line, place] for line in (2, 0, 1, 3) for place in (0, 2, 1)]


def test_without_a_column_the_order_in_the_file_tells_the_place():
    ring = np.array([0, 1, 2, 3, 1, 0, 0, 3, 2])
    assert own_scan.scan_lines({"ring": ring})[:, 1].tolist() == [0, 0, 0, 0, 1, 1, 2, 1, 1]


@pytest.mark.parametrize("table", [{}, {"ring": np.zeros(9)}, {"ring": np.arange(9)}, {"column": np.arange(9)}])
def test_what_tells_no_lines_gives_none(table):
    assert own_scan.scan_lines(table) is None


def test_what_is_held_out_lies_beyond_a_plane():
    scan = OwnScan("room", room())
    learned, held_out = own_scan.divide(scan)
    assert len(held_out.points) == 1_300 and len(learned.points) == 3_900
    assert len(np.unique(np.concatenate([learned.points, held_out.points]), axis=0)) == 5_200
    # Some direction has all of one part before all of the other.
    apart = held_out.points.mean(0) - learned.points.mean(0)
    centred = scan.points - scan.points.mean(0)
    axes = np.linalg.eigh(centred.T @ centred)[1].T
    axis = max((sign * axis for axis in axes for sign in (1, -1)), key=lambda axis: axis @ apart)
    assert (learned.points @ axis).max() <= (held_out.points @ axis).min()


def test_of_a_large_scan_less_is_held_out_and_all_the_rest_is_learned_from(monkeypatch):
    monkeypatch.setattr(own_scan, "MOST_HELD_OUT", 500)
    learned, held_out = own_scan.divide(OwnScan("room", room()))
    assert len(held_out.points) == 500 and len(learned.points) == 3_900


def test_lines_stay_with_their_points():
    learned, held_out = own_scan.divide(grid())
    for part in (learned, held_out):
        assert np.array_equal(part.points[:, 0], part.lines[:, 0] * 0.1)


@pytest.mark.parametrize("lines", [0.0, 1.0])
@pytest.mark.parametrize("depth", [1, 2, 3])
def test_the_target_is_what_was_taken_away(lines, depth):
    scan = grid()
    source = ScanPatches([scan], 40, 1.3, lines=lines)
    given, taken, reach = source.pair(0, depth)
    wanted = int(40 * (2**depth - 1) * 1.3)
    assert given.shape == (40, 3) and taken.shape == (wanted, 3)
    assert np.linalg.norm(given, axis=1).max() == pytest.approx(1)
    assert np.linalg.norm(given, axis=1).min() == 0
    assert np.linalg.norm(taken, axis=1).max() == pytest.approx(float(reach))
    assert len(np.unique(np.concatenate([given, taken]).round(9), axis=0)) == 40 + wanted
    # As dense as the scan: the target surrounds the input.
    assert reach > 0.9


def test_every_second_line_and_place_is_kept():
    source = ScanPatches([grid()], 40, 1.3, lines=1.0)
    near = source.trees[0].query(source.scans[0].points[3_240], 200)[1]
    kept = source.kept_lines(source.scans[0].lines, near, 3_240, 2)
    found = source.scans[0].lines[near[kept]]
    assert len(np.unique(found % 2, axis=0)) == 1 and 40 <= len(found) <= 60
    assert len(np.unique(source.scans[0].lines[near[~kept]] % 2, axis=0)) == 3


def test_batches_are_drawn_as_deep_as_the_scan_allows():
    assert [scan_patches.deepest(points, 312) for points in (1_800, 1_872, 3_744, 7_488, 20_000)] == [0, 1, 2, 3, 4]
    small, large = OwnScan("small", room(480)), OwnScan("large", room(2_000))
    source = ScanPatches([small, large], 40, 1.3)
    assert source.depths == [2, 4] and source.levels == 4
    for levels in (1, 4):
        batch = source.draw(levels, 3)
        assert batch.points.shape == (3, 40, 3) and batch.points.dtype == torch.float32
        assert batch.reference.shape[1] >= 40 * (2**levels - 1)
        assert torch.allclose(batch.reference.norm(dim=-1).max(1, keepdim=True)[0], batch.reference_radius, rtol=1e-5)


def test_the_same_seed_draws_the_same_batches():
    batches = []
    for seed in (1, 1, 2):
        torch.manual_seed(0)
        batches.append(ScanPatches([OwnScan("room", room())], 40, 1.3, seed).draw(2, 2).points)
    assert torch.equal(batches[0], batches[1]) and not torch.equal(batches[0], batches[2])


def test_a_mix_takes_batches_of_both():
    class Fixed:
        def __init__(self, value):
            self.value = value

        def draw(self, levels, batch):
            return Batch(*[torch.full((batch, 1), self.value)] * 4)

    mixed = Mixed(Fixed(0.0), Fixed(1.0), 0.25, random.Random(0))
    drawn = np.array([float(mixed.draw(1, 1).points) for _ in range(400)])
    assert set(drawn) == {0.0, 1.0} and 0.2 < drawn.mean() < 0.3


def scores(*distances: float) -> list:
    return [{"CDH": distance, **{name: 0.0 for name in verdict.COLUMNS[1:]}} for distance in distances]


@pytest.mark.parametrize(
    "after, better",
    [
        ((1.9, 1.9, 1.9), True),
        ((1.99, 1.99, 1.99), False),  # half a percent, however sure
        ((1.6, 1.8, 2.1), False),  # 8 percent, less than twice its error
        ((2.1, 2.1, 2.1), False),
    ],
)
def test_only_what_is_more_than_chance_is_better(after, better):
    found = verdict.Verdict(scores(2.0, 2.0, 2.0), scores(*after))
    assert found.better is better
    assert ("are kept" in str(found)) is better and ("stay as they were" in str(found)) is not better


class Pretended(Program):
    """Stands in for the program: adds points beside those of the input, the nearer the better its model is said to
    be."""

    errors = {"base": 0.2, "model": 0.2}

    def run(self, *arguments: object) -> str:
        _, given, made, *options = map(str, arguments)
        points = np.load(given) if given.endswith(".npy") else np.loadtxt(given)
        if "--model" in options:
            off = self.errors[Path(options[options.index("--model") + 1]).name]
            points = np.concatenate([points] * 4) + np.random.default_rng(0).normal(
                scale=off, size=(4 * len(points), 3)
            )
        np.save(made, points)
        return ""


@pytest.fixture
def base(tmp_path):
    """A model folder with four units that have seen nothing."""
    none = cloud_sets.Clouds(["ball"], [{"source": "here", "licence": "CC0"}], [], torch.ones(1), torch.ones(1))
    trainer = Trainer(configs.load(configs.CONFIGS / "default.toml"), none, None)
    checkpoints.save(tmp_path / "run" / checkpoints.FILE, trainer.state())
    export_model(tmp_path / "run", tmp_path / "base", "base")
    return tmp_path / "base"


@pytest.fixture
def scan(tmp_path):
    """A file of a scan."""
    np.savetxt(tmp_path / "mine.xyz", room(), fmt="%.17g")
    return tmp_path / "mine.xyz"


def adapted(monkeypatch, scan: Path, base: Path, out: Path, errors: dict, *more: str) -> dict:
    """Runs the command with a pretended program; returns the card of what it wrote."""
    monkeypatch.setattr(adapt, "Program", Pretended)
    monkeypatch.setattr(adapt, "find_program", lambda given: "densecloud")
    monkeypatch.setattr(Pretended, "errors", errors)
    adapt.main([str(scan), "--out", str(out), "--start-from", str(base), "--minutes", "0.01", "--threads", "1", *more])
    return tomllib.loads((out / "model.toml").read_text())


def test_better_weights_are_kept(monkeypatch, capsys, scan, base, tmp_path):
    out = tmp_path / "models" / "mine"
    card = adapted(monkeypatch, scan, base, out, {"base": 0.2, "model": 0.1})
    assert "the adapted weights are kept" in capsys.readouterr().out
    assert card["name"] == "adapted to mine" and card["adaptations"][0]["kept"] is True
    assert card["adaptations"][0]["scans"] == ["mine"] and card["adaptations"][0]["gain"]["mean"] > 0.1
    assert {shape for data in card["data"] for shape in data["shapes"]} == {"ball", "mine"}
    assert [path.name for path in out.parent.iterdir()] == ["mine"]
    for unit in ("unit1.onnx", "unit2.onnx"):
        assert (out / unit).read_bytes() != (base / unit).read_bytes()


def test_a_model_can_be_adapted_again(monkeypatch, scan, base, tmp_path):
    errors = {"base": 0.2, "first": 0.1, "model": 0.05}
    first = adapted(monkeypatch, scan, base, tmp_path / "first", errors)
    again = adapted(monkeypatch, scan, tmp_path / "first", tmp_path / "again", errors)
    assert again["training"]["steps"] > first["training"]["steps"] > 0
    assert len(again["training"]["stages"]) == 2


def test_what_gains_nothing_leaves_the_weights_as_they_were(monkeypatch, capsys, scan, base, tmp_path):
    card = adapted(monkeypatch, scan, base, tmp_path / "mine", {"base": 0.2, "model": 0.2})
    assert "stay as they were" in capsys.readouterr().out
    assert card["name"] == "base" and card["adaptations"][0]["kept"] is False
    for unit in card["units"]:
        assert (tmp_path / "mine" / unit["file"]).read_bytes() == (base / unit["file"]).read_bytes()


def test_only_the_unit_of_4x_learns_if_asked(monkeypatch, scan, base, tmp_path):
    adapted(monkeypatch, scan, base, tmp_path / "mine", {"base": 0.2, "model": 0.1}, "--units", "last")
    changed = [
        (tmp_path / "mine" / f"unit{n}.onnx").read_bytes() != (base / f"unit{n}.onnx").read_bytes()
        for n in (1, 2, 3, 4)
    ]
    assert changed == [False, True, False, False]


def test_batches_of_meshes_are_mixed_in_if_asked(prepared):
    config = configs.load(configs.CONFIGS / "default.toml")
    own = ScanPatches([OwnScan("room", room())], config.patch, config.data.reference_margin)
    source = adapt.with_meshes(own, config, prepared)
    # A mesh's target is four times as dense as the prediction, and far from a scan's in number.
    sizes = {source.draw(1, 2).reference.shape[1] for _ in range(12)}
    meshes = {int(config.patch * 2**level * config.data.reference_margin) for level in (1, 2, 3)}
    assert sizes & meshes and sizes - meshes


def test_a_failure_leaves_nothing_behind(monkeypatch, scan, base, tmp_path):
    def fail(self, *arguments):
        raise ProgramError("it failed")

    monkeypatch.setattr(Pretended, "run", fail)
    with pytest.raises(ProgramError):
        adapted(monkeypatch, scan, base, tmp_path / "models" / "mine", {})
    assert list((tmp_path / "models").iterdir()) == []


@pytest.mark.parametrize(
    "minutes, spent, measuring, left",
    [(20, 100, 60, 1200 - 100 - 78), (1, 100, 60, 15)],
)
def test_the_time_is_for_all_of_it(minutes, spent, measuring, left):
    assert adapt.training_time(60 * minutes, spent, measuring) == pytest.approx(left)
