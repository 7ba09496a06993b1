import pytest

from crazychoir.optimization.rounds.program import Program
from crazychoir.team.round import Round


class Sum(Program):
    """Adds what it hears, for a number of rounds."""

    def __init__(self, rounds):
        self.rounds, self.total = rounds, 0
        super().__init__()

    def run(self):
        for n in range(self.rounds):
            heard = yield n
            self.total += sum(heard.values())
            self.order = list(heard)
        return f"sum {self.total}"


def test_each_yield_is_a_round_and_the_return_value_the_result():
    program = Sum(2)
    assert isinstance(program, Round)
    assert (program.message(), program.done, program.k) == (0, False, 0)
    program.step({2: 5, 1: 4})
    assert program.order == [1, 2]
    assert program.message() == 1
    program.step({1: 1})
    assert (program.done, program.result, program.k) == (True, "sum 10", 2)


def test_a_program_without_rounds_is_done_at_once():
    assert Sum(0).result == "sum 0"


def test_there_is_no_result_before_the_end():
    with pytest.raises(AttributeError):
        _ = Sum(1).result
