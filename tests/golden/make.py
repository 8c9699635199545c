"""``python -m tests.golden.make NAME... [--draw]``: accept today's detections of streams as the expected ones."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from tests.golden.judge import Verdict, differences, score, table
from tests.golden.streams import load_outcome, load_stream, names, play, save_outcome, save_stream


def make(name: str, *, draw: bool) -> Verdict:
    """Store the detections of a stream; draw its frames first if asked to, or if there are none."""
    try:
        before = load_outcome(name)
        score_before = score(load_stream(name), before)
    except LookupError:
        before = score_before = None
    if draw:
        from tests.golden.catalogue import STREAMS

        save_stream(STREAMS[name]())
    stream = load_stream(name)
    outcome, took = play(stream)
    save_outcome(name, outcome)
    off, now = differences(before, outcome) if before else ["new"], score(stream, outcome)
    return Verdict(name, stream.frames, off, now, score_before or now, took)


def main(argv: Sequence[str] | None = None) -> int:
    """Make streams and print the errors before and after; return 2 for an unknown name."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden.make", description=__doc__)
    parser.add_argument("names", nargs="+", metavar="NAME", help="streams, or patterns such as 'rope_*'")
    parser.add_argument(
        "--draw",
        action="store_true",
        help="draw the frames, too: for streams of the catalogue that are new or drawn differently",
    )
    options = parser.parse_args(argv)
    known = None
    if options.draw:
        from tests.golden.catalogue import STREAMS

        known = sorted(STREAMS)
    try:
        chosen = names(options.names, known)
    except LookupError as error:
        print(error.args[0], file=sys.stderr)
        return 2
    print(table([make(name, draw=options.draw) for name in chosen]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
