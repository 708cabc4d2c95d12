"""The entry point: `python run.py +augment=safi +reg=uar seed=0,1,2 -m`; `--help` tells more."""

import sys

from framework.cli import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
