"""``cazsl keys``: create API keys."""

import click

from service.cli.command_line import argument, errors_as_one_line, option
from service.cli.terminal import echo
from service.transport.keys import Grant, Scope


@click.group()
def keys() -> None:
    """Create API keys for a service that is started with CAZSL_KEYS."""


@keys.command("new")
@argument("name")
@option(
    "--scope",
    "scopes",
    type=click.Choice([scope.value for scope in Scope]),
    multiple=True,
    default=[Scope.PREDICT.value],
    show_default=True,
    help="Scope of the key. May be given more than once.",
)
@errors_as_one_line
def new_key(name: str, scopes: tuple[str, ...]) -> None:
    """Create an API key for NAME. The line for the file of keys goes to standard output, the key to standard error.

    The key is shown this once and stored nowhere.

    \b
    cazsl keys new robot-7 >> /etc/cazsl/keys
    """
    grant, key = Grant.new(name, frozenset(Scope(scope) for scope in scopes))
    echo(grant.line())
    echo(f"API key (shown only now): {key}", err=True)
