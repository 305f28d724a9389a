"""``cazsl-train``: simulate pushes, draw views, fit a recipe, evaluate it, publish it, reproduce the paper."""

import click

import service
from service.cli.command_line import HELP, CommandLine
from training.cli.data import data
from training.cli.reproduction import reproduce
from training.cli.runs import evaluate, fit_recipe, publish
from training.cli.shapes import simulate_drawn_shapes
from training.cli.simulation import draw_images, simulate


@click.group(cls=CommandLine, context_settings=HELP)
@click.version_option(service.__version__, prog_name="cazsl-train")
def main() -> None:
    """Train pushing models and publish them.

    \b
    cazsl-train simulate                        62,500 pushes of 250 objects on ABS, 2,500 of 10 on plywood
    cazsl-train simulate shapes                 800,000 pushes of 4,000 objects: boxes, letters, tools, blobs
    cazsl-train data check FOLDER               is this copy of Omnipush fit to train on?
    cazsl-train images --camera                 top-down views of the objects as a camera would see them
    cazsl-train fit push-indicator              the served model into runs/push-indicator (fit paper: the paper's)
    cazsl-train evaluate runs/push-indicator    its figures on held-out objects
    cazsl-train publish runs/push-indicator     the next version of models/push-indicator
    cazsl-train reproduce --all                 every table of the paper, beside the paper's own figures

    An interrupted command continues where it stopped when it is started again.
    """


simulate.add_command(simulate_drawn_shapes)
for command in (simulate, draw_images, data, fit_recipe, evaluate, publish, reproduce):
    main.add_command(command)
