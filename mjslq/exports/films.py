"""Films and pictures of a result: MP4 by PyAV, GIF and PNG by Pillow, all drawn by MuJoCo.

Frame k of a film shows the motion at time k speed / fps, and the last one its end.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mjslq.exports.drawing import Drawing
from mjslq.exports.motion import Motion
from mjslq.files import atomic_write
from mjslq.reports.units import model_from_mjb
from mjslq.result import Result
from mjslq.validation import count, finite, positive

Pictures = Iterator[NDArray[np.uint8]]

SIZES = {".mp4": (1280, 720), ".gif": (640, 360), ".png": (1280, 720)}
"""Width and height unless given. [px]"""
RATES = {".mp4": 50.0, ".gif": 20.0}
"""Pictures a second unless given. [1/s]"""
LARGEST, LEAST = 8192, 16
"""Of a width or height. [px]"""
POSES = 6
"""In a picture without a moment."""
MOST_FRAMES = 100_000
_FASTEST_GIF = 50.0  # what browsers play
_QUALITY = "18"  # of x264: constant rate factor, 0 lossless, 23 its own choice


def write_film(
    result: Result,
    path: str | os.PathLike[str],
    *,
    size: tuple[int, int] | None = None,
    camera: str | None = None,
    fps: float | None = None,
    speed: float = 1.0,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write the motion of `result` to a `.mp4` or `.gif` file; see `mjslq.export`."""
    ending = Path(path).suffix.lower()
    width, height = _size(size, ending)
    rate = RATES[ending] if fps is None else positive("fps", fps)
    positive("speed", speed)
    if ending == ".mp4":
        _av()
        if width % 2 or height % 2:
            raise ValueError(f"size must be even numbers for .mp4 files, got {width} x {height}")
    elif rate > _FASTEST_GIF:
        raise ValueError(f"fps must be at most {_FASTEST_GIF:g} for .gif files, got {rate:g}")
    model, motion = _motion(result)
    frames = int(np.ceil(motion.duration * rate / speed - 1e-9)) + 1
    if frames > MOST_FRAMES:
        raise ValueError(f"the film would have {frames} pictures; a lower fps or a higher speed makes it shorter")

    def pictures(drawing: Drawing) -> Pictures:
        for frame in range(frames):
            yield drawing.picture(motion(min(frame * speed / rate, motion.duration)))
            if progress is not None:
                progress((frame + 1) / frames)

    with atomic_write(path) as stream, Drawing(model, motion, (width, height), camera) as drawing:
        write = _write_mp4 if ending == ".mp4" else _write_gif
        write(stream, pictures(drawing), (width, height), rate)


def write_picture(
    result: Result,
    path: str | os.PathLike[str],
    *,
    size: tuple[int, int] | None = None,
    camera: str | None = None,
    at: float | None = None,
    poses: int | None = None,
) -> None:
    """Write one moment of `result`, or several poses in one, to a `.png` file; see `mjslq.export`."""
    from PIL import Image

    number = count("poses", poses) if poses is not None else POSES if at is None else 1
    model, motion = _motion(result)
    moment = motion.duration if at is None else finite("at", at)
    if not 0.0 <= moment <= motion.duration * (1.0 + 1e-9):
        raise ValueError(f"at must be from 0 to {motion.duration:g} s, the length of the motion, got {moment:g}")
    times = [time for time in np.linspace(0.0, motion.duration, number) if abs(time - moment) > 1e-9] * (number > 1)
    ghosts = [motion(time) for time in times]
    with Drawing(model, motion, _size(size, ".png"), camera, len(ghosts)) as drawing:
        picture = drawing.picture(motion(moment), ghosts)
    with atomic_write(path) as stream:
        Image.fromarray(picture).save(stream, "PNG", optimize=True)


def _write_mp4(stream: BinaryIO, pictures: Pictures, size: tuple[int, int], rate: float) -> None:
    av = _av()
    with av.open(stream, "w", format="mp4") as film:
        track = film.add_stream(
            "libx264", rate=Fraction(rate).limit_denominator(1000), options={"crf": _QUALITY, "preset": "medium"}
        )
        track.width, track.height = size
        track.pix_fmt = "yuv420p"  # what every browser and slide program plays
        for picture in pictures:
            for packet in track.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")):
                film.mux(packet)
        for packet in track.encode():
            film.mux(packet)


def _write_gif(stream: BinaryIO, pictures: Pictures, size: tuple[int, int], rate: float) -> None:
    """Write with one palette for all, of the first picture, so that what stands still stays the same."""
    from PIL import Image

    palette = Image.fromarray(next(pictures)).quantize(255, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)

    def reduced() -> Iterator[Any]:
        for picture in pictures:
            yield Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)

    duration = 10 * max(round(100.0 / rate), 2)  # GIF counts hundredths of a second
    palette.save(stream, "GIF", save_all=True, append_images=reduced(), duration=duration, loop=0, optimize=False)


def _motion(result: Result) -> tuple[Any, Motion]:
    if result.scene is None:
        raise ValueError("the result has no model to draw; .html and .csv files show its curves")
    model = model_from_mjb(result.scene.model)
    return model, Motion(model, result)


def _size(size: tuple[int, int] | None, ending: str) -> tuple[int, int]:
    if size is None:
        return SIZES[ending]
    try:
        width, height = size
    except (TypeError, ValueError):
        raise ValueError(f"size must be a width and a height, such as (1280, 720), got {size!r}") from None
    width, height = count("width", width, LEAST), count("height", height, LEAST)
    if max(width, height) > LARGEST:
        raise ValueError(f"size must be at most {LARGEST} x {LARGEST}, got {width} x {height}")
    return width, height


def _av() -> Any:
    try:
        import av
    except ImportError:
        raise ImportError(
            '.mp4 files need the package av, which `pip install "mjslq[video]"` brings; .gif files need nothing more'
        ) from None
    return av
