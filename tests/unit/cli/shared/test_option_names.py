import pytest

from crazychoir.cli.shared.option_names import naming_options
from crazychoir.errors import ConfigError


def test_an_error_of_a_value_names_its_option():
    with (
        pytest.raises(ConfigError, match=r"^--drones: found 7; allowed: 4"),
        naming_options(),
    ):
        raise ConfigError("drones", 7, "4")
    with pytest.raises(ConfigError, match=r"^swarm a: found 7"), naming_options():
        raise ConfigError("swarm a", 7, "4")
