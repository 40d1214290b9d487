"""Off-screen rendering of MuJoCo scenes, with or without a display."""

import os
import platform
from unittest.mock import patch

import mujoco
from mujoco.rendering.classic import gl_context

from study.common.errors import StudyError

_NOT_AVAILABLE = "OpenGL is not available"
_NO_EGL = (
    f"{_NOT_AVAILABLE} by EGL; on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri "
    "libopengl0; with a display: set MUJOCO_GL=glfw"
)


def renderer(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    """A renderer of pictures [height, width, 3] uint8. It is a context manager.

    On Linux it renders by EGL, which needs no display, unless the environment variable MUJOCO_GL
    names another library. On other systems MuJoCo chooses. The model's off-screen buffer is
    enlarged to the size of the picture.

    Raises:
        StudyError: OpenGL is not available.
    """
    size = model.vis.global_
    size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
    # MuJoCo reads MUJOCO_GL when it is imported, and without it uses a library with a display.
    by_egl = platform.system() == "Linux" and not os.environ.get("MUJOCO_GL")
    try:
        if not by_egl:
            return mujoco.Renderer(model, height, width)
        from mujoco.egl import GLContext

        with patch.object(gl_context, "GLContext", GLContext):
            return mujoco.Renderer(model, height, width)
    # A missing library gives an ImportError, an AttributeError of None, MuJoCo's FatalError or an
    # error of OpenGL.
    except Exception as error:
        if library := os.environ.get("MUJOCO_GL"):
            message = f"{_NOT_AVAILABLE} by MUJOCO_GL={library}; unset it, or choose another"
        else:
            message = _NO_EGL if by_egl else _NOT_AVAILABLE
        raise StudyError(message) from error
