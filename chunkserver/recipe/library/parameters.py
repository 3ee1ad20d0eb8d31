"""What may stand in a parameter of a built-in world: lengths at which all of its features can exist."""

from typing import Annotated

from pydantic import Field

Size = Annotated[float, Field(strict=True, ge=16, le=1 << 20, allow_inf_nan=False)]
LargeSize = Annotated[float, Field(strict=True, ge=64, le=1 << 20, allow_inf_nan=False)]
"""Voxels."""
