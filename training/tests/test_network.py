"""The unit: its size, and that every form of it is the same function."""

import numpy as np
import pytest
import torch

from densecloud_training import native
from densecloud_training.edge import EdgeBlock, nearest_in_features
from densecloud_training.network import (
    CHANNELS,
    PARAMETERS_PER_UNIT,
    Cascade,
    Previous,
    Unit,
    normalise,
    relative,
    skip,
)


def patches(batch: int, count: int) -> torch.Tensor:
    return normalise(torch.randn(batch, count, 3))[0]


def previous(batch: int, count: int, rows: int = 50) -> Previous:
    return Previous(torch.randn(rows, CHANNELS), torch.randint(0, rows, (batch, count, 5)), torch.rand(batch, count, 5))


@pytest.fixture
def unit() -> Unit:
    unit = Unit()
    for parameter in unit.parameters():  # biases start at zero, where a wrong one would not show
        if parameter.dim() == 1:
            torch.nn.init.normal_(parameter, std=0.1)
    return unit


def test_parameters_are_counted_as_in_the_paper():
    count = sum(parameter.numel() for parameter in Unit().parameters())
    assert count == PARAMETERS_PER_UNIT == 76_027
    assert sum(parameter.numel() for parameter in Cascade(4).parameters()) == 304_108


def test_shapes(unit):
    output = unit(patches(2, 40), previous(2, 40))
    assert output.dense.shape == (2, 80, 3)
    assert output.features.shape == (2, 40, 264)


def values_and_gradients(form, unit, points, before, weights):
    """dense, features, and the gradients of a random weighing of both, for the points and every parameter."""
    unit.zero_grad(set_to_none=True)
    points = points.clone().requires_grad_(True)
    dense, features = form(points, before)
    ((dense * weights[0]).sum() + (features * weights[1]).sum()).backward()
    gradients = [points.grad] + [parameter.grad.clone() for parameter in unit.parameters()]
    return dense.detach(), features.detach(), gradients


@pytest.mark.parametrize("with_skip", [False, True])
@pytest.mark.parametrize("count", [33, 100])
def test_fast_form_equals_the_plain_one(unit, with_skip, count):
    # In double precision: in single, two edges of a maximum may be so close that rounding picks another in each form.
    unit = unit.double()
    before = previous(3, count) if with_skip else None
    before = before and Previous(before.features.double(), before.indices, before.distances.double())
    inputs = patches(3, count).double(), before
    weights = torch.randn(3, 2 * count, 3).double(), torch.randn(3, count, CHANNELS).double()
    plain = values_and_gradients(unit.plain, unit, *inputs, weights)
    fast = values_and_gradients(unit, unit, *inputs, weights)
    assert torch.allclose(fast[0], plain[0], atol=1e-10)
    assert torch.allclose(fast[1], plain[1], atol=1e-10)
    for got, wanted in zip(fast[2], plain[2]):
        assert (got - wanted).norm() <= 1e-8 * wanted.norm()


@pytest.mark.parametrize("count", [33, 100, 312])
def test_kernels_equal_the_fast_form(unit, count, monkeypatch):
    if native.library() is None:
        pytest.skip("no compiler here: the kernels are not used")
    inputs = patches(3, count), previous(3, count)
    weights = torch.randn(3, 2 * count, 3), torch.randn(3, count, CHANNELS)
    kernels = values_and_gradients(unit, unit, *inputs, weights)
    monkeypatch.setattr(native, "usable", lambda tensor: False)
    wanted = values_and_gradients(unit, unit, *inputs, weights)
    assert torch.allclose(kernels[0], wanted[0], atol=1e-5)
    assert torch.allclose(kernels[1], wanted[1], atol=1e-5)
    # Single precision only: see above for why gradients may part a little.
    for got, expected in zip(kernels[2], wanted[2]):
        assert (got - expected).norm() <= 0.05 * expected.norm()


def test_neighbours_leave_the_point_itself_out():
    features = torch.randn(2, 50, 24)
    wanted = torch.cdist(features, features).topk(9, largest=False)[1][..., 1:].sort(-1)[0]
    assert torch.equal(nearest_in_features(features, 8).sort(-1)[0], wanted)
    if native.library() is not None:
        assert torch.equal(native.neighbours(features, 8).long().sort(-1)[0], wanted)


def test_the_kernels_leave_numbers_of_the_process_as_they_are():
    native.library()
    assert np.float32(1e-40) * np.float32(0.5) > 0, "numbers near zero must stay, for libraries that count on them"


def test_kernel_breaks_ties_by_index():
    if native.library() is None:
        pytest.skip("no compiler here: the kernels are not used")
    found = native.neighbours(torch.zeros(1, 20, 24), 5).sort(-1)[0]
    assert found[0, 0].tolist() == [1, 2, 3, 4, 5]
    assert found[0, 19].tolist() == [0, 1, 2, 3, 4]


def test_kernel_refuses_more_neighbours_than_points():
    if native.library() is None:
        pytest.skip("no compiler here: the kernels are not used")
    with pytest.raises(ValueError, match="no 20 other points"):
        native.neighbours(torch.zeros(1, 20, 24), 20)


def test_edge_block_by_hand():
    """Two points and one neighbour each: the block's five steps, written out."""
    block = EdgeBlock(channels=24, growth=12, k=1)
    features = torch.randn(1, 2, 24)
    own, other = features[0, 0], features[0, 1]
    a = torch.relu(block.first(torch.cat([own, other - own])))
    b = torch.relu(block.second(torch.cat([a, own])))
    c = block.third(torch.cat([b, a, own]))
    assert torch.allclose(block(features)[0, 0], torch.cat([c, b, a, own]), atol=1e-5)


def test_skip_by_hand():
    """Equal feature distances: the weights are exp(-2 d/h) of the spatial distances alone."""
    rows = torch.zeros(5, CHANNELS)
    rows[:, 0] = torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0])
    distances = torch.tensor([[[1.0, 2.0, 3.0, 4.0, 5.0]]])
    got = skip(torch.zeros(1, 1, CHANNELS), Previous(rows, torch.arange(5).view(1, 1, 5), distances))
    weights = torch.softmax(-2 * distances[0, 0], 0)
    assert torch.allclose(got[0, 0, 0], 0.2 * (weights * rows[:, 0]).sum(), atol=1e-6)
    assert torch.count_nonzero(got[0, 0, 1:]) == 0


def test_skip_weights_carry_no_gradient_but_features_do():
    features = torch.randn(1, 6, CHANNELS, requires_grad=True)
    before = previous(1, 6)
    table = before.features.clone().requires_grad_(True)
    skip(features, before._replace(features=table)).sum().backward()
    assert torch.equal(features.grad, torch.ones_like(features))
    assert table.grad.abs().sum() > 0


def test_skip_where_every_point_coincides_with_a_previous_one():
    distances = torch.zeros(1, 4, 5)
    distances[..., 1:] = 1.0
    assert torch.isfinite(relative(distances)).all()
    found = skip(torch.zeros(1, 4, CHANNELS), previous(1, 4)._replace(distances=distances))
    assert torch.isfinite(found).all()


def test_normalise_fills_the_unit_sphere_and_is_undone():
    cloud = torch.randn(3, 20, 3) * 7 + 5
    normal, frame = normalise(cloud)
    assert torch.allclose(normal.mean(1), torch.zeros(3, 3), atol=1e-6)
    assert torch.allclose(normal.norm(dim=-1).max(1)[0], torch.ones(3))
    assert torch.allclose(frame.undo(normal), cloud, atol=1e-5)
