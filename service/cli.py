"""``cazsl``: serve predictions, look at the registry, predict one push."""

import functools
import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec

import click
import pydantic
import uvicorn

import service
from service.app import create_app
from service.connections import bounded_connection
from service.contract import ContextKind
from service.errors import CazslError
from service.keys import Grant, Scope
from service.loaded_models import DEFAULT_MODELS, LoadedModel, LoadedModels, load_version
from service.manifest import ModelReference
from service.object_bodies import ContextBody
from service.predictions import predict_with
from service.predictor import OnnxPredictor
from service.registry import Registry
from service.requests import PredictRequest, PusherBody
from service.settings import Settings
from service.telemetry import configure_logging

P = ParamSpec("P")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(service.__version__, prog_name="cazsl")
def main() -> None:
    """Where does a pushed object end up, and how sure can we be?

    \b
    cazsl serve                                        start the HTTP service on 127.0.0.1:8000
    cazsl predict 1a2b3c4a -- -0.075 0 0               one prediction, without a service
    cazsl models list                                  what is published

    Settings come from the environment (CAZSL_REGISTRY, CAZSL_PORT, ...); options win over them.
    """


def mend(command: Callable[P, None]) -> Callable[P, None]:
    """An error of ours becomes one line and exit status 1."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except CazslError as error:
            raise click.ClickException(str(error)) from error

    return run


registry_option = click.option(
    "--registry",
    type=click.Path(file_okay=False, path_type=Path),
    envvar="CAZSL_REGISTRY",
    default=Path("models"),
    show_default=True,
    help="The folder of models.",
)


@main.command()
@click.option("--host", help="Address to listen on. [default: 127.0.0.1]")
@click.option("--port", type=int, help="Port to listen on; 0 picks a free one. [default: 8000]")
@click.option("--registry", type=click.Path(path_type=Path), help="The folder of models. [default: models]")
def serve(**options: Any) -> None:
    """Start the HTTP service; /docs shows and tries every route.

    New versions and moved aliases are served without a restart. SIGTERM finishes running requests, then stops.
    """
    try:
        settings = Settings(**{name: value for name, value in options.items() if value is not None})
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = "CAZSL_" + "_".join(str(part) for part in first["loc"]).upper()
        raise click.ClickException(f"{name}: {first['msg']}") from error
    configure_logging(settings.log_level)
    models = LoadedModels(Registry(settings.registry), OnnxPredictor, settings.newest_versions)
    if sys.stdout.isatty():  # a person; whoever collects logs gets JSON lines only
        click.echo(f"serving {settings.registry}; try http://{settings.host}:{settings.port}/docs; Ctrl-C stops")
    # uvicorn finishes what it has on SIGTERM and then raises the signal once more: having finished is success
    signal.signal(signal.SIGTERM, lambda *_: None)
    uvicorn.run(
        create_app(settings, models),
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        http=bounded_connection(settings.body_timeout_s),
        proxy_headers=False,  # who asks is who connects
        timeout_graceful_shutdown=settings.grace_s,
    )


@main.group()
def models() -> None:
    """Look at the registry."""


@models.command("list")
@registry_option
@mend
def list_models(registry: Path) -> None:
    """Name, versions and aliases of every model."""
    store = Registry(registry)
    for name in store.names():
        aliases = ", ".join(f"{alias} -> {version}" for alias, version in store.aliases(name).items()) or "no alias"
        click.echo(f"{name}  versions {', '.join(map(str, store.versions(name))) or 'none'}  {aliases}")
    if not store.names():
        click.echo("no model is published; train and publish one with: make train")


@models.command("show")
@click.argument("reference")
@click.option("--json", "as_json", is_flag=True, help="The manifest instead of the card.")
@registry_option
@mend
def show(reference: str, as_json: bool, registry: Path) -> None:
    """The card of a model: NAME, NAME@ALIAS or NAME@VERSION."""
    store, parsed = Registry(registry), ModelReference.parse(reference, "reference")
    version = store.read(parsed.name, store.resolve(parsed))
    click.echo(json.dumps(json.loads(version.manifest.render()), indent=2) if as_json else version.card)


@models.command("verify")
@click.argument("reference", required=False)
@registry_option
@mend
def verify(reference: str | None, registry: Path) -> None:
    """Check digests, tensors and self-check of one version, or of all published; exit status 1 if any fails."""
    store = Registry(registry)
    references = [reference] if reference else [f"{n}@{v}" for n in store.names() for v in store.versions(n)]
    broken = 0
    for each in references:
        try:
            found = _load(registry, each)
            click.echo(f"{found.manifest.name}@{found.manifest.version}  ok")
        except CazslError as error:
            click.echo(f"{each}  BROKEN  {error}", err=True)
            broken += 1
    if broken:
        sys.exit(1)


@main.group()
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


@main.command()
@click.argument("descriptor", required=False)
@click.argument("pose", nargs=3, type=float, metavar="X_M Y_M ANGLE_RAD")
@click.option("--model", "reference", help="NAME, NAME@ALIAS or NAME@VERSION. [default: the champion for this context]")
@registry_option
@mend
def predict(descriptor: str | None, pose: tuple[float, float, float], reference: str | None, registry: Path) -> None:
    """Predict one push, without a service; prints what POST /v1/predict would answer.

    DESCRIPTOR is four sides, each a shape digit and a weight letter, such as 1a2b3c4a. The pusher's pose is in the
    object's frame: put -- before it when a number is negative.
    """
    context = None if descriptor is None else ContextBody(descriptor=descriptor)
    try:
        request = PredictRequest(
            pusher=PusherBody(x=pose[0], y=pose[1], angle=pose[2]), context=context, model=reference
        )
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise click.ClickException(f"{first['loc'][-1]}: {first['msg']}") from error
    kind = ContextKind.NONE if context is None else ContextKind.INDICATOR
    answer = predict_with(_load(registry, reference or DEFAULT_MODELS[kind]), request)
    click.echo(json.dumps(json.loads(answer.content), indent=2))


def _load(registry: Path, reference: str) -> LoadedModel:
    store, parsed = Registry(registry), ModelReference.parse(reference, "reference")
    return load_version(store, OnnxPredictor, parsed.name, store.resolve(parsed))
