"""Constructors of plenoptic cameras."""

from __future__ import annotations

from abc import ABC

from clplen.cameras.description import Described
from clplen.cameras.focused_camera import Plenoptic2, type2
from clplen.cameras.fourier_microscope import fourier_microscope
from clplen.cameras.light_field_microscope import Microscope, microscope
from clplen.cameras.optics.lenslet_camera import Kind, LensletCamera
from clplen.cameras.standard_camera import Plenoptic1, type1


class PlenopticCamera(Described, LensletCamera, ABC):
    """Plenoptic camera simulated by wave optics: built by `type1`, `type2` or `microscope`.

    Cameras of all constructors are instances of this class; ``kind`` names their type.

    Attributes
    ----------
    kind : {"standard", "focused", "microscope"}
        Type of the camera.
    focal_length, object_distance, image_distance, aperture_diameter, wavelength : float
        Lengths in metres.
    others
        Attributes of `LensletCamera`.

    Examples
    --------
    >>> mla = clplen.MicrolensArray(100e-6, 1e-3, count=11)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=10e-3, mla=mla, wavelength=550e-9, pixels_per_lenslet=5)
    >>> camera.kind, isinstance(camera, clplen.PlenopticCamera)
    ('standard', True)
    >>> raw = camera.expose(clplen.PointSources((0, 0, 1e-3)))
    >>> raw.shape, f"alpha = {camera.alpha(1e-3):.3f}"
    ((55, 55), 'alpha = 1.048')
    """

    kind: Kind
    focal_length: float
    object_distance: float
    image_distance: float
    aperture_diameter: float
    wavelength: float

    def __init__(self) -> None:
        raise TypeError(
            "Build a camera by PlenopticCamera.type1(...), .type2(...) or .microscope(...)."
        )

    type1 = staticmethod(type1)
    type2 = staticmethod(type2)
    microscope = staticmethod(microscope)
    fourier_microscope = staticmethod(fourier_microscope)


for _camera in (Plenoptic1, Plenoptic2, Microscope):
    PlenopticCamera.register(_camera)
for _make in (type1, type2, microscope, fourier_microscope):
    _make.__qualname__ = f"PlenopticCamera.{_make.__name__}"  # the public name, for messages
