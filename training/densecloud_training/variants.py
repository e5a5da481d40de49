"""Other forms of the unit, to be measured against the plain one; a config's `[unit]` table chooses them.

* `code = "learned"`: the two values that tell a point's copies apart are parameters. (The plain unit's codes are
  constants times a learned column of weights, so both forms express the same functions; they learn at other rates.)
* `start = "midpoints"`: the second copy starts halfway to a neighbour; see `partners`.
* `skip = false`: nothing is taken from the level before.
* `shared = true`: one unit serves all levels. The skip has no weights, so it stays.
"""

import torch
from torch import nn
from torch.nn import functional

from .config import Switches
from .edge import gather_rows, nearest_others
from .network import CODES, Cascade, Previous, Unit, UnitOutput

MIDPOINT_CANDIDATES = 6
# No axis and no diagonal, so that points on a grid are not tied.
AHEAD = (0.36, 0.48, 0.8)


def build_cascade(levels: int, k: int, switches: Switches) -> Cascade:
    """The cascade that a config asks for: of plain `Unit`s unless a switch changes what a unit computes."""
    plain = Switches(neighbours=switches.neighbours, shared=switches.shared)
    count = 1 if switches.shared else levels
    units = [Unit(k, switches.neighbours) if switches == plain else VariantUnit(k, switches) for _ in range(count)]
    return Cascade(units=units * levels if switches.shared else units)


class VariantUnit(Unit):
    """A unit with other codes, starting positions or without the skip; parameters as in `Unit`, and two
    more for learned codes."""

    def __init__(self, k: int, switches: Switches):
        super().__init__(k, switches.neighbours)
        self.switches = switches
        if switches.code == "learned":
            self.codes = nn.Parameter(torch.tensor(CODES))

    def forward(self, points: torch.Tensor, previous: Previous = None) -> UnitOutput:
        return super().forward(points, previous if self.switches.skip else None)

    def upsample(self, points: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
        first, *others = self.expand
        own = functional.linear(features, first.weight[:, :-1], first.bias)
        starts, hidden = [points, points], [own, own]
        if self.switches.start == "midpoints":
            # The first layer is linear: halfway between two points' features is halfway between its outputs.
            partner = partners(points)
            starts[1] = (points + gather_rows(points, partner).squeeze(2)) / 2
            hidden[1] = (own + gather_rows(own, partner).squeeze(2)) / 2
        codes = self.codes if self.switches.code == "learned" else CODES
        hidden = torch.cat([part + code * first.weight[:, -1] for part, code in zip(hidden, codes)], dim=1)
        for layer in others:
            hidden = layer(functional.relu(hidden))
        return hidden + torch.cat(starts, dim=1)

    def plain(self, points: torch.Tensor, previous: Previous = None) -> UnitOutput:
        raise NotImplementedError("variants are measured, not shipped: they have the fast form only")


@torch.no_grad()
def partners(points: torch.Tensor) -> torch.Tensor:
    """[B,N,3] -> [B,N,1]: the neighbour that each point starts its second copy halfway to.

    Of a point's 6 nearest, those ahead of it in a fixed direction: so of two points only one can choose the other, and
    no two copies start at one place. Of these the one whose midpoint is farthest from all 6: it lies in the widest gap.
    Where none is ahead (at a border), the same choice among all 6.
    """
    indices = nearest_others(points, MIDPOINT_CANDIDATES).long()
    centres = points.unsqueeze(2)
    neighbours = gather_rows(points, indices)
    middles = (centres + neighbours) / 2
    gaps = (middles.unsqueeze(3) - neighbours.unsqueeze(2)).square().sum(-1).min(-1)[0]
    ahead = (neighbours - centres) @ points.new_tensor(AHEAD) > 0
    choice = (gaps + ahead * gaps.max()).argmax(-1, keepdim=True)
    return indices.gather(2, choice)
