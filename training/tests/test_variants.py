"""Other forms of the unit: what each changes and nothing else, and the command that tables them."""

import json

import pytest
import torch
from torch.nn import functional

from densecloud_training import ablate
from densecloud_training import checkpoint as checkpoints
from densecloud_training import config as configs
from densecloud_training.config import Config, Data, Loss, Stage, Switches
from densecloud_training.edge import EdgeBlock, nearest_in_features
from densecloud_training.errors import InputError
from densecloud_training.export import export_units
from densecloud_training.export import main as export
from densecloud_training.loss import chamfer, crowding
from densecloud_training.network import CHANNELS, Cascade, Previous, Unit, normalise
from densecloud_training.train import Trainer
from densecloud_training.variants import VariantUnit, build_cascade, partners

K = 8


def small() -> Config:
    """Three stages of two units on patches of 40 points, as `default` has them."""
    stages = [
        Stage(levels=1, together=False, share=0.4, iterations=1, learning_rate=1e-3),
        Stage(levels=2, together=False, share=0.1, iterations=1, learning_rate=5e-4),
        Stage(levels=2, together=True, share=0.2, iterations=1, learning_rate=4e-4),
    ]
    data = Data(windows=[1.0], kinds={"poisson": 1.0}, reference_margin=1.3, coverage=0.3)
    loss = Loss(borders=True)
    return Config(levels=2, k=K, patch=40, batch_cpu=2, warm_start=True, data=data, loss=loss, stages=stages)


def points(batch: int = 2, count: int = 60) -> torch.Tensor:
    return normalise(torch.randn(batch, count, 3))[0]


def twins(**switches) -> tuple:
    """A plain unit and a variant of the same weights."""
    plain, variant = Unit(K), VariantUnit(K, Switches(**switches))
    for parameter in plain.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    variant.load_state_dict(plain.state_dict(), strict=False)
    return plain, variant


def previous(count: int) -> Previous:
    return Previous(torch.randn(count, CHANNELS), torch.randint(0, count, (2, 60, 5)), torch.rand(2, 60, 5))


def test_a_config_without_switches_builds_plain_units():
    cascade = build_cascade(2, K, configs.from_dict({}).unit)
    assert all(type(unit) is Unit and unit.neighbours == "features" for unit in cascade.units)
    assert cascade.state_dict().keys() == Cascade(2, K).state_dict().keys()


def test_an_unknown_value_of_a_switch_is_refused():
    with pytest.raises(ValueError, match="unit.start = 'middle': must be one of copies, midpoints"):
        configs.from_dict({"unit": {"start": "middle"}})


def test_learned_codes_begin_as_the_fixed_ones_and_learn():
    plain, variant = twins(code="learned")
    patch, before = points(), previous(90)
    assert torch.allclose(variant(patch, before).dense, plain(patch, before).dense, atol=1e-5)
    variant(patch).dense.square().sum().backward()
    assert (variant.codes.grad != 0).all()
    assert sum(p.numel() for p in variant.parameters()) == 76_027 + 2


def test_without_the_skip_the_previous_level_changes_nothing():
    plain, variant = twins(skip=False)
    patch, before = points(), previous(90)
    assert torch.equal(variant(patch, before).dense, plain(patch).dense)
    assert not torch.equal(plain(patch, before).dense, plain(patch).dense)


@pytest.mark.parametrize("neighbours, spatial_blocks", [("space", 1), ("space-shared", 4)])
def test_neighbours_in_space(neighbours, spatial_blocks):
    plain, variant = twins()[0], Unit(K, neighbours)
    variant.load_state_dict(plain.state_dict())
    patch = points()
    spatial = nearest_in_features(patch, K)
    features = plain.lift(patch)
    features = torch.cat([plain.blocks[0](features, spatial), features], dim=-1)
    for number, (squeeze, block) in enumerate(zip(plain.squeezes, plain.blocks[1:]), start=2):
        squeezed = functional.relu(squeeze(features))
        own = spatial if number <= spatial_blocks else nearest_in_features(squeezed, K)
        features = torch.cat([block(squeezed, own), features], dim=-1)
    assert torch.allclose(variant(patch).features, features, atol=1e-4)
    assert not torch.allclose(plain(patch).features, features, atol=1e-2)


def test_given_neighbours_that_a_block_would_find_change_nothing():
    block, features = EdgeBlock(k=K), torch.randn(2, 60, 24)
    assert torch.allclose(block(features), block(features, nearest_in_features(features, K)), atol=1e-5)


def test_midpoints_start_between_a_point_and_one_of_its_six_nearest():
    _, variant = twins(start="midpoints")
    torch.nn.init.zeros_(variant.expand[-1].weight)
    torch.nn.init.zeros_(variant.expand[-1].bias)
    patch = points()
    first, second = variant(patch).dense.split(60, dim=1)
    assert torch.equal(first, patch)
    chosen = partners(patch)
    assert (nearest_in_features(patch, 6) == chosen).any(-1).all()
    assert torch.allclose(second, (patch + patch.gather(1, chosen.expand(-1, -1, 3))) / 2)


def test_midpoints_do_not_coincide_inside_nor_depend_on_the_order_of_points():
    patch = points(1, 400)
    chosen = partners(patch)[0, :, 0]
    mutual = chosen[chosen] == torch.arange(400)
    assert mutual.float().mean() < 0.02  # points of which no neighbour is ahead may choose one that chose them
    order = torch.randperm(400)
    assert torch.equal(order[partners(patch[:, order])[0, :, 0]], chosen[order])


def test_shared_units_are_one_and_learn_at_both_levels(training):
    config = small()
    ablate.one_unit(config)
    trainer = Trainer(config, training, None)
    assert trainer.cascade.units[0] is trainer.cascade.units[1]
    assert trainer.averaged.units[0] is trainer.averaged.units[1]
    assert sum(p.numel() for p in trainer.cascade.parameters()) == 76_027
    while not trainer.finished:
        before = [p.detach().clone() for p in trainer.cascade.parameters()]
        trainer.train_step()
        assert any(not torch.equal(a, b) for a, b in zip(before, trainer.cascade.parameters()))
        trainer.leave_stage()


def test_crowding_is_nothing_for_even_points_and_pushes_close_ones_apart():
    grid = torch.cartesian_prod(torch.arange(5.0), torch.arange(5.0), torch.zeros(1)).unsqueeze(0)
    assert crowding(grid).item() == pytest.approx(0, abs=1e-9)
    line = torch.tensor([[[0.0, 0, 0], [0.5, 0, 0], [2.0, 0, 0], [4.0, 0, 0]]], requires_grad=True)
    # Nearest distances 0.5, 0.5, 1.5, 2: mean 1.125.
    assert crowding(line).item() == pytest.approx(2 * 0.625**2 / 4)
    crowding(line).sum().backward()
    assert line.grad[0, 0, 0] > 0 > line.grad[0, 1, 0]
    together = torch.zeros(1, 4, 3, requires_grad=True)
    crowding(together).sum().backward()
    assert torch.isfinite(together.grad).all()


def test_the_surface_weight_counts_one_direction():
    prediction, reference = torch.zeros(1, 1, 3), torch.tensor([[[1.0, 0, 0], [0, 2.0, 0]]])
    assert chamfer(prediction, reference).item() == pytest.approx(1 + 2.5)
    assert chamfer(prediction, reference, surface=2.0).item() == pytest.approx(2 + 2.5)


@pytest.mark.parametrize("name", ["learned-code", "midpoint", "no-skip"])
def test_a_variant_comes_back_from_its_checkpoint_and_is_not_exported(name, training, tmp_path):
    trainer = Trainer(ablate.config_of(small(), name), training, None)
    checkpoints.save(tmp_path / checkpoints.FILE, trainer.state())
    cascade, _, _ = checkpoints.load_cascade(tmp_path)
    patch = points()
    assert torch.equal(cascade.units[0](patch).dense, trainer.averaged.units[0](patch).dense)
    with pytest.raises(InputError, match="units with Switches.*cannot be written"):
        export([str(tmp_path), str(tmp_path / "model")])
    assert not (tmp_path / "model").exists()


def test_one_unit_for_all_levels_is_exported_as_a_file_a_level(tmp_path):
    first, second = export_units(build_cascade(2, K, Switches(shared=True)), tmp_path)
    assert first.exists() and second.exists()


def test_one_command_makes_a_table_and_goes_on_where_it_stopped(prepared, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(configs, "load", lambda path: small())
    command = ["--data", str(prepared), "--out", str(tmp_path), "--patches", "2", "--minutes", "0.001"]
    ablate.main([*command, "--only", "one-unit,k16"])
    table = json.loads((tmp_path / "table.json").read_text())
    assert set(table["rows"]) == {"one-unit", "k16"} and set(table["controls"]) == {"paper", "unit"}
    assert set(table["rows"]["one-unit"]["scores"]["even 4x"]) == {"cd", "hd", "p2f", "cv"}
    assert all(score > 0 for scores in table["rows"]["k16"]["scores"].values() for score in scores.values())
    assert table["rows"]["one-unit"]["parameters"] == table["rows"]["k16"]["parameters"] == 76_027
    ablate.main([*command, "--only", "k16,surface"])
    assert "k16: done before" in capsys.readouterr().out
    after = json.loads((tmp_path / "table.json").read_text())
    assert set(after["rows"]) == {"one-unit", "k16", "surface"}
    assert after["rows"]["k16"]["scores"] == table["rows"]["k16"]["scores"]
    text = (tmp_path / "table.md").read_text()
    assert all(f"| {name} |" in text for name in ("one-unit", "k16", "surface", "rule: midpoint", "rule: repeat"))
    assert all(row["milliseconds"] > 0 for row in after["rows"].values())
    with pytest.raises(SystemExit, match="another --minutes"):
        ablate.main([*command[:-1], "0.002"])
    with pytest.raises(SystemExit):
        ablate.main([*command, "--only", "k17"])


def test_every_variant_departs_from_its_group_s_base_in_what_it_says(training):
    base = small()
    base.loss.balance = 0.5
    before = base.as_dict()
    for name, variant in ablate.VARIANTS.items():
        config = ablate.config_of(base, name)
        assert config.levels == ablate.LEVELS[variant.group]
        assert max(stage.levels for stage in config.stages) == config.levels
        reference = ablate.config_of(base, "full" if variant.group == "paper" else "baseline")
        assert (config.as_dict() == reference.as_dict()) == (name in ("full", "baseline"))
    assert base.as_dict() == before
