"""Figures and animations that a notebook shows, whether or not pyplot is loaded."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure
from PIL import Image

DOTS_PER_INCH = 100
SIGNS = {
    "minus": "−", "fast-backward": "|◀◀", "step-backward": "|◀", "play fa-flip-horizontal": "◀", "pause": "❚❚", "play": "▶",
    "step-forward": "▶|", "fast-forward": "▶▶|", "plus": "+",
}  # fmt: skip
"""Signs on the buttons of a player, by the names of the icons that matplotlib takes from another address."""


class NotebookFigure(Figure):
    """A figure with its own picture for notebooks, which show figures without pyplot as text."""

    def _repr_png_(self) -> bytes:
        picture = io.BytesIO()
        self.savefig(picture, dpi=DOTS_PER_INCH, format="png")
        return picture.getvalue()


class NotebookAnimation(FuncAnimation):  # type: ignore[misc]
    """An animation that a notebook shows as a player with buttons, whatever ``rcParams["animation.html"]`` is.

    Parameters
    ----------
    figure : Figure
        The figure.
    show : callable
        Shows a picture, given its number.
    moving : sequence of Artist
        All parts that change from picture to picture, from the lowest up. The rest is drawn only once.
    **settings
        Those of `matplotlib.animation.FuncAnimation`.
    """

    def __init__(self, figure: Figure, show: Callable[[int], Any], moving: Sequence[Artist], **settings: Any):
        super().__init__(figure, show, **settings)
        self.figure, self.moving = figure, moving

    def save(self, *args: Any, **settings: Any) -> None:
        """See `matplotlib.animation.Animation.save`."""
        figure: Any = self.figure
        canvas, dpi = figure.canvas, figure.dpi
        canvas.draw_idle = lambda: None  # nothing is shown on the screen meanwhile
        figure.savefig = _Pictures(figure, self.moving).write
        try:
            super().save(*args, **settings)
        finally:
            del canvas.draw_idle, figure.savefig
            figure.dpi = dpi

    def to_jshtml(self, *args: Any, **settings: Any) -> str:
        """See `matplotlib.animation.Animation.to_jshtml`. The page needs no other address: its buttons have signs, no icons."""
        page = re.sub(r'<link rel="stylesheet"\s+href="https?://[^>]*>', "", super().to_jshtml(*args, **settings))
        return re.sub(r'<i class="fa fa-([\w -]+)"></i>', lambda icon: SIGNS.get(icon[1], icon[0]), page)

    def _repr_html_(self) -> str:
        return self.to_jshtml(default_mode="once")


class _Pictures:
    """Pictures of one figure that share what does not move. They take a quarter of the time of complete ones."""

    def __init__(self, figure: Any, moving: Sequence[Artist]):
        self.figure, self.moving = figure, moving
        self.renderer: Any = None
        self.background: Any = None

    def write(self, file: Any, *, format: str | None = None, dpi: Any = None, **settings: Any) -> None:
        """Do what `Figure.savefig` does."""
        if format not in ("png", "rgba"):
            type(self.figure).savefig(self.figure, file, format=format, dpi=dpi, **settings)
            return
        if self.renderer is None:
            self.figure.dpi = self.figure.dpi if dpi in (None, "figure") else dpi
            width, height = (int(size) for size in self.figure.bbox.size)
            self.renderer = RendererAgg(width, height, self.figure.dpi)
            for artist in self.moving:
                artist.set_visible(False)
            self.figure.draw(self.renderer)
            for artist in self.moving:
                artist.set_visible(True)
            self.background = self.renderer.copy_from_bbox(self.figure.bbox)
        self.renderer.restore_region(self.background)
        for artist in self.moving:
            artist.draw(self.renderer)
        pixels = np.asarray(self.renderer.buffer_rgba())
        if format == "png":
            Image.fromarray(pixels).save(file, format="png")
        else:
            file.write(pixels.tobytes())


__all__ = ["NotebookAnimation", "NotebookFigure"]
