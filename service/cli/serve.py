"""``cazsl serve``: start the HTTP service."""

import asyncio
import contextlib
import gc
import logging
import signal
import socket
import sys
import warnings
from collections.abc import Callable
from typing import Any, Final, NoReturn

import click
import uvicorn
from starlette.types import ASGIApp

from service.app import create_app
from service.background.ending import Ending
from service.cli.config import configured, settings_options
from service.cli.terminal import FAILED, printable
from service.connections.open_connections import raise_descriptors
from service.errors import SettingsError
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.model.trial import expect_trials
from service.observability.log_writer import LogWriter
from service.observability.logs import RequestLog, configure_logging, log_uncaught
from service.registry.location import open_registry, trusted_keys
from service.settings import Settings
from service.transport.draining import DrainingServer

SWITCH_INTERVAL_S: Final = 0.0001

logger = logging.getLogger(__name__)


@click.command()
@settings_options
def serve(**options: Any) -> None:
    """Start the HTTP service. Its page /docs documents every route.

    New versions and moved aliases are served without a restart. After SIGTERM the service finishes running requests and
    stops. `cazsl config` shows every setting.
    """
    signal.signal(signal.SIGTERM, _stop)  # the first process of a container gets no signal that it does not handle
    settings = configured(options).settings
    _check_host(settings)
    log = LogWriter()
    configure_logging(settings.log_level, log)
    log_uncaught()
    # Pillow warns about each odd tag of a picture. A client would write thousands of lines to standard error.
    warnings.filterwarnings("ignore", module=r"PIL\.")
    expect_trials()
    keys = trusted_keys(settings.require_signature)
    registry = open_registry(settings.registry, keys, settings.max_model_bytes, settings.cache)
    models = LoadedModels(registry, OnnxPredictor, settings.newest_versions, settings.default_models())
    trace, send_spans = _tracing(settings.otlp_endpoint)
    raise_descriptors(settings.max_connections)
    app = create_app(settings, models, RequestLog(log), trace)
    app.openapi()  # the first request for it would hold the event loop for a tenth of a second
    _greet(f"serving {settings.registry}; documentation: http://{settings.host}:{settings.port}/docs; Ctrl-C stops")
    serving = _configured(app, app.connections, settings)
    others = []
    if settings.metrics_port is not None:
        metrics = _configured(app.metrics, app.metrics_connections, settings)
        others.append((_listening(settings.host, settings.metrics_port), metrics))
    # Loading a version holds the interpreter lock in another thread. Requests wait for a switch, by default for 5 ms.
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()  # these objects stay: to traverse them at each collection costs 5 us per push, and pauses
    ending = Ending([send_spans, log.close])
    ending.start()
    server = DrainingServer(serving, settings.drain_s, app.parts.readiness.drain, ending.begin, others)
    try:
        server.run()
    except (KeyboardInterrupt, SystemExit):  # uvicorn raises Ctrl-C again, and exits if it cannot start
        logger.info("the server has ended")
    except BaseException:  # the log is the only place that the operator reads
        logger.critical("the server failed", exc_info=True)
        ending.leave(FAILED)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the end is on its way
    ending.leave(0 if server.started else FAILED)


def _stop(*_: object) -> NoReturn:
    """End with success at SIGTERM before the server handles signals, and when it raises them again after its end."""
    raise SystemExit(0)


def _check_host(settings: Settings) -> None:
    """Refuse a host without an address.

    Raises:
        SettingsError: the host has no address.
    """
    try:
        socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or "not the name of a host"
        raise SettingsError(f"CAZSL_HOST: {reason}. Send an address of this machine, such as 127.0.0.1.") from error


def _configured(app: ASGIApp, connections: type[asyncio.Protocol], settings: Settings) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        http=connections,
        proxy_headers=False,  # the client address is that of the connection
        timeout_graceful_shutdown=settings.grace_s,
    )


def _listening(host: str, port: int) -> socket.socket:
    """Return a socket for metrics that is bound already, so that a port in use ends the start.

    Raises:
        click.ClickException: the port is not free.
    """
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        return socket.create_server(address, family=family)
    except OSError as error:
        raise click.ClickException(f"CAZSL_METRICS_PORT: cannot listen on port {port}: {error.strerror}") from error


def _greet(text: str) -> None:
    """Print a line to the terminal of the operator, if there is one. It is not awaited, because a terminal may hang."""
    with contextlib.suppress(AttributeError, ValueError, OSError):  # standard output may be closed
        if sys.stdout.isatty():  # log collectors get JSON lines only
            LogWriter(sys.stdout).put(f"{printable(text)}\n".encode())


def _tracing(endpoint: str) -> tuple[Callable[[ASGIApp], ASGIApp], Callable[[], object]]:
    """Return the middleware that records spans, and a function that sends the remaining ones.

    If no endpoint is set, they do nothing.
    """
    if not endpoint:
        return lambda app: app, lambda: None
    try:  # optional dependencies
        from service.observability.tracing import Tracing, exporting
    except ImportError as error:
        raise click.ClickException("CAZSL_OTLP_ENDPOINT needs the extra 'otel': pip install 'cazsl[otel]'") from error
    provider = exporting(endpoint)
    return lambda app: Tracing(app, provider), provider.shutdown
