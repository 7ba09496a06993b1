"""What is printed of a running swarm."""

import json

from crazychoir.bus.impairment.model import Impairment
from crazychoir.cli.operate import inspect as look
from crazychoir.config.network import impairment_changes
from crazychoir.config.tables import LinkTable
from crazychoir.types import State


def test_a_state_is_printed_by_its_parts_and_no_age_is_negative(capsys):
    look._print_value(3, State.at((1.0, 2.0, float("nan")), (0.5, 0.0, 0.0)), -0.0004)
    assert json.loads(capsys.readouterr().out) == {
        "drone": 3,
        "p": [1.0, 2.0, None],
        "v": [0.5, 0.0, 0.0],
        "q": [0.0, 0.0, 0.0, 1.0],
        "w": [0.0, 0.0, 0.0],
        "age": 0.0,
        "a": [0.0, 0.0, 0.0],
    }
    look._print_value(3, "a line", 0.25)
    assert json.loads(capsys.readouterr().out) == {
        "drone": 3,
        "value": "a line",
        "age": 0.25,
    }


def test_a_simulated_network_is_printed_in_words():
    network = Impairment(7)
    assert look._in_words(network.describe()) == "nothing: perfect"
    network.update(impairment_changes(LinkTable(loss=0.25, burst=5.0, delay=0.1)))
    network.update({"edge": [1, 2], "loss": 0.5})
    network.update({"edge": [2, 1], "directed": True, "jitter": 0.02})
    network.update({"drone": 3, "loss": 1.0, "partitions": [{"since": 5, "a": [0, 1]}]})
    assert look._in_words(network.describe()).splitlines() == [
        "delay 0.1, loss 0.25 in bursts of 5",
        "1 and 2: loss 0.5",
        "2 to 1: jitter 0.02",
        "drone 3: loss 1",
        "0, 1 apart from the others, from 5 s after GO to the end",
    ]
    assert look._in_words("refused: not now") == "refused: not now"
