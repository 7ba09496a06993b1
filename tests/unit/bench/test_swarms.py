import math

import pytest

from crazychoir.bench.swarms import (
    BENCH_SWARMS,
    FlightCase,
    build_bench_swarm,
    build_formation,
    build_lattice,
)
from crazychoir.guidance.formation.bearing import NORMALISED_LAW, check_formation


def list_neighbors(formation):
    neighbors = {i: set() for i in formation.places}
    for i, j in formation.edges:
        neighbors[i].add(j)
        neighbors[j].add(i)
    return neighbors


@pytest.mark.parametrize("drones", [5, 7, 30, 57])
def test_a_drone_of_a_lattice_hears_the_drones_beside_it_and_on_the_diagonals(drones):
    lattice = build_lattice(drones)
    assert sorted(lattice.places) == list(range(drones))
    reach = 1.01 * math.sqrt(2.0) * BENCH_SWARMS.spacing
    for i, heard in list_neighbors(lattice).items():
        near = {
            j
            for j, place in lattice.places.items()
            if j != i and math.dist(place, lattice.places[i]) < reach
        }
        assert heard == near


def test_corners_of_a_lattice_and_every_fifth_drone_of_its_border_lead():
    assert build_lattice(100).leaders == (0, 5, 9, 50, 59, 90, 95, 99)


@pytest.mark.parametrize(
    "drones", [5, 6, 7, 13, 21, 30, 100, pytest.param(300, marks=pytest.mark.slow)]
)
def test_a_lattice_is_rigid_and_fast_enough_to_fly_without_force(drones):
    lattice = build_lattice(drones)
    neighbors = list_neighbors(lattice)
    report = check_formation(lattice.places, neighbors, lattice.leaders, NORMALISED_LAW)
    assert not report.warnings


@pytest.mark.parametrize("shape", ["lattice", "ring"])
def test_drones_take_off_into_the_formation_inside_the_fence(shape):
    config = build_bench_swarm(FlightCase(12, shape=shape), 3.0)
    formation = build_formation(shape, 12)
    assert config.flight.takeoff_height == BENCH_SWARMS.height
    for drone in config.drones:
        x, y, z = formation.places[drone.id]
        assert drone.home == (x, y, 0.0)
        assert config.fence.min[0] < x < config.fence.max[0]
        assert config.fence.min[1] < y < config.fence.max[1]
        assert z == BENCH_SWARMS.height


def test_the_case_chooses_engine_and_collision_filter():
    config = build_bench_swarm(FlightCase(5, plant="motors", collision="off"), 3.0)
    assert config.collision.method == "off"
    assert {drone.uri for drone in config.drones} == {"sim://motors"}
