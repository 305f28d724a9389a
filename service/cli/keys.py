"""``cazsl keys``: make API keys."""

import click

from service.cli.terminal import mend
from service.transport.keys import Grant, Scope


@click.group()
def keys() -> None:
    """API keys, for a service that is started with CAZSL_KEYS."""


@keys.command("new")
@click.argument("name")
@click.option(
    "--scope",
    "scopes",
    type=click.Choice([scope.value for scope in Scope]),
    multiple=True,
    default=[Scope.PREDICT.value],
    show_default=True,
    help="What it covers; may be given more than once.",
)
@mend
def new_key(name: str, scopes: tuple[str, ...]) -> None:
    """Make a key for NAME: the line for the file of keys on standard output, the key itself on standard error, once.

    \b
    cazsl keys new robot-7 >> /etc/cazsl/keys
    """
    grant, key = Grant.new(name, frozenset(Scope(scope) for scope in scopes))
    click.echo(grant.line())
    click.echo(f"the key, shown this once: {key}", err=True)
