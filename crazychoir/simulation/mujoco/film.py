"""Off-screen pictures of a swarm: MuJoCo's model with the drones at given places."""

import importlib
import math
import sys
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError
from crazychoir.simulation.mujoco.model import MODEL_NAMES, MODEL_SETTINGS, body_name
from crazychoir.simulation.mujoco.shape import Colour
from crazychoir.types import Mat, Vec

Image = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PictureSettings:
    """How a picture of a swarm is drawn."""

    hidden_height: float = -1000.0
    """Height in m at which a drone with an unknown place is hidden."""
    azimuth: float = 60.0
    """Azimuth in deg of the camera that shows the whole flight."""
    elevation: float = -28.0
    """Elevation in deg of the camera that shows the whole flight."""
    trail_width: float = 2.0
    """Width in pixels of the line behind a drone."""
    largest_geom_count: int = 20_000
    """Largest number of geoms in one picture."""


PICTURE_SETTINGS = PictureSettings()


class Film:
    """A camera that takes pictures of drones at given places.

    model: the model with all drones
    ids: the drones of the model, in the order of the rows
    width: pixels
    height: pixels
    low: (3,) m: lower corner of the space in which the drones fly
    high: (3,) m: upper corner of that space
    camera: name of a camera of the scene; empty: a camera that shows the whole space
    Raises ConfigError for a wrong size or camera, or if off-screen drawing is not possible.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        ids: tuple[int, ...],
        width: int,
        height: int,
        low: Vec,
        high: Vec,
        camera: str = "",
    ) -> None:
        if not (
            16 <= width <= MODEL_SETTINGS.largest_width
            and 16 <= height <= MODEL_SETTINGS.largest_height
        ):
            raise ConfigError(
                "size",
                f"{width}x{height}",
                f"16x16 to {MODEL_SETTINGS.largest_width}x{MODEL_SETTINGS.largest_height} pixels",
            )
        self.model, self.data = model, mujoco.MjData(model)
        self.width = width
        self.height = height
        # The extent sets the range of light and shadow: the space in which the drones fly.
        model.stat.center, model.stat.extent = (
            0.5 * (low + high),
            _bounding_radius(low, high),
        )
        self._rows = [int(model.joint(body_name(i)).qposadr[0]) for i in ids]
        self._camera = self._named(camera) if camera else self._overview(low, high)
        self._gl = _make_context(width, height)
        self._gl.make_current()
        self._scene = mujoco.MjvScene(
            model, maxgeom=PICTURE_SETTINGS.largest_geom_count
        )
        self._scene.flags[mujoco.mjtRndFlag.mjRND_HAZE.value] = 0
        self._options = mujoco.MjvOption()
        self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)

    def _overview(self, low: Vec, high: Vec) -> mujoco.MjvCamera:
        """Return a camera so far away that the sphere around the flight fills the picture."""
        camera = mujoco.MjvCamera()
        view = math.radians(self.model.vis.global_.fovy)
        narrow = min(
            view, 2.0 * math.atan(math.tan(0.5 * view) * self.width / self.height)
        )
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat = 0.5 * (low + high)
        camera.azimuth = PICTURE_SETTINGS.azimuth
        camera.elevation = PICTURE_SETTINGS.elevation
        camera.distance = 0.72 * _bounding_radius(low, high) / math.sin(0.5 * narrow)
        return camera

    def _named(self, name: str) -> mujoco.MjvCamera:
        names = [self.model.camera(k).name for k in range(self.model.ncam)]
        found = next(
            (
                k
                for k, own in enumerate(names)
                if name in (own, own.removeprefix(MODEL_NAMES.scene_prefix))
            ),
            None,
        )
        if found is None:
            there = (
                ", ".join(own.removeprefix(MODEL_NAMES.scene_prefix) for own in names)
                or "none"
            )
            raise ConfigError(
                "camera",
                name,
                f"a camera of the scene: {there}",
                "Leave it out to see all.",
            )
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = found
        return camera

    def picture(
        self,
        p: Mat,
        q: Mat,
        trails: tuple[Mat, ...] = (),
        colours: tuple[Colour, ...] = (),
    ) -> Image:
        """Draw the drones and return the picture (height, width, 3).

        p: (N, 3) m: from the floor to the centre of mass of each drone; NaN to hide it
        q: (N, 4): attitude of each drone; NaN to hide it
        trails: (k, 3) m: earlier places of each drone, drawn as a line
        colours: colour of each trail
        """
        for at, place, turn in zip(self._rows, p, q, strict=True):
            known = bool(np.isfinite(place).all() and np.isfinite(turn).all())
            self.data.qpos[at : at + 3] = (
                place if known else (0.0, 0.0, PICTURE_SETTINGS.hidden_height)
            )
            self.data.qpos[at + 3 : at + 7] = (
                turn[[3, 0, 1, 2]] if known else (1.0, 0.0, 0.0, 0.0)
            )
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        all_kinds = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self.model,
            self.data,
            self._options,
            None,
            self._camera,
            all_kinds,
            self._scene,
        )
        for trail, colour in zip(trails, colours, strict=False):
            self._draw(trail, colour)
        return self._read()

    def _draw(self, trail: Mat, colour: Colour) -> None:
        """Draw a line through the places, the fainter the older."""
        scene = self._scene
        line = mujoco.mjtGeom.mjGEOM_LINE
        n = max(len(trail) - 1, 1)
        for k in range(len(trail) - 1):
            if scene.ngeom >= scene.maxgeom or not np.isfinite(trail[k : k + 2]).all():
                continue
            geom = scene.geoms[scene.ngeom]
            rgba = np.array([*colour[:3], 0.1 + 0.6 * k / n], np.float32)
            mujoco.mjv_initGeom(
                geom, line, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba
            )
            mujoco.mjv_connector(
                geom, line, PICTURE_SETTINGS.trail_width, trail[k], trail[k + 1]
            )
            scene.ngeom += 1

    def _read(self) -> Image:
        image: Image = np.zeros((self.height, self.width, 3), np.uint8)
        window = mujoco.MjrRect(0, 0, self.width, self.height)
        mujoco.mjr_render(window, self._scene, self._mjr)
        mujoco.mjr_readPixels(image, None, window, self._mjr)
        return image[::-1]

    def close(self) -> None:
        """Free the graphics context."""
        self._mjr.free()
        self._gl.free()

    def __enter__(self) -> "Film":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _bounding_radius(low: Vec, high: Vec) -> float:
    """Return the radius in m of a sphere around the box from low to high, with room for a drone."""
    return 0.5 * float(np.linalg.norm(high - low)) + 0.15


def _make_context(width: int, height: int) -> Any:
    """Return a context to draw without a window: EGL on Linux, with or without a graphics card.

    Raises ConfigError if there is none.
    """
    try:
        if sys.platform == "linux":
            return importlib.import_module("mujoco.egl").GLContext(width, height)
        return mujoco.GLContext(width, height)
    except (ImportError, AttributeError, RuntimeError) as error:
        do = (
            "Install it (Debian: libegl1 and libgl1-mesa-dri)."
            if sys.platform == "linux"
            else ""
        )
        raise ConfigError(
            "pictures of MuJoCo", str(error), "OpenGL off-screen: on Linux EGL", do
        ) from error
