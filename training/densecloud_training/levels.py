"""A patch through several levels: between two levels a smaller patch is cut out of the prediction."""

from typing import Callable, NamedTuple, Optional, Sequence

import torch

from .config import Data
from .faults import noised
from .loss import nearest_distances
from .network import SKIP_NEIGHBOURS, Previous, normalise
from .patches import Batch, nearest_of_seed

# A unit, or a rule that stands in for one: (points [B,N,3] normalised, previous) -> (dense [B,2N,3], features or None).
Step = Callable[[torch.Tensor, Optional[Previous]], tuple]


class Result(NamedTuple):
    """The last level in its own patch's frame (radius 1): prediction [B,2N,3], reference [B,R,3], and which points of
    each lie within the other's crop ([B,2N], [B,R] bool)."""

    prediction: torch.Tensor
    reference: torch.Tensor
    prediction_inside: torch.Tensor
    reference_inside: torch.Tensor


def run_levels(steps: Sequence[Step], batch: Batch, data: Data, frozen: int = 0) -> Result:
    """Runs `steps` one after the other; the first `frozen` of them without gradient.

    Each next patch: a random predicted point is the seed (moved towards the middle as `data.seed_pull` says), the input
    is its N nearest predictions, with noise of up to `data.level_noise` radii, and the reference halves around it.
    """
    points, reference = batch.points, batch.reference
    seed = torch.zeros_like(points[:, :1])
    input_radius, reference_radius = batch.input_radius, batch.reference_radius
    crops = [(seed, input_radius, reference_radius)]
    previous, strays = None, batch.strays
    for level, step in enumerate(steps, start=1):
        with torch.set_grad_enabled(torch.is_grad_enabled() and level > frozen):
            normal, frame = normalise(points)
            dense, features = step(normal, previous)
            dense = frame.undo(dense)
        if level == len(steps):
            break
        patch = points.shape[1]
        with torch.no_grad():
            seed = next_seed(dense, data.seed_pull)
        # Neighbours are chosen without gradient; the coordinates that they select keep theirs.
        distances = (dense.detach() - seed).square().sum(-1)
        # What a stray becomes stays one.
        marked = dense if strays is None else torch.cat([dense, strays.to(dense).repeat(1, 2).unsqueeze(-1)], -1)
        following, input_radius = nearest_of_seed(distances, marked, patch)
        if strays is not None:
            following, strays = following[..., :3], following[..., 3] > 0.5
        if data.level_noise:
            following = noised(following, input_radius.unsqueeze(-1), data.noise_share, data.level_noise, 1.0)
        if features is not None:
            previous = nearest_previous(following, points, features)
        wanted = batch.reference.shape[1] >> level
        reference, reference_radius = nearest_of_seed((reference - seed).square().sum(-1), reference, wanted)
        crops.append((seed, input_radius, reference_radius))
        points = following
    with torch.no_grad():
        # By the point that a prediction came from: one that strays outwards must not escape its loss by straying.
        inside = torch.stack([(points - s).norm(dim=-1) <= reach for s, _, reach in crops]).all(0)
        if strays is not None:
            inside &= ~strays
        prediction_inside = torch.cat([inside, inside], dim=1)
        reference_inside = torch.stack([(reference - s).norm(dim=-1) <= radius for s, radius, _ in crops]).all(0)
        # Where the input saw nothing (the far side of a scan), nothing is asked for.
        gap = nearest_distances(reference, batch.points).to_reference.sqrt()
        reference_inside &= gap <= data.coverage * batch.input_radius
    scale = input_radius.unsqueeze(-1)
    return Result((dense - seed) / scale, (reference - seed) / scale, prediction_inside, reference_inside)


def next_seed(dense: torch.Tensor, pull: float) -> torch.Tensor:
    """[B,1,3]: a random point of each prediction, moved towards the centre and back to the nearest prediction."""
    picks = torch.randint(dense.shape[1], (len(dense), 1, 1), device=dense.device)
    drawn = dense.gather(1, picks.expand(-1, -1, 3))
    centre = dense.mean(1, keepdim=True)
    target = centre + pull * (drawn - centre)
    nearest = (dense - target).square().sum(-1).argmin(1)
    return dense.gather(1, nearest.view(-1, 1, 1).expand(-1, -1, 3))


def nearest_previous(points: torch.Tensor, before: torch.Tensor, features: torch.Tensor) -> Previous:
    """The 5 nearest points of the previous level's input for each point of the next patch."""
    with torch.no_grad():
        squares = points.square().sum(-1).unsqueeze(2) + before.square().sum(-1).unsqueeze(1)
        table = torch.baddbmm(squares, points, before.transpose(1, 2), alpha=-2.0).clamp_min_(0.0)
        distances, indices = table.topk(SKIP_NEIGHBOURS, dim=2, largest=False, sorted=False)
        offsets = torch.arange(len(points), device=points.device).view(-1, 1, 1) * before.shape[1]
    return Previous(features.reshape(-1, features.shape[-1]), indices + offsets, distances)
