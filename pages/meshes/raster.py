"""Triangles and lines to planes of pixels: VTK draws them, without any light, off the screen and without a GPU.

VTK gets its OpenGL from the system: on Linux from Mesa's EGL, which draws in software where there is no GPU.
"""

import ctypes
import math
import os
import sys
from types import TracebackType
from typing import Any, Final, Literal, Self

import numpy as np
import pyvista
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkRenderingCore import vtkWindowToImageFilter

from pages.scenes import Camera

Vectors = NDArray[np.float64]
Integers = NDArray[np.int64]
Plane = NDArray[np.float32]
Pixels = NDArray[np.uint8]

EGL: Final = "libEGL.so.1"
NEAREST: Final = 0.25
"""Voxels from the eye at which anything is seen."""
NEARER: Final = 0.5
"""Where the range of depths begins, as a share of the distance of the nearest thing seen: lines lie before it."""
SLACK: Final = 1.001
"""How much further than the farthest point the range of depths goes."""


class Stage:
    """A window that nobody sees, with one set of triangles and several of lines in it. To be used in `with`.

    Everything is moved so that `centre` is the origin: float32 is enough anywhere.
    """

    def __init__(self, width: int, height: int, centre: Vectors, points: Vectors, triangles: Integers) -> None:
        """points: (V, 3) voxels. triangles: (T, 3). Raises `RuntimeError` if the system has no OpenGL."""
        _find_opengl()
        self.width, self.height = width, height
        self._centre = centre
        self._points: NDArray[Any] = (points - centre).astype(np.float32)
        self._plotter = pyvista.Plotter(off_screen=True, window_size=[width, height], lighting="none")
        self._plotter.renderer.SetBackground(0, 0, 0)
        window = self._plotter.render_window
        if window is None:
            raise RuntimeError("VTK made no window")
        self._window = window
        self._window.SetMultiSamples(0)
        self._lines: dict[str, pyvista.Actor] = {}
        self._front_mesh, self._fronts = self._drawn(triangles, "back")
        self._back_mesh, self._backs = self._drawn(triangles, "front")
        _, self._both = self._drawn(triangles, False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._plotter.close()

    def _drawn(
        self, triangles: NDArray[Any], hidden: Literal["back", "front", False]
    ) -> tuple[pyvista.PolyData, pyvista.Actor]:
        """Put the triangles on the stage, without one of their sides or with both."""
        shown = pyvista.PolyData.from_regular_faces(self._points, triangles)
        shown["colour"] = np.zeros(self._points.shape, np.uint8)
        return shown, self._plotter.add_mesh(shown, scalars="colour", rgb=True, lighting=False, culling=hidden)

    def add_lines(self, name: str, points: Vectors, edges: Integers, strengths: Vectors, width: float) -> None:
        """Put lines on the stage, unseen but by `lines_seen(name)`.

        points: (V, 3) voxels. edges: (E, 2). strengths: (V,), 0 to 1. width: pixels.
        """
        cells = np.column_stack([np.full(len(edges), 2), edges]).reshape(-1)
        lines = pyvista.PolyData((points - self._centre).astype(np.float32), lines=cells)
        lines["colour"] = np.repeat(_bytes(strengths)[:, None], 3, axis=1)
        actor = self._plotter.add_mesh(lines, scalars="colour", rgb=True, lighting=False, line_width=width)
        self._lines[name] = actor

    def look(self, camera: Camera) -> None:
        """Look at the stage as `camera` does."""
        lens = self._plotter.camera
        lens.SetParallelProjection(False)
        lens.SetViewAngle(math.degrees(2 * math.atan(camera.pixel * camera.height / 2)))
        eye, axes = np.asarray(camera.eye) - self._centre, camera.axes()
        self._aim(eye, axes, NEAREST)
        seen = float(self.distance_seen().min())
        if math.isfinite(seen):  # the nearer the range begins, the coarser are its depths
            self._aim(eye, axes, NEARER * seen)

    def look_along(self, axes: Vectors, radius: float) -> None:
        """Look from far away at the ball of `radius` voxels around the centre. axes: (3, 3) right, up and ahead."""
        self._plotter.camera.SetParallelProjection(True)
        self._plotter.camera.SetParallelScale(radius)
        self._aim(-2 * radius * axes[2], axes, NEARER * radius)

    def _aim(self, eye: Vectors, axes: Vectors, nearest: float) -> None:
        ahead = self._points @ axes[2].astype(np.float32) - np.float32(eye @ axes[2])
        self._range = max(nearest, NEARER * float(ahead.min())), max(2 * nearest, float(ahead.max()) * SLACK)
        lens = self._plotter.camera
        lens.SetPosition(*eye)
        lens.SetFocalPoint(*(eye + axes[2]))
        lens.SetViewUp(*axes[1])
        lens.SetClippingRange(*self._range)

    def colours_seen(self, fronts: Vectors, backs: Vectors) -> Plane:
        """Return what is seen, (H, W, 3), 0 where nothing is, if the two sides of the triangles have these colours.

        fronts, backs: (V, 3), 0 to 1; what is seen is rounded to 1/255.
        """
        self._front_mesh["colour"] = _bytes(fronts)
        self._back_mesh["colour"] = _bytes(backs)
        return self._read("SetInputBufferTypeToRGB", self._fronts, self._backs).astype(np.float32) / np.float32(255)

    def lines_seen(self, name: str) -> Plane:
        """Return the strength of the lines of that name, (H, W), where no triangle is in front of them."""
        strength = self._read("SetInputBufferTypeToRGB", self._both, self._lines[name])[..., 0]
        return np.asarray(strength, np.float32) / np.float32(255)

    def distance_seen(self, fronts_only: bool = False) -> Plane:
        """Return how far ahead the triangles are, (H, W), voxels along the view; infinite where there are none.

        fronts_only: those seen from the rock are not there.
        """
        depth = self._read("SetInputBufferTypeToZBuffer", self._fronts if fronts_only else self._both)[..., 0]
        near, far = self._range
        parallel = self._plotter.camera.GetParallelProjection()
        ahead = near + depth * (far - near) if parallel else near * far / (far - depth * (far - near))
        return np.where(depth < 1, ahead, np.inf).astype(np.float32)

    def _read(self, buffer: str, *shown: pyvista.Actor) -> NDArray[Any]:
        """Draw these actors, and return a buffer of the window, (H, W, components)."""
        for actor in (self._fronts, self._backs, self._both, *self._lines.values()):
            actor.SetVisibility(actor in shown)
        self._window.Render()
        reader = vtkWindowToImageFilter(input=self._window, read_front_buffer=False)
        getattr(reader, buffer)()
        reader.ShouldRerenderOff()
        reader.Update()
        scalars = reader.GetOutput().GetPointData().GetScalars()
        pixels = vtk_to_numpy(scalars)  # type: ignore[no-untyped-call]
        return np.ascontiguousarray(pixels.reshape(self.height, self.width, -1)[::-1])


def _bytes(shares: Vectors) -> Pixels:
    """Return 0 to 1 as 0 to 255."""
    return np.round(255 * np.clip(shares, 0, 1)).astype(np.uint8)


def _find_opengl() -> None:
    """Choose EGL on Linux, display or not, so that all pictures are drawn alike. VTK itself would crash without it."""
    if sys.platform != "linux":
        return
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    try:
        ctypes.CDLL(EGL)
    except OSError as error:
        raise RuntimeError(f"no {EGL}, which pictures are drawn with (in Debian's libegl1): {error}") from error
