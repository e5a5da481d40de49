"""The modified Chamfer distance."""

from typing import NamedTuple, Optional

import torch

from . import native
from .edge import gather_rows, nearest_others


class Nearest(NamedTuple):
    """Squared distances [B,P] of predictions to their nearest reference, and [B,Q] of references to theirs."""

    to_reference: torch.Tensor
    to_prediction: torch.Tensor


def nearest_distances(prediction: torch.Tensor, reference: torch.Tensor) -> Nearest:
    """Both directions, from one table of products. The partners are found without gradient; the distances to them are
    then computed exactly, so that rounding in the products shifts no loss value."""
    with torch.no_grad():
        if native.usable(prediction) and native.usable(reference):
            of_prediction = native.nearest(prediction, reference)
            of_reference = native.nearest(reference, prediction)
        else:
            squares = prediction.square().sum(-1).unsqueeze(2) + reference.square().sum(-1).unsqueeze(1)
            table = torch.baddbmm(squares, prediction, reference.transpose(1, 2), alpha=-2.0)
            of_prediction = table.argmin(2)
            of_reference = table.argmin(1)
    to_reference = prediction - reference.gather(1, of_prediction.unsqueeze(-1).expand(-1, -1, 3))
    to_prediction = reference - prediction.gather(1, of_reference.unsqueeze(-1).expand(-1, -1, 3))
    return Nearest(to_reference.square().sum(-1), to_prediction.square().sum(-1))


def masked_mean(values: torch.Tensor, keep: Optional[torch.Tensor], outlier_threshold: Optional[float]) -> torch.Tensor:
    """[B,P] -> [B]: the mean over what is kept; xi then drops terms above `outlier_threshold` times that mean.

    Dropped terms count as zero under the same divisor, as in the method.
    """
    weights = torch.ones_like(values) if keep is None else keep.to(values.dtype)
    count = weights.sum(1).clamp_min(1.0)
    mean = (values * weights).sum(1) / count
    if outlier_threshold is None:
        return mean
    small = values <= outlier_threshold * mean.detach().unsqueeze(1)
    return (values * weights * small).sum(1) / count


def chamfer(
    prediction: torch.Tensor,
    reference: torch.Tensor,
    keep_prediction: Optional[torch.Tensor] = None,
    keep_reference: Optional[torch.Tensor] = None,
    outlier_threshold: Optional[float] = None,
    surface: float = 1.0,
) -> torch.Tensor:
    """Modified Chamfer distance [B]: both directed means of squared nearest distances, added.

    `keep_*` [B,P], [B,Q] leave out points whose counterpart may lie beyond the other cloud's border. `surface` weights
    the direction from the prediction to the reference: how far points are off the surface, against how well they cover
    it.
    """
    nearest = nearest_distances(prediction, reference)
    return surface * masked_mean(nearest.to_reference, keep_prediction, outlier_threshold) + masked_mean(
        nearest.to_prediction, keep_reference, outlier_threshold
    )


def crowding(prediction: torch.Tensor, keep: Optional[torch.Tensor] = None) -> torch.Tensor:
    """[B]: the mean of max(0, m - d)^2, where d is a prediction's distance to its nearest other one and m the mean d of
    its patch, without gradient. In the Chamfer distance's unit, and 0 where points are even."""
    partners = gather_rows(prediction, nearest_others(prediction, 1)).squeeze(2)
    # Two copies of a point may coincide, where a root has no gradient.
    distances = ((prediction - partners).square().sum(-1) + 1e-12).sqrt()
    mean = masked_mean(distances, keep, None).detach().unsqueeze(1)
    return masked_mean((mean - distances).clamp_min(0).square(), keep, None)
