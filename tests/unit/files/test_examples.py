"""The swarm files that come with the package."""

import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.files.examples import (
    find_example,
    list_copies,
    list_examples,
    require_example,
)


def test_every_swarm_file_of_deploy_is_an_example_with_a_summary(repository):
    summaries = list_examples()
    files = {file.stem for file in (repository / "deploy").glob("*.toml")}
    assert set(summaries) == files
    assert all(len(summary) > 20 for summary in summaries.values())
    assert not any("crazychoir run" in summary for summary in summaries.values())


def test_example_is_found_by_its_name_alone():
    assert find_example("lab6").name == "lab6.toml"
    assert find_example("lab7") is None
    assert find_example("../examples/lab6") is None


def test_misspelt_example_is_refused_with_the_name_that_was_meant():
    with pytest.raises(ConfigError, match=r"Did you mean grid30\?"):
        require_example("grid3")


@pytest.mark.parametrize("name", ["formation_drawn", "aggregative_replayed", "lab6"])
def test_copies_of_an_example_stand_beside_each_other(name, tmp_path):
    for one in list_copies(require_example(name)):
        assert "../agents" not in one.text
        (tmp_path / one.name).write_text(one.text)
    config = SwarmConfig.load(str(tmp_path / f"{name}.toml"))
    assert config.ids == SwarmConfig.load(str(find_example(name))).ids
