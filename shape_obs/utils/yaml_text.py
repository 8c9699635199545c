"""YAML as its users mean it: the numbers of YAML 1.2, texts with leading zeros as they are, and no name twice.

PyYAML reads YAML 1.1, which has other numbers than people expect:

==============================  ======================  ==============
written                         YAML 1.1                here
==============================  ======================  ==============
``1e2``, ``8e-3``               text                    number
``034422``, ``020``             octal number            text
``1:30``                        90, sexagesimal         text
``1_000``, ``0b11``             number                  text
``2026-11-27``                  date                    text
``on: 1``, ``no: 1`` as names   True, False             text
the same name twice             the last one            error
``{a:1}``                       name ``a:1`` of nothing  error
==============================  ======================  ==============

``true``, ``yes`` and ``on`` stay True as values. Text that either of the two takes for something else is quoted when
it is written.
"""

from __future__ import annotations

import re
from typing import Any, Final

import yaml

_FLOAT: Final = re.compile(
    r"[-+]?(\.[0-9]+|[0-9]+\.[0-9]*|(0|[1-9][0-9]*)(?=[eE]))([eE][-+]?[0-9]{1,3})?$|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$"
)
_INT: Final = re.compile(r"[-+]?(0|[1-9][0-9]*)$|0x[0-9a-fA-F]+$")
_BOOL: Final = "tag:yaml.org,2002:bool"
_MERGE: Final = "tag:yaml.org,2002:merge"
_TEXT: Final = "tag:yaml.org,2002:str"
#: Values that YAML 1.1 has and these files do not.
_LEFT_OUT: Final = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "timestamp", "value"))


class Loader(yaml.SafeLoader):
    """Read YAML as the table of this module has it."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - of PyYAML
        first: [(tag, pattern) for tag, pattern in resolvers if tag not in _LEFT_OUT]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_mapping_node(self, anchor: Any) -> Any:
        """Compose a mapping whose names are texts and differ."""
        node = super().compose_mapping_node(anchor)
        seen: set[Any] = set()
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == _MERGE:
                continue
            if key.tag == _BOOL:
                key.tag = _TEXT
            if key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"{key.value!r} is given twice", problem_mark=key.start_mark)
            seen.add(key.value)
            empty = isinstance(value, yaml.ScalarNode) and value.value == "" and value.style is None
            if node.flow_style and empty and key.style is None and ":" in key.value:
                raise yaml.MarkedYAMLError(
                    problem=f"{key.value!r} needs a space after its colon", problem_mark=key.start_mark
                )
        return node


class Dumper(yaml.SafeDumper):
    """Write YAML that ``Loader`` and any reader of YAML 1.1 read as the same values."""


Loader.add_implicit_resolver("tag:yaml.org,2002:int", _INT, list("-+0123456789"))
for _class in (Loader, Dumper):
    _class.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))
