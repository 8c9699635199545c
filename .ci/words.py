"""Compare codespell's findings with the baseline: `uv run python .ci/words.py`; a count may fall but not rise.

`--update` lowers the counts of the baseline to those of today. `.ci/words.txt` is the dictionary.
"""

import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
BASELINE = ROOT / ".ci" / "words_baseline.txt"
CHECKED = ("shape_obs", "envs", "examples", "docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
FINDING = re.compile(r"^(\S+:\d+): (.+?) ==> (.*)$", re.MULTILINE)


def findings() -> dict[str, list[str]]:
    """Return for each word the places where it stands, with its replacements."""
    done = subprocess.run(["codespell", "-q", "3", *CHECKED], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.stderr or done.returncode not in (0, 65):  # 65: there are findings
        sys.exit(f"codespell failed: {done.stderr or done.returncode}")
    found: dict[str, list[str]] = defaultdict(list)
    for place, word, better in FINDING.findall(done.stdout):
        found[word.lower()].append(f"{place}: {word}: write {better or 'nothing'}")
    return found


def main() -> None:
    """Fail if a word stands more often than in the baseline."""
    found = findings()
    lines = BASELINE.read_text(encoding="utf-8").splitlines()
    allowed = {word: int(count) for count, _, word in (line.partition(" ") for line in lines)}
    if "--update" in sys.argv[1:]:
        allowed = {word: min(count, len(found[word])) for word, count in allowed.items() if word in found}
        BASELINE.write_text("".join(f"{count} {word}\n" for word, count in allowed.items()), encoding="utf-8")
    more = [word for word, places in found.items() if len(places) > allowed.get(word, 0)]
    for word in more:
        print(f"{word}: {len(found[word])} uses, at most {allowed.get(word, 0)}", *found[word], sep="\n  ")
    print(f"words to replace: {sum(map(len, found.values()))}, in the baseline {sum(allowed.values())}")
    if more:
        sys.exit("Replace the words that you added; .ci/words.txt has others for them.")


if __name__ == "__main__":
    main()
