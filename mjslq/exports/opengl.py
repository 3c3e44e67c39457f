"""An OpenGL context without a window, by the first way that works on this machine.

MuJoCo chooses its way once, when it is imported, by the environment variable MUJOCO_GL, and takes GLFW where nothing is
set, which needs a display. Here a machine without a display gets EGL; MUJOCO_GL is obeyed where it names a way.
"""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from typing import Any

import mujoco

WAYS = ("glfw", "egl", "osmesa", "cgl")
"""Modules of `mujoco` that open a context, as MUJOCO_GL names them."""


def ways() -> tuple[str, ...]:
    """Return the ways to try, the best first: what MUJOCO_GL names, or what suits the platform."""
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked in WAYS:
        return (asked,)
    if sys.platform == "darwin":
        return ("cgl",)
    if sys.platform == "win32":
        return ("glfw",)
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return ("glfw", "egl")
    return ("egl",)


def open_context(model: Any, width: int, height: int) -> tuple[Any, Any]:
    """Return a current OpenGL context, to be freed by the caller, and MuJoCo's rendering context for `model` on it.

    Raises ValueError, with what each way said, where none works.
    """
    said = []
    for way in ways():
        context = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # GLFW warns where there is no display
                context = importlib.import_module(f"mujoco.{way}").GLContext(width, height)
                context.make_current()
                _demand_current(way)
                rendering = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, rendering)
            if rendering.currentBuffer != mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value:
                raise RuntimeError("it has no buffer to draw into")
            return context, rendering
        except Exception as error:  # each way has errors of its own, from missing libraries to the driver's
            said.append(way + ": " + (" ".join(str(error).split()) or type(error).__name__))
            if context is not None:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    context.free()
    raise ValueError(
        f"pictures and films need OpenGL, and none could be opened ({'; '.join(said)}); set MUJOCO_GL to egl, osmesa "
        "or glfw, whichever this machine has, or export to .html or .csv, which need none"
    )


def _demand_current(way: str) -> None:
    """Raise RuntimeError where GLFW made no context; MuJoCo ends the process when it looks for one in vain twice."""
    if way == "glfw":
        import glfw

        if not glfw.get_current_context():
            raise RuntimeError("it opens no window here")
