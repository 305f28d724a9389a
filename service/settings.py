"""What the operator decides: every setting is ``CAZSL_<NAME>`` in the environment, with a default that works."""

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

PREFIX: Final = "CAZSL_"


class Settings(BaseSettings):
    """Settings of the service; built by the command line, never at import."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, frozen=True, extra="forbid")

    host: Annotated[str, Field(description="address to listen on; loopback unless told otherwise")] = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535, description="port to listen on; 0 picks a free one")] = 8000
    registry: Annotated[str, Field(description="the folder of models, or s3://bucket/prefix")] = "models"
    cache: Annotated[
        Path | None, Field(description="where copies of a bucket's models are kept; without it ~/.cache/cazsl")
    ] = None
    require_signature: Annotated[
        str, Field(description="public keys (PEM files, separated as in PATH) of which one must have signed a version")
    ] = ""
    max_model_bytes: Annotated[
        int, Field(ge=1024, le=1 << 30, description="largest model file that is read, in bytes")
    ] = 64 << 20
    poll_interval_s: Annotated[
        float, Field(gt=0, le=3600, description="how often to look for new versions and moved aliases, in s")
    ] = 2.0
    newest_versions: Annotated[
        int, Field(ge=1, le=1000, description="versions of a model to serve besides those that aliases name")
    ] = 8
    max_body_bytes: Annotated[
        int, Field(ge=1024, le=1 << 30, description="largest request body, in bytes, declared or chunked")
    ] = 12 << 20
    body_timeout_s: Annotated[
        float, Field(gt=0, le=3600, description="how long the head of a request, and then its body, may take, in s")
    ] = 10.0
    max_held_bytes: Annotated[
        int, Field(ge=1 << 20, le=1 << 40, description="bytes of request bodies held at once, over all requests")
    ] = 256 << 20
    max_in_flight: Annotated[int, Field(ge=1, le=100_000, description="requests answered at once; more get a 503")] = (
        256
    )
    max_in_flight_per_caller: Annotated[
        int,
        Field(
            ge=0, le=100_000, description="the same per API key, or per address without keys; more get a 429; 0: none"
        ),
    ] = 0
    max_waiting: Annotated[
        int, Field(ge=0, le=100_000, description="large batches and images that wait for a thread; more get a 503")
    ] = 64
    deadline_s: Annotated[
        float, Field(gt=0, le=3600, description="how long a large batch or image may take, waiting included, in s")
    ] = 10.0
    keys: Annotated[
        Path | None, Field(description="the file of API keys, re-read when it changes; without it no key is needed")
    ] = None
    probe_interval_s: Annotated[
        float, Field(gt=0, le=3600, description="how often every model is asked for its self-check, in s")
    ] = 10.0
    metrics_port: Annotated[
        int | None,
        Field(ge=0, le=65535, description="a port of its own for /metrics, without keys; without it the service's own"),
    ] = None
    drain_s: Annotated[
        float,
        Field(ge=0, le=3600, description="how long to go on serving after SIGTERM, not ready, before closing, in s"),
    ] = 0.0
    grace_s: Annotated[
        int, Field(ge=0, le=3600, description="how long running requests may take after SIGTERM, in s")
    ] = 20
    otlp_endpoint: Annotated[
        str, Field(description="where spans go (OTLP over HTTP, http://host:4318/v1/traces); none without it")
    ] = ""
    log_level: Annotated[Literal["DEBUG", "INFO", "WARNING", "ERROR"], Field(description="least level logged")] = "INFO"
