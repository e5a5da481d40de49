"""Before and after, of real scans."""

from dataclasses import dataclass
from pathlib import Path
from typing import List, Sequence, Tuple

from .inputs import write_points
from .program import Program
from .scans import crop, read_scan

Corner = Tuple[float, float, float]
RATIO = 4
EXTENSIONS = (".pcd", ".las", ".ply", ".xyz", ".pwn")
# So many colours that shading shows no steps; a picture of them is a third as large.
COLOURS = 96


@dataclass(frozen=True)
class View:
    """Where to look from, at which part of a scan; corners are shares of its box, angles as `densecloud render`'s."""

    scan: str
    view: str
    up: str = "z"
    low: Corner = (0.0, 0.0, 0.0)
    high: Corner = (1.0, 1.0, 1.0)
    # Pixels of one cloud.
    size: str = "640x520"

    @property
    def options(self) -> Sequence[object]:
        return ["--size", self.size, f"--view={self.view}", "--up", self.up]


# A head and a building by laser, a carton by a depth camera, a lamp post from a street scanner, a house front from the
# ground, and a bridge from an aircraft. A part was chosen where the whole would not show single points.
VIEWS = (
    View("cgal_oni", "20,5", "y"),
    View("cgal_building", "80,15", low=(0.5, 0.0, 0.0), high=(1.0, 0.25, 1.0)),
    View("pcl_milk", "350,20", "y"),
    View("pcl_lamppost", "110,10", low=(0.0, 0.0, 0.75)),
    View("pcl_region_growing_tutorial", "200,20", "x", high=(0.35, 1.0, 1.0)),
    View("pdal_autzen_trim", "30,25", low=(0.3, 0.5, 0.0), high=(0.5, 1.0, 1.0)),
)


def views(names: Sequence[str]) -> List[View]:
    """The views of the scans named, in that order; those of all without a name."""
    known = {view.scan: view for view in VIEWS}
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise SystemExit(f"no view is known of {', '.join(unknown)}; there are: {', '.join(known)}")
    return [known[name] for name in names] or list(VIEWS)


def find_scan(folder: Path, name: str) -> Path:
    """A scan's file, whatever its extension."""
    files = sorted(file for file in folder.glob(f"{name}.*") if file.suffix.lower() in EXTENSIONS)
    if not files:
        raise SystemExit(f"{folder} has no {name} as {', '.join(EXTENSIONS)}")
    return files[0]


def draw(program: Program, view: View, scans: Path, out: Path) -> Path:
    """Upsamples what the view shows and draws it beside what it was: `OUT/pictures/SCAN.png`."""
    clouds = out / "scans"
    clouds.mkdir(parents=True, exist_ok=True)
    sparse, dense = clouds / f"{view.scan}.xyz", clouds / f"{view.scan}-dense.ply"
    write_points(sparse, crop(read_scan(find_scan(scans, view.scan)), view.low, view.high))
    program.upsample(sparse, dense, "--ratio", RATIO)
    return beside(program, [sparse, dense], view, out)


def beside(program: Program, clouds: Sequence[Path], view: View, out: Path) -> Path:
    """Draws clouds side by side, in few colours, as `OUT/pictures/SCAN.png`."""
    picture = out / "pictures" / f"{view.scan}.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    others = [argument for cloud in clouds[1:] for argument in ("--beside", cloud)]
    program.run("render", clouds[0], picture, *others, *view.options)
    from PIL import Image

    with Image.open(picture) as image:
        few = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(picture, optimize=True)
    return picture
