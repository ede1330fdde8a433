"""Two camera files to compare: one main lens, array and sensor, on the main image or behind it."""

from __future__ import annotations

_PAIR = """\
# {title}
# clplen analyse standard.toml focused.toml -o compared

[camera]
{kind}
focal_length_mm = 120.0         # main lens, 2f in front of it and 2f behind
aperture_diameter_mm = 10.75    # of both: the focused camera's pupil fills its sub-images
wavelength_nm = 532.0
pixels_per_lenslet = 30

[camera.microlenses]
pitch_um = 150.0
focal_length_mm = 3.0
count = 101
fill = "full"

[scene]
# pairs of points 0.06, 0.1, 0.16, 0.24 and 0.36 mm apart
points_mm = [
{points}
]
"""
_KINDS = {
    "standard": (
        "A standard plenoptic camera (1.0): the array on the main lens' image",
        'kind = "plenoptic1"',
    ),
    "focused": (
        "A focused plenoptic camera (2.0): the array 18 mm behind the main lens' image",
        'kind = "plenoptic2"\nm = 0.2                         # a lenslet\'s b/a: a = 18 mm, '
        "b = 3.6 mm",
    ),
}
_SEPARATIONS = (0.06, 0.1, 0.16, 0.24, 0.36)  # mm
_APART = 0.55  # mm from pair to pair


def pair() -> dict[str, str]:
    """The camera files "standard" and "focused", by name."""
    rows = []
    for k, separation in enumerate(_SEPARATIONS):
        x = (k - (len(_SEPARATIONS) - 1) / 2) * _APART
        rows += [f"  [{x - separation / 2:.3f}, 0.0, 0.0], [{x + separation / 2:.3f}, 0.0, 0.0],"]
    return {
        name: _PAIR.format(title=title, kind=kind, points="\n".join(rows))
        for name, (title, kind) in _KINDS.items()
    }
