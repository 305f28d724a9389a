"""``cazsl-train simulate shapes``: a table of pushes of drawn shapes, and a picture of them."""

import time
from pathlib import Path
from typing import Final

import click

from service.bulk.executors import choose_executor
from service.cli.command_line import FILE, FOLDER, argument, option
from service.cli.terminal import echo
from service.processors import processors
from training.shapes.dataset import ShapePlan, simulate_shapes
from training.shapes.families import FAMILIES, KINDS, chosen_families

DEFAULT_FOLDER: Final = Path("data/shapes")
NAMES: Final = [*KINDS, *FAMILIES]


@click.command("shapes", short_help="Objects of random families, as a table of pushes.")
@argument("folder", type=FOLDER, default=DEFAULT_FOLDER)
@option("--objects", type=click.IntRange(1, 1_000_000), default=4000, show_default=True, help="Objects to draw.")
@option("--pushes", type=click.IntRange(1, 100_000), default=200, show_default=True, help="Pushes of each object.")
@option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random numbers.")
@option("--families", type=click.Choice(NAMES), multiple=True, help="Families or kinds to draw from. [default: all]")
@option("--hold-out", type=click.Choice(NAMES), multiple=True, help="Families or kinds to leave out, to test on later.")
@option("--jobs", type=click.IntRange(1, 1024), help="Objects at once. [default: one per processor]")
@option("--gallery", type=FILE, help="Draw only this PNG: the families, and some objects with a push.")
def simulate_drawn_shapes(
    folder: Path,
    objects: int,
    pushes: int,
    seed: int,
    families: tuple[str, ...],
    hold_out: tuple[str, ...],
    jobs: int | None,
    gallery: Path | None,
) -> None:
    """Draw objects of named families, push them in the simulation, and write them as a table into FOLDER.

    \b
    blocks   box, rounded-box, bar, regular-polygon, irregular-polygon, ellipse, star
    letters  L, T, U, H, Z, cross
    tools    wrench, hammer, screwdriver, bottle, mug, pan, spoon, key
    blobs    blob, bean, union

    The largest extent of objects is 20 to 300 mm, pushes are 5 to 120 mm long. They start between touch and their own
    length before it, aimed anywhere over the outline and past it. Give --families and --hold-out several times to name
    several families. An interrupted command continues where it stopped. The files depend on the options, but not on
    --jobs or on interruptions. The default FOLDER is data/shapes.
    """
    chosen = chosen_families(families, hold_out)
    if gallery is not None:
        if gallery.suffix.lower() != ".png":
            raise click.BadParameter(f"{gallery} is not the name of a PNG file. Send one that ends in .png.")
        from training.shapes.gallery import draw_gallery  # slow to import, as matplotlib is

        draw_gallery(gallery, chosen, seed)
        echo(f"{gallery} shows {len(chosen)} families, and pushes of two objects of each")
        return
    started = time.perf_counter()
    executor = choose_executor(jobs or processors())
    simulated = simulate_shapes(ShapePlan(objects, pushes, seed, chosen), folder, executor)
    seconds = time.perf_counter() - started
    if simulated:
        rate = f"{simulated} pushes took {seconds:.0f} s, {simulated / seconds:.0f} a second on {executor.description}"
        echo(rate)
    else:
        echo(f"{folder} holds this table already")
    echo(f"{folder}: {objects} objects of {len(chosen)} families, {objects * pushes} pushes")
    echo(f"next: cazsl-train data check {folder}")
