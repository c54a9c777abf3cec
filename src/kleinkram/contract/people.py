"""People, as far as one user sees them, and who is asking."""

import uuid

from pydantic import BaseModel, ConfigDict


class PersonRef(BaseModel):
    """A person, as named beside what they did."""

    model_config = ConfigDict(frozen=True)

    id: uuid.UUID
    name: str


class ServiceRead(BaseModel):
    """What a server says of itself to somebody it knows: `GET /api/v1/service`."""

    model_config = ConfigDict(frozen=True)

    version: str
    public_url: str
    store_url: str
    checksum: str
    person: PersonRef
