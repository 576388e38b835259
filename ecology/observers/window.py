"""Window that shows a world while it is stepped; `render_mode="human"` opens it."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from ecology.errors import EcologyError
from ecology.observers.viewer import needs_display


class Window:
    """Shows one picture after another; a window that its user closed stays closed."""

    def __init__(self, title: str) -> None:
        """Open it. Raises EcologyError where there is no screen, or nothing to open a window with."""
        needs_display('use render_mode="rgb_array", whose pictures need no screen')
        try:
            import tkinter
        except ImportError as error:
            raise EcologyError(
                f'render_mode="human" opens a window with Python\'s tkinter, which cannot be loaded ({error}). Install '
                "it (python3-tk in Debian), or use render_mode='rgb_array'."
            ) from error
        try:
            self._root: Any = tkinter.Tk()
        except tkinter.TclError as error:
            raise EcologyError(f'render_mode="human" cannot open a window: {error}.') from error
        self._broken, self._photo = tkinter.TclError, tkinter.PhotoImage
        self._root.title(title)
        self._label = tkinter.Label(self._root, borderwidth=0)
        self._label.pack()

    def show(self, picture: np.ndarray) -> None:
        """Show a picture, uint8 (height, width, 3)."""
        height, width = picture.shape[:2]
        data = b"P6 %d %d 255 " % (width, height) + np.ascontiguousarray(picture).tobytes()
        with contextlib.suppress(self._broken):  # its user has closed it
            self._image = self._photo(data=data, format="PPM")
            self._label.configure(image=self._image)
            self._root.update()

    def close(self) -> None:
        """Close it."""
        with contextlib.suppress(self._broken):
            self._root.destroy()
