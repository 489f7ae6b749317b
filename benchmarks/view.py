"""The live view in Chromium: from a sample to pixels, frames and bytes a second, what its server costs."""

from __future__ import annotations

import sys

from _harness import main
from _view_jobs import view_rows

if __name__ == "__main__":
    sys.exit(main(view_rows, __doc__))
