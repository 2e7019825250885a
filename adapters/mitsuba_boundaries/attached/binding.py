"""The binding of named parameters to a scene, as attached samplers use it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from contextlib import AbstractContextManager
from typing import Any, Protocol

from mitsuba_boundaries.drjit.arrays import Float32Array

__all__ = ["Binding"]


class Binding(Protocol):
    """Sets the parameters of a scene by name, with or without gradients."""

    def leaves(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Check `params` and return them as flat arrays of Dr.Jit."""

    def set(self, leaves: Mapping[str, Any], names: Collection[str] | None = None) -> None:
        """Set all parameters in the scene, or those in `names`."""

    def attached(self, params: Mapping[str, Any], wrt: Collection[str]) -> AbstractContextManager[dict[str, Any]]:
        """Set `params` in the scene with gradients enabled for `wrt`, and yield their leaves."""

    def gradients(self, leaves: Mapping[str, Any], names: Iterable[str]) -> dict[str, Float32Array]:
        """Return the gradients that leaves have accumulated, in the shapes of their parameters."""
