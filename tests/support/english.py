"""The language of the documentation and of ``--help``: banned words, lengths of sentences and of pages.

Run: ``uv run python tests/support/english.py``
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import statistics
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Final
from unittest import mock

ROOT: Final = Path(__file__).parents[2]
BANNED: Final = (
    "told", "tells", "tell", "says", "knows", "nobody", "of which", "beside", "anew", "apart", "at all", "of its own",
    "once in a while", "by that hair",
)  # fmt: skip
#: Limits that ``tests/project/test_english.py`` checks.
MOST_BANNED, LONGEST_MEDIAN, LONGEST_PAGE = 5, 22, 1500

_BANNED_WORDS: Final = re.compile(rf"\b({'|'.join(BANNED)})\b".replace(" ", r"\s+"), re.IGNORECASE)
_ADMONITIONS: Final = r"\{(?:note|tip|hint|important|warning|caution|danger|attention|seealso|admonition)\}"
_FENCE: Final = re.compile(r"^( *)(`{3,}|~{3,})([^\n]*)\n(.*?)^ *\2`* *$\n?", re.MULTILINE | re.DOTALL)
_ABBREVIATIONS: Final = re.compile(r"\b(e\.g|i\.e|etc|vs|cf|approx|resp)\.")
_END: Final = re.compile(r"(?<=[.!?])[\"')\]*_]*\s+(?=[\"'(\[*_]*[A-Z0-9])")
_FEWEST_WORDS: Final = 3  # a shorter piece is a label, not a sentence


def pages() -> dict[str, str]:
    """Return the text of each page of prose in the repository, by its path."""
    files = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    files += sorted((ROOT / "docs").rglob("*.md"))
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in files}


def help_texts() -> dict[str, str]:
    """Return the ``--help`` of each command and subcommand, without boxes and line breaks inside an option's text."""
    from shape_obs.cli import COMMANDS
    from shape_obs.cli.calibrate import CALIBRATIONS
    from tests.benchmarks.cli import MEASUREMENTS

    parts = {"calibrate": CALIBRATIONS, "bench": MEASUREMENTS}
    commands = ["", *COMMANDS, *(f"{group} {name}" for group, names in parts.items() for name in names)]
    return {f"shape-obs {command}".strip(): _help(command.split()) for command in commands}


def _help(command: list[str]) -> str:
    from shape_obs.cli import main

    out = io.StringIO()
    with (
        mock.patch.dict(os.environ, {"COLUMNS": "1000", "NO_COLOR": "1"}),
        contextlib.redirect_stdout(out),
        contextlib.suppress(SystemExit),
    ):
        main([*command, "--help"])
    text = re.sub(r"\x1b\[[0-9;]*m", "", out.getvalue())
    lines = (line.strip("│╭╮╰╯─ ") for line in text.splitlines())
    return "\n".join(line for line in lines if line)


def shown(markdown: str) -> str:
    """Return what a reader sees of a page, without code, pictures, comments and the targets of links."""
    text = re.sub(r"<!--.*?-->", "", markdown, flags=re.DOTALL)
    text = _FENCE.sub(lambda fence: fence[4] if re.match(_ADMONITIONS, fence[3].strip()) else "\n", text)
    text = re.sub(r"^ *:{3,}.*$|^ *:[\w-]+:.*$|^\([\w-]+\)=$|^\$\$.*?\$\$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)(?:\{[^}]*\})?", "", text)
    text = re.sub(r"(?:\{[\w:.-]+\})?(`+)(?!`).+?(?<!`)\1(?!`)", "Code", text, flags=re.DOTALL)
    text = re.sub(r"\[([^\]]*)\]\([^)\s]*(?: \"[^\"]*\")?\)", lambda link: link[1] or "Link", text)
    return re.sub(r"<[^>\s][^>]*>|^\[[^\]]+\]:.*$", "", text, flags=re.MULTILINE)


def prose(markdown: str) -> list[str]:
    """Return the sentences of a page, without code, tables, headings, directives and the targets of links.

    Code within a sentence counts as one word. The items of a list are separate.
    """
    text = re.sub(r"^ *[#|].*$|^ *[-=]{3,} *$", "\n", shown(markdown), flags=re.MULTILINE)
    text = re.sub(r"^ *(?:[-*+]|\d+\.) +", "\n\n", text, flags=re.MULTILINE)
    text = _ABBREVIATIONS.sub(lambda word: word[0].replace(".", ""), re.sub(r"^ *> ?", "", text, flags=re.MULTILINE))
    blocks = (" ".join(block.split()) for block in re.split(r"\n\s*\n", text))
    sentences = (sentence.strip() for block in blocks for sentence in _END.split(block))
    return [sentence for sentence in sentences if length(sentence) >= _FEWEST_WORDS]


def length(sentence: str) -> int:
    """Return the number of words of a sentence."""
    return sum(any(letter.isalnum() for letter in word) for word in sentence.split())


def count_banned(texts: Iterable[str]) -> Counter[str]:
    """Count the banned words in texts, whole words in any case; every use counts, whatever the subject is."""
    return Counter(" ".join(found.lower().split()) for text in texts for found in _BANNED_WORDS.findall(text))


def _report() -> None:
    texts = {name: shown(text) for name, text in pages().items()} | help_texts()
    found = count_banned(texts.values())
    print(f"banned words: {found.total()}, at most {MOST_BANNED}", dict(found) or "")
    for name, text in texts.items():
        if here := count_banned([text]):
            print(f"  {name}: {', '.join(f'{word} {number}' for word, number in here.items())}")
    sentences = [(length(sentence), name, sentence) for name, text in pages().items() for sentence in prose(text)]
    print(f"median sentence: {statistics.median(words for words, *_ in sentences):g} words, at most {LONGEST_MEDIAN}")
    for words, name, sentence in sorted(sentences, reverse=True)[:15]:
        print(f"  {words} {name}: {sentence[:100]}")
    print(f"longest pages, at most {LONGEST_PAGE} words")
    for words, name in sorted(((len(text.split()), name) for name, text in pages().items()), reverse=True)[:12]:
        print(f"  {words} {name}")


if __name__ == "__main__":
    _report()
