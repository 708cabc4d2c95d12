"""The entry point: `python run.py +augment=safi +reg=uar seed=0,1,2 -m`; `--help` explains it."""

import shlex
import sys

NEEDED = "torch", "numba", "hydra", "omegaconf", "cv2", "scipy", "pandas", "matplotlib"


def check_python() -> None:
    """End in one line where this Python cannot run the project, before a traceback says so."""
    from importlib.util import find_spec  # here Ctrl-C is caught

    lacking = "" if sys.version_info >= (3, 11) else "Python 3.11 or newer"
    lacking = lacking or ", ".join(name for name in NEEDED if find_spec(name) is None)
    if lacking:
        python = "{} (Python {}.{})".format(sys.executable, *sys.version_info)
        how = "`make setup && . .venv/bin/activate`, or `pip install -e .`"
        print(f"error: {python} lacks {lacking}: {how} in the project's folder", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    try:
        check_python()
        from framework.command.entry import command

        command(sys.argv[1:], f"python {shlex.quote(sys.argv[0])}")
    except KeyboardInterrupt:  # while modules are imported; later on it is caught inside
        print("error: interrupted", file=sys.stderr)
        sys.exit(130)
