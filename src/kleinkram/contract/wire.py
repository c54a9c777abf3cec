"""Base classes of everything that crosses the wire."""

from pydantic import BaseModel, ConfigDict


class Request(BaseModel):
    """What a client sends: immutable; unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Response(BaseModel):
    """What a server answers: immutable; unknown fields are ignored, so that an older client reads a newer server."""

    model_config = ConfigDict(frozen=True)
