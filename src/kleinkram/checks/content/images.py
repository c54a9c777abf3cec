"""Checks of images: black, overexposed, frozen, blurred.

The brightness is the mean over an even grid of pixels and their colours, from 0 to 255. Images of 16 bits are scaled by
the fewest bits (10, 12, 14 or 16) that the brightest values of the topic take, apart from single bright pixels. Of
depth images, it is the share of pixels with a depth. The sharpness is the variance of the Laplacian of the image in
grey, scaled to a width of 320 pixels.

Source: Pech-Pacheco et al., "Diatom autofocusing in brightfield microscopy" (2000), variance of the Laplacian.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kleinkram.checks.content.probe import Probe, SampledMessage, number
from kleinkram.checks.document import ImageRule
from kleinkram.checks.outcomes import seconds
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import ReadingExtraMissing, image
from kleinkram.recordings.decoding.types import DecodeError
from kleinkram.recordings.decoding.values import part, payload, type_name

FULL_BRIGHTNESS = 255.0
_DEPTHS_BITS = (10, 12, 14, 16)
_LEAST_BRIGHT = 2**9  # below it, a dark image of a usual sensor of 12 bits
_BRIGHT_PERCENTILE = 99.5
_GRID = 240  # rows or columns of pixels, at least, by which the brightness is measured
_SHARPNESS_WIDTH = 320


@dataclass(frozen=True)
class Exposure:
    """Brightness of one picture: `mean` and `brightest` of its values; `is_scaled`: from 0 to 255."""

    time_ns: int
    mean: float
    brightest: float
    is_scaled: bool


@dataclass
class _Standstill:
    """Pictures in a row that are the same; `shows_motion`: bright enough to show whether they are."""

    digest: int
    first_ns: int
    last_ns: int
    shows_motion: bool = True


class ImageProbe(Probe[ImageRule]):
    """Checks of the images of one topic."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._exposures: list[Exposure] = []
        self._sharpness: list[tuple[float, int]] = []
        self._has_exposure = True
        self._standstill: _Standstill | None = None
        self._longest_ns, self._longest_start_ns = 0, 0
        self._has_dark_repeats = False
        self._showing = 0
        self._compared = 0
        self._pictures_error = ""
        self._pictures_failed = 0

    def measure(self, sample: SampledMessage) -> None:
        """Compare the picture with the one before; of a sample, measure brightness and sharpness."""
        digest = zlib.crc32(payload(sample.value))
        self._compared += 1
        shows_motion = True
        if sample.is_picked:
            try:
                shows_motion = self._measure_picture(sample)
            except (DecodeError, ReadingExtraMissing) as error:
                self._pictures_error = self._pictures_error or str(error)
                self._pictures_failed += 1
        self._compare(digest, sample.log_time_ns, shows_motion=shows_motion)

    def results(self) -> Iterator[Check]:
        """Yield the checks of brightness, standstill and sharpness."""
        yield from self._results_of_pictures()
        yield self._frozen()

    def _results_of_pictures(self) -> Iterator[Check]:
        names = [name for name in self.names if name != "image.frozen"]
        if not self._exposures:
            reason = self._pictures_error or "no picture was among the samples"
            for name in names:
                yield self.row(name, CheckStatus.not_made, f"its pictures cannot be read: {reason}")
            return
        if self._pictures_failed:
            total = self._pictures_failed + len(self._exposures)
            reason = f"{self._pictures_failed} of {total} pictures cannot be read: {self._pictures_error}"
            yield self.row("image.black", CheckStatus.not_made, reason)
        brightness = self._brightness()
        yield self._black(brightness)
        yield self._overexposed(brightness)
        if self.rule.min_sharpness is not None:
            yield self._blurred(self.rule.min_sharpness)

    def _measure_picture(self, sample: SampledMessage) -> bool:
        """Measure a picture; return whether a standstill would show in it."""
        picture = image(sample.value)
        if picture.size == 0:
            raise DecodeError(type_name(sample.value), "the picture has no pixels")
        encoding = str(part(sample.value, "encoding") or part(sample.value, "format") or "").lower()
        time_ns = sample.log_time_ns
        if _is_depth(encoding, picture):
            self._has_exposure = False
            share = float(np.mean(np.isfinite(picture) & (picture != 0)))
            self._exposures.append(Exposure(time_ns, share * FULL_BRIGHTNESS, FULL_BRIGHTNESS, True))
            return share > 0
        colours = picture[..., :3]
        step = max(1, min(colours.shape[:2]) // _GRID)
        grid = colours[::step, ::step]
        mean = float(np.mean(grid))
        brightest = 0.0 if picture.dtype == np.uint8 else float(np.percentile(grid, _BRIGHT_PERCENTILE))
        self._exposures.append(Exposure(time_ns, mean, brightest, picture.dtype == np.uint8))
        if picture.dtype == np.uint8:
            shows_motion = self.rule.min_brightness <= mean <= self.rule.max_brightness
        else:
            shows_motion = bool((grid != grid[0, 0]).any())
        if self.rule.min_sharpness is not None and shows_motion:
            self._sharpness.append((sharpness(colours, is_mosaic=encoding.startswith("bayer")), time_ns))
        return shows_motion

    def _compare(self, digest: int, time_ns: int, *, shows_motion: bool) -> None:
        self._showing += shows_motion
        current = self._standstill
        if current is None or current.digest != digest:
            self._end_standstill()
            self._standstill = _Standstill(digest, time_ns, time_ns, shows_motion)
            return
        current.last_ns = time_ns
        current.shows_motion = current.shows_motion and shows_motion

    def _end_standstill(self) -> None:
        current = self._standstill
        if current is None or current.last_ns == current.first_ns:
            return
        if not current.shows_motion:
            self._has_dark_repeats = True
        elif current.last_ns - current.first_ns > self._longest_ns:
            self._longest_ns, self._longest_start_ns = current.last_ns - current.first_ns, current.first_ns

    def _brightness(self) -> list[tuple[float, int]]:
        brightest = max((item.brightest for item in self._exposures if not item.is_scaled), default=0)
        depths = _DEPTHS_BITS if brightest >= _LEAST_BRIGHT else _DEPTHS_BITS[1:]
        full = next((2**bits - 1 for bits in depths if brightest < 2**bits), max(1.0, brightest))
        return [
            (item.mean if item.is_scaled else item.mean / full * FULL_BRIGHTNESS, item.time_ns)
            for item in self._exposures
        ]

    def _black(self, brightness: Sequence[tuple[float, int]]) -> Check:
        limit = self.rule.min_brightness
        dark = [time_ns for mean, time_ns in brightness if mean < limit]
        decisive = _decisive([mean for mean, _ in brightness], self.rule.allowed)
        what = "brightness" if self._has_exposure else "share of pixels with a depth, times 255,"
        message = f"{len(dark)} of {len(brightness)} pictures are black: their {what} is below {number(limit)}"
        return self._share_outcome("image.black", message, dark, len(brightness), decisive, limit)

    def _overexposed(self, brightness: Sequence[tuple[float, int]]) -> Check:
        limit = self.rule.max_brightness
        if not self._has_exposure:
            return self.outcome("image.overexposed", "depth images have no exposure", fails=False)
        bright = [time_ns for mean, time_ns in brightness if mean > limit]
        decisive = -_decisive([-mean for mean, _ in brightness], self.rule.allowed)
        message = f"{len(bright)} of {len(brightness)} pictures are overexposed: brighter than {number(limit)}"
        return self._share_outcome("image.overexposed", message, bright, len(brightness), decisive, limit)

    def _blurred(self, limit: float) -> Check:
        if not self._sharpness:
            what = "black or overexposed pictures" if self._has_exposure else "depth images"
            return self.row("image.blurred", CheckStatus.not_made, f"{what} have no sharpness")
        blurred = [time_ns for value, time_ns in self._sharpness if value < limit]
        decisive = _decisive([value for value, _ in self._sharpness], self.rule.allowed)
        message = (
            f"{len(blurred)} of {len(self._sharpness)} pictures are blurred: their sharpness is below {number(limit)}"
        )
        return self._share_outcome("image.blurred", message, blurred, len(self._sharpness), decisive, limit)

    def _share_outcome(
        self, name: str, message: str, bad: Sequence[int], count: int, decisive: float, limit: float
    ) -> Check:
        fails = len(bad) > self.rule.allowed * count
        return self.outcome(name, message, fails=fails, value=decisive, limit=limit, time_ns=min(bad, default=None))

    def _frozen(self) -> Check:
        self._end_standstill()
        limit_ns, frozen_ns = self.rule.max_frozen, self._longest_ns
        if self._compared < 2:
            return self.row("image.frozen", CheckStatus.not_made, "there is only one picture")
        if not self._showing or (self._has_dark_repeats and not frozen_ns):
            reason = "black or overexposed pictures do not show whether the camera is frozen"
            return self.row("image.frozen", CheckStatus.not_made, reason)
        message = f"the same picture for {seconds(frozen_ns)}" if frozen_ns else "no picture equals the one before"
        return self.outcome(
            "image.frozen",
            f"{message} ({self._compared} pictures)",
            fails=frozen_ns > limit_ns,
            value=frozen_ns / 1e9,
            limit=limit_ns / 1e9,
            unit="s",
            time_ns=self._longest_start_ns,
        )


def sharpness(colours: NDArray[Any], *, is_mosaic: bool = False) -> float:
    """Return the variance of the Laplacian of a picture [H, W, C], scaled to a width of 320 pixels if it is wider.

    `is_mosaic`: the four pixels of a Bayer pattern are one.
    """
    height, width = colours.shape[:2]
    if is_mosaic and min(height, width) > 1:
        height, width = height // 2, width // 2
        colours = colours[: 2 * height, : 2 * width].reshape(height, 2, width, 2, -1).mean(axis=(1, 3))
    grey = _scaled(colours).astype(np.float32).mean(axis=2)
    if min(grey.shape) < 3:
        return 0.0
    centre = grey[1:-1, 1:-1]
    laplacian = grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:] - 4 * centre
    return float(np.var(laplacian))


def _scaled(colours: NDArray[Any]) -> NDArray[Any]:
    """Return a picture [H, W, C] with the width for sharpness, if it is wider."""
    from PIL import Image

    height, width, channels = colours.shape
    if width <= _SHARPNESS_WIDTH:
        return colours
    size = _SHARPNESS_WIDTH, max(1, round(height * _SHARPNESS_WIDTH / width))
    if colours.dtype == np.uint8 and channels == 3:  # ten times faster than as floating-point numbers
        return np.asarray(Image.fromarray(np.ascontiguousarray(colours)).resize(size, Image.Resampling.BOX))
    planes = [Image.fromarray(np.ascontiguousarray(colours[..., n], dtype=np.float32)) for n in range(channels)]
    return np.stack([np.asarray(plane.resize(size, Image.Resampling.BOX)) for plane in planes], axis=2)


def _is_depth(encoding: str, picture: NDArray[Any]) -> bool:
    is_named = encoding.startswith(("16uc1", "32fc1", "64fc1")) or "compresseddepth" in encoding
    return is_named or picture.dtype.kind not in "u"


def _decisive(values: Sequence[float], allowed: float) -> float:
    """Return the value that decides: the smallest behind the share that may be too small."""
    return sorted(values)[min(len(values) - 1, int(allowed * len(values)))]
