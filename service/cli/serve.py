"""``cazsl serve``: start the HTTP service."""

import signal
import sys
from collections.abc import Callable
from typing import Any, Final

import click
import uvicorn
from prometheus_client import start_http_server
from starlette.types import ASGIApp

from service.app import create_app
from service.cli.config import configured, settings_options
from service.cli.terminal import FAILED
from service.errors import CazslError
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.observability.logs import configure_logging
from service.registry.location import open_registry, trusted_keys
from service.transport.connection import bounded_connection
from service.transport.draining import DrainingServer

SWITCH_INTERVAL_S: Final = 0.0001


@click.command()
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
