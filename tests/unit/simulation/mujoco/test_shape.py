"""What a drone is made of, ours and a user's: sizes, lowest points, what is refused."""

import struct
from itertools import product

import numpy as np
import pytest

from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.errors import ConfigError
from crazychoir.platforms import PLATFORM_BY_NAME
from crazychoir.simulation.mujoco.shape import (
    CRAZYFLIE_LOOK,
    make_crazyflie_shape,
    read_shape,
    scale_shape,
)

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
QUADS = (
    (0, 1, 3, 2),
    (4, 6, 7, 5),
    (0, 4, 5, 1),
    (2, 3, 7, 6),
    (0, 2, 6, 4),
    (1, 5, 7, 3),
)


def stl(path, half):
    """A box with these half-lengths, twelve triangles."""
    triangles = [corner for a, b, c, d in QUADS for corner in ((a, b, c), (a, c, d))]
    rows = [
        struct.pack("<12fH", 0, 0, 0, *(CORNERS[list(one)] * half).ravel(), 0)
        for one in triangles
    ]
    path.write_bytes(bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows))
    return path


URDF = """<robot name="drone"><link name="base">
  <collision><geometry><box size="0.1 0.08 0.03"/></geometry></collision></link>
  <link name="arm"><collision><origin xyz="0 0 -0.02"/><geometry><sphere radius="0.01"/></geometry></collision></link>
  <joint name="turns" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""
MJCF = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="near" pos="5 5 5"><freejoint/>
  <geom type="capsule" size="0.01 0.03" euler="0 90 0"/><body pos="0 0 0.01"><joint type="hinge"/>
  <geom type="ellipsoid" size="0.05 0.05 0.02" contype="0" conaffinity="0" rgba="1 0 0 1"/></body></body>{more}
  </worldbody></mujoco>"""
OTHER = '<body name="far"><geom size="0.02"/></body>'


def written(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "platform", PLATFORM_BY_NAME.values(), ids=lambda row: row.name
)
def test_ours_is_a_dozen_primitives_that_stand_and_touch_where_drones_do(platform):
    shape = make_crazyflie_shape(platform)
    solid = [part for part in shape.parts if part.solid]
    assert len(shape.parts) <= 14
    assert shape.meshes == ()
    assert shape.lowest == pytest.approx(-CRAZYFLIE_LOOK.centre_height)
    assert len(solid) == 1
    assert 2.0 * solid[0].size[0] == pytest.approx(2.0 * platform.radius)
    assert 2.0 * solid[0].size[1] == CRAZYFLIE_LOOK.height
    assert platform.name == "cf21bl" or 2.0 * solid[0].size[0] == pytest.approx(
        SWARM_LIMITS.touching_distance
    )
    shown = [part for part in shape.parts if part.colour[3] > 0.0]
    assert all(part.p[2] - part.size[2] > -CRAZYFLIE_LOOK.height for part in shown)


def test_an_stl_of_millimetres_is_scaled(tmp_path):
    path = stl(tmp_path / "box.STL", (40.0, 30.0, 10.0))
    with pytest.raises(
        ConfigError, match=r"geoms up to 51 m from the origin.*scale = 0.001"
    ):
        read_shape(path)
    shape = read_shape(path, scale=0.001)
    assert shape.lowest == pytest.approx(-0.01, abs=1e-6)
    assert shape.reach == pytest.approx(0.051, abs=1e-3)
    assert [part.solid for part in shape.parts] == [True]


def test_a_urdf_with_joints_becomes_one_body_at_rest(tmp_path):
    shape = read_shape(written(tmp_path, "drone.urdf", URDF))
    assert len(shape.parts) == 2
    assert shape.lowest == pytest.approx(-0.03)


def test_the_body_of_an_mjcf_counts_in_its_own_frame_without_the_floor(tmp_path):
    path = written(tmp_path, "drone.xml", MJCF.format(more=""))
    shape = read_shape(path)
    assert [part.solid for part in shape.parts] == [True, False]
    assert shape.lowest == pytest.approx(-0.01)
    np.testing.assert_allclose(shape.parts[1].p, [0, 0, 0.01], atol=1e-12)
    assert shape.parts[1].colour == pytest.approx((1, 0, 0, 1))
    assert scale_shape(shape, 2.0).lowest == pytest.approx(-0.02)


def test_one_of_several_bodies_must_be_named(tmp_path):
    path = written(tmp_path, "two.xml", MJCF.format(more=OTHER))
    with pytest.raises(ConfigError, match="2 bodies: near, far"):
        read_shape(path)
    assert len(read_shape(path, "near").parts) == 2
    assert read_shape(path, "far").lowest == pytest.approx(-0.02)
    with pytest.raises(ConfigError, match="there is no such body; near, far"):
        read_shape(path, "nobody")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.dae", "", "a file .dae; allowed: .stl"),
        ("a.xml", "<mujoco", "MuJoCo says"),
        ("a.xml", "<mujoco><worldbody/></mujoco>", "no geom that can touch anything"),
        (
            "a.xml",
            '<mujoco><worldbody><geom size="1" contype="0" conaffinity="0"/></worldbody></mujoco>',
            "no geom",
        ),
        (
            "a.xml",
            '<mujoco><worldbody><geom size="0.001"/></worldbody></mujoco>',
            "geoms up to 0.00",
        ),
        ("a.stl", "solid", "MuJoCo says"),
    ],
)
def test_what_is_no_drone_is_refused(tmp_path, name, text, said):
    with pytest.raises(ConfigError, match=said):
        read_shape(written(tmp_path, name, text))
    with pytest.raises(ConfigError, match="no such file"):
        read_shape(tmp_path / "none.stl")
