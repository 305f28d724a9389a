"""Options that several commands share."""

from pathlib import Path

import click

from training.omnipush.layout import DEFAULT_DATA

data_option = click.option(
    "--data",
    "folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=DEFAULT_DATA,
    show_default=True,
    help="Folder of pushes in Omnipush's format.",
)
views_option = click.option(
    "--views",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of top-down views, for visual contexts. [default: top-down_view beside the data]",
)
registry_option = click.option(
    "--registry",
    type=click.Path(file_okay=False, path_type=Path),
    envvar="CAZSL_REGISTRY",
    default=Path("models"),
    show_default=True,
    help="Folder of the model registry.",
)
run_argument = click.argument("run", type=click.Path(file_okay=False, path_type=Path))
