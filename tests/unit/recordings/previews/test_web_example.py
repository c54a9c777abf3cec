"""The example from which the tests of the web interface read is what this package writes."""

import base64
import json
from pathlib import Path

import numpy as np

from kleinkram.recordings.previews.container import encode, read_preview
from kleinkram.recordings.previews.model import (
    CameraStrip,
    FieldSeries,
    LogLine,
    LogSeverity,
    PositionTrack,
    RecordingPreview,
    ThinnedCloud,
    Thumbnail,
    TopicSeries,
    TrackKind,
)

_EXAMPLE = Path(__file__).parents[4] / "web" / "src" / "recordings" / "testing" / "preview.json"
_START_NS = 1_700_000_000_000_000_000
_FIXES = np.array([[47.1, 8.123456789, np.nan], [47.2, 8.2, 430.5]])


def _example() -> RecordingPreview:
    first_ns = _START_NS + np.arange(4) * 1_000_000_000
    series = TopicSeries(
        topic="/imu",
        message_type="sensor_msgs/msg/Imu",
        message_count=40,
        messages_per_bin=10,
        first_ns=first_ns,
        last_ns=first_ns + 900_000_000,
        fields=(
            FieldSeries("angular.x", np.array([-1.0, 0.1, np.nan, 3.0]), np.array([1.0, 0.2, np.nan, 3.0])),
            FieldSeries("covariance[0]", np.full(4, 0.5), np.full(4, 0.5)),
        ),
        is_sampled=False,
    )
    thumbnails = (Thumbnail(_START_NS, 4, 3, b"first"), Thumbnail(_START_NS + 1, 4, 3, b"second"))
    return RecordingPreview(
        start_ns=_START_NS,
        end_ns=_START_NS + 3_900_000_000,
        read_share=1.0,
        series=(series,),
        cameras=(CameraStrip("/camera", 20, thumbnails),),
        tracks=(
            PositionTrack("/odometry", TrackKind.pose, 1, np.array([_START_NS]), np.array([[1.0, 2.0, 3.0]])),
            PositionTrack("/gnss", TrackKind.gnss, 2, np.array([_START_NS, _START_NS + 2]), _FIXES),
        ),
        log_lines=(
            LogLine(_START_NS, "/rosout", LogSeverity.info, "driver", "started"),
            LogLine(_START_NS + 3, "/other", LogSeverity.unknown, "", "text"),
            LogLine(_START_NS + 5, "/rosout", LogSeverity.error, "driver", "über limit"),
        ),
        log_line_count=7,
        clouds=(
            ThinnedCloud("/lidar", _START_NS, "lidar", 100_000, np.array([[1, 2, 3], [-1.5, 0, 0.25]], np.float32)),
            ThinnedCloud("/lidar", _START_NS + 2, "lidar", 7, np.array([[4, 5, np.nan]], np.float32)),
            ThinnedCloud("/radar", _START_NS + 1, "radar", 0, np.empty((0, 3), np.float32)),
        ),
        left_out=(),
        read_spans=np.array(
            [[_START_NS, _START_NS + 1_900_000_000], [_START_NS + 2_000_000_000, _START_NS + 3_900_000_000]]
        ),
    )


def test_the_example_of_the_web_interface_contains_what_is_written_today() -> None:
    data = base64.b64decode(json.loads(_EXAMPLE.read_text())["base64"])
    # Compressed bytes may differ between versions of zlib.
    assert encode(read_preview(data)) == encode(_example())
