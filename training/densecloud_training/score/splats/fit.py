"""The optimisation: loss, rates, densification, and how good unseen views become."""

import time
from dataclasses import dataclass
from typing import Dict, List, Optional

import numpy as np
import torch

from .gaussians import Gaussians, Seeds, from_seeds, project, render, rotations
from .view import Photograph

# The published learning rates; that of positions is in radii of the cameras and falls to a hundredth.
RATES = {"position": 1.6e-4, "scale": 5e-3, "rotation": 1e-3, "opacity": 5e-2, "colour": 2.5e-3}
FALL = 0.01
# The share of D-SSIM in the loss.
STRUCTURE = 0.2
# Densification as published, but that it begins at once and ends at half: each so many steps, Gaussians whose middles
# pull by more than GRADIENT (of half a picture's width) are cloned, or split where larger than LARGE camera radii.
EACH = 100
GRADIENT = 2e-4
LARGE = 0.01
SMALLER = 1.6
FAINT = 0.005
# Held-out views are scored so often.
CHECKS = 10


@dataclass(frozen=True)
class Check:
    """Held-out scores on the way: after so many steps and seconds of processor time, with so many Gaussians."""

    step: int
    seconds: float
    gaussians: int
    psnr: float
    ssim: float


def smoothing(size: int, reach: int = 5, deviation: float = 1.5) -> torch.Tensor:
    """[size,size]: what SSIM's window makes of a row of pixels; beyond the border is black."""
    apart = (torch.arange(size)[:, None] - torch.arange(size)).abs()
    weights = torch.exp(-(apart**2) / (2 * deviation**2)) * (apart <= reach)
    return weights / torch.exp(-(torch.arange(-reach, reach + 1) ** 2) / (2 * deviation**2)).sum()


def ssim(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    """The mean structural similarity of square pictures [s,s,3], as Wang et al. 2004."""
    a, b = one.permute(2, 0, 1), other.permute(2, 0, 1)
    rows = smoothing(len(one)).to(one.dtype)
    mean_a, mean_b, aa, bb, ab = (rows @ torch.cat([a, b, a * a, b * b, a * b]) @ rows).split(3)
    spread = (aa - mean_a**2) + (bb - mean_b**2)
    alike = (2 * mean_a * mean_b + 1e-4) * (2 * (ab - mean_a * mean_b) + 9e-4)
    return (alike / ((mean_a**2 + mean_b**2 + 1e-4) * (spread + 9e-4))).mean()


def loss(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """The paper's."""
    return (1 - STRUCTURE) * (image - truth).abs().mean() + STRUCTURE * (1 - ssim(image, truth))


def psnr(image: torch.Tensor, truth: torch.Tensor) -> float:
    """In dB, of values from 0 to 1."""
    return float(-10 * torch.log10(((image - truth) ** 2).mean()))


class Fit:
    """Gaussians on their way from seeds to photographs. `steps` is the whole schedule."""

    def __init__(self, seeds: Seeds, photographs: List[Photograph], steps: int, densify: bool, seed: int) -> None:
        centres = np.stack([photograph.view.centre for photograph in photographs])
        self.radius = 1.1 * float(np.linalg.norm(centres - centres.mean(0), axis=1).max())
        self.photographs, self.steps, self.densify = photographs, steps, densify
        self.random = np.random.default_rng(seed)
        self.gaussians: Gaussians = {}
        self.take(from_seeds(seeds))

    def take(self, gaussians: Gaussians, moments: Optional[Dict[str, Dict[str, torch.Tensor]]] = None) -> None:
        """Goes on with these, and with what Adam remembers of each where `moments` has it."""
        self.gaussians = {name: values.detach().clone().requires_grad_(True) for name, values in gaussians.items()}
        groups = [{"params": [values], "lr": RATES[name]} for name, values in self.gaussians.items()]
        self.adam = torch.optim.Adam(groups, eps=1e-15)
        for name, values in self.gaussians.items():
            self.adam.state[values].update(moments[name] if moments else {})
        self.pulled = torch.zeros(len(gaussians["opacity"]))
        self.times = torch.zeros(len(gaussians["opacity"]))

    def step(self, number: int) -> float:
        """One photograph; gives the loss."""
        if number % len(self.photographs) == 0:
            self.turn = self.random.permutation(len(self.photographs))
        photograph = self.photographs[self.turn[number % len(self.photographs)]]
        self.adam.param_groups[0]["lr"] = RATES["position"] * self.radius * FALL ** (number / self.steps)
        seen = project(self.gaussians, photograph.view)
        seen.centre.retain_grad()
        found = loss(render(self.gaussians, photograph.view, seen), torch.from_numpy(photograph.image))
        self.adam.zero_grad()
        found.backward()
        self.adam.step()
        if self.densify:
            self.watch(seen.centre.grad.norm(dim=1) * photograph.view.size / 2)
            if (number + 1) % EACH == 0 and number + 1 <= self.steps // 2:
                self.grow()
        return float(found)

    def watch(self, pull: torch.Tensor) -> None:
        """Remembers how much pictures pull at the Gaussians that they show."""
        self.pulled += pull
        self.times += pull > 0

    def grow(self) -> None:
        """Clones, splits and removes. Those that stay come first."""
        wanting = self.pulled / self.times.clamp(min=1) >= GRADIENT
        large = self.gaussians["scale"].detach().exp().max(1)[0] > LARGE * self.radius
        clear = torch.sigmoid(self.gaussians["opacity"].detach()) >= FAINT
        stay, cloned, halved = clear & ~(wanting & large), clear & wanting & ~large, clear & wanting & large
        chosen = torch.cat([torch.nonzero(which)[:, 0] for which in (stay, cloned, halved, halved)])
        values = {name: tensor.detach()[chosen] for name, tensor in self.gaussians.items()}
        self.part(values, len(chosen) - 2 * int(halved.sum()))
        self.take(values, self.remembered(chosen, int(stay.sum())))

    def part(self, values: Gaussians, first: int) -> None:
        """Makes those from `first` on smaller, and puts them at places drawn from themselves."""
        halves = {name: tensor[first:] for name, tensor in values.items()}
        drawn = torch.from_numpy(self.random.normal(size=tuple(halves["position"].shape)).astype(np.float32))
        offset = rotations(halves["rotation"]) @ (drawn * halves["scale"].exp())[..., None]
        halves["position"] += offset[..., 0]
        halves["scale"] -= float(np.log(SMALLER))

    def remembered(self, chosen: torch.Tensor, old: int) -> Dict[str, Dict[str, torch.Tensor]]:
        """What Adam remembers of the chosen; nothing of those after the first `old`."""
        found = {}
        for name, values in self.gaussians.items():
            state = dict(self.adam.state[values])
            for key in ("exp_avg", "exp_avg_sq"):
                state[key] = state[key][chosen]
                state[key][old:] = 0
            found[name] = state
        return found

    def check(self, step: int, seconds: float, unseen: List[Photograph]) -> Check:
        """Scores views that are not trained on."""
        with torch.no_grad():
            images = [render(self.gaussians, p.view, project(self.gaussians, p.view)).clamp(0, 1) for p in unseen]
            truths = [torch.from_numpy(p.image) for p in unseen]
            noise = [psnr(image, truth) for image, truth in zip(images, truths)]
            alike = [float(ssim(image, truth)) for image, truth in zip(images, truths)]
        return Check(step, seconds, len(self.gaussians["opacity"]), float(np.mean(noise)), float(np.mean(alike)))

    def run(self, unseen: List[Photograph]) -> List[Check]:
        """All steps; scores on the way, the first before any. Scoring does not count as time."""
        checks, seconds, each = [self.check(0, 0.0, unseen)], 0.0, max(1, self.steps // CHECKS)
        for number in range(self.steps):
            begin = time.process_time()
            self.step(number)
            seconds += time.process_time() - begin
            if (number + 1) % each == 0 or number + 1 == self.steps:
                checks.append(self.check(number + 1, seconds, unseen))
        return checks
