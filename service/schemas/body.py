"""The base of every body: exact types, no unknown field, numbers finite."""

from pydantic import BaseModel, ConfigDict


class Body(BaseModel):
    """What every body is: exact types, no unknown field, numbers finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)
