"""Runs: what learns in which stage, the same batches from the same seed, and checkpoints that lose nothing."""

import argparse
import json
import os
import random
import signal

import pytest
import torch

from densecloud_training import checkpoint as checkpoints
from densecloud_training import clouds as cloud_sets
from densecloud_training import config as configs
from densecloud_training.config import Config, Data, Stage
from densecloud_training.levels import run_levels
from densecloud_training.network import Cascade
from densecloud_training.patches import KINDS, PatchSource
from densecloud_training.schedule import learning_rate, prepare_units, trained_units
from densecloud_training.train import Trainer, main, run
from densecloud_training.validation import Validation


def small(iterations: int = 4) -> Config:
    """Two units on patches of 40 points."""
    stages = [
        Stage(levels=1, together=False, share=0.5, iterations=iterations, learning_rate=1e-3),
        Stage(levels=2, together=False, share=0.2, iterations=iterations, learning_rate=1e-3),
        Stage(levels=2, together=True, share=0.3, iterations=iterations, learning_rate=1e-3),
    ]
    data = Data(
        windows=[1.0],
        kinds={"poisson": 1.0, "random": 1.0},
        noise_share=0.5,
        reference_margin=1.3,
        reference_extra=1,
        seed_pull=0.5,
        coverage=0.3,
    )
    extension = [Stage(levels=2, together=True, share=1.0, iterations=2, learning_rate=1e-3)]
    return Config(
        levels=2, k=8, patch=40, batch_cpu=3, warm_start=True, decay_to=0.1, data=data, stages=stages,
        extension=extension, ratio_draw=[1.0, 1.0],
    )  # fmt: skip


def steps(trainer: Trainer, count: int) -> list:
    """Trains by iterations; returns the losses."""
    losses = []
    for _ in range(count):
        losses.append(trainer.train_step()[1].item())
        if trainer.progress() >= 1:
            trainer.leave_stage()
    return losses


def weights(trainer: Trainer) -> list:
    return [parameter.detach().clone() for parameter in trainer.cascade.parameters()]


def test_same_seed_same_run(training):
    first, second = Trainer(small(), training, None), Trainer(small(), training, None)
    first_losses = steps(first, 6)
    torch.manual_seed(99)  # a run's own state decides, not what came before it
    second = Trainer(small(), training, None)
    assert steps(second, 6) == first_losses
    assert all(torch.equal(a, b) for a, b in zip(weights(first), weights(second)))


def test_other_seed_other_batches(training):
    config = small()
    first = steps(Trainer(config, training, None), 1)
    config.seed = 1
    assert steps(Trainer(config, training, None), 1) != first


@pytest.mark.parametrize("before", [2, 5, 9])
def test_resuming_equals_never_having_stopped(training, tmp_path, before):
    straight = Trainer(small(), training, None)
    wanted = steps(straight, 11)
    stopped = Trainer(small(), training, None)
    losses = steps(stopped, before)
    checkpoints.save(tmp_path / checkpoints.FILE, stopped.state())
    random.seed(5)
    torch.manual_seed(5)
    resumed = Trainer(small(), training, None)
    resumed.restore(checkpoints.load(tmp_path / checkpoints.FILE))
    assert losses + steps(resumed, 11 - before) == wanted
    assert all(torch.equal(a, b) for a, b in zip(weights(resumed), weights(straight)))
    assert resumed.history == straight.history


def test_stages_freeze_and_warm_start(training):
    trainer = Trainer(small(2), training, None)
    first, second = trainer.cascade.units
    start = [p.clone() for p in second.parameters()]
    steps(trainer, 1)
    assert all(torch.equal(a, b) for a, b in zip(start, second.parameters()))
    steps(trainer, 1)
    # The second unit enters as a copy of the first, which then rests.
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters()))
    rested = [p.clone() for p in first.parameters()]
    steps(trainer, 1)
    assert all(torch.equal(a, b) for a, b in zip(rested, first.parameters()))
    assert not all(torch.equal(a, b) for a, b in zip(rested, second.parameters()))
    steps(trainer, 2)
    assert trainer.stage.together
    assert not all(torch.equal(a, b) for a, b in zip(rested, first.parameters()))


def test_an_extension_trains_on_without_starting_over(training):
    trainer = Trainer(small(1), training, None)
    steps(trainer, 3)
    assert trainer.finished
    before = weights(trainer)
    trainer.extend()
    assert all(torch.equal(a, b) for a, b in zip(before, weights(trainer)))
    steps(trainer, 2)
    assert trainer.finished and trainer.step == 5


def test_schedules_reach_every_unit():
    for name in ("default", "paper"):
        config = configs.load(configs.CONFIGS / f"{name}.toml")
        learned = [(list(trained_units(stage)), stage.levels) for stage in config.stages]
        assert learned == [([0], 1), ([1], 2), ([0, 1], 2), ([2], 3), ([0, 1, 2], 3), ([3], 4), ([0, 1, 2, 3], 4)]
        assert config.levels == 4 and config.patch == 312 and config.k == {"default": 16, "paper": 32}[name]


def test_a_config_takes_from_its_base_what_it_leaves_out(tmp_path):
    default, second = (configs.load(configs.CONFIGS / f"{name}.toml") for name in ("default", "second"))
    assert second.stages == default.stages and second.loss == default.loss and second.unit == default.unit
    assert (second.k, second.patch, second.levels) == (default.k, default.patch, default.levels)
    assert second.data.coverage == default.data.coverage and second.data.holes_share > default.data.holes_share == 0
    assert set(second.data.kinds) == {"poisson", *KINDS}
    (tmp_path / "own.toml").write_text('base = "second"\nseed = 7\n[data]\nkinds = { random = 1.0 }\n')
    own = configs.load(tmp_path / "own.toml")
    assert own.seed == 7 and own.extension == second.extension and own.data.kinds == {"random": 1.0}
    (tmp_path / "own.toml").write_text('base = "third"')
    with pytest.raises(ValueError, match="third is no file"):
        configs.load(tmp_path / "own.toml")


def test_an_unknown_setting_is_refused():
    with pytest.raises(ValueError, match="unknown settings: bach"):
        configs.from_dict({"bach": 3})


def test_learning_rate_rises_then_falls():
    config, stage = Config(warmup=10, decay_to=0.1), Stage(1, False, 1.0, 100, 1.0)
    assert learning_rate(config, stage, 0.0, 0) == pytest.approx(0.1)
    assert learning_rate(config, stage, 0.0, 50) == pytest.approx(1.0)
    assert learning_rate(config, stage, 1.0, 99) == pytest.approx(0.1)
    constant = Config(warmup=0, decay_to=1.0)
    assert learning_rate(constant, stage, 0.7, 0) == pytest.approx(1.0)


def test_a_budget_scales_the_stages(training):
    trainer = Trainer(small(), training, 100.0)
    trainer.stage_seconds = 25.0
    assert trainer.progress() == pytest.approx(0.5)  # the first stage has half of 100 seconds


def test_optimiser_holds_what_learns_only():
    config = small()
    learning = prepare_units(Cascade(2, 8), config.stages[1], False, True)
    assert sum(p.numel() for p in learning) == 76_027 and all(p.requires_grad for p in learning)


@pytest.mark.parametrize("kind", ["poisson", *KINDS])
def test_patches_of_every_kind(training, kind):
    """Points of the shape near a seed, in its frame, with a reference that covers them."""
    source = PatchSource(training, Data(windows=[1.0], kinds={kind: 1.0}, noise_share=0.0), 40, random.Random(0))
    batch = source.draw(1, 4)
    assert batch.points.shape == (4, 40, 3) and batch.reference.shape == (4, 80, 3)
    assert (batch.points.norm(dim=-1) <= batch.input_radius + 1e-5).all()
    assert (batch.reference.norm(dim=-1) <= batch.reference_radius + 1e-5).all()
    for points in batch.points:
        assert len(torch.unique(points, dim=0)) == 40
    # Both are samples of one surface: no input point is far from the reference that surrounds it.
    gaps = torch.cdist(batch.points, batch.reference).min(2)[0]
    inside = batch.points.norm(dim=-1) < 0.7 * batch.reference_radius
    assert gaps[inside].max() < 0.8


def test_noise_is_on_the_input_alone(training):
    clean = PatchSource(training, Data(windows=[1.0], noise_share=0.0), 40, random.Random(0))
    noisy = PatchSource(training, Data(windows=[1.0], noise_share=1.0, noise_most=0.05), 40, random.Random(0))
    batches = []
    for source in (clean, noisy):
        torch.manual_seed(3)
        batches.append(source.draw(1, 3))
    assert torch.equal(batches[0].reference, batches[1].reference)
    shift = (batches[0].points - batches[1].points).abs()
    assert 0 < shift.max() <= 3 * 0.05 * 1.2


def test_gradient_reaches_the_first_unit_through_the_second(training):
    trainer = Trainer(small(), training, None)
    trainer.cascade.requires_grad_(True)
    batch = trainer.source.draw(2, 2)
    run_levels(list(trainer.cascade.units), batch, trainer.config.data).prediction.sum().backward()
    assert all(unit.lift.weight.grad.abs().sum() > 0 for unit in trainer.cascade.units)
    trainer.cascade.zero_grad(set_to_none=True)
    run_levels(list(trainer.cascade.units), batch, trainer.config.data, frozen=1).prediction.sum().backward()
    assert trainer.cascade.units[0].lift.weight.grad is None


def test_held_out_shapes_are_held_out(prepared):
    device = torch.device("cpu")
    trained, held = (cloud_sets.load(prepared, device, held_out=held) for held in (False, True))
    assert trained.names == ["ball", "egg"] and held.names == [cloud_sets.validation_names()[0]]
    assert len(cloud_sets.validation_names()) >= 12
    assert trained.weights[1] > trained.weights[0]  # more detail, drawn more often


def test_scoring_does_not_change_what_is_drawn_next(prepared, training):
    config = small()
    config.levels = 1
    validation = Validation(cloud_sets.load(prepared, torch.device("cpu"), held_out=True), config, patches=3)
    trainer = Trainer(small(), training, None)
    before = torch.get_rng_state()
    scores = validation.of_cascade(trainer.cascade, 1)
    assert torch.equal(before, torch.get_rng_state())
    assert scores == validation.of_cascade(trainer.cascade, 1)
    assert validation.controls["midpoint"]["even 2x"]["cd"] < validation.controls["repeat"]["even 2x"]["cd"]


def test_a_signal_ends_a_run_with_a_checkpoint(training, tmp_path):
    trainer = Trainer(small(10_000), training, None)
    original = trainer.train_step

    def step_then_signal():
        if trainer.step == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        return original()

    trainer.train_step = step_then_signal
    arguments = argparse.Namespace(log_every=1e9, score_every=1e9, save_every=1e9, stop_after=None)
    handlers = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)]
    try:
        run(trainer, tmp_path, None, arguments)
    finally:
        for number, handler in zip((signal.SIGTERM, signal.SIGINT), handlers):
            signal.signal(number, handler)
    assert checkpoints.load(tmp_path / checkpoints.FILE)["counters"]["step"] == 4
    assert json.loads((tmp_path / "log.jsonl").read_text().splitlines()[-1])["stopped"] == "early"


def test_command_line_trains_to_the_end_and_refuses_to_go_on_unasked(prepared, tmp_path, monkeypatch):
    monkeypatch.setattr(configs, "load", lambda path: small(1))
    monkeypatch.setattr(signal, "signal", lambda *ignored: None)
    command = ["--data", str(prepared), "--out", str(tmp_path), "--device", "cpu", "--no-validation"]
    main(command)
    with pytest.raises(SystemExit, match="--extend"):
        main(command)
    main([*command, "--extend"])
    assert checkpoints.load(tmp_path / checkpoints.FILE)["counters"]["round"] == 1


def test_a_run_goes_on_elsewhere_with_its_log(prepared, tmp_path, monkeypatch):
    monkeypatch.setattr(configs, "load", lambda path: small(1))
    monkeypatch.setattr(signal, "signal", lambda *ignored: None)
    first, second = tmp_path / "first", tmp_path / "second"
    command = ["--data", str(prepared), "--device", "cpu", "--no-validation"]
    main([*command, "--out", str(first), "--stop-after", "0"])
    main([*command, "--out", str(second), "--start-from", str(first)])
    counters = [checkpoints.load(run / checkpoints.FILE)["counters"] for run in (first, second)]
    assert [count["step"] for count in counters] == [1, 3]
    assert (second / "log.jsonl").read_text().startswith((first / "log.jsonl").read_text())


def test_the_mean_of_the_weights_is_what_is_scored_and_shipped(training, tmp_path):
    config = small()
    config.average = 0.5
    trainer = Trainer(config, training, None)
    wanted = [p.detach().clone() for p in trainer.cascade.parameters()]
    for step in range(3):
        trainer.train_step()
        decay = min(0.5, (1 + step) / (10 + step))
        wanted = [decay * mean + (1 - decay) * p.detach() for mean, p in zip(wanted, trainer.cascade.parameters())]
    assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(wanted, trainer.averaged.parameters()))
    assert not all(torch.equal(a, b) for a, b in zip(trainer.averaged.parameters(), trainer.cascade.parameters()))
    checkpoints.save(tmp_path / checkpoints.FILE, trainer.state())
    loaded, _, _ = checkpoints.load_cascade(tmp_path)
    first = zip(loaded.units[0].parameters(), trainer.averaged.units[0].parameters())
    assert all(torch.equal(a, b) for a, b in first)
