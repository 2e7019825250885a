"""Every exception that `loi` raises on purpose.

Each derives from :class:`LoiError` and from the built-in exception that a caller who has never heard of `loi`
would catch: a wrong value is a ``ValueError``, a wrong type a ``TypeError``, and so on.
"""

from __future__ import annotations

__all__ = [
    "BackendNotFoundError",
    "ConformanceError",
    "FitError",
    "ImageError",
    "ImageFileError",
    "ImageTypeError",
    "LoiError",
    "NonFiniteImageError",
    "OptionError",
    "ParameterError",
    "RendererError",
    "RendererNotFoundError",
    "ScaleError",
    "SceneError",
]


class LoiError(Exception):
    """Base of all errors of this library; the message is one line that names the mend."""


class OptionError(LoiError, ValueError):
    """An option has a value outside what it allows."""


class ScaleError(OptionError):
    """A scale, bound or boundary of a :class:`~loi_core.ScaleSpace` is not allowed."""


class ImageError(LoiError, ValueError):
    """An image has a shape or size that the operation does not take."""


class ImageTypeError(LoiError, TypeError):
    """An image is not a floating-point array of the library that the operation needs."""


class NonFiniteImageError(ImageError):
    """An image holds NaN or infinite values.

    Attributes
    ----------
    count : int
        How many values are not finite.
    first : tuple of int
        Index of the first of them, ``(*batch, y, x, c)``.
    """

    def __init__(self, name: str, count: int, first: tuple[int, ...], size: int) -> None:
        axes = "(y, x, c)" if len(first) == 3 else "(*batch, y, x, c)"
        super().__init__(
            f"`{name}` has {count} non-finite value{'s' if count != 1 else ''} of {size}, the first at "
            f"{axes} = {first}; mend the render, or pass nan_policy='mask' to leave such pixels out"
        )
        self.name = name
        self.count = count
        self.first = first
        self.size = size

    def __reduce__(self) -> tuple[type[NonFiniteImageError], tuple[str, int, tuple[int, ...], int]]:
        return type(self), (self.name, self.count, self.first, self.size)


class ImageFileError(LoiError, OSError):
    """An image file is missing, damaged, too large, or of a kind that is not read."""


class ParameterError(LoiError, ValueError):
    """A scene parameter has a wrong name, shape, value or bound."""


class RendererError(LoiError, RuntimeError):
    """A renderer broke the contract of :class:`loi_core.Renderer`."""


class RendererNotFoundError(LoiError, LookupError):
    """No renderer of that name is installed, or the one that is cannot be loaded."""


class BackendNotFoundError(LoiError, LookupError):
    """No backend of that name is installed, or the one that is cannot be loaded."""


class SceneError(LoiError, ValueError):
    """A scene file has a wrong key, type or value."""


class FitError(LoiError, ArithmeticError):
    """A fit met a loss or gradient that is not finite; ``result`` holds the best iterate so far.

    Attributes
    ----------
    result : FitResult or None
        What the fit had reached; ``None`` only if the very first step failed.
    """

    def __init__(self, message: str, result: object = None) -> None:
        super().__init__(message)
        self.result = result


class ConformanceError(LoiError, AssertionError):
    """A renderer or objective failed a check of :mod:`loi_core.testing`.

    Attributes
    ----------
    check : str
        Name of the check.
    rule : str
        The rule of the contract that was broken.
    """

    def __init__(self, check: str, rule: str, finding: str) -> None:
        super().__init__(f"{check}: {finding} (rule: {rule})")
        self.check = check
        self.rule = rule
        self.finding = finding

    def __reduce__(self) -> tuple[type[ConformanceError], tuple[str, str, str]]:
        return type(self), (self.check, self.rule, self.finding)
