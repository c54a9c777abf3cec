"""The measured requests: the lists, searches, facets and details of everyday use."""

import hashlib
import uuid
from dataclasses import dataclass

_LARGE_MISSION = 5000


def seeded(kind: str) -> uuid.UUID:
    """Return the id of a seeded object: the UUID of the MD5 of its kind and number."""
    return uuid.UUID(hashlib.md5(kind.encode(), usedforsecurity=False).hexdigest())


@dataclass(frozen=True)
class Place:
    """One request; `most_ms` is the limit of the 95th percentile, None if there is none."""

    name: str
    path: str
    most_ms: float | None = 50


def places(facets_ms: float) -> list[Place]:
    """Return all requests."""
    large, project = seeded(f"mission{_LARGE_MISSION}"), seeded("project1")
    one = seeded("file1234-1")
    week = "recorded_after=2016-03-01&recorded_before=2016-03-08"
    lists = {
        "projects": "projects?limit=100",
        "projects, text": "projects?text=alps&limit=100",
        "missions": "missions?limit=100",
        "missions, latest": "missions?sort=-start&limit=100",
        "missions, counted": "missions?sort=-created&limit=100&count=true",
        "missions of a project": f"missions?project_id={project}&limit=100",
        "missions, metadata": "missions?where=robot=husky-03&limit=100",
        "missions, metadata, counted": "missions?where=operator=Keller&sort=-start&limit=100&count=true",
        "missions, two of metadata": "missions?where=temperature>30&where=weather=fog&limit=100",
        "missions, text": "missions?text=knee&limit=100",
        "files": "files?limit=100",
        "files, latest": "files?sort=-created&limit=100&count=true",
        "files of a large mission": f"files?mission_id={large}&limit=100&count=true",
        "files, topic": "files?topic=/hydra/sonar&sort=-start&limit=100",
        "files, rare topic": "files?topic=/experiment/trial_1*&sort=-start&limit=100",
        "files, type": "files?message_type=sensor_msgs/msg/NavSatFix&sort=-start&limit=100",
        "files, time": f"files?{week}&sort=-start&limit=100",
        "files, topic and time": f"files?topic=/imu/data&{week}&sort=-start&limit=100",
        "files, label": "files?label=train&sort=-start&limit=100",
        "search, everything": "search?query=",
        "search, word of all files": "search?query=drive",
        "search, word of a topic": "search?query=sonar",
        "search, word of some missions": "search?query=knee",
        "search, word of one mission": "search?query=harbour_001234",
        "search, two words": "search?query=glacier+calibration",
        "search, topic and place": "search?query=topic:/imu/data+glacier",
        "search, nothing": "search?query=zzyzx",
        "a file": f"files/{one}",
        "a file's topics": f"files/{one}/topics",
    }
    facets = {
        "facets, everything": "search/facets?query=",
        "facets, word of all files": "search/facets?query=drive",
        "facets, word of a topic": "search/facets?query=sonar",
        "facets, topic": "search/facets?query=topic:/hydra/sonar",
        "facets, word of one mission": "search/facets?query=harbour_001234",
    }
    others = {
        "home": "home",
        "storage": "home/storage",
        "overview": "overview",
        "statistics by project": "stats?by=project",
        "statistics by robot": "stats?by=metadata.robot",
        "statistics by topic, one project": f"stats?by=topic&project_id={project}",
        "topics": "topics?topic=/hydra/*&limit=100",
    }
    places = [Place(name, path) for name, path in lists.items()]
    places += [Place(name, path, facets_ms) for name, path in facets.items()]
    return places + [Place(name, path, None) for name, path in others.items()]
