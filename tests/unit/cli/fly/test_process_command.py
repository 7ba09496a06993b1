"""What the commands that run one process of a swarm have in common."""

import os
import subprocess
import sys

import pytest

COUNT_THREADS = """
from pathlib import Path
{begin}
threads = Path("/proc/self/task")
before = len(list(threads.iterdir()))
import numpy as np
np.ones((400, 400)) @ np.ones((400, 400))
print(len(list(threads.iterdir())) - before)
"""
BEGIN = (
    "from crazychoir.cli.fly.process_command import begin_process; begin_process(False)"
)


def count_threads(begin: str, **environment: str) -> int:
    """Return the threads that a product of matrices begins in a new process."""
    done = subprocess.run(
        [sys.executable, "-c", COUNT_THREADS.format(begin=begin)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **environment},
    )
    return int(done.stdout)


def test_the_process_of_a_drone_multiplies_matrices_in_one_thread():
    if count_threads("") == 0:
        pytest.skip("numpy begins no thread here anyway")
    assert count_threads(BEGIN) == 0


def test_a_number_of_threads_from_the_environment_is_kept():
    found = count_threads("", OPENBLAS_NUM_THREADS="2")
    assert count_threads(BEGIN, OPENBLAS_NUM_THREADS="2") == found
