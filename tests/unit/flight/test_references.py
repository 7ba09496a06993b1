"""References as users write them: converted once where they are taken, or refused; never an error of a kernel."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.flight.references import convert_reference, explain_refusal
from crazychoir.numerics.array_like import describe_value, to_floats
from crazychoir.types import Acceleration, FullState, Goto, Velocity

READ_ONLY = np.array([0.0, 0.0, 1.0])
READ_ONLY.flags.writeable = False
UNALIGNED = np.frombuffer(b"\0" + np.array([0.0, 0.0, 1.0]).tobytes(), dtype=np.uint8)[
    1:
].view(np.float64)
GOOD = {
    "integers": np.array([0, 0, 1]),
    "a list": [0, 0, 1],
    "a tuple": (0.0, 0, True),
    "numpy's scalars in a list": [np.float32(0), np.int8(0), np.bool_(True)],
    "float32": np.array([0, 0, 1], dtype=np.float32),
    "float16": np.array([0, 0, 1], dtype=np.float16),
    "long doubles": np.array([0, 0, 1], dtype=np.longdouble),
    "truth values": np.array([False, False, True]),
    "unsigned": np.array([0, 0, 1], dtype=np.uint8),
    "objects": np.array([0, Fraction(0), 1.0], dtype=object),
    "big-endian": np.array([0.0, 0.0, 1.0]).astype(">f8"),
    "every second entry": np.array([0.0, 9.0, 0.0, 9.0, 1.0])[::2],
    "backwards": np.array([1.0, 0.0, 0.0])[::-1],
    "a row of a column-major matrix": np.asfortranarray(
        [[0.0, 0.0, 1.0], [9.0, 9.0, 9.0]]
    )[0],
    "read-only": READ_ONLY,
    "unaligned": UNALIGNED,
    "a subclass": np.array([0.0, 0.0, 1.0]).view(np.recarray),
    "masked, nothing masked": np.ma.array([0.0, 0.0, 1.0]),
}
BAD = {
    "nothing": None,
    "one number": 1.0,
    "too few": [0.0, 1.0],
    "too many": [0.0, 0.0, 1.0, 0.0],
    "a row of a matrix": [[0.0, 0.0, 1.0]],
    "a column": np.array([[0.0], [0.0], [1.0]]),
    "ragged": [0.0, [1.0], 2.0],
    "complex": np.array([0.0, 0.0, 1j]),
    "texts": ["0", "0", "1"],
    "texts as objects": np.array(["0", "0", "1"], dtype=object),
    "a missing entry": [0.0, None, 1.0],
    "a set": {0.0, 1.0, 2.0},
    "a dictionary": {0: 1.0, 1: 2.0, 2: 3.0},
    "times": np.array([0, 0, 1], dtype="m8[s]"),
    "nan": [0.0, np.nan, 1.0],
    "inf": np.array([0.0, np.inf, 1.0], dtype=np.float32),
    "beyond what a float holds": [0, 0, 10**400],
    "a masked entry": np.ma.array([0.0, 0.0, 1.0], mask=[False, True, False]),
}
KINDS = {"a": Acceleration, "v": Velocity, "p": Goto}


def is_for_kernels(array):
    return (
        type(array) is np.ndarray
        and array.dtype == np.float64
        and array.dtype.isnative
        and array.flags.carray
    )


@pytest.mark.parametrize("name", GOOD)
@pytest.mark.parametrize("field", KINDS)
def test_what_holds_three_numbers_is_converted(name, field):
    found = convert_reference(KINDS[field](GOOD[name], np.int64(0)))
    assert type(found) is KINDS[field]
    vector = getattr(found, field)
    assert is_for_kernels(vector)
    assert vector.tolist() == [0.0, 0.0, 1.0]
    assert (type(found.yaw), found.yaw) == (float, 0.0)


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("field", KINDS)
def test_what_does_not_is_refused_with_its_type_and_shape(name, field):
    reference = KINDS[field](BAD[name])
    assert convert_reference(reference) is None
    text = explain_refusal(reference)
    assert text.startswith(
        f"{KINDS[field].__name__}.{field}: found {describe_value(BAD[name])}"
    )
    assert "allowed: 3 finite numbers of shape (3,)" in text
    if isinstance(BAD[name], np.ndarray):
        assert f"{BAD[name].dtype} array of shape {BAD[name].shape}" in text


@pytest.mark.parametrize("yaw", [None, "0", [0.0], np.array([0.0]), np.nan, np.inf, 1j])
@pytest.mark.parametrize("field", KINDS)
def test_a_yaw_that_is_no_number_is_refused(yaw, field):
    reference = KINDS[field](np.zeros(3), yaw)
    assert convert_reference(reference) is None
    assert explain_refusal(reference).startswith(f"{KINDS[field].__name__}.yaw: found")


@pytest.mark.parametrize("duration", [None, "1", np.nan])
def test_a_duration_that_is_no_number_is_refused(duration):
    reference = Goto(np.zeros(3), 0.0, duration)
    assert convert_reference(reference) is None
    assert explain_refusal(reference).startswith("Goto.duration: found")


@pytest.mark.parametrize(
    "flat",
    [
        list(range(14)),
        np.arange(14),
        np.arange(14, dtype=np.float32),
        np.arange(28.0)[::2] / 2.0,
        range(14),
    ],
)
def test_a_full_state_of_fourteen_numbers_is_converted(flat):
    found = convert_reference(FullState(flat))
    assert is_for_kernels(found.flat)
    assert found.flat.tolist() == list(range(14))


@pytest.mark.parametrize(
    "flat", [None, np.zeros(13), np.zeros((14, 1)), [0.0] * 13 + [np.nan], ["0"] * 14]
)
def test_a_full_state_of_anything_else_is_refused(flat):
    assert convert_reference(FullState(flat)) is None
    assert explain_refusal(FullState(flat)).startswith("FullState.flat: found")


@pytest.mark.parametrize(
    "thing", [None, 3, "up", np.zeros(3), (0.0, 0.0, 1.0), Acceleration, object()]
)
def test_what_is_no_reference_is_refused(thing):
    assert convert_reference(thing) is None
    assert (
        "allowed: Acceleration(...), FullState(...), Goto(...), Velocity(...) or None"
        in explain_refusal(thing)
    )


def test_what_needs_no_conversion_is_taken_as_it_is():
    for reference in (
        Acceleration(np.zeros(3)),
        Velocity(np.zeros(3), 0.5),
        FullState(np.zeros(14)),
    ):
        assert convert_reference(reference) is reference
        assert explain_refusal(reference) == ""


@given(
    st.lists(st.floats(-1e6, 1e6) | st.integers(-1000, 1000), min_size=0, max_size=5),
    st.sampled_from(["f8", "f4", "i8", "i2", ">f8", "O", "c16", "U9", "?"]),
    st.sampled_from(["as it is", "list", "every second", "read-only"]),
)
def test_any_array_is_converted_or_refused_and_never_an_error(numbers, dtype, how):
    array = np.array(numbers, dtype=float).astype(dtype)
    if how == "every second":
        array = np.repeat(array, 2)[::2]
    array.flags.writeable = how != "read-only"
    found = to_floats(array.tolist() if how == "list" else array, (3,))
    is_good = len(numbers) == 3 and dtype not in ("c16", "U9")
    assert (found is not None) == is_good
    if found is not None:
        assert is_for_kernels(found)
        assert found.tolist() == pytest.approx(array.astype(float).tolist())
