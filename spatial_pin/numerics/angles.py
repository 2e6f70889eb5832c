"""Whole turns of angles."""

from __future__ import annotations

from typing import Any

import numpy as np


def whole_turns(angle: Any) -> Any:
    """Return the whole turns nearest to an angle, or to each of several [rad]."""
    return 2.0 * np.pi * np.round(angle / (2.0 * np.pi))
