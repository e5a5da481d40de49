"""The command line; `python -m densecloud_training.score --help`."""

import argparse
import json
from pathlib import Path
from typing import List, Sequence

from ..clouds import validation_names
from ..errors import run_command
from ..prepare import find_program
from . import (
    confidence,
    noisy,
    peers,
    pictures,
    plane,
    real,
    rules,
    stress,
    surfaces,
    targets,
    thin,
    tiled,
    validation,
    worst,
)
from .inputs import Inputs
from .program import Program
from .splats import experiment as splats


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--program", default="", help="the densecloud program [default: target/release, or the path]")
    common.add_argument("--model", type=Path, help="folder of another model than the one inside the program")
    common.add_argument("--threads", type=int, help="worker threads [default: one a processor]")
    common.add_argument("--out", type=Path, required=True, help="folder for tables, and for what is made on the way")
    common.add_argument("--shapes", help="only these, separated by commas: for a trial")
    further = "a further option of `evaluate` and `upsample`: --option=--inner=0.7"
    common.add_argument("--option", action="append", default=[], help=further)
    meshes = argparse.ArgumentParser(add_help=False)
    meshes.add_argument("--meshes", type=Path, required=True, help="folder that has the held-out meshes")

    top = argparse.ArgumentParser(prog="densecloud_training.score", description="Scores of the finished program.")
    commands = top.add_subparsers(dest="command", required=True)
    commands.add_parser("validation", parents=[common, meshes], help="held-out shapes, beside the controls")
    commands.add_parser("stress", parents=[common, meshes], help="curves over noise and over removed points")
    commands.add_parser("rules", parents=[common, meshes], help="overlap, merging, strays, polish: each changed alone")
    commands.add_parser("targets", parents=[common, meshes], help="how well a spacing or a density is met")
    commands.add_parser("thin", parents=[common, meshes], help="thin and close parts of the shapes against the rest")
    found = commands.add_parser("tiles", parents=[common, meshes], help="shapes and scans in one piece and in tiles")
    found.add_argument("--scans", type=Path, action="append", default=[], help="a folder of scans; may be given again")
    found = commands.add_parser("peers", parents=[common], help="the PU-GAN benchmark, beside other networks")
    found.add_argument("--benchmark", type=Path, required=True, help="folder with mesh/, input_*/ and reference_*/")
    found = commands.add_parser("real", parents=[common], help="real scans, thinned and upsampled back")
    found.add_argument(
        "--scans", type=Path, required=True, action="append", help="a folder of scans; may be given again"
    )
    commands.add_parser("plane", parents=[common], help="what the columns of `real` say of a perfect result")
    found = commands.add_parser("confidence", parents=[common, meshes], help="what is said of points against the truth")
    found.add_argument("--scans", type=Path, action="append", default=[], help="a folder of scans; may be given again")
    found.add_argument("--fit", action="store_true", help="also fits the model's constants, on one half of the inputs")
    found = commands.add_parser("noisy", parents=[common, meshes], help="what cleaning before upsampling gains")
    found.add_argument("--scans", type=Path, help="folder of scans: draws one of them too, cleaned in each way")
    commands.add_parser("surfaces", parents=[common, meshes], help="meshes of sparse clouds and of upsampled ones")
    found = commands.add_parser("splats", parents=[common, meshes], help="what denser seeds gain Gaussian splatting")
    found.add_argument("--seeds", type=int, default=splats.SEEDS, help="scenes of each shape [default: %(default)s]")
    found.add_argument("--steps", type=int, default=splats.STEPS, help="of each optimisation [default: %(default)s]")
    found = commands.add_parser("pictures", parents=[common], help="before and after, of real scans")
    found.add_argument("--scans", type=Path, required=True, help="folder of scans")
    found.add_argument("names", nargs="*", help=f"of: {' '.join(view.scan for view in pictures.VIEWS)}")
    return top


def held_out(arguments: argparse.Namespace, program: Program, usual: Sequence[str] = ()) -> Inputs:
    """The held-out shapes that were asked for; else the `usual` ones; else all."""
    names = validation_names()
    if usual and not arguments.shapes:
        names = list(usual)
    if arguments.shapes:
        asked = arguments.shapes.split(",")
        unknown = sorted(set(asked) - set(names))
        if unknown:
            raise SystemExit(f"not held out: {', '.join(unknown)}; there are: {', '.join(names)}")
        names = [name for name in names if name in asked]
    return Inputs(program, arguments.meshes, arguments.out, names)


def write(out: Path, name: str, text: str) -> None:
    """Keeps a table, and prints it."""
    (out / name).write_text(text)
    print(text)


def run(arguments: argparse.Namespace) -> None:
    """Runs one command."""
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    program = Program(find_program(arguments.program), arguments.model, arguments.threads, arguments.option)
    if arguments.command == "validation":
        inputs = held_out(arguments, program)
        reports = validation.evaluate(inputs)
        write(out, "validation.md", validation.text(reports, validation.centroids_alone(inputs, reports)))
    elif arguments.command == "stress":
        steps = stress.evaluate(held_out(arguments, program))
        (out / "stress.json").write_text(json.dumps(stress.as_json(steps), indent=1) + "\n")
        stress.draw(steps, out / "stress.png")
        write(out, "stress.md", stress.text(steps))
    elif arguments.command == "rules":
        write(out, "rules.md", rules.text(rules.evaluate(held_out(arguments, program))))
    elif arguments.command == "targets":
        write(out, "targets.md", targets.text(targets.evaluate(held_out(arguments, program), out)))
    elif arguments.command == "thin":
        write(out, "thin.md", thin.text(thin.evaluate(held_out(arguments, program))))
    elif arguments.command == "tiles":
        inputs = held_out(arguments, program, validation_names()[: tiled.SHAPES])
        write(out, "tiles.md", tiled.text(tiled.shapes(inputs), tiled.scans(program, arguments.scans, out)))
    elif arguments.command == "peers":
        only: List[str] = arguments.shapes.split(",") if arguments.shapes else []
        write(out, "peers.md", peers.text(peers.evaluate(program, arguments.benchmark, out, only or None)))
    elif arguments.command == "real":
        only = arguments.shapes.split(",") if arguments.shapes else []
        rows, facts = real.evaluate(program, arguments.scans, out, only)
        write(out, "real.md", real.text(rows, facts))
        print(f"the worst: {worst.draw(program, rows, out)}")
    elif arguments.command == "plane":
        write(out, "plane.md", plane.text())
    elif arguments.command == "confidence":
        cases = list(confidence.shapes(held_out(arguments, program)))
        cases += confidence.scans(program, arguments.scans, out)
        confidence.draw(cases, out / "confidence.png")
        write(out, "confidence.md", confidence.text(cases))
        if arguments.fit:
            write(out, "confidence-fit.md", confidence.fit_text(cases))
    elif arguments.command == "surfaces":
        write(out, "surfaces.md", surfaces.text(surfaces.evaluate(held_out(arguments, program, surfaces.SHAPES))))
    elif arguments.command == "noisy":
        drawn = noisy.draw(program, arguments.scans, out) + "\n" if arguments.scans else ""
        inputs = held_out(arguments, program, noisy.SHAPES)
        write(out, "noisy.md", drawn + noisy.text(noisy.evaluate(inputs), inputs.shapes))
    elif arguments.command == "splats":
        runs = splats.evaluate(held_out(arguments, program, splats.SHAPES), arguments.seeds, arguments.steps)
        write(out, "splats.md", splats.text(runs))
    elif arguments.command == "pictures":
        for view in pictures.views(arguments.names):
            picture = pictures.draw(program, view, arguments.scans, out)
            print(f"{picture}: {picture.stat().st_size / 1024:.0f} KiB")


def main() -> None:
    run(parser().parse_args())


if __name__ == "__main__":
    run_command(main)
