"""The two hottest loops in hand-written vectors, through Numba's private API; :mod:`.rows` has plain loops instead.

LLVM vectorises loops that it understands. With many rows read and written at once it can no longer prove that they do
not overlap, and it does not recognise the transpose of a square. With plain
loops the comparison takes 1.4 to 1.8 times as long at 64x64 pixels, and 1.01 to 1.12 times at 192x256 and 512x512; the
results are the same to the last bit.

The module depends on `numba.core`, which may change with any release of Numba. :mod:`.rows` tests it at import and
falls back to the plain loops.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.extending import register_model
from numba.extending import intrinsic

from loi_core.method.compiled.compiling import compiled
from loi_core.method.compiled.tables import GROUP_ROWS, PAIRS_PER_STEP, SQUARE_SIDE, VECTOR_BYTES, Floats, Plane

__all__ = ["combine_pairs", "computes_correctly", "transpose"]

ROWS_PER_SIDE: Final = GROUP_ROWS + PAIRS_PER_STEP - 1  # rows above, and below, that a group reads in a step


@compiled
def combine_pairs(
    kernel: Floats,
    workspace: Floats,
    above: int,
    below: int,
    source_stride: int,
    target: Plane,
    width: int,
    add: bool,
) -> None:
    """See :func:`loi_core.method.compiled.rows.combine_pairs`."""
    zero = _broadcast(workspace, workspace.dtype.type(0))
    for x in range(0, width, VECTOR_BYTES // workspace.itemsize):
        sum0, sum1, sum2, sum3 = zero, zero, zero, zero
        if add:
            sum0, sum1, sum2, sum3 = _load_vectors(workspace, target.offset + x, target.stride, GROUP_ROWS)
        up, down = above + x, below + x
        for pair in range(0, kernel.size, PAIRS_PER_STEP):
            up0, up1, up2, up3, up4, up5 = _load_vectors(workspace, up, source_stride, ROWS_PER_SIDE)
            down0, down1, down2, down3, down4, down5 = _load_vectors(workspace, down, source_stride, ROWS_PER_SIDE)
            weight = _broadcast(workspace, kernel[pair])
            sum0 = _add_product(sum0, weight, up2, down0)
            sum1 = _add_product(sum1, weight, up3, down1)
            sum2 = _add_product(sum2, weight, up4, down2)
            sum3 = _add_product(sum3, weight, up5, down3)
            weight = _broadcast(workspace, kernel[pair + 1])
            sum0 = _add_product(sum0, weight, up1, down1)
            sum1 = _add_product(sum1, weight, up2, down2)
            sum2 = _add_product(sum2, weight, up3, down3)
            sum3 = _add_product(sum3, weight, up4, down4)
            weight = _broadcast(workspace, kernel[pair + 2])
            sum0 = _add_product(sum0, weight, up0, down2)
            sum1 = _add_product(sum1, weight, up1, down3)
            sum2 = _add_product(sum2, weight, up2, down4)
            sum3 = _add_product(sum3, weight, up3, down5)
            up, down = up - PAIRS_PER_STEP * source_stride, down + PAIRS_PER_STEP * source_stride
        _store_vectors(workspace, target.offset + x, target.stride, (sum0, sum1, sum2, sum3))


@compiled
def transpose(workspace: Floats, source: Plane, width: int, groups: int, target: Plane) -> None:
    """See :func:`loi_core.method.compiled.rows.transpose`."""
    for x in range(0, width, SQUARE_SIDE):
        for y in range(0, GROUP_ROWS * groups, SQUARE_SIDE):  # y inside, so that writes are contiguous
            square = _load_square(workspace, source.offset + y * source.stride + x, source.stride)
            _store_vectors(workspace, target.offset + x * target.stride + y, target.stride, _transposed(square))


def computes_correctly() -> bool:
    """Return whether this Numba compiles the vectors, and a transposed element arrives where it belongs."""
    workspace = np.arange(64.0 * 64.0)
    transpose(workspace, Plane(0, 64), SQUARE_SIDE, SQUARE_SIDE // GROUP_ROWS, Plane(2048, 64))
    combine_pairs(np.ones(PAIRS_PER_STEP), workspace, 5 * 64, 9 * 64, 64, Plane(1024, 64), SQUARE_SIDE, False)
    return bool(workspace[2048 + 64] == 1.0)


class _Vector(types.Type):  # type: ignore[misc]  # Numba has no types
    """The Numba type of an LLVM vector."""

    def __init__(self, dtype: Any, count: int) -> None:
        super().__init__(name=f"vector({dtype} x {count})")
        self.dtype, self.count = dtype, count


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, vector: _Vector) -> None:
        element = manager.lookup(vector.dtype).get_value_type()
        super().__init__(manager, vector, ir.VectorType(element, vector.count))


def _full_vector(array: Any) -> _Vector:
    return _Vector(array.dtype, VECTOR_BYTES * 8 // array.dtype.bitwidth)


def _instruction(function: Callable[..., Any]) -> Any:
    """Return an intrinsic from a function of Numba types to a signature and a generator of LLVM instructions."""
    return intrinsic(prefer_literal=True)(function)


@_instruction
def _load_vectors(typing: Any, array: Any, index: Any, stride: Any, count: Any) -> Any:
    """Load `count` (a literal) vectors of VECTOR_BYTES, from `index` on and `stride` apart."""
    results = types.UniTuple(_full_vector(array), count.literal_value)
    return results(array, index, stride, count), _loader(array, results)


@_instruction
def _load_square(typing: Any, array: Any, index: Any, stride: Any) -> Any:
    """Load a square of SQUARE_SIDE vectors of SQUARE_SIDE numbers, from `index` on and `stride` apart."""
    results = types.UniTuple(_Vector(array.dtype, SQUARE_SIDE), SQUARE_SIDE)
    return results(array, index, stride), _loader(array, results)


def _loader(array: Any, results: Any) -> Callable[..., Any]:
    def generate(context: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        pointers = _pointers(context, builder, array, args, results.dtype, results.count)
        vectors = [builder.load(pointer, align=array.dtype.bitwidth // 8) for pointer in pointers]
        return context.make_tuple(builder, signature.return_type, vectors)

    return generate


@_instruction
def _store_vectors(typing: Any, array: Any, index: Any, stride: Any, rows: Any) -> Any:
    """Store a tuple of vectors, from `index` on and `stride` apart."""

    def generate(context: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        pointers = _pointers(context, builder, array, args, rows.dtype, rows.count)
        for pointer, vector in zip(pointers, cgutils.unpack_tuple(builder, args[3], rows.count), strict=True):
            builder.store(vector, pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, index, stride, rows), generate


def _pointers(context: Any, builder: Any, array: Any, args: Sequence[Any], vector: _Vector, count: int) -> list[Any]:
    data = context.make_array(array)(context, builder, args[0]).data
    pointer = context.get_value_type(vector).as_pointer()
    indices = [args[1]]
    for _ in range(count - 1):
        indices.append(builder.add(indices[-1], args[2]))
    return [builder.bitcast(builder.gep(data, [index]), pointer) for index in indices]


@_instruction
def _broadcast(typing: Any, array: Any, number: Any) -> Any:
    """Fill a vector of VECTOR_BYTES with one number of the array's dtype."""
    vector = _full_vector(array)

    def generate(context: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        undefined = ir.Constant(context.get_value_type(vector), ir.Undefined)
        first = builder.insert_element(undefined, args[1], cgutils.int32_t(0))
        return builder.shuffle_vector(first, undefined, _mask([0] * vector.count))

    return vector(array, array.dtype), generate


@_instruction
def _add_product(typing: Any, total: Any, weight: Any, first: Any, second: Any) -> Any:
    """Return ``total + weight * (first + second)``; product and sum may be fused."""

    def generate(context: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        fused = ("contract",)
        pair = builder.fadd(args[2], args[3])
        return builder.fadd(args[0], builder.fmul(args[1], pair, flags=fused), flags=fused)

    return total(total, weight, first, second), generate


# A square is transposed in three stages, which mix rows 1, 2 and 4 apart. The masks give the low and high half of a
# mixed pair (a, b): numbers below SQUARE_SIDE are of a, the others of b. Each moves within as few lanes as it can.
_LOW_MASKS: Final = (0, 8, 1, 9, 4, 12, 5, 13), (0, 1, 8, 9, 4, 5, 12, 13), (0, 1, 2, 3, 8, 9, 10, 11)
_HIGH_MASKS: Final = (2, 10, 3, 11, 6, 14, 7, 15), (2, 3, 10, 11, 6, 7, 14, 15), (4, 5, 6, 7, 12, 13, 14, 15)
_COLUMN_ORDER: Final = (0, 2, 1, 3, 4, 6, 5, 7)


@_instruction
def _transposed(typing: Any, rows: Any) -> Any:
    """Return the columns of a square of SQUARE_SIDE vectors."""

    def generate(context: Any, builder: Any, signature: Any, args: Sequence[Any]) -> Any:
        vectors = cgutils.unpack_tuple(builder, args[0], SQUARE_SIDE)
        for stage, (low_mask, high_mask) in enumerate(zip(_LOW_MASKS, _HIGH_MASKS, strict=True)):
            distance = 2**stage
            for index in range(SQUARE_SIDE):
                if not index & distance:
                    pair = vectors[index], vectors[index + distance]
                    vectors[index] = builder.shuffle_vector(*pair, _mask(low_mask))
                    vectors[index + distance] = builder.shuffle_vector(*pair, _mask(high_mask))
        return context.make_tuple(builder, signature.return_type, [vectors[index] for index in _COLUMN_ORDER])

    return rows(rows), generate


def _mask(lanes: Sequence[int]) -> Any:
    return ir.Constant(ir.VectorType(cgutils.int32_t, len(lanes)), list(lanes))
