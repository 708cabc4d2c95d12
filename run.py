"""The entry point: `python run.py +augment=safi +reg=uar seed=0,1,2 -m`; `--help` tells more."""

import sys

from framework.command.entry import command

if __name__ == "__main__":
    command(sys.argv[1:])
