"""Settings of the service. Each is ``CAZSL_<NAME>`` in the environment, and each has a default that works.

A value without text is not set: ``CAZSL_HOST=`` means the default, as in a compose file that passes a variable on.
White space and line feeds at the ends are cut off, as files of secrets have them.
"""

import re
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from service.model.reference import is_name

PREFIX: Final = "CAZSL_"
# Controls, separators of lines, a byte order mark, and halves of characters, from bytes that are not UTF-8.
NOT_TEXT: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ufeff\ud800-\udfff]")
_LONGEST_TEXT: Final = 4096  # as long as a path may be
_PREFIX_PATH: Final = re.compile(r"(/[A-Za-z0-9_~-][A-Za-z0-9._~-]*)+")
_DEFAULT_MODELS: Final = ("model_none", "model_indicator", "model_visual", "model_shape", "model_support")  # by kind
_ROUTES: Final = ("v1", "v2", "docs", "livez", "readyz", "metrics", "openapi.json")


def is_set(value: object) -> bool:
    """Return True if a value of the environment, a file or an option counts: it is not None, and a text has letters."""
    return bool(value.strip()) if isinstance(value, str) else value is not None


class Settings(BaseSettings):
    """Settings of the service. The command line creates them, never an import."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, frozen=True, extra="forbid", protected_namespaces=())

    host: Annotated[str, Field(description="Address to listen on. The default is this machine only.")] = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535, description="Port to listen on. 0 picks a free port.")] = 8000
    root_path: Annotated[
        str,
        Field(
            description="Path prefix of a proxy, such as /cazsl, whether the proxy strips it or not. Empty: no prefix."
        ),
    ] = ""
    registry: Annotated[str, Field(description="Registry of models: a folder, or s3://bucket/prefix.")] = "models"
    cache: Annotated[Path | None, Field(description="Folder for cached models of a bucket. Unset: ~/.cache/cazsl.")] = (
        None
    )
    require_signature: Annotated[
        str,
        Field(
            description="Public keys (PEM files, separated as in PATH). "
            "Only versions signed by one of them are served. Empty: no signature is needed."
        ),
    ] = ""
    max_model_bytes: Annotated[
        int,
        Field(
            ge=1024, le=1 << 30, description="Maximum size of a model file, in bytes. Larger files are refused unread."
        ),
    ] = 64 << 20
    poll_interval_s: Annotated[
        float, Field(gt=0, le=3600, description="Interval between polls for new versions and moved aliases, in s.")
    ] = 2.0
    newest_versions: Annotated[
        int,
        Field(
            ge=1,
            le=1000,
            description="Number of newest versions of each model to serve, besides those that aliases name.",
        ),
    ] = 8
    model_none: Annotated[
        str, Field(description="Model whose champion answers pushes that name no model and have no context.")
    ] = "push-none"
    model_indicator: Annotated[str, Field(description="Likewise with a descriptor or an indicator as context.")] = (
        "push-indicator"
    )
    model_visual: Annotated[
        str, Field(description="Likewise with a visual context, or an image without its scale.")
    ] = "push-visual"
    model_shape: Annotated[
        str, Field(description="Likewise with an outline, or an image with its scale (metres_per_pixel).")
    ] = "push-shape"
    model_support: Annotated[
        str, Field(description="Likewise with a support: pushes of the object with their outcomes.")
    ] = "push-anp"
    max_body_bytes: Annotated[
        int, Field(ge=1024, le=1 << 30, description="Maximum size of a request body, in bytes. Larger bodies get 413.")
    ] = 12 << 20
    body_timeout_s: Annotated[
        float,
        Field(
            gt=0, le=3600, description="Maximum time to receive the head of a request, and again for its body, in s."
        ),
    ] = 10.0
    keep_alive_s: Annotated[
        float,
        Field(
            gt=0,
            le=3600,
            description="Time for which an idle connection is kept, in s. "
            "It must be longer than that of a load balancer in front.",
        ),
    ] = 75.0
    answer_timeout_s: Annotated[
        float,
        Field(
            gt=0,
            le=3600,
            description="Time in which 4 KiB/s of a waiting answer have to leave, in s. Slower clients are cut off.",
        ),
    ] = 10.0
    max_connections: Annotated[
        int,
        Field(
            ge=1,
            le=1_000_000,
            description="Maximum number of connections. An idle one makes room for a new one. "
            "It needs as many file descriptors.",
        ),
    ] = 2000
    max_unsent_bytes: Annotated[
        int,
        Field(
            ge=1 << 20,
            le=1 << 40,
            description="Maximum bytes of all answers that their clients have not read. Excess clients are cut off.",
        ),
    ] = 64 << 20
    max_held_bytes: Annotated[
        int,
        Field(
            ge=1 << 20,
            le=1 << 40,
            description="Maximum bytes of all requests in memory. One caller may hold three quarters. "
            "Excess requests get 503.",
        ),
    ] = 256 << 20
    max_in_flight: Annotated[
        int, Field(ge=1, le=100_000, description="Maximum concurrent requests. Excess requests get 503.")
    ] = 256
    max_in_flight_per_caller: Annotated[
        int,
        Field(
            ge=0,
            le=100_000,
            description="Maximum concurrent requests per API key (per client address if keys are off). "
            "Excess requests get 429. 0: three quarters of CAZSL_MAX_IN_FLIGHT.",
        ),
    ] = 0
    max_waiting: Annotated[
        int,
        Field(
            ge=0,
            le=100_000,
            description="Maximum number of large batches and images that wait for a thread. Excess requests get 503.",
        ),
    ] = 64
    max_working_bytes: Annotated[
        int,
        Field(
            ge=1 << 20,
            le=1 << 40,
            description="Maximum memory of the large batches and images in threads, in bytes, as their sizes and "
            "pixels let expect. Others wait. One may always work, whatever it takes.",
        ),
    ] = 256 << 20
    deadline_s: Annotated[
        float,
        Field(
            gt=0,
            le=3600,
            description="Maximum time for a large batch or an image, including the wait for a thread, in s. "
            "Later answers are a 503.",
        ),
    ] = 10.0
    keys: Annotated[
        Path | None, Field(description="File of API keys, read again twice a second. Unset: no key is needed.")
    ] = None
    probe_interval_s: Annotated[
        float, Field(gt=0, le=3600, description="Interval between self-checks of every model, in s.")
    ] = 10.0
    metrics_port: Annotated[
        int | None,
        Field(
            ge=0,
            le=65535,
            description="Separate port for /metrics, without keys. Unset: /metrics is on the port of the service.",
        ),
    ] = None
    drain_s: Annotated[
        float,
        Field(ge=0, le=3600, description="Time to keep serving after SIGTERM while /readyz reports not ready, in s."),
    ] = 0.0
    grace_s: Annotated[
        int, Field(ge=0, le=3600, description="Maximum time for running requests to finish after SIGTERM, in s.")
    ] = 20
    otlp_endpoint: Annotated[
        str,
        Field(
            description="Address for spans (OTLP over HTTP, such as http://host:4318/v1/traces). "
            "Empty: no spans are sent."
        ),
    ] = ""
    log_level: Annotated[
        Literal["DEBUG", "INFO", "WARNING", "ERROR"], Field(description="Lowest level that is logged.")
    ] = "INFO"

    def default_models(self) -> dict[str, str]:
        """Return the name of the default model for each kind of context."""
        return {name.removeprefix("model_"): getattr(self, name) for name in _DEFAULT_MODELS}

    @model_validator(mode="before")
    @classmethod
    def _drop_empty(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Leave out values without text, so that their defaults count."""
        return {name: value for name, value in values.items() if is_set(value)}

    @field_validator("*", mode="before")
    @classmethod
    def _clean(cls, value: object) -> object:
        """Cut white space from the ends of a text, and refuse control characters within."""
        if isinstance(value, bool):
            raise ValueError("Input should be a number or a text")
        if not isinstance(value, str):
            return value
        if NOT_TEXT.search(value.strip()):
            raise ValueError("Input should be text in UTF-8 without line feeds and control characters")
        if len(value.strip()) > _LONGEST_TEXT:
            raise ValueError(f"Input should be text of at most {_LONGEST_TEXT} characters")
        return value.strip()

    @field_validator("root_path")
    @classmethod
    def _check_root_path(cls, value: str) -> str:
        """Refuse a prefix that is no path, or that a route of the service begins with. Return it without its last /."""
        prefix = value.rstrip("/")
        if prefix and (not _PREFIX_PATH.fullmatch(prefix) or prefix.split("/")[1] in _ROUTES):
            raise ValueError(f"Input should be a path such as /cazsl, and not begin with /{', /'.join(_ROUTES)}")
        return prefix

    @field_validator(*_DEFAULT_MODELS)
    @classmethod
    def _check_model(cls, value: str) -> str:
        """Refuse a text that names no model."""
        if not is_name(value):
            raise ValueError("Input should be the name of a model, such as push-shape, without an alias or a version")
        return value

    @field_validator("otlp_endpoint")
    @classmethod
    def _check_endpoint(cls, value: str) -> str:
        """Refuse an address that no exporter can reach."""
        if value and not re.fullmatch(r"https?://[^\s/]+\S*", value):
            raise ValueError("Input should begin with http:// or https:// and a host")
        return value
