"""The dense edge block: the layer that lets a point see its neighbours (method: "dense edge block").

Three forms of one function live here. `EdgeBlock.plain` follows the definition word by word and is what the tests
compare with; `EdgeBlock.forward` is what runs: linear maps are split so that nothing that depends on one point alone
is computed once per neighbour.
"""

from typing import Optional

import torch
from torch import nn
from torch.nn import functional

from . import native


@torch.no_grad()
def nearest_in_features(features: torch.Tensor, k: int) -> torch.Tensor:
    """Indices [B,N,k] of each point's k nearest others in feature space, in no particular order.

    A batched product gives all distances at once; |x_i|^2 is left out, since it shifts a whole row and so cannot
    change which neighbours are nearest. No gradient flows through indices.
    """
    squares = features.square().sum(-1).unsqueeze(1)
    distances = torch.baddbmm(squares, features, features.transpose(1, 2), alpha=-2.0)
    distances.diagonal(dim1=-2, dim2=-1).fill_(float("inf"))
    return distances.topk(k, dim=-1, largest=False, sorted=False).indices


def nearest_others(features: torch.Tensor, k: int) -> torch.Tensor:
    """`nearest_in_features` by the fastest way at hand: int32 from the CPU kernels, else int64."""
    return native.neighbours(features, k) if native.usable(features) else nearest_in_features(features, k)


def gather_rows(table: torch.Tensor, indices: torch.Tensor) -> torch.Tensor:
    """Rows of each item's own table: [B,N,C] and [B,M,k] -> [B,M,k,C]."""
    batch, rows, channels = table.shape
    offsets = torch.arange(batch, device=table.device).view(-1, 1, 1) * rows
    flat = table.reshape(batch * rows, channels).index_select(0, (indices + offsets).reshape(-1))
    return flat.view(batch, indices.shape[1], indices.shape[2], channels)


class EdgeBlock(nn.Module):
    """[B,N,channels] -> [B,N,3*growth+channels], through the k nearest neighbours in feature space, or those given."""

    def __init__(self, channels: int = 24, growth: int = 12, k: int = 32):
        super().__init__()
        self.channels, self.growth, self.k = channels, growth, k
        self.first = nn.Linear(2 * channels, growth)
        self.second = nn.Linear(growth + channels, growth)
        self.third = nn.Linear(2 * growth + channels, growth)

    def forward(self, features: torch.Tensor, indices: Optional[torch.Tensor] = None) -> torch.Tensor:
        point, neighbour, on_a, on_b = self.split()
        # Everything that depends on one point alone, in one product.
        own = features @ torch.cat([point[0], neighbour], dim=1)
        own_a, own_b, own_c, other = own.split(self.growth, dim=-1)
        bias_a, bias_b, bias_c = point[1].split(self.growth)
        own_a, own_b, own_c = own_a + bias_a, own_b + bias_b, own_c + bias_c
        if indices is None:
            indices = nearest_others(features, self.k)
        # c's share of the point itself is the same for every neighbour, so it is added after the maximum.
        if native.usable(features) and self.growth == native.GROWTH:
            to_b, to_c = on_a.split(self.growth, dim=1)
            maxima = native.EdgeMaxima.apply(own_a, own_b, other, to_b, to_c, on_b, indices.int())
            return torch.cat([maxima[..., : self.growth] + own_c, maxima[..., self.growth :], features], dim=-1)
        a = functional.relu(own_a.unsqueeze(2) + gather_rows(other, indices))
        on_b_and_c = a @ on_a
        b = functional.relu(on_b_and_c[..., : self.growth] + own_b.unsqueeze(2))
        c = on_b_and_c[..., self.growth :] + b @ on_b
        return torch.cat([c.max(2)[0] + own_c, b.max(2)[0], a.max(2)[0], features], dim=-1)

    def split(self):
        """The three linear maps, regrouped by what they act on.

        Returns ((own [C,3G], bias [3G]), neighbour [C,G], on_a [G,2G], on_b [G,G]), all for products from the right:
        `own` acts on f_i (columns: maps 1, 2, 3), `neighbour` on f_j (map 1), `on_a` on a (columns: maps 2 and 3),
        `on_b` on b (map 3).
        """
        c, g = self.channels, self.growth
        first, second, third = self.first.weight, self.second.weight, self.third.weight
        own = torch.cat([first[:, :c] - first[:, c:], second[:, g:], third[:, 2 * g :]]).t()
        bias = torch.cat([self.first.bias, self.second.bias, self.third.bias])
        return (own, bias), first[:, c:].t(), torch.cat([second[:, :g], third[:, g : 2 * g]]).t(), third[:, :g].t()

    def plain(self, features: torch.Tensor, indices: Optional[torch.Tensor] = None) -> torch.Tensor:
        """The definition, step by step."""
        if indices is None:
            indices = nearest_in_features(features, self.k)
        centre = features.unsqueeze(2).expand(-1, -1, self.k, -1)
        edge = torch.cat([centre, gather_rows(features, indices) - centre], dim=-1)
        a = functional.relu(self.first(edge))
        b = functional.relu(self.second(torch.cat([a, centre], dim=-1)))
        c = self.third(torch.cat([b, a, centre], dim=-1))
        return torch.cat([c, b, a, centre], dim=-1).max(dim=2)[0]
