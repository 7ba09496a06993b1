"""Crazyflies in MuJoCo: one model of all drones, with contacts, sensors and pictures.

It needs the extra `mujoco`.
"""

from crazychoir.errors import ConfigError

try:
    import mujoco  # noqa: F401 - an import of this package without MuJoCo gets the error below
except ImportError as error:
    raise ConfigError(
        "MuJoCo", str(error), "an installed one", "pip install 'crazychoir[mujoco]'"
    ) from error
