"""Positions on earth, in degrees (WGS 84)."""

from __future__ import annotations

from dataclasses import dataclass

MAX_LATITUDE, MAX_LONGITUDE = 90.0, 180.0


@dataclass(frozen=True)
class GeoPosition:
    """A place on earth: degrees to the north and to the east."""

    latitude: float
    longitude: float


def usable_position(latitude: float, longitude: float) -> GeoPosition | None:
    """Return a position; None for numbers that are none.

    Not finite, out of range, or 0/0, which receivers write that have no fix.
    """
    is_in_range = abs(latitude) <= MAX_LATITUDE and abs(longitude) <= MAX_LONGITUDE  # False for NaN
    if not is_in_range or (latitude == 0 and longitude == 0):
        return None
    return GeoPosition(float(latitude), float(longitude))
