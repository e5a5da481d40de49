"""A whole cloud through the cascade in PyTorch."""

import numpy as np
import pytest
import torch

from densecloud_training.cascade import (
    Rules,
    cover,
    farthest_point_sampling,
    inner_part,
    most_central,
    nearest,
    upsample,
)
from densecloud_training.network import Cascade


@pytest.fixture(scope="module")
def cascade():
    torch.manual_seed(2)
    cascade = Cascade(2).eval().requires_grad_(False)
    for unit in cascade.units:  # small residuals, as trained units have
        unit.expand[-1].weight *= 0.05
    return cascade


def ball(count: int) -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


@pytest.mark.parametrize("count, ratio, wanted", [(500, 4, 2000), (400, 2.5, 1000), (100, 8, 800), (400, 1, 400)])
@pytest.mark.parametrize("inner", [1.0, 0.25])
def test_exact_count_in_the_clouds_own_place(cascade, count, ratio, wanted, inner):
    cloud = ball(count) * 30 + 1000
    dense, times = upsample(cascade, cloud, ratio, Rules(inner=inner))
    assert dense.shape == (wanted, 3)
    assert np.abs(np.linalg.norm(dense - 1000, axis=1) - 30).max() < 20
    assert set(times.seconds) <= {"seeds", "patches", "units", "resample"}


def test_too_few_points_are_refused(cascade):
    with pytest.raises(ValueError, match="32 points are too few"):
        upsample(cascade, ball(32), 2)


def test_farthest_point_sampling_takes_the_farthest():
    line = torch.tensor([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0], [10.0, 0, 0]])
    assert farthest_point_sampling(line, 3, "plain").tolist() == [0, 3, 2]


def test_patches_cover_every_point_and_know_their_owner():
    points = torch.from_numpy(ball(600)).float()
    patches = cover(points, torch.tensor([0]), 50)
    assert set(patches.reshape(-1).tolist()) == set(range(600))
    owners = most_central(patches, 600)
    places = torch.arange(50).repeat(len(patches))
    for point in range(0, 600, 37):
        occurrences = (patches.reshape(-1) == point).nonzero()[:, 0]
        assert owners[point] in occurrences and places[owners[point]] == places[occurrences].min()


def test_every_point_keeps_its_output_whatever_is_merged():
    points = torch.from_numpy(ball(300)).float()
    patches = cover(points, torch.tensor([0, 100]), 60)
    dense = points[patches].repeat(1, 2, 1)  # a rule that repeats its input
    merged = inner_part(dense, most_central(patches, 300), len(patches), 60, 0.1)
    assert len(torch.unique(merged, dim=0)) == 300
    assert len(merged) < dense.numel() // 3


def test_nearest_against_brute_force():
    points = torch.randn(50, 3)
    distances, indices = nearest(points, points, 4)
    assert torch.equal(indices[:, 0], torch.arange(50))
    assert torch.allclose(distances, torch.cdist(points, points).sort(1)[0][:, :4].square(), atol=1e-4)


def test_both_plain_forms_of_farthest_point_sampling_choose_the_same_points():
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(1))
    plain = farthest_point_sampling(points, 120, "plain")
    assert len(set(plain.tolist())) == 120
    assert farthest_point_sampling(points, 120, "tensor").tolist() == plain.tolist()
