"""``cazsl``: serve predictions, keep the registry, predict one push."""

import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click
import pydantic
import uvicorn
from prometheus_client import start_http_server
from starlette.types import ASGIApp

import service
import service.cli.model_changes
from service.api.v1.queries import predict_with
from service.app import create_app
from service.cli.config import config, configured, settings_options
from service.cli.models import load, models
from service.cli.predict_parquet import predict_parquet
from service.cli.terminal import FAILED, mend, registry_option
from service.errors import CazslError
from service.inference.loaded_models import DEFAULT_MODELS, LoadedModels
from service.model.predictor import OnnxPredictor
from service.observability.telemetry import configure_logging
from service.pushing.contexts import ContextKind
from service.registry.location import open_registry, trusted_keys
from service.schemas.contexts import ContextBody
from service.schemas.pushes import PredictRequest, PusherBody
from service.transport.connection import bounded_connection
from service.transport.draining import DrainingServer
from service.transport.keys import Grant, Scope

SWITCH_INTERVAL_S: Final = 0.0001
POSE_PARTS: Final = 3


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


@main.command()
@settings_options
def serve(**options: Any) -> None:
    """Start the HTTP service; /docs shows and tries every route.

    New versions and moved aliases are served without a restart. SIGTERM finishes running requests, then stops.
    `cazsl config` shows every setting.
    """
    settings = configured(options).settings
    configure_logging(settings.log_level)
    try:
        keys = trusted_keys(settings.require_signature)
        registry = open_registry(settings.registry, keys, settings.max_model_bytes, settings.cache)
    except CazslError as error:
        raise click.ClickException(str(error)) from error
    models = LoadedModels(registry, OnnxPredictor, settings.newest_versions)
    app = create_app(settings, models, trace=_tracing(settings.otlp_endpoint))
    if sys.stdout.isatty():  # a person; whoever collects logs gets JSON lines only
        click.echo(f"serving {settings.registry}; try http://{settings.host}:{settings.port}/docs; Ctrl-C stops")
    # uvicorn finishes what it has on SIGTERM and then raises the signal once more: having finished is success
    signal.signal(signal.SIGTERM, lambda *_: None)
    serving = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        http=bounded_connection(settings.body_timeout_s, app.state.requests.refuse, app.state.short_way),
        proxy_headers=False,  # who asks is who connects
        timeout_graceful_shutdown=settings.grace_s,
    )
    if settings.metrics_port is not None:
        try:
            start_http_server(settings.metrics_port, settings.host, app.state.metrics)
        except OSError as error:
            raise click.ClickException(f"CAZSL_METRICS_PORT: {settings.metrics_port}: {error.strerror}") from error
    # Loading a version is Python on another thread; requests wait for it to give way, by default for 5 ms
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    server = DrainingServer(serving, settings.drain_s, app.state.readiness.drain)
    server.run()
    if not server.started:
        sys.exit(FAILED)


def _tracing(endpoint: str) -> Callable[[ASGIApp], ASGIApp]:
    """The ring that makes spans, where they are wanted."""
    if not endpoint:
        return lambda app: app
    try:  # dependencies that only those pay who want spans
        from service.observability.tracing import Tracing, exporting
    except ImportError as error:
        raise click.ClickException("CAZSL_OTLP_ENDPOINT needs the extra 'otel': pip install 'cazsl[otel]'") from error
    provider = exporting(endpoint)  # sends what is left at the end of the process
    return lambda app: Tracing(app, provider)


main.add_command(config)
main.add_command(models)


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
@click.argument("push", nargs=-1, metavar="[DESCRIPTOR] X_M Y_M ANGLE_RAD")
@click.option(
    "--parquet",
    "files",
    nargs=2,
    type=click.Path(path_type=Path),
    metavar="IN OUT",
    help="Predict every row of the Parquet file IN into the new file OUT.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1),
    help="With --parquet: threads of this process. [default: one per processor]",
)
@click.option(
    "--ray", "ray_address", metavar="ADDRESS", help="With --parquet: on this Ray cluster: HOST:PORT, or auto."
)
@click.option("--model", "reference", help="NAME, NAME@ALIAS or NAME@VERSION. [default: the champion for this context]")
@registry_option
@mend
def predict(
    push: tuple[str, ...],
    files: tuple[Path, Path] | None,
    jobs: int | None,
    ray_address: str | None,
    reference: str | None,
    registry: str,
) -> None:
    """Predict one push, or a file of millions, without a service.

    \b
    cazsl predict 1a2b3c4a -- -0.075 0 0
    cazsl predict --parquet pushes.parquet predictions.parquet

    One push prints what POST /v1/predict would answer. DESCRIPTOR is four sides, each a shape digit and a weight
    letter, such as 1a2b3c4a; without it the model knows nothing of the object. The pusher's pose is in the object's
    frame: put -- before it when a number is negative.

    A file (extra 'parquet') has columns x_m, y_m and angle_rad, and of the object descriptor (text), visual (1,024
    bytes) or nothing; other columns are kept. OUT has the same rows in the same order with mean_x_m, mean_y_m,
    mean_angle_rad, std_x_m, std_y_m and std_angle_rad, and names model and version in its metadata. It appears when it
    is whole, is the same to the bit for any number of jobs, and never takes the place of another file.
    """
    if files is not None:
        if push or (jobs is not None and ray_address is not None):
            raise click.UsageError("--parquet takes its pushes from IN, and either --jobs or --ray")
        predict_parquet(*files, reference, open_registry(registry), jobs, ray_address)
        return
    if jobs is not None or ray_address is not None:
        raise click.UsageError("--jobs and --ray are for --parquet IN OUT")
    if len(push) not in (POSE_PARTS, POSE_PARTS + 1):
        raise click.UsageError(
            f"received {len(push)} words; accepted is [DESCRIPTOR] X_M Y_M ANGLE_RAD, or --parquet IN OUT"
        )
    descriptor = None if len(push) == POSE_PARTS else push[0]
    x_m, y_m, angle_rad = (click.FLOAT(word) for word in push[-POSE_PARTS:])
    context = None if descriptor is None else ContextBody(descriptor=descriptor)
    try:
        request = PredictRequest(pusher=PusherBody(x=x_m, y=y_m, angle=angle_rad), context=context, model=reference)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise click.ClickException(f"{first['loc'][-1]}: {first['msg']}") from error
    kind = ContextKind.NONE if context is None else ContextKind.INDICATOR
    answer = predict_with(load(open_registry(registry), reference or DEFAULT_MODELS[kind]), request)
    click.echo(json.dumps(json.loads(answer.content), indent=2))
