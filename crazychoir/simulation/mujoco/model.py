"""One MuJoCo model of a whole swarm: floor, light, the user's scene, and a free body a drone.

Each drone has its sensors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import Platform
from crazychoir.simulation.motor_level.motors import MOTOR_TIME_STEP
from crazychoir.simulation.mujoco.shape import Shape


@dataclass(frozen=True, slots=True)
class ModelNames:
    """Names in the MuJoCo model."""

    floor: str = "floor"
    """Name of the floor's geom, texture and material."""
    scene_prefix: str = "scene/"
    """Prefix of the names from a user's scene."""
    accelerometer: str = "accelerometer"
    """Last part of the name of a drone's accelerometer."""
    gyroscope: str = "gyro"
    """Last part of the name of a drone's gyroscope."""
    position: str = "position"
    """Last part of the name of a drone's position sensor."""


MODEL_NAMES = ModelNames()


@dataclass(frozen=True, slots=True)
class ModelSettings:
    """Settings of the MuJoCo model: contacts of the drones, groups of geoms, and the largest
    picture.
    """

    contact_response: tuple[float, ...] = (0.004, 0.6)
    """Time constant in s and damping ratio of a contact with a drone (solref); chosen.

    A drone bounces back with about a fifth of its speed.
    """
    friction: tuple[float, ...] = (0.8, 0.005, 0.0001)
    """Friction coefficients of a drone: sliding, torsional, rolling; chosen."""
    visible_group: int = 1
    """Group of geoms that cameras show."""
    hidden_group: int = 3
    """Group of geoms that cameras do not show."""
    largest_width: int = 3840
    """Width in pixels of the largest picture."""
    largest_height: int = 2160
    """Height in pixels of the largest picture."""


MODEL_SETTINGS = ModelSettings()


SENSOR_TYPES = {
    MODEL_NAMES.accelerometer: mujoco.mjtSensor.mjSENS_ACCELEROMETER,
    MODEL_NAMES.gyroscope: mujoco.mjtSensor.mjSENS_GYRO,
    MODEL_NAMES.position: mujoco.mjtSensor.mjSENS_FRAMEPOS,
}
"""Sensors of each drone, without noise.

The accelerometer reports m/s2 body, the gyroscope rad/s body, the position is in m world.
"""

Point = tuple[float, float, float]


def body_name(i: int) -> str:
    """Return the name of drone i in the model."""
    return f"cf{i}"


def compile_model(
    ids: Sequence[int],
    platforms: Sequence[Platform],
    shapes: Sequence[Shape],
    scene: Path | None = None,
) -> mujoco.MjModel:
    """Return the compiled model of a swarm.

    Masses and inertias are those of the platforms, whatever the shapes are.
    ids: the drones
    platforms: one a drone
    shapes: one a drone
    scene: a user's MJCF file; its bodies, geoms, lights and cameras are added
    Raises ConfigError if the scene cannot be read or the model does not compile.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = MOTOR_TIME_STEP
    spec.option.gravity = [0.0, 0.0, -STANDARD_GRAVITY]
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET
    _add_room(spec)
    if scene is not None:
        _add_scene(spec, scene)
    meshes: dict[int, list[str]] = {}
    for i, platform, shape in zip(ids, platforms, shapes, strict=True):
        if id(shape.meshes) not in meshes:
            meshes[id(shape.meshes)] = _add_meshes(spec, shape, f"mesh{len(meshes)}")
        _add_drone(spec, i, platform, shape, meshes[id(shape.meshes)])
    for name, kind in SENSOR_TYPES.items():
        for i in ids:
            site = body_name(i)
            spec.add_sensor(
                name=f"{site}/{name}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=site,
            )
    try:
        return spec.compile()
    except ValueError as error:
        raise ConfigError(
            f"mujoco.scene {scene}", f"MuJoCo says: {error}", "a model that compiles"
        ) from error


def _add_room(spec: mujoco.MjSpec) -> None:
    """Add the floor z = 0, light, and a sky."""
    texture = mujoco.mjtTexture
    builtin = mujoco.mjtBuiltin
    spec.add_texture(
        name="sky",
        type=texture.mjTEXTURE_SKYBOX,
        builtin=builtin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.62, 0.70, 0.80],
        width=256,
        height=256,
    )
    spec.add_texture(
        name=MODEL_NAMES.floor,
        type=texture.mjTEXTURE_2D,
        builtin=builtin.mjBUILTIN_CHECKER,
        rgb1=[0.80, 0.82, 0.84],
        rgb2=[0.74, 0.76, 0.79],
        width=256,
        height=256,
    )
    material = spec.add_material(
        name=MODEL_NAMES.floor, texrepeat=[1, 1], texuniform=True
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = MODEL_NAMES.floor
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(
        name=MODEL_NAMES.floor,
        type=plane,
        size=[0, 0, 0.05],
        material=MODEL_NAMES.floor,
        castshadow=False,
    )
    spec.worldbody.add_light(
        pos=[0, 0, 8],
        dir=[0.3, 0.35, -1],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.55, 0.55, 0.55],
    )
    visual = spec.visual
    visual.headlight.ambient = [0.42, 0.42, 0.42]
    visual.headlight.diffuse = [0.3, 0.3, 0.3]
    visual.global_.offwidth = MODEL_SETTINGS.largest_width
    visual.global_.offheight = MODEL_SETTINGS.largest_height
    visual.quality.shadowsize = 2048
    visual.quality.numslices = 24
    visual.quality.numstacks = 6


def _add_scene(spec: mujoco.MjSpec, path: Path) -> None:
    where = f"mujoco.scene {path}"
    if not path.is_file():
        raise ConfigError(
            where,
            "no such file",
            "an MJCF, its path relative to the swarm file",
            "Correct the path.",
        )
    try:
        scene = mujoco.MjSpec.from_file(str(path))
        for key in list(scene.keys):
            scene.delete(key)
        spec.attach(
            scene, prefix=MODEL_NAMES.scene_prefix, frame=spec.worldbody.add_frame()
        )
    except ValueError as error:
        raise ConfigError(
            where,
            f"MuJoCo says: {error}",
            "an MJCF that MuJoCo reads",
            "Correct the file.",
        ) from error


def _add_meshes(spec: mujoco.MjSpec, shape: Shape, prefix: str) -> list[str]:
    """Add the meshes of a shape once; drones share them, so that the model compiles quickly."""
    names = []
    for k, (vertices, faces) in enumerate(shape.meshes):
        names.append(f"{prefix}-{k}")
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(
            name=names[-1],
            uservert=vertices.ravel(),
            userface=faces.ravel(),
            inertia=shell,
        )
    return names


def _add_drone(
    spec: mujoco.MjSpec, i: int, platform: Platform, shape: Shape, meshes: Sequence[str]
) -> None:
    name = body_name(i)
    body = spec.worldbody.add_body(name=name)
    body.add_freejoint(name=name)
    body.add_site(name=name, group=MODEL_SETTINGS.hidden_group)
    # MuJoCo takes each value that is not set here from the place of the body, so all are set.
    body.explicitinertial = True
    body.ipos = [0.0, 0.0, 0.0]
    body.iquat = [1.0, 0.0, 0.0, 0.0]
    body.mass = platform.mass
    body.inertia = platform.inertia
    for part in shape.parts:
        geom = body.add_geom(
            type=part.kind,
            pos=part.p,
            quat=part.q,
            rgba=part.colour,
            friction=MODEL_SETTINGS.friction,
        )
        if part.mesh >= 0:
            geom.meshname = meshes[part.mesh]
        else:
            geom.size = part.size
        geom.density = 0.0
        geom.group = (
            MODEL_SETTINGS.visible_group
            if part.colour[3] > 0.0
            else MODEL_SETTINGS.hidden_group
        )
        geom.contype = geom.conaffinity = int(part.solid)
        geom.solref[:] = MODEL_SETTINGS.contact_response
