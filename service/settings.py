"""What the operator decides, from the environment: every setting is ``CAZSL_<NAME>``, with a default that works."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


class Settings(BaseSettings):
    """Settings of the service; built by the command line, never at import."""

    model_config = SettingsConfigDict(env_prefix="CAZSL_", frozen=True, extra="forbid")

    host: Annotated[str, Field(description="address to listen on; loopback unless told otherwise")] = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535, description="port to listen on; 0 picks a free one")] = 8000
    registry: Annotated[str, Field(description="the folder of models, or s3://bucket/prefix")] = "models"
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
    ] = 1 << 20
    grace_s: Annotated[
        int, Field(ge=0, le=3600, description="how long running requests may take after SIGTERM, in s")
    ] = 20
    log_level: Annotated[Literal["DEBUG", "INFO", "WARNING", "ERROR"], Field(description="least level logged")] = "INFO"
