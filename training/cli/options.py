"""Options that several commands share."""

from pathlib import Path

import click

from training.cli.simulation import DEFAULT_DATA

data_option = click.option(
    "--data",
    "folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=DEFAULT_DATA,
    show_default=True,
    help="A folder of Omnipush-format files.",
)
views_option = click.option(
    "--views",
    type=click.Path(file_okay=False, path_type=Path),
    help="A folder of top-down views, for visual contexts. [default: top-down_view beside the data]",
)
registry_option = click.option(
    "--registry",
    type=click.Path(file_okay=False, path_type=Path),
    envvar="CAZSL_REGISTRY",
    default=Path("models"),
    show_default=True,
    help="The folder of models.",
)
run_argument = click.argument("run", type=click.Path(file_okay=False, path_type=Path))


def data_words(folder: Path, views: Path | None) -> str:
    """The options that the next command needs as well."""
    return ("" if folder == DEFAULT_DATA else f" --data {folder}") + ("" if views is None else f" --views {views}")
