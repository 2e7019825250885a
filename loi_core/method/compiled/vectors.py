"""Vectors in compiled code: several numbers that are loaded, multiplied and stored together.

Compilers make vectors of loops that they understand. Where many rows are read and written at once they can no longer
tell that these do not overlap, and a square that is turned they do not recognise as one. So these are written out.

Only for functions that Numba compiles. Arrays have one dimension.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.extending import register_model
from numba.extending import intrinsic

from loi_core.method.compiled.records import LINE, SIDE

__all__ = ["add_product", "filled", "load_lines", "load_sides", "plus", "store_rows", "turned"]

FUSED: Final = ("contract",)


class _Vector(types.Type):  # type: ignore[misc]  # Numba has no types
    """So many numbers of one type."""

    def __init__(self, dtype: Any, count: int) -> None:
        super().__init__(name=f"vector({dtype} x {count})")
        self.dtype, self.count = dtype, count


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: _Vector) -> None:
        element = manager.lookup(kind.dtype).get_value_type()
        super().__init__(manager, kind, ir.VectorType(element, kind.count))


def _generated(function: Callable[..., Any]) -> Any:
    """What compiled code calls, of a function from types to a signature and what generates the instructions."""
    return intrinsic(prefer_literal=True)(function)


@_generated
def load_lines(typing: Any, array: Any, index: Any, stride: Any, count: Any) -> Any:
    """As many vectors of LINE bytes as the literal `count` says, from `index` on and `stride` apart."""
    return _load(array, index, stride, count, _Vector(array.dtype, LINE * 8 // array.dtype.bitwidth))


@_generated
def load_sides(typing: Any, array: Any, index: Any, stride: Any, count: Any) -> Any:
    """The same of SIDE numbers each."""
    return _load(array, index, stride, count, _Vector(array.dtype, SIDE))


def _load(array: Any, index: Any, stride: Any, count: Any, vector: _Vector) -> Any:
    def generate(context: Any, builder: Any, signature: Any, given: Sequence[Any]) -> Any:
        places = _places(context, builder, array, given, vector, count.literal_value)
        found = [builder.load(place, align=array.dtype.bitwidth // 8) for place in places]
        return context.make_tuple(builder, signature.return_type, found)

    return types.UniTuple(vector, count.literal_value)(array, index, stride, count), generate


@_generated
def store_rows(typing: Any, array: Any, index: Any, stride: Any, rows: Any) -> Any:
    """Write vectors to an array from `index` on and `stride` apart."""

    def generate(context: Any, builder: Any, signature: Any, given: Sequence[Any]) -> Any:
        places = _places(context, builder, array, given, rows.dtype, rows.count)
        for place, vector in zip(places, cgutils.unpack_tuple(builder, given[3], rows.count), strict=True):
            builder.store(vector, place, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, index, stride, rows), generate


def _places(context: Any, builder: Any, array: Any, given: Sequence[Any], vector: _Vector, count: int) -> list[Any]:
    """Where so many vectors begin."""
    data = context.make_array(array)(context, builder, given[0]).data
    pointer = context.get_value_type(vector).as_pointer()
    indices = [given[1]]
    for _ in range(count - 1):
        indices.append(builder.add(indices[-1], given[2]))
    return [builder.bitcast(builder.gep(data, [index]), pointer) for index in indices]


@_generated
def filled(typing: Any, array: Any, number: Any) -> Any:
    """A vector of LINE bytes, of one number of the array's type."""
    vector = _Vector(array.dtype, LINE * 8 // array.dtype.bitwidth)

    def generate(context: Any, builder: Any, signature: Any, given: Sequence[Any]) -> Any:
        unknown = ir.Constant(context.get_value_type(vector), ir.Undefined)
        first = builder.insert_element(unknown, given[1], cgutils.int32_t(0))
        return builder.shuffle_vector(first, unknown, _mask([0] * vector.count))

    return vector(array, array.dtype), generate


@_generated
def plus(typing: Any, one: Any, other: Any) -> Any:
    """The sum of two vectors."""

    def generate(context: Any, builder: Any, signature: Any, given: Sequence[Any]) -> Any:
        return builder.fadd(*given)

    return one(one, other), generate


@_generated
def add_product(typing: Any, total: Any, one: Any, other: Any) -> Any:
    """`total` and the product of two vectors, in one rounding where processors can."""

    def generate(context: Any, builder: Any, signature: Any, given: Sequence[Any]) -> Any:
        return builder.fadd(given[0], builder.fmul(given[1], given[2], flags=FUSED), flags=FUSED)

    return total(total, one, other), generate


# What two vectors a and b become at each of three stages: numbers of a, and those of b from SIDE on. Stages mix rows
# that are 1, 2 and 4 apart, each within as few numbers as it can, which processors do best.
_LOW: Final = (0, 8, 1, 9, 4, 12, 5, 13), (0, 1, 8, 9, 4, 5, 12, 13), (0, 1, 2, 3, 8, 9, 10, 11)
_HIGH: Final = (2, 10, 3, 11, 6, 14, 7, 15), (2, 3, 10, 11, 6, 7, 14, 15), (4, 5, 6, 7, 12, 13, 14, 15)
_ORDER: Final = (0, 2, 1, 3, 4, 6, 5, 7)  # where the columns are in the end


@_generated
def turned(typing: Any, rows: Any) -> Any:
    """The columns of a square whose rows are SIDE vectors of SIDE numbers."""

    def generate(context: Any, builder: Any, signature: Any, given: Sequence[Any]) -> Any:
        vectors = cgutils.unpack_tuple(builder, given[0], SIDE)
        for stage, (low, high) in enumerate(zip(_LOW, _HIGH, strict=True)):
            apart = 2**stage
            for index in range(SIDE):
                if not index & apart:
                    pair = vectors[index], vectors[index + apart]
                    vectors[index] = builder.shuffle_vector(*pair, _mask(low))
                    vectors[index + apart] = builder.shuffle_vector(*pair, _mask(high))
        return context.make_tuple(builder, signature.return_type, [vectors[index] for index in _ORDER])

    return rows(rows), generate


def _mask(places: Sequence[int]) -> Any:
    return ir.Constant(ir.VectorType(cgutils.int32_t, len(places)), list(places))
