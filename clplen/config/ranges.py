"""Ranges of a microscope's parameters in the units of its file, and which unit was meant."""

from __future__ import annotations

from dataclasses import dataclass

_POWERS = (3, -3, 6, -6, 9, -9)  # of 10: from m, mm, um and nm to one another


@dataclass(frozen=True)
class Range:
    """From ``low`` to ``high``, both included, of instruments that exist.

    Attributes
    ----------
    low, high : float
    unit : str
        Of both, empty for plain numbers.
    """

    low: float
    high: float
    unit: str = ""

    def check(self, value: float) -> float:
        """The value, refused outside the range.

        Raises
        ------
        ValueError
            With the value that another unit would have meant, where one is in the range.
        """
        if self.low <= value <= self.high:
            return value
        said = f"lies between {self.low:g} and {self.high:g}"
        if self.unit:
            said = f"is in {self.unit} here, from {self.low:g} to {self.high:g}"
        for power in _POWERS if self.unit else ():
            meant = value * 10.0**power
            if self.low <= meant <= self.high:
                said += f": did you mean {meant:.6g}?"
                break
        raise ValueError(said)


MAGNIFICATION = Range(1, 250)
NA = Range(0.01, 1.8)
INDEX = Range(1, 2.5)
WAVELENGTH = Range(150, 3000, "nm")
TUBE_LENS = Range(10, 2000, "mm")
PITCH = Range(3, 5000, "um")
FOCAL_LENGTH = Range(10, 2e5, "um")
FOCAL_LENGTH_MM = Range(0.01, 200, "mm")
PIXEL = Range(0.3, 200, "um")
STEP = Range(1e-4, 1e4, "um")
PIXELS = Range(3, 1000)  # of a lenslet, along an axis
F_NUMBER = Range(0.5, 1000)  # of a lenslet
