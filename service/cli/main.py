"""``cazsl``: serve predictions, keep the registry, predict one push."""

import click

import service
from service.cli.config import config
from service.cli.keys import keys
from service.cli.model_changes import CHANGES
from service.cli.models import models
from service.cli.predict import predict
from service.cli.serve import serve


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(service.__version__, prog_name="cazsl")
def main() -> None:
    """Where does a pushed object end up, and how sure can we be?

    \b
    cazsl serve                                        start the HTTP service on 127.0.0.1:8000
    cazsl config                                       every setting, and where its value came from
    cazsl predict 1a2b3c4a -- -0.075 0 0               one prediction, without a service
    cazsl predict --parquet IN OUT                     millions of them, on all cores or on a Ray cluster
    cazsl models list                                  what is published

    Settings come from options, the environment (CAZSL_REGISTRY, CAZSL_PORT, ...) and a file (CAZSL_CONFIG): the first
    that names one wins.
    """


for command in (serve, config, models, keys, predict):
    main.add_command(command)
for change in CHANGES:
    models.add_command(change)
