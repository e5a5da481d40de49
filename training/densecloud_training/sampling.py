"""Ways to sample an input: each takes points that are much denser and says which of them a sensor would have given.

All take offsets [B,D,3] in patch radii, where an even patch has a point about every 0.1, and `share`, how many of the
points an even sampling would keep. They give masks [B,D].
"""

from typing import List

import torch

# A depth image around the seed: this many pixels a side, and a patch radius. A patch of even points has about 10 points
# a radius; slopes take some away, so pixels are finer.
SCAN_GRID = 104
SCAN_PIXELS_PER_RADIUS = 13
FAR = 1e9
# Scan lines: how far they lie apart at least and at most (0.17 is 3 times as far as their points, 0.55 is 30 times),
# how wide a line is, and how many of them are lost.
LINES_APART = (0.17, 0.55)
LINE_WIDTH = 0.03
LINES_LOST = 0.1
# Of the patches of scan lines, how many have dashes; of a dash, how much is seen.
DASHED = 0.35
DASH = 0.55


def random_rotations(count: int, device: torch.device) -> torch.Tensor:
    """[count,3,3], uniform over rotations (from uniform unit quaternions)."""
    w, x, y, z = torch.nn.functional.normalize(torch.randn(count, 4, device=device), dim=1).unbind(1)
    rows: List[torch.Tensor] = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, 1).view(count, 3, 3)


def directions(count: int, device: torch.device) -> torch.Tensor:
    """[count,3,1] random unit vectors."""
    return torch.nn.functional.normalize(torch.randn(count, 3, 1, device=device), dim=1)


def fraction(values: torch.Tensor) -> torch.Tensor:
    """What is above the next lower whole number, 0 to 1, for negative values too."""
    return values - values.floor()


def thin_random(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """Uniform random sampling: every point is kept with the same probability."""
    return torch.rand(offsets.shape[:2], device=offsets.device) < share


def thin_ramp(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """Density rises along a random direction, by up to e^2.4 across a patch."""
    count, device = len(offsets), offsets.device
    slope = 1.2 * torch.rand(count, 1, device=device)
    along = (offsets @ directions(count, device)).squeeze(-1).clamp(-1.5, 1.5)
    return torch.rand(along.shape, device=device) < share * torch.exp(slope * along)


def thin_stripes(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """Scan lines: points lie in parallel sheets, denser along them than across."""
    count, device = len(offsets), offsets.device
    spacing = 0.15 + 0.15 * torch.rand(count, 1, device=device)
    phase = (offsets @ directions(count, device)).squeeze(-1) / spacing + torch.rand(count, 1, device=device)
    width = 0.25
    inside = (phase - phase.floor()) < width
    return inside & (torch.rand(phase.shape, device=device) < share / width)


def thin_scan(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """A single view: of all points behind one pixel only the nearest is seen (slopes get sparse, backs vanish)."""
    count, device = len(offsets), offsets.device
    turned = offsets @ random_rotations(count, device)
    pixels = torch.floor(turned[..., :2] * SCAN_PIXELS_PER_RADIUS).long() + SCAN_GRID // 2
    inside = ((pixels >= 0) & (pixels < SCAN_GRID)).all(-1)
    cells = (pixels[..., 0] * SCAN_GRID + pixels[..., 1]).masked_fill(~inside, SCAN_GRID * SCAN_GRID)
    depth = turned[..., 2]
    nearest = torch.full((count, SCAN_GRID * SCAN_GRID + 1), -FAR, device=device)
    nearest = nearest.scatter_reduce(1, cells, depth, reduce="amax", include_self=True)
    return inside & (depth >= nearest.gather(1, cells))


def thin_lines(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """Scan lines whose points are 3 to 30 times as dense along them as across; some lines are lost, some in dashes."""
    count, device = len(offsets), offsets.device
    near, far = LINES_APART
    apart = near * (far / near) ** torch.rand(count, 1, device=device)
    turned = offsets @ random_rotations(count, device)
    across = turned[..., 0] / apart + torch.rand(count, 1, device=device)
    line = across.floor()
    seen = (across - line) * apart < LINE_WIDTH
    # The same number for all points of a line, without a table.
    lost = fraction(line * 0.754877 + torch.rand(count, 1, device=device)) < LINES_LOST
    dash = fraction(turned[..., 1] / (2 * apart) + 0.5 * line) < DASH
    dash |= torch.rand(count, 1, device=device) >= DASHED
    return seen & ~lost & dash & (torch.rand(across.shape, device=device) < share * apart / LINE_WIDTH)


def thin_range(offsets: torch.Tensor, share: float) -> torch.Tensor:
    """Density falls with the square to fourth power of the distance from a sensor that is 1.3 to 4 radii away."""
    count, device = len(offsets), offsets.device
    away = 1.3 + 2.7 * torch.rand(count, 1, device=device)
    power = 2 + 2 * torch.rand(count, 1, device=device)
    sensor = directions(count, device).transpose(1, 2) * away.unsqueeze(-1)
    distances = (offsets - sensor).norm(dim=-1)
    return torch.rand(distances.shape, device=device) < share * (away / distances.clamp_min(0.3)) ** power


KINDS = {
    "random": thin_random,
    "ramp": thin_ramp,
    "stripes": thin_stripes,
    "scan": thin_scan,
    "lines": thin_lines,
    "range": thin_range,
}
