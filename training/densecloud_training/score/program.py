"""The `densecloud` program: its commands, and results that are kept."""

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Sequence

from ..errors import InputError
from . import report
from .report import Report


class ProgramError(InputError):
    """A command of the program failed; the message holds the command and what it said."""


@dataclass(frozen=True)
class Program:
    """The program, and the options that all of a table's rows share."""

    path: str
    # Another model folder than the one inside the program.
    model: Optional[Path] = None
    threads: Optional[int] = None
    # Further options of `evaluate` and `upsample`.
    options: Sequence[str] = ()

    def run(self, *arguments: object) -> str:
        """Runs one command; gives what it printed."""
        command = [self.path, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            raise ProgramError(f"{' '.join(command)}\n{done.stderr.strip()}")
        return done.stdout

    def sample(self, mesh: Path, out: Path, points: int, seed: int, *more: object) -> Path:
        """Points of a mesh; a file that is there and no older than the mesh is used again."""
        if not (out.exists() and out.stat().st_mtime_ns >= mesh.stat().st_mtime_ns):
            out.parent.mkdir(parents=True, exist_ok=True)
            # Under another name until it is whole: a run that was stopped must not leave half a cloud.
            partial = out.with_name(f".{os.getpid()}-{out.name}")
            self.run("sample", mesh, partial, "--points", points, "--seed", seed, *more)
            partial.replace(out)
        return out

    def evaluate(
        self,
        kept: Path,
        inputs: Path,
        reference: Path,
        meshes: Path,
        shapes: List[str],
        ratio: float,
        controls: bool = True,
    ) -> Report:
        """Upsamples and scores `shapes`, and the controls beside. The result is kept in the folder `kept`, under a name
        that tells program, model, options and the times of all files apart."""
        # Python's shortest form of the ratio is read back as the same number.
        arguments = ["evaluate", "--input", inputs, "--reference", reference, "--mesh", meshes, "--shapes",
                     ",".join(shapes), "--ratio", repr(ratio), "--quiet", "--json", "-",
                     *(["--controls"] if controls else []), *self.model_options()]  # fmt: skip
        stamps = [stamp(Path(self.path)), *folder_stamps(inputs, shapes), *folder_stamps(reference, shapes)]
        stamps += [stamp(file) for file in sorted(self.model.iterdir())] if self.model else []
        key = hashlib.sha256("\n".join([*map(str, arguments), *stamps]).encode()).hexdigest()[:16]
        file = kept / f"{inputs.name}-{reference.name}-{key}.json"
        if not file.exists():
            print(f"{inputs.name} -> {reference.name}: {len(shapes)} shapes", file=sys.stderr, flush=True)
            threads = ["--threads", self.threads] if self.threads else []
            text = self.run(*arguments, *threads)
            kept.mkdir(parents=True, exist_ok=True)
            partial = file.with_name(f".{os.getpid()}-{file.name}")
            partial.write_text(text)
            partial.replace(file)
        return report.parse(json.loads(file.read_text()))

    def score(self, clouds: Path, reference: Path, meshes: Path, shapes: List[str]) -> Report:
        """Scores dense clouds that are there already; no controls, nothing kept."""
        text = self.run("evaluate", "--pred", clouds, "--reference", reference, "--mesh", meshes, "--shapes",
                        ",".join(shapes), "--quiet", "--json", "-")  # fmt: skip
        return report.parse(json.loads(text))

    def upsample(self, cloud: Path, out: Path, *more: object) -> Path:
        """A denser cloud, always made anew."""
        threads = ["--threads", self.threads] if self.threads else []
        self.run("upsample", cloud, out, "--quiet", *more, *self.model_options(), *threads)
        return out

    def model_options(self) -> List[object]:
        """The options that decide what the cascade gives."""
        return [*(["--model", self.model] if self.model else []), *self.options]


def stamp(path: Path) -> str:
    """Tells a file from a later one of the same name."""
    found = path.stat()
    return f"{path} {found.st_size} {found.st_mtime_ns}"


def folder_stamps(folder: Path, shapes: List[str]) -> List[str]:
    """The stamps of the shapes' files in a folder."""
    return [stamp(file) for file in sorted(folder.iterdir()) if file.stem in shapes]
