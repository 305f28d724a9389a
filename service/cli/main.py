"""``cazsl``: the group of all commands."""

import click

import service
from service.cli.command_line import HELP, CommandLine
from service.cli.config import config
from service.cli.keys import keys
from service.cli.model_changes import CHANGES
from service.cli.model_checks import CHECKS
from service.cli.models import models
from service.cli.predict import predict
from service.cli.serve import serve


@click.group(cls=CommandLine, context_settings=HELP)
@click.version_option(service.__version__, prog_name="cazsl")
def main() -> None:
    """Predict the pose of a pushed object, with its uncertainty.

    \b
    cazsl serve                                        start the HTTP service on 127.0.0.1:8000
    cazsl config                                       every setting, its value and its source
    cazsl predict 1a2b3c4a -- -0.075 0 0               predict one push without a service
    cazsl predict --parquet IN OUT                     predict a file of pushes, on all cores or on a Ray cluster
    cazsl models list                                  all published models

    Settings come from options, the environment (CAZSL_REGISTRY, CAZSL_PORT, ...) and a file (CAZSL_CONFIG), in this
    order of precedence.
    """


for command in (serve, config, models, keys, predict):
    main.add_command(command)
for command in (*CHECKS, *CHANGES):
    models.add_command(command)
