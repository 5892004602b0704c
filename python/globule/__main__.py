"""The command line, as `globule` and as `python -m globule`."""

import sys


def main() -> int:
    """Run one command and return its exit status."""
    try:
        from .cli import main as run  # takes a while, in which one may press Ctrl-C
    except KeyboardInterrupt:
        print("globule: interrupted", file=sys.stderr)
        return 130
    return run()


if __name__ == "__main__":
    sys.exit(main())
