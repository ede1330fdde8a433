"""A table of a camera's derived parameters."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One derived parameter: its name, value in SI units, unit and what it means."""

    name: str
    value: float
    unit: str
    text: str


@dataclass(frozen=True)
class Description:
    """Derived parameters of a camera; prints as a table.

    Attributes
    ----------
    title : str
    rows : tuple of Row
    """

    title: str
    rows: tuple[Row, ...]

    def __getitem__(self, name: str) -> float:
        """Value of a parameter in SI units.

        Raises
        ------
        KeyError
            Listing the names there are.
        """
        for row in self.rows:
            if row.name == name:
                return row.value
        raise KeyError(f"no parameter {name!r}; there are {', '.join(r.name for r in self.rows)}")

    def __str__(self) -> str:
        width = max(len(row.name) for row in self.rows)
        lines = [self.title]
        for row in self.rows:
            value, unit = _readable(row.value, row.unit)
            lines.append(f"  {row.name:<{width}}  {value:>10} {unit:<4}  {row.text}".rstrip())
        return "\n".join(lines)


def _readable(value: float, unit: str) -> tuple[str, str]:
    """Metres as m, mm, um or nm; anything else as it is."""
    if unit != "m" or value == 0:
        return f"{value:.6g}", unit
    for factor, name in ((1.0, "m"), (1e-3, "mm"), (1e-6, "um")):
        if abs(value) >= factor:
            return f"{value / factor:.6g}", name
    return f"{value * 1e9:.6g}", "nm"
