"""How the package's commands end where what they were given cannot be used: by one line, not by a trace."""

from typing import Callable


class InputError(ValueError):
    """A file or a setting that a command was given is not what it needs; the text says what to give instead."""


def run_command(main: Callable[[], None]) -> None:
    """Runs a command; an unusable input, or a file that cannot be read or written, ends it with exit code 1."""
    try:
        main()
    except InputError as error:
        raise SystemExit(f"failed: {error}") from error
    except OSError as error:
        if error.filename is None:
            raise
        raise SystemExit(f"failed: {error.filename}: {error.strerror}") from error
