"""Positions of missions, for maps: where each of them was recorded first."""

import enum
from typing import Annotated

from pydantic import Field

from kleinkram.contract.base import Response
from kleinkram.contract.missions import MissionRef

MAX_PLACED_MISSIONS = 2_000


class PositionSource(str, enum.Enum):
    """Where the position of a mission is known from."""

    recording = "recording"  # the first fix in its recordings, from their previews
    metadata = "metadata"  # its first metadata field of the type location, where no recording has a fix


class MissionPosition(Response):
    """Where a mission is on the map, in degrees (WGS 84)."""

    mission: MissionRef
    latitude: Annotated[float, Field(ge=-90, le=90)]
    longitude: Annotated[float, Field(ge=-180, le=180)]
    source: PositionSource


class MissionPositions(Response):
    """The positions of the 2,000 missions that were recorded last, of those that match.

    `unplaced_count` of these have no known position; `left_out_count` are the earlier missions that match.
    """

    items: Annotated[list[MissionPosition], Field(max_length=MAX_PLACED_MISSIONS)]
    unplaced_count: int
    left_out_count: int
