"""Shape of a drone for pictures and contacts: built from primitives, or read from a user's file."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.simulation.motor_level.body import ROTOR_HEIGHT
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class CrazyflieLook:
    """Size and colours of the drone that is built from primitives."""

    height: float = 0.029
    """Height in m of a drone that stands (Bitcraze's data sheet)."""
    centre_height: float = 0.0125
    """Height in m of the centre of mass above the floor, between battery and board; chosen."""
    dark_colour: tuple[float, float, float, float] = (0.13, 0.14, 0.16, 1.0)
    """Colour of the board and the arms: red, green, blue, opacity."""
    grey_colour: tuple[float, float, float, float] = (0.55, 0.57, 0.60, 1.0)
    """Colour of the battery and the motors, and of a drone without its own colour."""
    front_colour: tuple[float, float, float, float] = (0.90, 0.25, 0.15, 1.0)
    """Colour of the part that shows the front."""


CRAZYFLIE_LOOK = CrazyflieLook()


@dataclass(frozen=True, slots=True)
class ShapeFileRules:
    """Which files are accepted as the shape of a drone."""

    smallest_reach: float = 0.01
    """Least distance in m from the origin to the farthest point of a shape."""
    largest_reach: float = 1.0
    """Greatest distance in m from the origin to the farthest point of a shape."""
    mesh_suffixes: tuple[str, ...] = (".stl", ".obj", ".msh")
    """Endings of files with one mesh."""
    model_suffixes: tuple[str, ...] = (".xml", ".mjcf", ".urdf")
    """Endings of files with a whole model."""


SHAPE_FILE_RULES = ShapeFileRules()


Geom = mujoco.mjtGeom
Colour = tuple[float, float, float, float]


@dataclass(frozen=True)
class Part:
    """One geom in the drone's frame: origin in its centre of mass, x forward, z up."""

    kind: int
    """MuJoCo's type of the geom."""
    size: Vec
    """Half-lengths or radii in m."""
    p: Vec
    """(3,) m: position."""
    q: Vec
    """(4,): attitude, [w, x, y, z] as in MuJoCo."""
    colour: Colour
    """Red, green, blue, opacity, each 0 to 1."""
    solid: bool = False
    """True if the part can touch other geoms."""
    mesh: int = -1
    """Index of its mesh in the meshes of the shape; -1 for a primitive."""


@dataclass(frozen=True)
class Shape:
    """All parts of a drone."""

    parts: tuple[Part, ...]
    """The geoms."""
    meshes: tuple[tuple[Mat, Mat], ...] = ()
    """(vertices (n, 3) m, faces (m, 3)) of each mesh."""

    @property
    def solid(self) -> "Shape":
        """The shape with only the parts that can touch: all that a simulation needs."""
        return Shape(tuple(part for part in self.parts if part.solid), self.meshes)

    @property
    def lowest(self) -> float:
        """Height in m of the lowest solid point above the centre of mass, level: negative."""
        return min(self._lowest(part) for part in self.parts if part.solid)

    @property
    def reach(self) -> float:
        """Distance in m from the origin to the farthest point, or a little more."""
        return max(
            float(np.linalg.norm(part.p)) + self._radius(part) for part in self.parts
        )

    def _lowest(self, part: Part) -> float:
        down, (a, b, _) = _rotation(part.q)[2], part.size.tolist()
        below: float
        match part.kind:
            case Geom.mjGEOM_SPHERE:
                below = a
            case Geom.mjGEOM_CAPSULE:
                below = a + b * abs(down[2])
            case Geom.mjGEOM_CYLINDER:
                below = a * math.sqrt(max(0.0, 1.0 - down[2] ** 2)) + b * abs(down[2])
            case Geom.mjGEOM_ELLIPSOID:
                below = float(np.linalg.norm(part.size * down))
            case Geom.mjGEOM_BOX:
                below = float(np.abs(part.size) @ np.abs(down))
            case _:
                below = -float((self.meshes[part.mesh][0] @ down).min())
        return float(part.p[2]) - below

    def _radius(self, part: Part) -> float:
        if part.mesh >= 0:
            return float(np.linalg.norm(self.meshes[part.mesh][0], axis=1).max())
        return float(np.linalg.norm(part.size))


def make_crazyflie_shape(
    platform: Platform, colour: Colour = CRAZYFLIE_LOOK.grey_colour
) -> Shape:
    """Return a Crazyflie of a dozen primitives, from the lengths of its platform.

    Its only solid part is a cylinder around the drone with the platform's radius, so two drones
    touch at the distance at which a run counts them as touching.
    """
    arm = platform.arm
    rotor = platform.rotor.radius
    hub = ROTOR_HEIGHT - CRAZYFLIE_LOOK.centre_height
    parts = [
        _make_part(
            Geom.mjGEOM_CYLINDER,
            (platform.radius, 0.5 * CRAZYFLIE_LOOK.height),
            (0, 0, 0.5 * CRAZYFLIE_LOOK.height - CRAZYFLIE_LOOK.centre_height),
            (0, 0, 0, 0),
            True,
        ),
        _make_part(
            Geom.mjGEOM_BOX,
            (0.016, 0.014, 0.001),
            (0, 0, -0.006),
            CRAZYFLIE_LOOK.dark_colour,
        ),
        _make_part(
            Geom.mjGEOM_BOX,
            (0.011, 0.010, 0.0035),
            (0, 0, -0.001),
            CRAZYFLIE_LOOK.grey_colour,
        ),
        _make_part(
            Geom.mjGEOM_BOX,
            (0.003, 0.006, 0.001),
            (0.014, 0, -0.004),
            CRAZYFLIE_LOOK.front_colour,
        ),
        _make_arm(math.hypot(arm, arm), math.pi / 4.0),
        _make_arm(math.hypot(arm, arm), -math.pi / 4.0),
    ]
    for x, y in ((arm, -arm), (-arm, -arm), (-arm, arm), (arm, arm)):
        parts.append(
            _make_part(
                Geom.mjGEOM_CYLINDER,
                (0.0035, 0.5 * hub + 0.005),
                (x, y, 0.5 * hub - 0.005),
                CRAZYFLIE_LOOK.grey_colour,
            )
        )
        parts.append(
            _make_part(
                Geom.mjGEOM_CYLINDER, (rotor, 0.0006), (x, y, hub), (*colour[:3], 0.55)
            )
        )
    return Shape(tuple(parts))


def _make_part(
    kind: int,
    size: tuple[float, ...],
    p: tuple[float, ...],
    colour: Colour,
    solid: bool = False,
) -> Part:
    full = np.zeros(3)
    full[: len(size)] = size
    return Part(
        int(kind),
        full,
        np.array(p, float),
        np.array([1.0, 0.0, 0.0, 0.0]),
        colour,
        solid,
    )


def _make_arm(half: float, yaw: float) -> Part:
    """Return a bar of the frame through the centre, which carries two motors."""
    bar = _make_part(
        Geom.mjGEOM_BOX,
        (half, 0.0022, 0.001),
        (0, 0, -0.0045),
        CRAZYFLIE_LOOK.dark_colour,
    )
    return replace(
        bar, q=np.array([math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])
    )


def read_shape(path: Path, body: str = "", scale: float = 1.0) -> Shape:
    """Return the geoms of a user's STL, OBJ, URDF or MJCF file in their places at rest.

    Masses and joints of the file are ignored.

    path: the file
    body: name of the drone's body, if the file has several
    scale: factor of all lengths, 0.001 for a file in millimetres
    Raises ConfigError if the file cannot be read, has no solid geom, or has a wrong size.
    """
    where = f"mujoco.model {path}"
    model = _compile_file(path, where)
    shape = scale_shape(_read_parts(model, _find_root(model, body, where)), scale)
    if not any(part.solid for part in shape.parts):
        do = "Give one of its geoms a contype, or a URDF a <collision>."
        raise ConfigError(
            where, "no geom that can touch anything", "a drone stands on the floor", do
        )
    if (
        not SHAPE_FILE_RULES.smallest_reach
        <= shape.reach
        <= SHAPE_FILE_RULES.largest_reach
    ):
        found = f"geoms up to {shape.reach:.3g} m from the origin"
        allowed = (
            f"{SHAPE_FILE_RULES.smallest_reach:g} to {SHAPE_FILE_RULES.largest_reach:g} "
            "m; the origin is the drone's centre of mass"
        )
        raise ConfigError(
            where,
            found,
            allowed,
            "For a file in millimetres, write scale = 0.001 into [mujoco].",
        )
    return shape


def _compile_file(path: Path, where: str) -> mujoco.MjModel:
    """Compile the file as a model of its own."""
    suffix = path.suffix.lower()
    if suffix not in SHAPE_FILE_RULES.mesh_suffixes + SHAPE_FILE_RULES.model_suffixes:
        raise ConfigError(
            where,
            f"a file {suffix or 'without ending'}",
            ", ".join(SHAPE_FILE_RULES.mesh_suffixes + SHAPE_FILE_RULES.model_suffixes),
            "Convert it.",
        )
    if not path.is_file():
        raise ConfigError(
            where,
            "no such file",
            "a path relative to the swarm file",
            "Correct the path.",
        )
    try:
        spec = (
            _wrap_mesh(path)
            if suffix in SHAPE_FILE_RULES.mesh_suffixes
            else mujoco.MjSpec.from_file(str(path))
        )
        # With fusestatic the first link of a URDF would become part of the world.
        spec.compiler.fusestatic = False
        return spec.compile()
    except ValueError as error:
        raise ConfigError(
            where,
            f"MuJoCo says: {error}",
            "a model that MuJoCo compiles",
            "Correct the file.",
        ) from error


def _wrap_mesh(path: Path) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.add_mesh(
        name="mesh", file=str(path), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    )
    spec.worldbody.add_geom(
        type=Geom.mjGEOM_MESH, meshname="mesh", rgba=CRAZYFLIE_LOOK.grey_colour
    )
    return spec


def _find_root(model: mujoco.MjModel, body: str, where: str) -> int:
    """Return the drone's body: the named body or the only body.

    A file with a mesh alone has no body; then it is the world, 0.
    Raises ConfigError if there is no body of that name, or several bodies and no name.
    """
    tops = [k for k in range(1, model.nbody) if model.body_parentid[k] == 0]
    names = {model.body(k).name: k for k in range(1, model.nbody)}
    if body:
        if body not in names:
            there = ", ".join(filter(None, names)) or "the file has none with a name"
            raise ConfigError(
                f"{where}: mujoco.body",
                body,
                there,
                "Correct it.",
                "there is no such body",
            )
        return names[body]
    if len(tops) > 1:
        found = ", ".join(model.body(k).name or f"number {k}" for k in tops)
        raise ConfigError(
            where,
            f"{len(tops)} bodies: {found}",
            "one drone",
            "Write body = its name into [mujoco].",
        )
    return tops[0] if tops else 0


def _read_parts(model: mujoco.MjModel, root: int) -> Shape:
    """Return all geoms of a body and its children, in its frame.

    Planes are left out: they are the floor of the file's scene.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turned = data.xmat[root].reshape(3, 3)
    p0 = data.xpos[root]
    parts = []
    for g in range(model.ngeom):
        if model.geom_type[g] == Geom.mjGEOM_PLANE or not _is_part_of(
            model, int(model.geom_bodyid[g]), root
        ):
            continue
        q = np.zeros(4)
        mujoco.mju_mat2Quat(q, (turned.T @ data.geom_xmat[g].reshape(3, 3)).ravel())
        colour = (
            model.mat_rgba[model.geom_matid[g]]
            if model.geom_matid[g] >= 0
            else model.geom_rgba[g]
        )
        kind = int(model.geom_type[g])
        solid = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        mesh = int(model.geom_dataid[g]) if kind == Geom.mjGEOM_MESH else -1
        p = turned.T @ (data.geom_xpos[g] - p0)
        size = model.geom_size[g].copy()
        parts.append(Part(kind, size, p, q, tuple(colour.tolist()), solid, mesh))
    return Shape(tuple(parts), tuple(_read_mesh(model, k) for k in range(model.nmesh)))


def _is_part_of(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body not in (0, root):
        body = int(model.body_parentid[body])
    return body == root


def _read_mesh(model: mujoco.MjModel, k: int) -> tuple[Mat, Mat]:
    vertices = slice(model.mesh_vertadr[k], None)
    faces = slice(model.mesh_faceadr[k], None)
    return (
        model.mesh_vert[vertices][: model.mesh_vertnum[k]].astype(float),
        model.mesh_face[faces][: model.mesh_facenum[k]].copy(),
    )


def scale_shape(shape: Shape, scale: float) -> Shape:
    """Return the shape with all lengths multiplied by scale."""
    parts = tuple(
        replace(part, size=scale * part.size, p=scale * part.p) for part in shape.parts
    )
    return Shape(
        parts, tuple((scale * vertices, faces) for vertices, faces in shape.meshes)
    )


def _rotation(q: Vec) -> Mat:
    r = np.zeros(9)
    mujoco.mju_quat2Mat(r, q)
    return r.reshape(3, 3)
