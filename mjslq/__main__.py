"""The program `mjslq`, also as `python -m mjslq`; Ctrl-C ends it during its imports, too."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line; see `mjslq.cli`."""
    try:
        from mjslq.cli import main as run

        run()
    except KeyboardInterrupt:
        print("mjslq: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
