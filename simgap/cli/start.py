"""Starts Snakemake in a process of its own: run as a file, so that nothing of simgap is imported for it.

Ctrl-C while it starts ends it without a traceback: it begins with the signal blocked. An option that Snakemake does not
have is told in a line, with the nearest that there is.
"""

from __future__ import annotations

import difflib
import signal
import sys

USAGE = 64  # of sysexits.h: the command line was wrong, and has been told


def start(words: list[str]) -> None:
    """Run Snakemake with these words."""
    from snakemake.cli import get_argument_parser, main  # type: ignore[import-untyped]

    parser = get_argument_parser()
    unknown = [word for word in parser.parse_known_args(words)[1] if word.startswith("-")]
    if unknown:
        option = unknown[0].partition("=")[0]
        near = difflib.get_close_matches(option, parser._option_string_actions, 1)
        meant = f"Did you mean {near[0]}?" if near else "`snakemake --help` lists those that there are."
        told = option.encode("unicode_escape").decode()
        sys.stderr.write(f"simgap: {told[:80]}: neither simgap nor Snakemake has such an option. {meant}\n")
        sys.exit(USAGE)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    main(words)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    try:
        start(sys.argv[1:])
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # what is left is to end
