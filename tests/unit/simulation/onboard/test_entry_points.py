"""The kernels of the firmware, called by their entry points."""

import subprocess
import sys

WAITING = """
from crazychoir.numerics.compiling import KERNEL_QUEUE
with KERNEL_QUEUE.checks_first():
    from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.platforms import find_platform
print(Onboard(find_platform("cf21")).state)
"""


def test_kernels_that_wait_for_the_checks_of_a_program_are_compiled_at_their_first_call(
    repository,
):
    done = subprocess.run(
        [sys.executable, "-c", WAITING],
        cwd=repository,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "not initialised\n"
