"""Words about the parts of an optical system, and how they share the room beside a drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clplen.plot.rays import Rays
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.number_format import metres
from clplen.wave.systems.components import Lens, Part, Space, Stop, label_of, length_of
from clplen.wave.systems.optical_system import OpticalSystem

LINE = 0.145  # inches of a line of text
_LETTER = 0.068
_FUNCTION = "function"  # a part that is one without a name


@dataclass(frozen=True)
class Label:
    """Words about z, or between two z, in metres."""

    z: float
    text: str
    ends: tuple[float, float] = (0.0, 0.0)

    @property
    def lines(self) -> list[str]:
        """The words, line by line."""
        return self.text.split("\n")


def names(optics: OpticalSystem, rays: Rays) -> list[Label]:
    """What stands above the drawing; things in one plane share a label."""
    meeting = "focus" if rays.distant else "image"
    found = [] if rays.distant else [(0.0, "object")]
    found += [(image.z, meeting) for image in rays.images if not is_on_lenslets(optics, image.z)]
    for part, z in zip(optics, optics.positions, strict=True):
        name = _FUNCTION if label_of(part) == "<lambda>" else label_of(part)
        if isinstance(part, MicrolensArray) and any(_near(optics, z, i.z) for i in rays.images):
            name += f" at the {meeting}"
        if not isinstance(part, Space):
            found.append((z + length_of(part) / 2, "\n".join([name, *_details(part)])))
    if not any(_near(optics, z, optics.length) for z, _ in found):
        found.append((optics.length, "last plane"))
    labels: list[Label] = []
    for z, text in sorted(found, key=lambda pair: pair[0]):
        if labels and _near(optics, labels[-1].z, z):
            labels[-1] = Label(labels[-1].z, f"{labels[-1].text}\n{text}")
        else:
            labels.append(Label(z, text))
    return labels


def is_on_lenslets(optics: OpticalSystem, z: float) -> bool:
    """Whether lenslets stand in the plane z, in metres."""
    return any(
        isinstance(part, MicrolensArray) and _near(optics, at, z)
        for part, at in zip(optics, optics.positions, strict=True)
    )


def _near(optics: OpticalSystem, one: float, other: float) -> bool:
    """Whether two planes are one but for rounding."""
    return abs(one - other) <= 1e-6 * abs(optics.length)


def _details(part: Part) -> list[str]:
    """Focal length and width of a part."""
    words = []
    if isinstance(part, Lens | MicrolensArray):
        words.append(f"f = {_short(part.focal_length)}")
    if isinstance(part, MicrolensArray):
        words.append(f"pitch {_short(part.pitch)}")
    elif isinstance(part, Lens | Stop) and part.diameter is not None:
        words.append(f"D = {_short(part.diameter)}")
    return words


def spans(optics: OpticalSystem) -> list[Label]:
    """The distances."""
    return [
        Label(z + length / 2, _short(length), (z, z + length))
        for part, z in zip(optics, optics.positions, strict=True)
        if (length := length_of(part))
    ]


def _short(length: float) -> str:
    value, unit = metres(length).split()
    return f"{float(value):.4g} {unit.replace('um', 'µm')}".replace("-", "\u2212")


def in_rows(labels: Sequence[Label], z_inch: float) -> list[list[Label]]:
    """Labels in as few rows as it takes that none of a row overlap."""
    rows: list[list[Label]] = []
    edges: list[float] = []
    for label in sorted(labels, key=lambda label: label.z):
        half = (max(len(line) for line in label.lines) * _LETTER / 2 + 0.05) * z_inch
        row = next((i for i, edge in enumerate(edges) if label.z - half >= edge), len(rows))
        if row == len(rows):
            rows.append([])
            edges.append(0.0)
        rows[row].append(label)
        edges[row] = label.z + half
    return rows
