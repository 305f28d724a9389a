"""Options that several commands share."""

from pathlib import Path

from service.cli.command_line import FOLDER, argument, option
from training.omnipush.layout import DEFAULT_DATA

data_option = option(
    "--data",
    "folder",
    type=FOLDER,
    default=DEFAULT_DATA,
    show_default=True,
    help="Folder of pushes in Omnipush's format.",
)
views_option = option(
    "--views",
    type=FOLDER,
    help="Folder of top-down views, for visual contexts. [default: top-down_view beside the data]",
)
registry_option = option(
    "--registry",
    type=FOLDER,
    envvar="CAZSL_REGISTRY",
    default=Path("models"),
    show_default=True,
    help="Folder of the model registry.",
)
run_argument = argument("run", type=FOLDER)
