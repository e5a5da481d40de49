"""How far a work is, on a terminal or wherever the caller wants."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import Union

#: Hears what is done, from 0 to 1, and the name of the stage.
Hear = Callable[[float, str], object]

#: Whether to show a bar, or who hears how far it is.
ProgressLike = Union[bool, Hear, None]

_WIDTH = 30


class Bar:
    """A line on standard error."""

    def __call__(self, fraction: float, stage: str) -> None:
        done = "=" * round(_WIDTH * fraction)
        sys.stderr.write(f"\r[{done:<{_WIDTH}}] {100 * fraction:3.0f} %  {stage:<12}")
        sys.stderr.flush()

    def end(self) -> None:
        sys.stderr.write("\n")


@contextlib.contextmanager
def heard(progress: ProgressLike) -> Iterator[Hear | None]:
    """Who hears of it: the last of it, too, and then the line of a bar ends."""
    hear = (Bar() if progress else None) if progress is None or isinstance(progress, bool) else progress
    try:
        yield hear
        if hear is not None:
            hear(1.0, "done")
    finally:
        if isinstance(hear, Bar):
            hear.end()
