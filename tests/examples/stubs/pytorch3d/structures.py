"""Batches of meshes."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Meshes:
    """A batch of one mesh."""

    verts: list[Tensor]
    faces: list[Tensor]
