"""The entry point: `python run.py +augment=safi +reg=uar seed=0,1,2 -m`; `--help` tells more."""

import gc
import sys

from framework.cli import main

if __name__ == "__main__":
    code = main(sys.argv[1:])
    gc.freeze()  # all is written: freeing torch's objects one by one takes 0.7 s
    sys.exit(code)
