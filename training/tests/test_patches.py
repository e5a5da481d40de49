"""What a patch holds: each way to sample, what a sensor does to it, and that none of it reaches the reference."""

import random

import pytest
import torch

from densecloud_training import clouds as cloud_sets
from densecloud_training import patches
from densecloud_training.config import Config, Data
from densecloud_training.faults import noised, outliers, quantised, without_holes
from densecloud_training.levels import run_levels
from densecloud_training.network import Cascade
from densecloud_training.patches import PatchSource
from densecloud_training.sampling import KINDS, thin_lines, thin_range
from densecloud_training.thin import ThinPlaces, thickness
from densecloud_training.validation import Validation


def plane(points: int = 20_000) -> torch.Tensor:
    """[1,n,3]: a square of 4 by 4 radii, evenly strewn."""
    flat = 4 * torch.rand(1, points, 2) - 2
    return torch.cat([flat, torch.zeros(1, points, 1)], -1)


def draw(training, levels: int = 1, **settings):
    """A batch of three patches of 40 points, always the same of the same settings."""
    torch.manual_seed(3)
    data = Data(windows=[1.0], scale=[1.0, 1.0], reference_margin=1.3, **{"noise_share": 0.0, **settings})
    return PatchSource(training, data, 40, random.Random(0)).draw(levels, 3)


def test_lines_are_denser_along_than_across():
    cloud = plane()
    points = cloud[0][thin_lines(cloud, 1.0)[0]]
    assert len(points) > 50
    # Across the lines nearly all is empty; in the worst case lines lie flat on the plane's own direction.
    widest = [torch.histc(points @ way, 200, -3, 3).eq(0).float().mean() for way in ways_in_plane()]
    assert max(widest) > 0.4


def ways_in_plane():
    angles = torch.linspace(0, torch.pi, 181)
    return torch.stack([angles.cos(), angles.sin(), torch.zeros(181)], 1)


def test_density_falls_with_range():
    cloud = plane()
    kept = thin_range(cloud, 0.2)[0]
    centre = cloud[0][kept].mean(0)
    # All directions of a sensor but that straight above give a plane a side that is nearer.
    assert 0.05 < kept.float().mean() < 0.6 and centre.norm() > 0.05


def test_a_sensor_that_sees_too_little_is_replaced(training, monkeypatch):
    monkeypatch.setitem(KINDS, "random", lambda offsets, share: torch.zeros(offsets.shape[:2], dtype=torch.bool))
    batch = draw(training, kinds={"random": 1.0})
    assert all(len(torch.unique(points, dim=0)) == 40 for points in batch.points)
    assert batch.points.norm(dim=-1).max(1)[0] == pytest.approx(torch.ones(3), abs=1e-4)


def test_holes_are_in_the_input_alone(training):
    whole, holed = draw(training), draw(training, holes_share=1.0, holes_most=0.6)
    reach = [batch.points[0].norm(dim=-1).max() for batch in (whole, holed)]
    assert reach == pytest.approx([1.0, 1.0], abs=1e-4)

    def widest(batch):
        near = batch.reference.norm(dim=-1) < 0.7
        return (torch.cdist(batch.reference, batch.points).min(2)[0] * near).max(1)[0].mean()

    assert widest(holed) > 1.2 * widest(whole)


def test_holes_are_balls():
    offsets = plane()
    kept = torch.ones(1, offsets.shape[1], dtype=torch.bool)
    without_holes(kept, offsets, torch.arange(1), 0.2)
    gone = offsets[0][~kept[0]]
    assert len(gone) > 0 and gone.norm(dim=-1).max() < 0.8 + 0.2
    untouched = torch.ones(1, offsets.shape[1], dtype=torch.bool)
    without_holes(untouched, offsets, torch.arange(0), 0.2)
    assert untouched.all()


def test_a_cut_ends_input_and_reference_alike(training, monkeypatch):
    source = PatchSource(training, Data(cut_share=1.0), 40, random.Random(0))
    monkeypatch.setattr(patches, "directions", lambda count, device: torch.eye(3)[:1].expand(count, 3).unsqueeze(-1))
    offsets, dense = plane(2000), plane(4000)
    kept = torch.ones(1, 2000, dtype=torch.bool)
    left = source.cut(kept, offsets, dense, 100)
    border = offsets[0][kept[0]][:, 0].max()
    assert 0 <= border <= patches.MOST_CUT_AT
    assert torch.equal(kept, offsets[..., 0] <= border)
    assert abs(dense[0][left[0]][:, 0].max() - border) < 0.05


def test_what_a_cut_leaves_too_little_of_stays_whole(training):
    source = PatchSource(training, Data(cut_share=1.0), 1990, random.Random(0))
    kept = torch.ones(1, 2000, dtype=torch.bool)
    assert source.cut(kept, plane(2000), plane(4000), 100).all() and kept.all()


def test_jitter_moves_the_centre_off_the_input(training):
    assert draw(training).points.norm(dim=-1).min(1)[0].max() == 0
    moved = draw(training, seed_jitter=0.1)
    assert moved.points.norm(dim=-1).min(1)[0].min() > 0
    assert moved.points.norm(dim=-1).max(1)[0] == pytest.approx(torch.ones(3), abs=1e-4)


def test_depth_comes_in_steps_along_one_direction():
    points = plane(300) @ patches.random_rotations(1, torch.device("cpu"))
    shift = quantised(points, torch.ones(1, 1, 1), 1.0, 0.1) - points
    assert 0 < shift.norm(dim=-1).max() <= 0.05 + 1e-6
    assert torch.linalg.matrix_rank(shift[0], tol=1e-4) == 1
    assert torch.equal(quantised(points, torch.ones(1, 1, 1), 0.0, 0.1), points)


def test_outliers_are_marked_and_the_others_stay():
    points = plane(2000)
    moved, strays = outliers(points, torch.full((1, 1, 1), 1.5), 1.0, 0.4)
    assert 0 < strays.sum() < 0.45 * 2000
    assert torch.equal(moved[~strays], points[~strays])
    assert moved[strays].norm(dim=-1).max() <= 1.5 and moved[strays][:, 2].abs().max() > 0.5


def test_nothing_is_asked_of_outliers_at_any_level(training):
    batch = draw(training, levels=2, outlier_share=1.0, outlier_most=0.5)
    assert batch.strays.any()
    cascade, data = Cascade(2, 8), Data(windows=[1.0], reference_margin=1.3)
    for levels in (1, 2):
        torch.manual_seed(5)
        marked = run_levels(list(cascade.units)[:levels], batch, data)
        torch.manual_seed(5)
        plain = run_levels(list(cascade.units)[:levels], batch._replace(strays=None), data)
        assert torch.equal(marked.prediction, plain.prediction)
        assert not (marked.prediction_inside & ~plain.prediction_inside).any()
        assert marked.prediction_inside.sum() < plain.prediction_inside.sum()
        assert torch.equal(marked.reference_inside, plain.reference_inside)


def test_noise_between_levels_reaches_the_second_unit_alone(training):
    batch, cascade = draw(training, levels=2), Cascade(2, 8)
    results = []
    for noise in (0.0, 0.05):
        torch.manual_seed(5)
        data = Data(windows=[1.0], level_noise=noise)
        results.append([run_levels(list(cascade.units)[:levels], batch, data).prediction for levels in (1, 2)])
    assert torch.equal(results[0][0], results[1][0])
    assert not torch.equal(results[0][1], results[1][1])
    assert (results[0][1] - results[1][1]).abs().max() < 1


def test_scores_have_no_noise_between_levels(prepared):
    clouds = cloud_sets.load(prepared, torch.device("cpu"), held_out=True)
    scores = []
    for noise in (0.0, 0.1):
        config = Config(levels=2, k=8, patch=40, data=Data(level_noise=noise))
        torch.manual_seed(4)
        scores.append(Validation(clouds, config, patches=2).of_cascade(Cascade(2, 8), 2))
    assert scores[0] == scores[1]


def test_noise_is_in_its_patch_s_own_unit():
    torch.manual_seed(0)
    shift = noised(torch.zeros(400, 50, 3), torch.full((400, 1, 1), 2.0), 0.5, 0.1, 1.0)
    assert 0.35 < shift.flatten(1).any(1).float().mean() < 0.65
    assert 0.3 < shift.abs().max() <= 2 * 0.3


def test_two_near_sheets_are_thin_and_a_plane_is_not():
    torch.manual_seed(0)
    sheet = plane(8000)[0]
    spacing = (16 / 2000) ** 0.5
    both = torch.cat([sheet[:4000], sheet[4000:] + torch.tensor([0.0, 0.0, spacing])])
    inner = torch.zeros(1, 3)
    assert thickness(inner, sheet) < 0.01
    assert thickness(inner, both) > 0.2


def test_thin_places_are_drawn_of_all_shapes_where_they_are(training):
    clouds = training._replace(levels=[level.clone() for level in training.levels])
    for level in clouds.levels:
        # The second shape becomes two discs that nearly touch; the first stays a ball.
        level[1, :, 2] = 0.03 * level[1, :, 2].sign()
    places = ThinPlaces(clouds, 1)
    shapes, seeds = places.draw(0, 200)
    assert (shapes == 1).float().mean() > 0.9
    assert seeds[shapes == 1][:, 2].abs().max() < 0.031


def test_thin_places_become_seeds(training):
    source = PatchSource(training, Data(windows=[1.0], thin_share=1.0), 40, random.Random(0))
    shapes, seeds = source.places(5, 0, 2)
    known = source.thin.places[0]
    assert all((known[shape] == seed).all(1).any() for shape, seed in zip(shapes, seeds))
