"""``python -m loi`` is ``loi``."""

import sys

from loi_core.cli import main

if __name__ == "__main__":
    sys.exit(main())
