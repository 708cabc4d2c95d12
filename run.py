"""The entry point: `python run.py +augment=safi +reg=uar seed=0,1,2 -m`; `--help` tells more."""

import gc
import sys

from framework.cli import main

if __name__ == "__main__":
    code = main(sys.argv[1:])
    gc.freeze()  # all is written: going through torch's objects to free them takes a second
    sys.exit(code)
