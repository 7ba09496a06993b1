"""What JSON has for any value that travels."""

import math
from typing import Any


def plain(value: Any) -> Any:
    """Lists for arrays, fields by name, null for what is not finite."""
    if isinstance(value, dict):
        return {
            key if isinstance(key, str | int) else str(key): plain(item)
            for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # an array
        return plain(value.tolist())
    if hasattr(value, "__struct_fields__"):  # a wire type
        return {name: plain(getattr(value, name)) for name in value.__struct_fields__}
    return None if isinstance(value, float) and not math.isfinite(value) else value
