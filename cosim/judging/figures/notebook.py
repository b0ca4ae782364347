"""Figures and animations that a notebook shows, whether or not pyplot is loaded."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot
from matplotlib.animation import FuncAnimation, writers
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure
from PIL import Image, features

from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.errors import ResultFileError

OF_PILLOW = (".gif", ".png", ".apng", ".webp", ".tif", ".tiff")
"""Files of several pictures that Pillow writes."""
LONGEST = {".gif": 655.35, ".png": 65.535, ".apng": 65.535}
"""Most seconds of a picture, by the ending of the file: 16 bits of hundredths, or of thousandths."""
DOTS_PER_INCH = 100
OPAQUE = 255
ALTERNATIVE = "Animation: the plant, what each sensor reads, and the signals up to the shown instant."
SLIDER = "Shown instant"
SIGNS = {
    "minus": "−",
    "fast-backward": "|◀◀",
    "step-backward": "|◀",
    "play fa-flip-horizontal": "◀",
    "pause": "❚❚",
    "play": "▶",
    "step-forward": "▶|",
    "fast-forward": "▶▶|",
    "plus": "+",
}
"""Signs on the buttons of a player, by the names of the icons that matplotlib takes from another address."""


class NotebookFigure(Figure):
    """A figure that a notebook shows once.

    Pyplot shows all its figures below the cell. One that is the cell's result as well is shown a second time, unless pyplot does
    not know it any more.
    """

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        pyplot.close(self)
        return {}

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
        Those of `matplotlib.animation.FuncAnimation`; ``frames`` is the number of pictures.
    """

    def __init__(self, figure: Figure, show: Callable[[int], Any], moving: Sequence[Artist], **settings: Any):
        super().__init__(figure, show, **settings)
        self.figure, self.moving = figure, moving
        self.pictures = int(settings["frames"])
        self.page: str | None = None
        self.differences: _Differences | None = None

    def save(self, filename: str | PathLike[str], *args: Any, **settings: Any) -> None:
        """See `matplotlib.animation.Animation.save`. A film needs the program ffmpeg; a GIF and a page (.html) do not.

        Raises
        ------
        ResultFileError
            If ffmpeg is missing, or each picture would last longer than such a file allows.
        """
        if not args and settings.get("writer") is None:
            settings["writer"] = _writer(Path(filename))
            interval: float = self._interval / 1000.0  # type: ignore[attr-defined]
            _refuse_long(Path(filename), 1.0 / settings["fps"] if settings.get("fps") else interval)
        pictures = self.differences or _Pictures(self.figure, self.moving)
        figure: Any = self.figure
        canvas, dpi = figure.canvas, figure.dpi
        canvas.draw_idle = lambda: None  # nothing is shown on the screen meanwhile
        figure.savefig = pictures.write
        try:
            with nullcontext() if self.differences else reported(f"Drawing {filename}, for some seconds."):
                super().save(Path(filename), *args, **settings)
        finally:
            del canvas.draw_idle, figure.savefig
            figure.dpi = dpi

    def to_jshtml(self, *args: Any, **settings: Any) -> str:
        """See `matplotlib.animation.Animation.to_jshtml`.

        The page needs no other address: its buttons have signs, no icons. It is a fifth as large: a picture contains only what
        differs from the first one, which lies below it.
        """
        if self.page is None:
            self.differences = pictures = _Differences(self.figure, self.moving)
            try:
                with reported("Drawing the animation, for some seconds."):
                    page = super().to_jshtml(*args, **settings)
            finally:
                self.differences = None
            page = re.sub(r'<link rel="stylesheet"\s+href="https?://[^>]*>', "", page)
            page = re.sub(r'<i class="fa fa-([\w -]+)"></i>', lambda icon: SIGNS.get(icon[1], icon[0]), page)
            page = page.replace("data:image/png;", f"data:image/{pictures.kind};")
            page = page.replace('<img id="', f'<img alt="{ALTERNATIVE}" style="{pictures.style()}" id="', 1)
            self.page = page.replace('type="range"', f'type="range" style="max-width: 100%" aria-label="{SLIDER}"', 1)
        return self.page

    def __repr__(self) -> str:
        seconds: float = self.pictures * self._interval / 1000.0  # type: ignore[attr-defined]
        size = f"{self.pictures} pictures in {seconds:.4g} s"
        return f"<NotebookAnimation of {size}; animation.save('run.gif') writes it to a file>"

    def _repr_html_(self) -> str:
        return self.to_jshtml(default_mode="once")


def _writer(file: Path) -> str:
    """Return the writer of matplotlib for a file; for a film only if its program is there.

    Raises
    ------
    ResultFileError
        If the program is missing.
    """
    if file.suffix.lower() in OF_PILLOW:
        return "pillow"
    if file.suffix.lower() in (".html", ".htm"):
        return "html"
    if not writers.is_available("ffmpeg"):
        raise ResultFileError(
            f"{file} cannot be written: this needs the program ffmpeg, which is not installed. Save a GIF, "
            f"{file.stem}.gif, or install ffmpeg."
        )
    return "ffmpeg"


def _refuse_long(file: Path, seconds: float) -> None:
    """Refuse pictures that last longer than the kind of file allows: Pillow would end in an overflow after all are drawn."""
    most = LONGEST.get(file.suffix.lower(), seconds)
    if seconds > most:
        raise ResultFileError(
            f"{file} cannot be written: each picture would last {seconds:.4g} s, but it can last {most:g} s in such a file. Give "
            f"animate() a speed= at least {1.01 * seconds / most:.3g} times as large, or more frames=."
        )


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
            self.encode(pixels, file)
        else:
            file.write(pixels.tobytes())

    def encode(self, pixels: Any, file: Any) -> None:
        """Write a picture."""
        Image.fromarray(pixels).save(file, format="png")


class _Differences(_Pictures):
    """Pictures that are transparent where they are equal to the first one: without loss, and half as large."""

    def __init__(self, figure: Any, moving: Sequence[Artist]):
        super().__init__(figure, moving)
        self.first: Any = None
        self.kind = "webp" if features.check("webp") else "png"

    def encode(self, pixels: Any, file: Any) -> None:
        """Write a picture."""
        if self.first is None:
            self.first = pixels.copy()
        if (self.first[..., 3] == OPAQUE).all():  # else the first one would shine through
            pixels = np.where((pixels == self.first).all(axis=2, keepdims=True), np.uint8(0), pixels)
        self._write(pixels, file)

    def _write(self, pixels: Any, file: Any) -> None:
        Image.fromarray(pixels).save(file, format=self.kind, lossless=True)

    def style(self) -> str:
        """Return the style of an image that shows the first picture below the present one."""
        if not (self.first[..., 3] == OPAQUE).all():
            return "max-width: 100%"
        below = io.BytesIO()
        self._write(self.first, below)
        address = f"data:image/{self.kind};base64,{base64.b64encode(below.getvalue()).decode('ascii')}"
        return f"max-width: 100%; background: url({address}) 0 0 / 100% 100%; print-color-adjust: exact"


__all__ = ["NotebookAnimation", "NotebookFigure"]
