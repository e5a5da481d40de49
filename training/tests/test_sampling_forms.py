"""The forms of farthest point sampling that the cascade in PyTorch offers."""

import torch

from densecloud_training.cascade import farthest_point_sampling


def test_both_plain_forms_choose_the_same_points():
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(1))
    plain = farthest_point_sampling(points, 120, "plain")
    assert len(set(plain.tolist())) == 120
    assert farthest_point_sampling(points, 120, "tensor").tolist() == plain.tolist()
