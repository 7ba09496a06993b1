"""The world mujoco://: Crazyflies with bodies, contacts and sensors of MuJoCo.

Rotors, air and firmware are those of the motor-level world.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.platforms import CRAZYFLIE_21, Platform
from crazychoir.simulation.common.world import WorldSetup
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.lanes import (
    AIRBORNE_FLAG,
    LANE_COUNT,
    MOTOR_ALIVE_1,
)
from crazychoir.simulation.motor_level.motors import (
    MOTOR_TIME_STEP,
    MotorConditions,
)
from crazychoir.simulation.mujoco.model import (
    MODEL_NAMES,
    SENSOR_TYPES,
    body_name,
    compile_model,
)
from crazychoir.simulation.mujoco.shape import Shape, make_crazyflie_shape, read_shape
from crazychoir.simulation.mujoco.wrench import (
    find_contacts,
    read_joint_states,
    write_joint_states,
    write_mean_wrenches,
)
from crazychoir.types import Mat, Vec

CONTACT_STANDING_SPEED = 0.05
"""Speed in m/s below which a drone that touches something counts as standing."""


class MujocoWorld(CrazyflieWorld):
    """CrazyflieWorld with free bodies of one MuJoCo model, which can touch each other.

    In each millisecond the motor-level model computes how rotors, air and weight would change the
    velocities of drones that touch nothing. MuJoCo gets this change as the mean wrench of the
    millisecond, adds the contacts, and returns the velocities. So drones in free flight fly as in
    CrazyflieWorld. The acceleration that the accelerometers sense, with contacts, is MuJoCo's;
    noise and bias are those of the motor-level world.

    shapes: one for all drones, or one a drone; None: a Crazyflie of primitives
    scene: a user's MJCF file with the objects in the room
    options: options of CrazyflieWorld, with platform and bodies
    model: MuJoCo's model
    data: MuJoCo's data
    """

    def __init__(
        self,
        ids: Sequence[int],
        p0: Mat,
        yaw0: Vec | None = None,
        platform: Platform | Sequence[Platform] = CRAZYFLIE_21,
        *,
        shapes: Shape | Sequence[Shape] | None = None,
        scene: Path | None = None,
        **options: Any,
    ) -> None:
        self._shapes = shapes
        self._scene = scene
        super().__init__(ids, p0, yaw0, platform, **options)

    def _fill(self, seed: int, conditions: MotorConditions) -> None:
        super()._fill(seed, conditions)
        self._options[:3] = (
            0.0  # the floor is MuJoCo's, not that of the motor-level world
        )
        self._blocks[:, AIRBORNE_FLAG : AIRBORNE_FLAG + LANE_COUNT] = self._blocks[
            :, MOTOR_ALIVE_1 : MOTOR_ALIVE_1 + LANE_COUNT
        ]
        self._build()

    def _build(self) -> None:
        """Build the model, and find the places of the drones in its arrays."""
        n = len(self.ids)
        ids = self.ids
        shapes = self._shapes
        if shapes is None:
            own = {row.name: make_crazyflie_shape(row) for row in self.platforms}
            shapes = [own[row.name] for row in self.platforms]
        shapes = [shapes] * n if isinstance(shapes, Shape) else list(shapes)
        self.model = compile_model(
            ids, self.platforms, [shape.solid for shape in shapes], self._scene
        )
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(body_name(i)).id for i in ids]
        self._places = self.model.jnt_qposadr[joints].astype(np.int64)
        self._speeds = self.model.jnt_dofadr[joints].astype(np.int64)
        self._bodies = np.array([self.model.body(body_name(i)).id for i in ids])
        self._drone_of = np.full(self.model.nbody, -1)
        self._drone_of[self._bodies] = np.arange(n)
        self._stands = np.array([-shape.lowest for shape in shapes])
        self._inertia = np.array([[row.mass, *row.inertia] for row in self.platforms])
        first = self.model.sensor(
            f"{body_name(ids[0])}/{MODEL_NAMES.accelerometer}"
        ).adr[0]
        self._forces = self.data.sensordata[first : first + 3 * n]
        self._before = self.states.copy()
        self._touching = np.zeros(n)
        self._hit = np.zeros(n)
        self._against = np.zeros(n, np.int64)

    def _advance(self, time: int, steps: int) -> None:
        model = self.model
        data = self.data
        if steps == 0:
            super()._advance(time, 0)
        write_joint_states(
            self.states, self._stands, self._places, self._speeds, data.qpos, data.qvel
        )
        for k in range(steps):
            mujoco.mj_step1(model, data)
            self._touch()
            np.copyto(self._before, self.states)
            super()._advance(time + k, 1)
            write_mean_wrenches(
                self._before,
                self.states,
                self._inertia,
                self._bodies,
                MOTOR_TIME_STEP,
                data.xfrc_applied,
            )
            mujoco.mj_step2(model, data)
            read_joint_states(
                self._before,
                data.qvel,
                self._speeds,
                MOTOR_TIME_STEP,
                self._forces,
                self.states,
                self._lanes,
            )
            write_joint_states(
                self.states,
                self._stands,
                self._places,
                self._speeds,
                data.qpos,
                data.qvel,
            )
        np.copyto(self.impact, self._hit)
        slow = np.linalg.norm(self.states[:, 3:6], axis=1) < CONTACT_STANDING_SPEED
        np.copyto(self._resting, np.where(slow, self._touching, 0.0))

    def _touch(self) -> None:
        """Find the drones that touch something."""
        data = self.data
        model = self.model
        self._touching[:] = 0.0
        if data.ncon:
            contacts = data.contact
            find_contacts(
                contacts.geom,
                contacts.pos,
                contacts.frame,
                model.geom_bodyid,
                model.body_rootid,
                data.cvel,
                data.subtree_com,
                self._drone_of,
                self._touching,
                self._hit,
                self._against,
            )

    def sensed(self, i: int) -> dict[str, Vec]:
        """Return the last readings of drone i's SENSOR_TYPES in MuJoCo, without noise."""
        return {
            name: self.data.sensor(f"{body_name(i)}/{name}").data.copy()
            for name in SENSOR_TYPES
        }

    def struck(self, i: int) -> str:
        """Return the name of the thing that drone i hit fastest."""
        geom = self.model.geom(int(self._against[self.row[i]]))
        body = int(geom.bodyid[0])
        other = int(self._drone_of[body])
        if other >= 0:
            return f"drone {self.ids[other]}"
        name = (geom.name or self.model.body(body).name).removeprefix(
            MODEL_NAMES.scene_prefix
        )
        return "the floor" if name == MODEL_NAMES.floor else name


def engine(setup: WorldSetup) -> MujocoWorld:
    """Make the world of a swarm file; its options are the tables [motors] and [mujoco].

    Raises ConfigError for a tilted floor.
    """
    options = setup.options
    if any(options["floor_tilt"]):
        do = "Leave it out; a plate that is tilted goes into a scene."
        raise ConfigError(
            "motors.floor_tilt",
            options["floor_tilt"],
            "[0, 0]: in MuJoCo the floor is level",
            do,
        )
    model = options["model"]
    scene = options["scene"]
    shape = (
        read_shape(Path(model), options["body"], options["scale"]) if model else None
    )
    return MujocoWorld.of(setup, shapes=shape, scene=Path(scene) if scene else None)
