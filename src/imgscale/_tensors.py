"""Arrays out of the tensors of any framework, without importing one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def as_numpy(values: Any) -> NDArray[Any]:
    """Turn a tensor of any framework, type and device, or nested lists into an array."""
    if hasattr(values, "detach"):  # torch's way to an array; numpy has no bfloat16
        values = values.detach().cpu()
        values = values.float() if "bfloat16" in str(values.dtype) else values
    return np.asarray(values)
