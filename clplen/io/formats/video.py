"""H.264 films as MP4, encoded by the ffmpeg of the package imageio-ffmpeg."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from clplen.checks import install_advice
from clplen.outputs import MARK

Array = np.ndarray[Any, Any]

_QUALITY = 18  # constant rate factor of x264, 0 to 51; visually lossless
# Conversion of full-range sRGB to limited-range BT.709. New versions of ffmpeg take the colour tags
# from the frames, old ones from the encoder.
_CONVERT = (
    "scale=out_color_matrix=bt709:out_range=tv:flags=bicubic+accurate_rnd+full_chroma_int,"
    "format=yuv420p,setparams=range=tv:colorspace=bt709:color_primaries=bt709:"
    "color_trc=iec61966-2-1"
)
_COLOURS = ("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1")


def encoder() -> str:
    """Return the path of ffmpeg."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ValueError(
            f"MP4 needs the package imageio-ffmpeg: {install_advice('video')}, or write .gif."
        ) from error
    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise ValueError(
            "imageio-ffmpeg cannot find ffmpeg: install ffmpeg, or write .gif."
        ) from error


def write_mp4(file: Path, frames: Sequence[Array], seconds: float) -> None:
    """Write frames as H.264 in yuv420p."""
    program = encoder()
    height, width = (n + n % 2 for n in frames[0].shape[:2])
    rate = Fraction(1 / seconds).limit_denominator(1000)
    kind = "gray" if frames[0].ndim == 2 else "rgb24"
    source = ("-f", "rawvideo", "-pix_fmt", kind, "-s", f"{width}x{height}", "-r", str(rate))
    codec = ("-vcodec", "libx264", "-crf", str(_QUALITY), "-vf", _CONVERT)
    tags = ("-color_range", "tv", *_COLOURS, "-metadata", f"comment={MARK}")
    command = (program, "-y", "-v", "error", *source, "-i", "-", "-an", *codec, *tags, str(file))
    samples = b"".join(_even(frame).tobytes() for frame in frames)
    process = subprocess.run(command, input=samples, capture_output=True, check=False)
    if process.returncode:
        messages = process.stderr.decode(errors="replace").strip().splitlines() or [
            "no reason given"
        ]
        raise OSError(f"ffmpeg failed ({messages[-1]}): write .gif, or use another size.")


def _even(frame: Array) -> Array:
    """Repeat the last row and column of a frame if their number is odd."""
    y, x = frame.shape[:2]
    return np.pad(frame, ((0, y % 2), (0, x % 2), (0, 0))[: frame.ndim], mode="edge")
