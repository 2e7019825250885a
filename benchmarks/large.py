"""Value and gradient of large images, tile by tile: time and peak memory, each size in a process of its own.

python -m benchmarks.large --sizes 1024 2048 4096 8192
python -m benchmarks.large --sizes 16384 --files FOLDER     # image, reference and gradient are memory maps there
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib.format import open_memmap

from loi_core import LOIObjective, ScaleSpace, TiledLOIObjective
from loi_core.tradeoff.memory import peak_memory, restart_peak

ROOT: Final = Path(__file__).parents[1]
SCALES: Final = {"default": None, "1 and 5, 2 and 8": ScaleSpace((1, 5), (2, 8), 0.125)}
MIB: Final = 2.0**20


def picture(into: np.ndarray[Any, Any], seed: int) -> None:
    """Waves and noise in [0, 1], a few rows at a time."""
    rng = np.random.default_rng(seed)
    height, width, channels = into.shape
    across = np.cos(np.linspace(0.0, 10.0, width, dtype=np.float32))[:, None]
    tones = np.arange(1, channels + 1, dtype=np.float32)
    for top in range(0, height, 64):
        down = np.linspace(0.0, 6.0, height, dtype=np.float32)[top : top + 64, None, None]
        into[top : top + 64] = 0.45 + 0.25 * np.sin(down * tones + np.float32(seed)) * across
        into[top : top + 64] += 0.1 * rng.random((len(down), width, channels), np.float32)


class Resident(threading.Thread):
    """The most memory that this process has to itself, files that are mapped left out; looked at 50 times a second."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.most, self.over = 0.0, threading.Event()

    def run(self) -> None:
        """Look."""
        while not self.over.wait(0.02):
            self.most = max(self.most, own_memory())


def own_memory() -> float:
    """Resident memory of this process, files that are mapped left out, in bytes; 0 where the system does not tell."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((1024.0 * float(line.split()[1]) for line in lines if line.startswith("RssAnon")), 0.0)


def measure(size: int, scales: str, accuracy: str, way: str, files: Path | None, tile: int) -> dict[str, Any]:
    """One row, for a process that does nothing else."""
    warnings.simplefilter("ignore")
    kind = {"tiles": TiledLOIObjective, "whole": LOIObjective}[way]
    tiny = np.random.default_rng(0).random((2, 64, 64, 3), np.float32)
    kind(tiny[0], SCALES[scales], accuracy).value_and_grad(tiny[1])  # compiles, or loads what is compiled
    shape = size, size, 3

    def made(name: str) -> np.ndarray[Any, Any]:
        if files is None:
            return np.empty(shape, np.float32)
        return open_memmap(files / f"{name}.npy", "w+", np.float32, shape)

    image, own, most = made("image"), own_memory(), restart_peak() or 0
    picture(image, 0)
    own, most = own_memory(), restart_peak() or 0
    reference = made("reference")
    picture(reference, 1)
    if files is not None:
        image, reference = (np.load(files / f"{name}.npy", mmap_mode="r") for name in ("image", "reference"))
    watch = Resident()
    watch.start()
    began = time.perf_counter()
    options = {"tile": tile} if kind is TiledLOIObjective else {}
    objective = kind(reference, SCALES[scales], accuracy, **options)
    prepared = time.perf_counter()
    out = {} if files is None else {"out": made("gradient")}
    value, gradient = objective.value_and_grad(image, **out)
    seconds = time.perf_counter() - prepared
    watch.over.set()
    watch.join()
    return {
        "size": size,
        "scales": scales,
        "accuracy": accuracy,
        "way": way,
        "files": files is not None,
        "value": float(value),
        "prepare s": prepared - began,
        "s": seconds,
        "ms a megapixel": 1e3 * seconds / (size * size / 2**20),
        "own MiB above the image": (watch.most - own) / MIB,
        "MiB above the image": ((peak_memory() or 0) - most) / MIB,
        "gradient norm": float(np.sqrt(sum(np.sum(np.square(row, dtype=np.float64)) for row in gradient))),
    }


def main() -> None:
    """Print a table, and write it as JSON where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1024, 2048, 4096])
    parser.add_argument("--scales", nargs="+", choices=SCALES, default=["default"])
    parser.add_argument("--accuracy", nargs="+", default=["exact"])
    parser.add_argument("--ways", nargs="+", choices=("tiles", "whole"), default=["tiles"])
    parser.add_argument("--tile", type=int, default=1024)
    parser.add_argument("--files", type=Path, help="a folder for memory maps, which are removed again")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(
            json.dumps(
                measure(asked.sizes[0], asked.scales[0], asked.accuracy[0], asked.ways[0], asked.files, asked.tile)
            )
        )
        return
    rows = []
    print("| size | scales | accuracy | way | s | ms a megapixel | peak above the image, MiB | of its own, MiB |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for scales in asked.scales:
        for accuracy in asked.accuracy:
            for size in asked.sizes:
                for way in asked.ways:
                    options = [
                        "--tile",
                        str(asked.tile),
                        "--sizes",
                        str(size),
                        "--scales",
                        scales,
                        "--accuracy",
                        accuracy,
                        "--ways",
                        way,
                        "--one",
                    ]
                    options += [] if asked.files is None else ["--files", str(asked.files)]
                    command = [sys.executable, "-m", "benchmarks.large", *options]
                    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
                    if done.returncode != 0:
                        print(f"| {size} | {scales} | {accuracy} | {way} | failed with {done.returncode} |", flush=True)
                        print(done.stderr[-500:], file=sys.stderr)
                        continue
                    row = json.loads(done.stdout)
                    rows.append(row)
                    print(
                        f"| {size}x{size} | {scales} | {accuracy} | {way}{', files' if row['files'] else ''} | "
                        f"{row['s']:.1f} | {row['ms a megapixel']:.0f} | {row['MiB above the image']:.0f} | "
                        f"{row['own MiB above the image']:.0f} |",
                        flush=True,
                    )
                    for name in ("image", "reference", "gradient") if asked.files else ():
                        (asked.files / f"{name}.npy").unlink(missing_ok=True)
    if asked.json:
        asked.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
