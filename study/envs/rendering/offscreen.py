"""Drawing MuJoCo scenes off screen, on a machine with a display or without one."""

import os
import platform
from unittest.mock import patch

import mujoco
from mujoco.rendering.classic import gl_context

from study.common.errors import StudyError

_PACKAGES = (
    "no OpenGL to draw with by EGL (on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri "
    "libopengl0; or set MUJOCO_GL=glfw to draw with a display)"
)
_NONE = "no OpenGL to draw with"


def renderer(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    """A renderer of images [height, width, 3] uint8; a context manager, to be closed after use.

    On Linux it draws by EGL, which needs no display, unless the environment variable MUJOCO_GL
    names another way; elsewhere by MuJoCo's own choice. It is no matter whether MuJoCo has already
    been imported. The model's off-screen buffer grows to the size asked for.

    Raises:
        StudyError: there is no OpenGL to draw with.
    """
    size = model.vis.global_
    size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
    # MuJoCo chooses once, when it is imported, and without MUJOCO_GL wants a display.
    by_egl = platform.system() == "Linux" and not os.environ.get("MUJOCO_GL")
    try:
        if not by_egl:
            return mujoco.Renderer(model, height, width)
        from mujoco.egl import GLContext

        with patch.object(gl_context, "GLContext", GLContext):
            return mujoco.Renderer(model, height, width)
    # What fails, and how, depends on the library that is missing: an ImportError, an AttributeError
    # of None, MuJoCo's FatalError or an error of OpenGL.
    except Exception as error:
        asked = os.environ.get("MUJOCO_GL")
        other = f"no OpenGL to draw with by MUJOCO_GL={asked}: unset it, or choose another"
        raise StudyError(other if asked else _PACKAGES if by_egl else _NONE) from error
