"""Every exception that `loi` raises on purpose.

Each derives from :class:`LoiError` and from the built-in exception that a caller who has never heard of `loi`
would catch: a wrong value is a ``ValueError``, a wrong type a ``TypeError``, and so on.
"""

from __future__ import annotations

__all__ = [
    "BackendNotFoundError",
    "CheckpointError",
    "ConformanceError",
    "DerivativeError",
    "ExecutorError",
    "FitDivergedError",
    "FitError",
    "ImageError",
    "ImageFileError",
    "ImageTypeError",
    "InUseError",
    "LoiError",
    "MeshError",
    "MissingPackageError",
    "NonFiniteImageError",
    "ObjectiveNotFoundError",
    "OptionError",
    "ParameterError",
    "RendererError",
    "RendererNotFoundError",
    "ScaleError",
    "SceneError",
    "SvgError",
    "WeightsError",
    "WriteError",
]


class LoiError(Exception):
    """Base of all errors of this library; the message is one line that names the fix."""


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
    name : str
        The argument that holds them.
    nan, positive, negative : int
        How many values are NaN, +inf and -inf.
    first : tuple of int
        Index of the first of them.
    axes : str
        What that index counts: ``"(*batch, y, x, c)"``, the batch only if there is one.
    size : int
        How many values there are.
    suspicion : str
        How the bad values lie, and what usually makes such a pattern.
    """

    def __init__(
        self, name: str, kinds: tuple[int, int, int], first: tuple[int, ...], axes: str, size: int, suspicion: str
    ) -> None:
        self.name = name
        self.nan, self.positive, self.negative = kinds
        self.first = first
        self.axes = axes
        self.size = size
        self.suspicion = suspicion
        fix = f"fix the {'reference' if name == 'reference' else 'render'}"
        if self.count < size:  # with nothing left to compare the loss would be 0, which fixes nothing
            fix += ", or pass nan_policy='mask' to leave such pixels out"
        super().__init__(f"{self.finding}; {fix}")

    @property
    def finding(self) -> str:
        """What is wrong, without what to do about it."""
        kinds = {"NaN": self.nan, "+inf": self.positive, "-inf": self.negative}
        named = ", ".join(f"{one} {what}" for what, one in kinds.items() if one)
        several = "s" if self.count != 1 else ""
        return (
            f"`{self.name}` has {self.count} non-finite value{several} of {self.size} ({named}), "
            f"the first at {self.axes} = {self.first}: {self.suspicion}"
        )

    @property
    def count(self) -> int:
        """How many values are not finite."""
        return self.nan + self.positive + self.negative

    def __reduce__(self) -> tuple[type[NonFiniteImageError], tuple[object, ...]]:
        kinds = (self.nan, self.positive, self.negative)
        return type(self), (self.name, kinds, self.first, self.axes, self.size, self.suspicion)


class ImageFileError(LoiError, OSError):
    """An image file is missing, damaged, too large, or of a kind that is not read."""


class DerivativeError(LoiError, NotImplementedError):
    """A derivative is asked for that there is not, and that would be zero if nothing were said."""


class ParameterError(LoiError, ValueError):
    """A scene parameter has a wrong name, shape, value or bound."""


class CheckpointError(ParameterError):
    """A checkpoint file is damaged, or is not a checkpoint.

    Attributes
    ----------
    path, reason : str
        The file, and the damage.
    """

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"`checkpoint` {path} is not a checkpoint of a fit ({reason}); delete it to start anew")

    def __reduce__(self) -> tuple[type[CheckpointError], tuple[str, str]]:
        return type(self), (self.path, self.reason)


class InUseError(LoiError, OSError):
    """A folder or a checkpoint is in use by another fit, here or in another process."""


class WriteError(LoiError, OSError):
    """A file could not be written: the disk is full, or the folder cannot be written to. It is as it was before."""


class RendererError(LoiError, RuntimeError):
    """A renderer broke the contract of :class:`loi_core.Renderer`."""


class RendererNotFoundError(LoiError, LookupError):
    """No renderer of that name is installed, or the one that is cannot be loaded."""


class BackendNotFoundError(LoiError, LookupError):
    """No backend of that name is installed, or the one that is cannot be loaded."""


class ObjectiveNotFoundError(LoiError, LookupError):
    """No objective of that name is installed, or the one that is cannot be loaded."""


class WeightsError(LoiError, OSError):
    """The weights of a network are not installed, or are not the ones that were published: ``PROBLEM; COMMAND``."""


class SceneError(LoiError, ValueError):
    """A scene file, or that of a sweep, has a wrong key, type or value."""


class SvgError(LoiError, ValueError):
    """An SVG file is missing, damaged or too large, or has an element or attribute that is not supported."""


class MeshError(LoiError, ValueError):
    """A file with a mesh is missing, damaged or too large, of a kind that is not supported, or has no triangles."""


class FitError(LoiError, RuntimeError):
    """A fit ended early: its renderer failed, or its checkpoint could not be written; what it had reached is kept.

    Attributes
    ----------
    result : FitResult or None
        What the fit had reached; ``None`` only if the very first step failed.
    """

    def __init__(self, message: str, result: object = None) -> None:
        super().__init__(message)
        self.result = result


class FitDivergedError(FitError, ArithmeticError):
    """A fit met an image, loss or gradient that is not finite."""


class MissingPackageError(LoiError, ImportError):
    """A function needs a package that is not installed; the message names the command that installs it."""


class ExecutorError(LoiError, RuntimeError):
    """What is to carry out runs is not installed, does not answer or broke; what had ended before is kept."""


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
