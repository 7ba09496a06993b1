"""The grid of an airspace: cells over the last places of all drones.

    cell along an axis = floor((s p - corner) / size),   s: entry of S, p: place

A drone that looks for near ones looks into the cells around its own place only.
"""

from crazychoir.numerics.kernels import kernel
from crazychoir.safety.airspace.airspace_rows import FarCell
from crazychoir.safety.airspace.nearness import compute_reach
from crazychoir.types import Ints, Records

CELLS_PER_DRONE = 2  # largest number of cells, in multiples of the number of drones
CELLS_PER_REACH = 2.0  # cells within the distance in which drones may be near


@kernel()
def find_corners(far: Records, grid: Records, rules: Records) -> int:
    """Choose the cells such that all places of the grid lie in one, and return their number.

    far: FAR_ROW, (swarm,)
    grid: one row of GRID_ROW
    rules: one row of AIRSPACE_RULES_ROW
    """
    scale = rules.scale
    is_empty = True
    high = (0.0, 0.0, 0.0)
    low = (0.0, 0.0, 0.0)
    for j in range(far.shape[0]):
        if far[j].cell < 0:
            continue
        p = far[j].place
        q = (scale[0] * p[0], scale[1] * p[1], scale[2] * p[2])
        if is_empty:
            is_empty = False
            low = q
            high = q
        low = (min(low[0], q[0]), min(low[1], q[1]), min(low[2], q[2]))
        high = (max(high[0], q[0]), max(high[1], q[1]), max(high[2], q[2]))
    for c in range(3):
        grid.corner[c] = low[c]
    grid.size = compute_reach(grid.fastest, grid.oldest, rules) / CELLS_PER_REACH
    while True:
        cells = 1
        for c in range(3):
            grid.counts[c] = int((high[c] - low[c]) / grid.size) + 1
            cells *= grid.counts[c]
        if cells <= CELLS_PER_DRONE * far.shape[0]:
            return cells
        grid.size *= 2.0


@kernel()
def build_grid(
    far: Records, grid: Records, rules: Records, begins: Ints, order: Ints
) -> None:
    """Sort all drones by their cells, and by id within a cell. The late drones come last.

    far: FAR_ROW, (swarm,)
    grid: one row of GRID_ROW
    rules: one row of AIRSPACE_RULES_ROW
    begins: (CELLS_PER_DRONE x swarm + 1,): receives where each cell begins in the order
    order: (swarm,): receives the rows of the drones
    """
    cells = find_corners(far, grid, rules)
    for cell in range(cells + 1):
        begins[cell] = 0
    for j in range(far.shape[0]):
        known = far[j]
        if known.cell == FarCell.UNKNOWN:
            continue
        if known.cell == FarCell.LATE:
            begins[cells] += 1
            continue
        cell = 0
        for c in range(2, -1, -1):
            along = int((rules.scale[c] * known.place[c] - grid.corner[c]) / grid.size)
            cell = cell * grid.counts[c] + along
        known.cell = cell
        begins[cell] += 1
    for cell in range(1, cells + 1):
        begins[cell] += begins[cell - 1]
    grid.late_first = begins[cells - 1]
    grid.late_end = begins[cells]
    for j in range(far.shape[0] - 1, -1, -1):
        cell = far[j].cell
        if cell == FarCell.UNKNOWN:
            continue
        if cell == FarCell.LATE:
            cell = cells
        begins[cell] -= 1
        order[begins[cell]] = j


@kernel()
def find_cells(
    p: float, reach: float, axis: int, grid: Records, rules: Records
) -> tuple[int, int]:
    """Return the first cell along an axis that may have near drones, and the end of these cells.

    p: m, coordinate of the drone that looks
    reach: m, see compute_reach
    axis: 0, 1 or 2
    grid: one row of GRID_ROW
    rules: one row of AIRSPACE_RULES_ROW
    """
    middle = rules.scale[axis] * p - grid.corner[axis]
    first = max((middle - reach) / grid.size, 0.0)
    end = min((middle + reach) / grid.size, grid.counts[axis] - 1.0) + 1.0
    if not end > first:
        return 0, 0
    return int(first), int(end)
