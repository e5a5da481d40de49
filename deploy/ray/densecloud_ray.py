"""Makes a cloud dense on a Ray cluster: the plan, each tile and the join are tasks, which Ray places and tries again.

    from densecloud_ray import upsample

    upsample("s3://bucket/scan.laz", "s3://bucket/dense.laz", ratio=4)

Each node has the program `densecloud`, and in its environment what the store asks for (AWS_ACCESS_KEY_ID and so on).
Without a store, all names are paths that the nodes share.
"""

import resource
import subprocess
import sys
import time
import uuid

import ray
import ray.exceptions


class DensecloudError(RuntimeError):
    """What the program said as it failed."""


class Refused(ValueError):
    """An argument is wrong: it would be again."""


def upsample(
    input: str,
    output: str,
    *,
    ratio: float | None = None,
    folder: str | None = None,
    program: str = "densecloud",
    cpus: int = 1,
    retries: int = 3,
    **options: object,
) -> dict[str, float]:
    """Upsamples `input` into `output`, and gives figures: tiles, and the seconds of processors that the steps took.

    `folder` is where the work lies (beside the output), in a folder of its own that is removed at the end. `cpus` are
    the threads of each step. `retries` is how often a step is tried again that fails or whose node is lost. The others
    are options of `densecloud tiles plan`: `tile_points=400_000`, `keep_input=True`, `quality="best"`.

    The result is that of `densecloud upsample` with the same options, byte for byte.
    """
    base = folder or f"{output}.tiles"
    if ratio is not None:
        options["ratio"] = ratio
    # Nodes have the program, but not this file.
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    step = ray.remote(num_cpus=cpus, max_retries=retries, retry_exceptions=[DensecloudError])
    plan_step, other_step = step(planned), step(ran)
    threads = ["--threads", str(cpus)]
    plan = [input, "--for", output, "--quiet", *threads, *flags(options)]
    try:
        work, tiles, spent = ray.get(plan_step.remote(program, base, plan))
        runs = [other_step.remote(program, ["run", work, str(tile), *threads]) for tile in range(tiles)]
        seconds = sum(ray.get(runs))
        joined = ray.get(other_step.remote(program, ["join", work, output, "--quiet"]))
        ray.get(other_step.remote(program, ["remove", work]))
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    return {"tiles": tiles, "plan": spent, "run": seconds, "join": joined}


def flags(options: dict[str, object]) -> list[str]:
    """Options as the command line has them."""
    given = [(f"--{name.replace('_', '-')}", value) for name, value in options.items() if value is not False]
    return [flag if value is True else f"{flag}={value}" for flag, value in given if value is not None]


def planned(program: str, base: str, arguments: list[str]) -> tuple[str, int, float]:
    """Plans in a folder of this attempt's own: what one left that was lost is in nobody's way."""
    work = f"{base}/{uuid.uuid4().hex}"
    source, *rest = arguments
    told, spent = densecloud(program, ["plan", source, work, *rest])
    return work, int(told), spent


def ran(program: str, arguments: list[str]) -> float:
    """Takes another step; gives the seconds of processors."""
    return densecloud(program, arguments)[1]


def densecloud(program: str, arguments: list[str]) -> tuple[str, float]:
    """Runs a step, and gives what it printed and the seconds of processors that it took."""
    before = processor_seconds()
    done = subprocess.run([program, "tiles", *arguments], capture_output=True, text=True, check=False)
    if done.returncode == 64:
        raise Refused(done.stderr.strip())
    if done.returncode != 0:
        raise DensecloudError(done.stderr.strip() or f"{program} ended with {done.returncode}")
    return done.stdout, processor_seconds() - before


def processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    import argparse

    parser = argparse.ArgumentParser(description="Makes a cloud dense on a Ray cluster.")
    parser.add_argument("input")
    parser.add_argument("output")
    parser.add_argument("--ratio", type=float)
    parser.add_argument("--tile-points", type=int)
    parser.add_argument("--cpus", type=int, default=1)
    parser.add_argument(
        "--address", help="the cluster's; without it the one that this machine is part of, or a new one here"
    )
    arguments = parser.parse_args()
    ray.init(address=arguments.address)
    begin = time.monotonic()
    figures = upsample(
        arguments.input,
        arguments.output,
        ratio=arguments.ratio,
        tile_points=arguments.tile_points,
        cpus=arguments.cpus,
    )
    print({**figures, "seconds": time.monotonic() - begin})


if __name__ == "__main__":
    main()
