"""All exceptions that `loi` raises on purpose.

Each derives from :class:`LoiError` and from the matching built-in exception: a wrong value is also a ``ValueError``, a
wrong type a ``TypeError``.
"""

from __future__ import annotations

__all__ = [
    "BackendNotFoundError",
    "CameraError",
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
    "NonFiniteImageError",
    "ObjectiveNotFoundError",
    "OptionError",
    "ParameterError",
    "RendererError",
    "RendererNotFoundError",
    "ScaleError",
    "SceneError",
    "SvgError",
    "UnknownOptionError",
    "WeightsError",
    "WriteError",
]


class LoiError(Exception):
    """Base of all errors of this library; the message is one line that names the fix."""


class OptionError(LoiError, ValueError):
    """An option has a value that is not allowed."""


class UnknownOptionError(LoiError, TypeError):
    """A call has a keyword that the function does not take."""


class ScaleError(OptionError):
    """A scale, bound or boundary of a :class:`~loi_core.ScaleSpace` is not allowed."""


class ImageError(LoiError, ValueError):
    """An image has a shape or size that the operation does not accept."""


class ImageTypeError(LoiError, TypeError):
    """An image is not a floating-point array of the library that the operation needs."""


class NonFiniteImageError(ImageError):
    """An image holds NaN or infinite values.

    Attributes
    ----------
    name : str
        The argument that holds them.
    nan, positive, negative : int
        Numbers of values that are NaN, +inf and -inf.
    first : tuple of int
        Index of the first of them.
    axes : str
        Names of the axes of that index: ``"(*batch, y, x, c)"``, the batch only if there is one.
    size : int
        Number of all values.
    suspicion : str
        Pattern of the bad values, and its usual cause.
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
        if self.count < size:  # with all pixels masked the loss would be 0
            fix += ", or pass nan_policy='mask' to leave such pixels out"
        super().__init__(f"{self.finding}; {fix}")

    @property
    def finding(self) -> str:
        """The problem, without the fix."""
        kinds = {"NaN": self.nan, "+inf": self.positive, "-inf": self.negative}
        counts = ", ".join(f"{count} {label}" for label, count in kinds.items() if count)
        plural = "s" if self.count != 1 else ""
        return (
            f"`{self.name}` has {self.count} non-finite value{plural} of {self.size} ({counts}), "
            f"the first at {self.axes} = {self.first}: {self.suspicion}"
        )

    @property
    def count(self) -> int:
        """Number of values that are not finite."""
        return self.nan + self.positive + self.negative

    def __reduce__(self) -> tuple[type[NonFiniteImageError], tuple[object, ...]]:
        kinds = (self.nan, self.positive, self.negative)
        return type(self), (self.name, kinds, self.first, self.axes, self.size, self.suspicion)


class ImageFileError(LoiError, OSError):
    """An image file is missing, damaged, too large, or of an unsupported format."""


class DerivativeError(LoiError, NotImplementedError):
    """A derivative that is not implemented was requested; without this error it would silently be zero."""


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
    """A file could not be written, because the disk is full or the folder is read-only; the old file is unchanged."""


class RendererError(LoiError, RuntimeError):
    """A renderer broke the contract of :class:`loi_core.Renderer`."""


class RendererNotFoundError(LoiError, LookupError):
    """No renderer of this name is installed, or it cannot be loaded."""


class BackendNotFoundError(LoiError, LookupError):
    """No backend of this name is installed, or it cannot be loaded."""


class ObjectiveNotFoundError(LoiError, LookupError):
    """No objective of this name is installed, or it cannot be loaded."""


class WeightsError(LoiError, OSError):
    """The weights of a network are not installed, or differ from the published ones: ``PROBLEM; COMMAND``."""


class SceneError(LoiError, ValueError):
    """A scene file or a sweep file has a wrong key, type or value."""


class SvgError(LoiError, ValueError):
    """An SVG file is missing, damaged or too large, or has an unsupported element or attribute."""


class MeshError(LoiError, ValueError):
    """A mesh file is missing, damaged or too large, of an unsupported format, or has no triangles."""


class CameraError(LoiError, ValueError):
    """A file of cameras is missing or damaged, or has a camera that is no pinhole."""


class FitError(LoiError, RuntimeError):
    """A fit ended early, because its renderer failed or its checkpoint could not be written; holds the partial result.

    Attributes
    ----------
    result : FitResult or None
        The result so far; ``None`` only if the very first step failed.
    """

    def __init__(self, message: str, result: object = None) -> None:
        super().__init__(message)
        self.result = result


class FitDivergedError(FitError, ArithmeticError):
    """An image, loss or gradient of a fit is not finite."""


class ExecutorError(LoiError, RuntimeError):
    """The executor of runs is not installed, does not respond or failed; finished runs are kept."""


class ConformanceError(LoiError, AssertionError):
    """A renderer or objective failed a check of :mod:`loi_core.testing`.

    Attributes
    ----------
    check : str
        Name of the check.
    rule : str
        The broken rule of the contract.
    finding : str
        The expected and the actual behaviour.
    """

    def __init__(self, check: str, rule: str, finding: str) -> None:
        super().__init__(f"{check}: {finding} (rule: {rule})")
        self.check = check
        self.rule = rule
        self.finding = finding

    def __reduce__(self) -> tuple[type[ConformanceError], tuple[str, str, str]]:
        return type(self), (self.check, self.rule, self.finding)
