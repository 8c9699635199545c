"""The language of the pages and of ``--help``: words, lengths of sentences, lengths of pages."""

from __future__ import annotations

import statistics

from english import (
    LONGEST_MEDIAN,
    LONGEST_PAGE,
    MOST_BANNED,
    count_banned,
    help_texts,
    length,
    pages,
    prose,
    shown,
)

PAGE = """\
(target)=
# A heading

The `first` sentence has a [link](page.md#part), e.g. to
another page. Version 1.5 is "new". Is it?

| a | table |
|---|---|
| with | cells that tell |

- An item of a list.
- `points`: the points; [](other.md)

```python
x = "nobody"
```

:::{note}
:class: tip
A note in a box.
:::

```{warning}
A second box with words.
```

<!-- not run: a comment that says nothing -->
![what it tells](picture.png)
"""


def test_prose_leaves_out_what_is_no_sentence():
    assert prose(PAGE) == [
        "The Code sentence has a link, eg to another page.",
        'Version 1.5 is "new".',
        "An item of a list.",
        "Code: the points; Link",
        "A note in a box.",
        "A second box with words.",
    ]


def test_banned_words_count_in_tables_but_not_in_code():
    assert count_banned([shown(PAGE)]) == {"tell": 1}
    assert count_banned(["Told once, telling, of\nwhich apartment"]) == {"told": 1, "of which": 1}


def test_help_is_found_for_every_command():
    texts = help_texts()
    assert {"shape-obs", "shape-obs detect", "shape-obs bench servo", "shape-obs calibrate base"} <= set(texts)
    assert all("usage: " + name in text for name, text in texts.items())


def test_banned_words_are_rare():
    texts = [*map(shown, pages().values()), *help_texts().values()]
    found = count_banned(texts)
    assert found.total() <= MOST_BANNED, found


def test_sentences_are_short():
    assert statistics.median(length(sentence) for text in pages().values() for sentence in prose(text)) <= (
        LONGEST_MEDIAN
    )


def test_pages_are_short():
    lengths = {name: len(text.split()) for name, text in pages().items() if name.startswith("docs/")}
    assert {name: words for name, words in lengths.items() if words > LONGEST_PAGE} == {}
