"""Methods that results share at a prompt: ``save``, ``plot`` and the picture a notebook shows.

Writers and figures stand above the results in the order of imports, so that a result names its
writer in `clplen.io` and its figure in `clplen.plot`, and looks them up when it is asked.
"""

from __future__ import annotations

from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar

from clplen.checks import check_keywords, keywords_of
from clplen.errors import ClplenError

_DPI = 100  # of the picture in a notebook


class Savable:
    """Base of what is written to a file by ``save``."""

    _writer: ClassVar[str]  # a function of clplen.io: path, result, options

    def save(self, path: str | Path, **options: Any) -> None:
        """Write this to a file; the ending chooses the format.

        Parameters
        ----------
        path : path-like
        **options
            Those of the writer in `clplen.io` for this type, such as ``write_stack`` for a
            `FocalStack`.

        Raises
        ------
        ValueError
            If the ending is none that the writer knows.
        OSError
            If the file cannot be written.
        """
        writer = getattr(import_module("clplen.io"), self._writer)
        check_keywords(options, keywords_of(writer), f"{type(self).__name__}.save")
        writer(path, self, **options)


class Plottable:
    """Base of what is drawn by ``plot``, and by a notebook of its own accord."""

    _figure: ClassVar[str]  # a function of clplen.plot: result, options

    def plot(self, **options: Any) -> Any:
        """Draw this with matplotlib.

        Parameters
        ----------
        **options
            Those of the function in `clplen.plot` for this type, such as ``montage`` for a
            `FocalStack`.

        Returns
        -------
        matplotlib.figure.Figure
            `clplen.plot.save` writes it.
        """
        figure = getattr(import_module("clplen.plot"), self._figure)
        check_keywords(options, keywords_of(figure), f"{type(self).__name__}.plot")
        return figure(self, **options)

    def _repr_png_(self) -> bytes | None:
        """The figure as a notebook shows it; None where this cannot be drawn."""
        try:
            figure = self.plot()
        except (
            ClplenError,
            TypeError,
            ValueError,
        ):  # such as a batch of fields
            return None
        data = BytesIO()
        figure.savefig(data, format="png", dpi=_DPI)
        return data.getvalue()
