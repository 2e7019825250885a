"""Separable blurs of stacks of planes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from torch import Tensor

from loi_core.method.plane_blurs import PlaneBlur
from loi_torch.triton_backend import kernels
from loi_torch.triton_backend.launching import Launcher
from loi_torch.triton_backend.tables import DEPTH, Band, band

__all__ = ["StackBlur"]

LINES: Final = 64  # of a tile of `blur`


@dataclass(frozen=True)
class StackBlur:
    """A separable blur of stacks, shape (..., H, W)."""

    plan: PlaneBlur
    run: Launcher

    def rows(self, *, adjoint: bool) -> Band:
        """Return the matrix that blurs rows of a plane, which is its vertical axis."""
        return band(self.plan.rows, self.run.device, adjoint=adjoint)

    def columns(self, *, adjoint: bool) -> Band:
        """Return the matrix that blurs columns of a plane."""
        return band(self.plan.columns, self.run.device, adjoint=adjoint)

    def apply(self, stack: Tensor, *, offset: float = 0.0) -> Tensor:
        """Return the blurred stack; `offset` is subtracted first."""
        if self.plan.columns_first:
            narrow = self.along(stack, self.columns(adjoint=False), -1, offset=offset)
            return self.along(narrow, self.rows(adjoint=False), -2)
        narrow = self.along(stack, self.rows(adjoint=False), -2, offset=offset)
        return self.along(narrow, self.columns(adjoint=False), -1)

    def adjoint(self, stack: Tensor, total: Tensor | None = None, target: Tensor | None = None) -> Tensor:
        """Return the transposed blur of a stack, added to `total` or written to `target`, which may be the stack."""
        if self.plan.columns_first:
            narrow = self.along(stack, self.rows(adjoint=True), -2)
            return self.along(narrow, self.columns(adjoint=True), -1, total, target)
        narrow = self.along(stack, self.columns(adjoint=True), -1)
        return self.along(narrow, self.rows(adjoint=True), -2, total, target)

    def along(
        self,
        stack: Tensor,
        matrix: Band,
        axis: int,
        total: Tensor | None = None,
        target: Tensor | None = None,
        *,
        offset: float = 0.0,
    ) -> Tensor:
        """Multiply one axis of a stack by a matrix; add the product to `total`, or write it to `target`."""
        *outer, height, width = stack.shape
        planes = math.prod(outer)
        if axis == -1:
            lines, shape = height, (*outer, height, matrix.cells)
            strides = (1, width, 1, matrix.cells)
        else:
            lines, shape = width, (*outer, matrix.cells, width)
            strides = (width, 1, width, 1)
        result = total if total is not None else self.run.empty(*shape) if target is None else target
        grid = planes, matrix.blocks, -(-lines // LINES)
        self.run.launch(
            kernels.blur,
            grid,
            stack,
            result,
            matrix.starts,
            matrix.table,
            matrix.size,
            matrix.cells,
            lines,
            matrix.depth,
            *strides,
            offset,
            BLOCK=matrix.block,
            LINES=LINES,
            DEPTH=DEPTH,
            OFFSET=offset != 0.0,
            ADD=total is not None,
            warps=matrix.warps,
            operations=2.0 * planes * lines * matrix.blocks * matrix.block * matrix.depth,
        )
        return result
