"""Options that several commands share, and groups with a default command."""

from pathlib import Path

import click

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
run_data_option = option(
    "--data",
    "folder",
    type=FOLDER,
    help=f"Folder of pushes in Omnipush's format, or for push-shape a table of shapes. [default: {DEFAULT_DATA}, or "
    "data/shapes]",
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


class DefaultGroup(click.Group):
    """Group that runs its first command if the command line names none of them."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the first command's name in front of arguments that are its own."""
        if not args or args[0] not in {*self.commands, *ctx.help_option_names}:
            args = [next(iter(self.commands)), *args]
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the commands as added, the default one first."""
        return list(self.commands)
