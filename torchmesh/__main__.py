"""`python -m torchmesh` is the command `torchmesh`."""

import sys

from .commands.main import main

if __name__ == "__main__":
    sys.exit(main())
