"""The picture of meshes by Open3D's plain visualizer, in a window or hidden.

Open3D takes a second or two to import: only the view's own processes do.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bridge.view.camera import FIELD, Camera, looking
from bridge.view.colours import Colour
from bridge.view.mesh import Mesh

_BOX = ((-1.2, -0.6, 0.0), (1.2, 0.6, 2.0))
_KEYS = range(32, 349)  # all that GLFW has: Open3D's own meanings are none of ours


class Window:
    """meshes: drawn in their colours. size: pixels. press: told the code of a key that is down.

    Raises ImportError or OSError where Open3D or what it needs is missing.
    """

    def __init__(
        self,
        meshes: list[Mesh],
        background: Colour,
        size: tuple[int, int],
        visible: bool,
        press: Callable[[int], None] = lambda code: None,
    ) -> None:
        _choose_display(visible)
        import open3d

        self._visible = visible
        self._utility = open3d.utility
        self._camera_parameters = open3d.camera.PinholeCameraParameters
        self._intrinsic = open3d.camera.PinholeCameraIntrinsic
        open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
        self._visualizer = open3d.visualization.VisualizerWithKeyCallback()
        if not self._visualizer.create_window("markerbridge", *size, visible=visible):
            raise OSError("no window can be opened")
        for code in _KEYS:
            self._visualizer.register_key_callback(code, _pressed(press, code))
        options = self._visualizer.get_render_option()
        options.background_color = background
        options.mesh_show_back_face = True
        self._geometries = []
        for mesh in meshes:
            geometry = open3d.geometry.TriangleMesh()
            # Its first place tells Open3D how large the world is, and what the mouse turns around.
            mesh.points[0], mesh.points[1:] = _BOX[0], _BOX[1]
            geometry.triangles = open3d.utility.Vector3iVector(mesh.triangles)
            geometry.vertices = open3d.utility.Vector3dVector(mesh.points)
            self._visualizer.add_geometry(geometry)
            mesh.points[:] = 0.0
            self._geometries.append((mesh, geometry))
        self._control = self._visualizer.get_view_control()
        self._control.set_constant_z_near(0.2)
        self._control.set_constant_z_far(40.0)

    def look(self, eye: npt.NDArray[np.float64], aim: npt.NDArray[np.float64]) -> None:
        """Puts the camera somewhere, whatever the mouse had done."""
        width, height = self._size()
        focal = height / 2 / np.tan(FIELD / 2)
        parameters = self._camera_parameters()
        parameters.intrinsic = self._intrinsic(
            width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5
        )
        parameters.extrinsic = looking(eye, aim)
        self._control.convert_from_pinhole_camera_parameters(parameters, True)

    @property
    def camera(self) -> Camera:
        """Where the mouse has turned it."""
        parameters = self._control.convert_to_pinhole_camera_parameters()
        intrinsic = parameters.intrinsic
        return Camera.of(np.array(parameters.extrinsic), intrinsic.width / intrinsic.height)

    def draw(self) -> bool:
        """Shows the meshes as they are now, then answers mouse and keys; False once the window was
        closed.
        """
        vector = self._utility.Vector3dVector
        for mesh, geometry in self._geometries:
            geometry.vertices = vector(mesh.points)
            geometry.vertex_colors = vector(mesh.colours)
            self._visualizer.update_geometry(geometry)
        self._visualizer.update_renderer()
        return bool(self._visualizer.poll_events())

    def picture(self) -> npt.NDArray[np.float32]:
        """What was drawn last: (height, width, 3), 0 to 1."""
        # What a window shows is no longer to be had: it is drawn once more.
        return np.array(self._visualizer.capture_screen_float_buffer(self._visible))

    def close(self) -> None:
        self._visualizer.destroy_window()

    def _size(self) -> tuple[int, int]:
        intrinsic = self._control.convert_to_pinhole_camera_parameters().intrinsic
        return int(intrinsic.width), int(intrinsic.height)


def _pressed(press: Callable[[int], None], code: int) -> Callable[[object], bool]:
    def call(visualizer: object) -> bool:
        press(code)
        return False

    return call


def _choose_display(visible: bool) -> None:
    """Which display Open3D is to find, before it is imported: X, or if hidden none.

    On Wayland its OpenGL loader fails, so it goes through Xwayland. Where there is a display a
    hidden window may be smaller than asked for, or empty.
    """
    for name in ("WAYLAND_DISPLAY",) if visible else ("WAYLAND_DISPLAY", "DISPLAY"):
        os.environ.pop(name, None)
    os.environ["XDG_SESSION_TYPE"] = "x11"
    if visible and not Path("/dev/dri").exists():
        # No graphics card. Smooth edges take Mesa 50 ms a frame instead of 10, and its threads wait
        # for one another longer than they gain where there are few cores.
        os.environ.setdefault("DRI_NO_MSAA", "1")
        os.environ.setdefault("LP_NUM_THREADS", str(max((os.cpu_count() or 1) // 2 - 1, 0)))
