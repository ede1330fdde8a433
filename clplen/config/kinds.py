"""Kinds of camera files, and errors for files of a wrong kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clplen.errors import FormatError

FOURIER = "fourier_microscope"
_FOURIER_KEY = "relay_mm"  # a key of Fourier microscopes only
_PLENOPTIC = "use 'clplen simulate', 'clplen analyse' or, in Python, clplen.read_camera"
_SUPPORT = {
    "plenoptic1": _PLENOPTIC,
    "plenoptic2": _PLENOPTIC,
    FOURIER: "use 'clplen microscope psf', 'clplen info' or, in Python, "
    "PlenopticCamera.fourier_microscope",
    "microscope": "use 'clplen microscope psf', 'clplen simulate' or, in Python, "
    "clplen.read_camera",
}


def kind_of(content: dict[str, Any]) -> Any:
    """Return the ``kind`` in ``[camera]`` of a file's content; None if it is missing."""
    camera = content.get("camera")
    return camera.get("kind") if isinstance(camera, dict) else None


def support_of(kind: str) -> str:
    """Return a clause with the commands and the function for files of a kind."""
    return _SUPPORT[kind]


def refuse_fourier(content: dict[str, Any], path: Path) -> None:
    """Raise an error for the file of a Fourier microscope where another camera is expected.

    A check of its keys would only list the many keys that differ.
    """
    if kind_of(content) == FOURIER:
        raise FormatError(
            f"{path} describes a Fourier microscope (kind = {FOURIER!r}), but a camera with "
            f"lenslets near its image is expected: {_SUPPORT[FOURIER]}."
        )


def refuse_lfanalyze(content: dict[str, Any], path: Path) -> None:
    """Raise an error for a file with the names of LFAnalyze where a camera file is expected."""
    if "camera" not in content and "ulens_pitch" in content:
        raise FormatError(
            f"{path} describes a microscope with the names of LFAnalyze, but a camera file is "
            "expected: use 'clplen microscope psf', or write a [camera] of kind = 'microscope'."
        )


def require_fourier(content: dict[str, Any], path: Path) -> None:
    """Raise an error for the file of another camera where a Fourier microscope is expected."""
    camera = content.get("camera")
    if isinstance(camera, dict):
        default = "" if _FOURIER_KEY in camera else "plenoptic1"
        kind = camera.get("kind", default)
        if kind == FOURIER or not isinstance(kind, str) or kind not in _SUPPORT:
            return
        description, remedy = f"a camera of kind {kind!r}", _SUPPORT[kind]
    elif "ulens_pitch" in content:
        description = "a microscope with the names of LFAnalyze"
        remedy = "use 'clplen microscope psf'"
    else:
        return
    raise FormatError(
        f"{path} describes {description}, but a Fourier microscope (kind = {FOURIER!r}) is "
        f"expected: {remedy}."
    )
