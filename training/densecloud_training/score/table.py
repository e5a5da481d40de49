"""Tables in Markdown."""

import math
from typing import Iterable, List, Sequence


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table, with a line end after it. Cells of every row must be as many as the header's."""
    lines: List[Sequence[str]] = [header, ["---"] * len(header), *rows]
    for line in lines:
        if len(line) != len(header):
            raise ValueError(f"a row of {len(line)} cells under a header of {len(header)}: {line}")
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def thousandths(value: float, digits: int = 3) -> str:
    """A value times 1000; a dash for what is not finite."""
    return plain(value * 1000, digits)


def plain(value: float, digits: int = 2) -> str:
    """A value as it is; a dash for what is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def published(cd: float, hd: float, p2f: float) -> str:
    """CD / HD / P2F from raw values, in the digits of the field's tables."""
    return f"{thousandths(cd)} / {thousandths(hd, 2)} / {thousandths(p2f, 2)}"
