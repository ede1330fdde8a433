"""Interactive methods of results: ``save``, ``plot`` and the picture in a notebook.

Writers and figures import results, not the reverse. A result therefore names its writer in
`clplen.io` and its figure in `clplen.plot`, and looks them up on use.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from clplen.checks import check_keywords, keywords_of
from clplen.errors import ClplenError


class Savable:
    """Base class of results with a method ``save``."""

    _writer: ClassVar[str]  # function of clplen.io (path, result, options)

    def save(self, path: str | Path, **options: Any) -> None:
        """Write the result to a file in the format of its ending.

        Parameters
        ----------
        path : path-like
            Output file.
        **options
            Options of the writer in `clplen.io` for this type, such as ``write_stack`` for a
            `FocalStack`.

        Raises
        ------
        ValueError
            If the writer does not support the ending.
        OSError
            If the file cannot be written.
        """
        writer = getattr(import_module("clplen.io"), self._writer)
        check_keywords(options, keywords_of(writer), f"{type(self).__name__}.save")
        writer(path, self, **options)


class Plottable:
    """Base class of results with a method ``plot``, shown as a picture in notebooks."""

    _figure: ClassVar[str]  # function of clplen.plot (result, options)

    def plot(self, **options: Any) -> Any:
        """Draw the result with matplotlib.

        Parameters
        ----------
        **options
            Options of the function in `clplen.plot` for this type, such as ``montage`` for a
            `FocalStack`.

        Returns
        -------
        matplotlib.figure.Figure
            Figure, for `clplen.plot.save`.
        """
        figure = getattr(import_module("clplen.plot"), self._figure)
        check_keywords(options, keywords_of(figure), f"{type(self).__name__}.plot")
        return figure(self, **options)

    def _repr_png_(self) -> bytes | None:
        """Return the figure as PNG for notebooks; None if it cannot be drawn."""
        try:
            figure = self.plot()
        except (ClplenError, TypeError, ValueError):
            return None
        picture: bytes = figure._repr_png_()
        return picture
