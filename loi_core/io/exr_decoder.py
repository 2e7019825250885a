"""Decodes one EXR file in a process of its own: ``python exr_decoder.py FILE``; see :func:`loi_core.io.exr.read_exr`.

The pixels go to standard output as NPY. The library goes on after damaged pixels and only prints that it does, so
whatever it prints means damage. Nothing of `loi_core` is imported, which would take longer than the decoding.
"""

from __future__ import annotations

import os
import sys

NO_COLOUR = 3  # exit code


def main(path: str) -> int:
    """Write the first part that has colours, shape (H, W, C), or brightness, shape (H, W)."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the library's words must not get between the pixels
    import numpy as np
    import OpenEXR

    with OpenEXR.File(path) as stored:
        for number in range(len(stored.parts)):
            channels = stored.channels(number)
            for name in ("RGB", "RGBA", "Y"):
                if name in channels:
                    np.save(output, channels[name].pixels, allow_pickle=False)
                    return 0
    return NO_COLOUR


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
