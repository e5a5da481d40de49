"""The modified Chamfer distance, against cases worked out by hand."""

import pytest
import torch

from densecloud_training import native
from densecloud_training.loss import chamfer, masked_mean, nearest_distances

PREDICTION = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
REFERENCE = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [3.0, 0.0, 0.0]]])


def test_both_directions_by_hand():
    # To the reference: 0 and 1. Back: 0, 1 and 4.
    assert chamfer(PREDICTION, REFERENCE).item() == pytest.approx(0.5 + 5 / 3)


def test_equal_clouds_have_no_distance():
    cloud = torch.randn(2, 30, 3)
    assert chamfer(cloud, cloud[:, torch.randperm(30)]).abs().max() == 0


def test_outliers_above_twice_the_mean_are_dropped():
    # Back: mean 5/3, so the term 4 exceeds twice the mean and counts as 0 under the same divisor.
    assert chamfer(PREDICTION, REFERENCE, outlier_threshold=2.0).item() == pytest.approx(0.5 + 1 / 3)


def test_masks_leave_points_out_of_their_own_direction():
    keep = torch.tensor([[True, True, False]])
    assert chamfer(PREDICTION, REFERENCE, keep_reference=keep).item() == pytest.approx(0.5 + 0.5)
    keep = torch.tensor([[True, False]])
    assert chamfer(PREDICTION, REFERENCE, keep_prediction=keep).item() == pytest.approx(0.0 + 5 / 3)


def test_a_direction_without_points_counts_nothing():
    assert masked_mean(torch.ones(1, 3), torch.zeros(1, 3, dtype=torch.bool), None).item() == 0


def test_gradient_by_hand():
    prediction = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.5, 0.0]]], requires_grad=True)
    chamfer(prediction, REFERENCE).sum().backward()
    # To the reference, mean of 2: (1,1,0) pulls by 2(0.5-1)/2 along y. Back, mean of 3: (1,1,0) by 2(0.5-1)/3 along y,
    # (3,0,0) by 2(1-3)/3 along x and 2(0.5-0)/3 along y.
    assert torch.allclose(prediction.grad[0, 1], torch.tensor([-4 / 3, -0.5, 0.0]))


@pytest.mark.parametrize("kernels", [False, True])
def test_nearest_against_brute_force(kernels, monkeypatch):
    if kernels and native.library() is None:
        pytest.skip("no compiler here: the kernels are not used")
    if not kernels:
        monkeypatch.setattr(native, "usable", lambda tensor: False)
    prediction, reference = torch.randn(3, 70, 3), torch.randn(3, 41, 3)
    table = torch.cdist(prediction.double(), reference.double()).square()
    found = nearest_distances(prediction, reference)
    assert torch.allclose(found.to_reference.double(), table.min(2)[0], atol=1e-5)
    assert torch.allclose(found.to_prediction.double(), table.min(1)[0], atol=1e-5)
