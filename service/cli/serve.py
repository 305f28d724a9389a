"""``cazsl serve``: start the HTTP service."""

import gc
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
from service.cli.terminal import FAILED, echo
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.model.trial import expect_trials
from service.observability.log_writer import LogWriter
from service.observability.logs import RequestLog, configure_logging, log_uncaught
from service.registry.location import open_registry, trusted_keys
from service.transport.draining import DrainingServer

SWITCH_INTERVAL_S: Final = 0.0001


@click.command()
@settings_options
def serve(**options: Any) -> None:
    """Start the HTTP service. Its page /docs documents every route.

    New versions and moved aliases are served without a restart. After SIGTERM the service finishes running requests and
    stops. `cazsl config` shows every setting.
    """
    settings = configured(options).settings
    log = LogWriter()
    configure_logging(settings.log_level, log)
    log_uncaught()
    expect_trials()
    keys = trusted_keys(settings.require_signature)
    registry = open_registry(settings.registry, keys, settings.max_model_bytes, settings.cache)
    models = LoadedModels(registry, OnnxPredictor, settings.newest_versions)
    app = create_app(settings, models, RequestLog(log), _tracing(settings.otlp_endpoint))
    if sys.stdout.isatty():  # log collectors get JSON lines only
        echo(f"serving {settings.registry}; documentation: http://{settings.host}:{settings.port}/docs; Ctrl-C stops")
    # After SIGTERM uvicorn finishes its requests and raises the signal again, which must not end in an error status.
    signal.signal(signal.SIGTERM, lambda *_: None)
    serving = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        http=app.connections,
        proxy_headers=False,  # the client address is that of the connection
        timeout_graceful_shutdown=settings.grace_s,
    )
    if settings.metrics_port is not None:
        try:
            start_http_server(settings.metrics_port, settings.host, app.parts.metrics)
        except OSError as error:
            raise click.ClickException(
                f"CAZSL_METRICS_PORT: cannot listen on port {settings.metrics_port}: {error.strerror}"
            ) from error
    # Loading a version holds the interpreter lock in another thread. Requests wait for a switch, by default for 5 ms.
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()  # these objects stay: to traverse them at each collection costs 5 us per push, and pauses
    server = DrainingServer(serving, settings.drain_s, app.parts.readiness.drain)
    server.run()
    if not server.started:
        sys.exit(FAILED)


def _tracing(endpoint: str) -> Callable[[ASGIApp], ASGIApp]:
    """Return the middleware that records spans, or the identity if no endpoint is set."""
    if not endpoint:
        return lambda app: app
    try:  # optional dependencies
        from service.observability.tracing import Tracing, exporting
    except ImportError as error:
        raise click.ClickException("CAZSL_OTLP_ENDPOINT needs the extra 'otel': pip install 'cazsl[otel]'") from error
    provider = exporting(endpoint)  # sends the remaining spans when the process ends
    return lambda app: Tracing(app, provider)
