"""``cazsl-train simulate`` and ``images``: pushes and views that stand in for those of Omnipush."""

import hashlib
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import click

from service.cli.command_line import FILE, FOLDER, argument, option
from service.cli.terminal import echo
from training.cli.options import DefaultGroup
from training.inspection.statistics import compare_statistics, missed
from training.inspection.text import statistics_lines
from training.omnipush.layout import SIMULATED, data_options
from training.omnipush.published import different_surfaces, omnipush_descriptors, published_normalisation
from training.omnipush.pushes import read_folder
from training.omnipush.views import VIEWS_FOLDER, camera_views_beside, read_camera_views, read_views
from training.simulation.dataset import Simulation, simulate_dataset
from training.simulation.drawing import write_camera_views, write_views
from training.simulation.plans import APPROACH, DEFAULT_PLAN, OMNIPUSH_APPROACH, PLANS, approach_plan
from training.simulation.surfaces import ABS, SURFACES

DEFAULT_VIEWS: Final = SIMULATED / VIEWS_FOLDER
DEFAULT_CAMERA_VIEWS: Final = SIMULATED / f"{VIEWS_FOLDER}-camera"


@click.group("simulate", cls=DefaultGroup)
def simulate() -> None:
    """Simulate pushes: of Omnipush's objects, unless another command is named.

    \b
    cazsl-train simulate                        all 250 objects of Omnipush, into data/approach
    cazsl-train simulate FOLDER                 ... into another folder
    cazsl-train simulate --plan ring            the data of the committed tables, into data/simulated
    cazsl-train simulate omnipush -h            all options
    cazsl-train simulate shapes                 objects of random families, into data/shapes
    """


@simulate.command("omnipush", short_help="The objects of Omnipush, in Omnipush's file format (the default).")
@argument("folder", type=FOLDER, required=False)
@option(
    "--plan",
    "plan_name",
    type=click.Choice(list(PLANS)),
    default=DEFAULT_PLAN.name,
    show_default=True,
    help="; ".join(f"{plan.name}: {plan.summary}" for plan in PLANS.values()) + ".",
)
@option(
    "--miss-share",
    type=click.FloatRange(0.0, 0.99),
    help=f"Share of the pushes that never touch the object, with the plan approach. "
    f"[default: {OMNIPUSH_APPROACH.miss_share}]",
)
@option("--surface", type=click.Choice([*SURFACES, "all"]), default="all", show_default=True, help="Surface.")
@option("--pushes", type=click.IntRange(1, 100_000), default=250, show_default=True, help="Pushes per object.")
@option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all random numbers.")
@option("--threads", type=click.IntRange(1, 1024), help="Threads. Files do not depend on it. [default: all cores]")
def simulate_omnipush(
    folder: Path | None,
    plan_name: str,
    miss_share: float | None,
    surface: str,
    pushes: int,
    seed: int,
    threads: int | None,
) -> None:
    """Simulate the default datasets in Omnipush's file format: FOLDER/abs, FOLDER/plywood, FOLDER/top-down_view.

    All 250 objects of Omnipush are pushed on ABS and the published ten on plywood, and drawn from above. Existing files
    are kept. The default FOLDER is the plan's: data/approach, or data/simulated for the ring.
    """
    plan = PLANS[plan_name]
    if miss_share is not None:
        if plan is not APPROACH:
            raise click.UsageError(f"--miss-share is for the plan approach. The plan {plan.name} has its own starts.")
        plan = approach_plan(replace(OMNIPUSH_APPROACH, miss_share=miss_share))
    folder = folder or plan.folder
    for name in SURFACES if surface == "all" else (surface,):
        objects = omnipush_descriptors() if name == ABS.name else different_surfaces().test
        started = time.perf_counter()
        simulated = simulate_dataset(Simulation(objects, pushes, seed, SURFACES[name], plan), folder / name, threads)
        _describe_pushes(folder / name, simulated, time.perf_counter() - started)
        write_views(folder / VIEWS_FOLDER, objects)
    data = data_options(folder / ABS.name, None)
    echo(f"{folder / VIEWS_FOLDER}: top-down views of the objects; next: cazsl-train fit push-indicator{data}")


def _describe_pushes(folder: Path, simulated: int, seconds: float) -> None:
    """Print the duration, the content of the folder, and its statistics beside the published ones."""
    found = read_folder(folder)
    if simulated:
        echo(f"{simulated} pushes took {seconds:.0f} s, {1e3 * seconds / simulated:.1f} ms a push")
    pushers, outcomes = found.rows()
    echo(
        f"{folder}: {found.source}: {len(found.descriptors)} objects, {found.count} pushes, "
        f"{100 * missed(outcomes).mean():.2f} % missed the object; sha256 {found.digest}"
    )
    for line in statistics_lines(compare_statistics(pushers, outcomes, published_normalisation())):
        echo(line)


@click.command("images")
@argument("folder", type=FOLDER, required=False)
@option("--camera", is_flag=True, help="Views as a camera would see them: light, table, blur, noise, JPEG.")
@option(
    "--views",
    type=click.IntRange(1, 1024),
    help="With --camera: so many views of each object, reduced to 32 x 32, for training.",
)
@option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the effects of --camera.")
@option(
    "--gallery",
    type=FILE,
    help="Draw only this PNG: some objects as drawn, as a camera sees them, and as a model's input.",
)
def draw_images(folder: Path | None, camera: bool, views: int | None, seed: int, gallery: Path | None) -> None:
    """Draw the top-down views of all 250 objects into FOLDER, in Omnipush's file format.

    The default FOLDER is data/approach/top-down_view, with --camera data/approach/top-down_view-camera, and with
    --views data/approach/top-down_view-cameras. Existing views are kept. The files depend on object and seed alone.
    """
    if gallery is not None:
        if gallery.suffix.lower() != ".png":
            raise click.BadParameter(f"{gallery} is not the name of a PNG file. Send one that ends in .png.")
        from training.inspection.view_gallery import draw_gallery  # slow to import, as matplotlib is

        draw_gallery(gallery, seed=seed)
        echo(f"{gallery} shows clean views, camera views, and the 32 x 32 input of a model")
        return
    if views is not None:
        if not camera:
            raise click.UsageError("--views draws many camera views of each object. Add --camera.")
        folder = folder or camera_views_beside(DEFAULT_VIEWS)
        write_camera_views(folder, omnipush_descriptors(), views, seed)
        found = read_camera_views(folder, omnipush_descriptors(), views)
        digest = hashlib.sha256(found.tobytes()).hexdigest()
        echo(f"{folder}: {views} camera views of each of {len(found)} objects, 32 x 32; sha256 of all: {digest}")
        echo("next: cazsl-train fit push-visual")
        return
    folder = folder or (DEFAULT_CAMERA_VIEWS if camera else DEFAULT_VIEWS)
    descriptors = omnipush_descriptors()
    write_views(folder, descriptors, camera, seed)
    contexts = read_views(folder, descriptors)
    digest = hashlib.sha256(contexts.tobytes()).hexdigest()
    echo(f"{folder}: {len(contexts)} views of 481 x 481; sha256 of their 32 x 32 contexts: {digest}")
    echo("next: cazsl-train images --gallery views.png, and look at it")
