"""Kinds of camera files, and what takes a file of another kind than the one asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clplen.errors import FormatError

FOURIER = "fourier_microscope"
_FOURIER_ALONE = "relay_mm"  # a key that no other kind has
_PLENOPTIC = "'clplen simulate' and 'clplen analyse' take it, and in Python clplen.read_camera does"
_TAKEN = {
    "plenoptic1": _PLENOPTIC,
    "plenoptic2": _PLENOPTIC,
    FOURIER: "'clplen microscope psf' and 'clplen info' take it, and in Python "
    "PlenopticCamera.fourier_microscope makes such a camera",
    "microscope": "'clplen microscope psf' and 'clplen simulate' take it, and in Python "
    "clplen.read_camera does",
}


def kind_of(content: dict[str, Any]) -> Any:
    """The ``kind`` in ``[camera]`` of a file's content, None where it has none."""
    camera = content.get("camera")
    return camera.get("kind") if isinstance(camera, dict) else None


def what_takes(kind: str) -> str:
    """The commands and the function that take files of a kind, as a clause."""
    return _TAKEN[kind]


def refuse_fourier(content: dict[str, Any], path: Path) -> None:
    """Refuse the file of a Fourier microscope where another camera is asked for.

    Most of its keys are others: checked one by one they would be a list of mistakes.
    """
    if kind_of(content) == FOURIER:
        raise FormatError(
            f"{path} is of a Fourier microscope (kind = {FOURIER!r}), whose lenslets lie on the "
            f"pupil, and a camera with lenslets about its image is asked for: {_TAKEN[FOURIER]}."
        )


def require_fourier(content: dict[str, Any], path: Path) -> None:
    """Refuse the file of another camera where a Fourier microscope is asked for."""
    camera = content.get("camera")
    if isinstance(camera, dict):
        default = "" if _FOURIER_ALONE in camera else "plenoptic1"
        kind = camera.get("kind", default)
        if kind == FOURIER or not isinstance(kind, str) or kind not in _TAKEN:
            return
        said, taken = f"kind {kind!r}", _TAKEN[kind]
    elif "ulens_pitch" in content:
        said, taken = "a microscope, by the names of LFAnalyze", "'clplen microscope psf' takes it"
    else:
        return
    raise FormatError(
        f"{path} is of {said}, and a Fourier microscope (kind = {FOURIER!r}) is asked for: {taken}."
    )
