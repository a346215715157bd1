"""The picture of a scene by Open3D's plain visualizer, in a window or hidden.

Open3D takes a second or two to import: only the view's own processes do.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.pose import Pose
from bridge.view.mesh import Array, Mesh
from bridge.view.scene import BACKGROUND, Camera, Scene
from drivers.frame import Floats

_FIELD = math.radians(34)  # of view, upright
_EYE = np.array([0.0, -4.35, 1.55])
_AIM = np.array([0.0, 0.0, 1.13])
_LIT_BOX = ((-1.2, -0.6, 0.0), (1.2, 0.6, 2.0))


class Window:
    """size: pixels. Raises ImportError or OSError where Open3D or what it needs is missing."""

    def __init__(self, scene: Scene, size: tuple[int, int], visible: bool) -> None:
        import open3d

        self._utility = open3d.utility
        open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
        self._visualizer = open3d.visualization.Visualizer()
        if not self._visualizer.create_window("markerbridge", *size, visible=visible):
            raise OSError("no window can be opened")
        self._scene = scene
        options = self._visualizer.get_render_option()
        options.background_color = BACKGROUND
        options.mesh_show_back_face = True
        options.mesh_shade_option = open3d.visualization.MeshShadeOption.Color  # smooth
        self._geometries: list[tuple[Mesh, Any]] = []
        for mesh in (scene.lit, scene.flat):
            geometry = open3d.geometry.TriangleMesh()
            # The lights hang about the box of what is added first: always the same one.
            mesh.points[::2], mesh.points[1::2] = _LIT_BOX
            geometry.triangles = open3d.utility.Vector3iVector(mesh.triangles)
            geometry.vertices = open3d.utility.Vector3dVector(mesh.points)
            if mesh is scene.lit:
                # Wanted for shading at all, though it is the corners' normals that shade.
                unused = np.zeros(mesh.triangles.shape)
                geometry.triangle_normals = open3d.utility.Vector3dVector(unused)
            self._visualizer.add_geometry(geometry, mesh is scene.lit)
            mesh.points[:] = 0.0
            self._geometries.append((mesh, geometry))
        self._control = self._visualizer.get_view_control()
        self._control.set_constant_z_near(0.2)
        self._control.set_constant_z_far(40.0)
        parameters = open3d.camera.PinholeCameraParameters()
        width, height = size
        focal = height / 2 / math.tan(_FIELD / 2)
        parameters.intrinsic = open3d.camera.PinholeCameraIntrinsic(
            width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5
        )
        parameters.extrinsic = _looking(_EYE, _AIM)
        self._control.convert_from_pinhole_camera_parameters(parameters, True)

    def draw(self, pose: Pose, truth: Floats | None) -> bool:
        """Shows a pose, with the true one (M, 3) where it is known; False once it was closed."""
        self._scene.update(pose, truth, self._camera())
        vector = self._utility.Vector3dVector
        for mesh, geometry in self._geometries:
            geometry.vertices = vector(mesh.points)
            geometry.vertex_colors = vector(mesh.colours)
            if mesh is self._scene.lit:
                geometry.vertex_normals = vector(mesh.normals)
            self._visualizer.update_geometry(geometry)
        return self.refresh()

    def refresh(self) -> bool:
        """Answers the mouse; False once the window was closed."""
        is_open = bool(self._visualizer.poll_events())
        self._visualizer.update_renderer()
        return is_open

    def picture(self) -> npt.NDArray[np.float32]:
        """What was drawn last: (height, width, 3), 0 to 1."""
        return np.array(self._visualizer.capture_screen_float_buffer(False))

    def close(self) -> None:
        self._visualizer.destroy_window()

    def _camera(self) -> Camera:
        """Where the mouse has turned it."""
        axes = np.array(self._control.convert_to_pinhole_camera_parameters().extrinsic)[:3, :3]
        return Camera(axes[0], -axes[1], -axes[2])


def _looking(eye: Array, aim: Array) -> Array:
    """The (4, 4) map from the world to a camera at `eye`: x right, y down, z ahead."""
    ahead = (aim - eye) / np.linalg.norm(aim - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(ahead, right), ahead])
    extrinsic = np.eye(4)
    extrinsic[:3, :3], extrinsic[:3, 3] = axes, -axes @ eye
    return extrinsic
