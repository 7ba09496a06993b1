"""Shows any value that travels on the bus in the terms of JSON."""

import math
from typing import Any


def to_plain_values(value: Any) -> Any:
    """Return lists for arrays, fields by name for wire types,
    and None for numbers that are not finite.
    """
    if isinstance(value, dict):
        return {
            key if isinstance(key, str | int) else str(key): to_plain_values(item)
            for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [to_plain_values(item) for item in value]
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return to_plain_values(value.tolist())
    if hasattr(value, "__struct_fields__"):  # a wire type
        return {
            name: to_plain_values(getattr(value, name))
            for name in value.__struct_fields__
        }
    return None if isinstance(value, float) and not math.isfinite(value) else value
