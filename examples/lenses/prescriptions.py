"""Two photographic lenses of the literature: surfaces as numbers, and the lenses in optiland."""

from dataclasses import dataclass

from optiland.optic import Optic

Surface = tuple[float, float, str | None, float]  # radius, thickness, glass after it, edge; in mm
FLAT = float("inf")


@dataclass(frozen=True)
class Prescription:
    """A lens for objects far away.

    ``stop`` counts surfaces from 1; ``aperture`` is the entrance pupil's diameter in mm, ``field``
    the largest half angle in degrees. Edges are the largest height at which rays pass.
    """

    name: str
    source: str
    surfaces: tuple[Surface, ...]
    stop: int
    aperture: float
    field: float

    def optic(self) -> Optic:
        """The lens in optiland, for the lines F, d and C."""
        lens = Optic(self.name)
        lens.surfaces.add(index=0, radius=FLAT, thickness=FLAT)
        for number, (radius, thickness, glass, edge) in enumerate(self.surfaces, start=1):
            lens.surfaces.add(
                index=number, radius=radius, thickness=thickness, is_stop=number == self.stop,
                material=(glass, "schott") if glass else "air",
                aperture=None if number == self.stop else 2 * edge)
        lens.surfaces.add(index=len(self.surfaces) + 1)
        lens.set_aperture(aperture_type="EPD", value=self.aperture)
        lens.fields.set_type(field_type="angle")
        for share in (0, 0.7, 1):
            lens.fields.add(y=share * self.field)
        for line, wavelength in (("F", 0.4861), ("d", 0.5876), ("C", 0.6563)):
            lens.wavelengths.add(value=wavelength, is_primary=line == "d")
        return lens


COOKE_TRIPLET = Prescription(
    "Cooke triplet, 50 mm f/5.6",
    "attributed to Geiser; J. Sasian, course OPTI 517, University of Arizona, and the triplet of "
    "ray-optics' documentation. There f/4; stopped down, and edges chosen here so that the field "
    "is vignetted",
    (
        (23.713, 4.831, "N-LAK9", 7.0),
        (7331.288, 5.860, None, 6.4),
        (-24.456, 0.975, "N-SF5", 5.0),
        (21.896, 4.822, None, 5.0),
        (86.759, 3.127, "N-LAK9", 5.8),
        (-20.4942, 41.2365, None, 6.2),
    ),
    stop=3, aperture=50 / 5.6, field=20.0)

DOUBLE_GAUSS = Prescription(
    "double Gauss, 100 mm f/6.7",
    "after U.S. Patent 2,532,751 (J. G. Baker, 1950), with the numbers that programs of lens "
    "design hand out as their sample of 28 degrees. There f/2 to f/3; stopped down, and edges "
    "chosen here",
    (
        (56.20238, 8.75, "N-SSK2", 15.5),
        (152.28580, 0.5, None, 14.5),
        (37.68262, 12.5, "N-SK2", 13.5),
        (FLAT, 3.8, "F5", 12.0),
        (24.23130, 16.369445, None, 10.0),
        (FLAT, 13.747957, None, 0.0),
        (-28.37731, 3.8, "F5", 10.0),
        (FLAT, 11.0, "N-SK16", 12.0),
        (-37.92546, 0.5, None, 13.0),
        (177.41176, 7.0, "N-SK16", 13.5),
        (-79.41143, 61.487536, None, 13.5),
    ),
    stop=6, aperture=15.0, field=14.0)

LENSES = {"cooke": COOKE_TRIPLET, "gauss": DOUBLE_GAUSS}
