"""A figure that a notebook shows, whether or not pyplot is loaded."""

from __future__ import annotations

import io

from matplotlib.figure import Figure

DOTS_PER_INCH = 100


class NotebookFigure(Figure):
    """A figure with its own picture for notebooks, which show figures without pyplot as text."""

    def _repr_png_(self) -> bytes:
        picture = io.BytesIO()
        self.savefig(picture, dpi=DOTS_PER_INCH, format="png")
        return picture.getvalue()


__all__ = ["NotebookFigure"]
