"""Specs: frozen dataclasses that configure a stage and convert to and from plain dicts and YAML.

A family of interchangeable stages (segmentations, regions of interest, features, ...) is a subclass of ``Spec``
declared with ``family=``; its members are declared with ``kind=``. A member is imported when its kind is first asked
for: those of this package are listed in the family's ``modules=``, those of other packages in the entry-point group
``shape_obs.<family>``.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Union

from shape_obs.utils.errors import SpecError as SpecError
from shape_obs.utils.errors import did_you_mean as did_you_mean

if TYPE_CHECKING:
    from typing_extensions import Self


_PLUGINS: ContextVar[bool] = ContextVar("plugins", default=True)


@contextmanager
def without_plugins() -> Iterator[None]:
    """Load no plugins while specs are read: kinds of other packages are known only if these are already imported.

    For values from untrusted files, whose names must not choose which code is loaded.
    """
    before = _PLUGINS.set(False)
    try:
        yield
    finally:
        _PLUGINS.reset(before)


class Spec:
    """Base class of all configuration dataclasses: ``from_dict``, ``to_dict`` and registries of kinds.

    Fields are always checked against their annotations and converted (lists to tuples, NumPy values to plain ones). The
    ``__post_init__`` of a subclass must call ``super().__post_init__()`` first.
    """

    family: ClassVar[str] = ""
    kind: ClassVar[str] = ""
    _members: ClassVar[dict[str, type[Spec]]] = {}
    _modules: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(
        cls,
        *,
        family: str | None = None,
        modules: Mapping[str, str] = types.MappingProxyType({}),
        kind: str | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init_subclass__(**kwargs)
        if family is not None:
            cls.family, cls._members, cls._modules = family, {}, modules
        if kind is not None:
            if not cls.family:
                raise TypeError(f"{cls.__name__}: kind={kind!r} needs a base class declared with family=.")
            cls.kind = kind
            cls._members[kind] = cls

    def __post_init__(self) -> None:
        where, hints = self.kind or type(self).__name__, _field_types(type(self))
        for name in hints:
            object.__setattr__(self, name, _convert(getattr(self, name), hints[name], f"{where}.{name}"))

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        """Return the kinds of this family, including those that other packages add through entry points."""
        if _PLUGINS.get():
            from importlib import metadata  # takes 20 ms, and most processes never ask

            for entry in metadata.entry_points(group=f"shape_obs.{cls.family}"):
                if entry.name not in cls._members:
                    entry.load()
        return tuple(sorted({*cls._members, *cls._modules}))

    @classmethod
    def from_dict(cls, value: Self | Mapping[str, Any] | str) -> Self:
        """Build a spec from a mapping; a spec passes through, and a bare string is read as ``{"kind": string}``.

        Args:
            value: The fields by name. In a family, ``kind`` selects the member.

        Raises:
            SpecError: A field or kind is unknown (the message suggests the nearest name), or a value has a wrong type.
        """
        if isinstance(value, cls):
            return value
        if isinstance(value, str) and cls.family:
            value = {"kind": value}
        if not isinstance(value, Mapping):
            raise SpecError(f"{cls.__name__}: expected a mapping or a {cls.__name__}, got {_describe(value)}.")
        fields = dict(value)
        member = cls._choose(fields.pop("kind", cls.kind or None)) if cls.family else cls
        return member._build(fields)

    def to_dict(self) -> dict[str, Any]:
        """Return the spec as JSON values, including defaults; ``from_dict`` returns an equal spec."""
        head = {"kind": self.kind} if self.kind else {}
        return {**head, **{name: to_plain(getattr(self, name)) for name in _field_types(type(self))}}

    @classmethod
    def _choose(cls, kind: Any) -> type[Self]:
        if kind is None:
            raise SpecError(f"{cls.family}: 'kind' is missing; known kinds: {', '.join(cls.kinds())}.")
        if isinstance(kind, str) and kind in cls._modules and kind not in cls._members:
            import_module(cls._modules[kind])
        # Entry points are looked up only for kinds that this package does not have: it takes milliseconds.
        if not isinstance(kind, str) or (kind not in cls._members and kind not in cls.kinds()):
            raise SpecError(f"{cls.family}: unknown kind {kind!r}{did_you_mean(kind, cls.kinds())}")
        member = cls._members[kind]
        if not issubclass(member, cls):
            raise SpecError(f"{cls.__name__}: kind {kind!r} is a {member.__name__}; expected {cls.kind!r}.")
        return member

    @classmethod
    def _build(cls, values: Mapping[str, Any]) -> Self:
        fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
        where = cls.kind or cls.__name__
        for name in values:
            if name not in fields:
                raise SpecError(f"{where}: unknown field {name!r}{did_you_mean(name, fields)}")
        missing = [
            name
            for name, f in fields.items()
            if name not in values and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
        ]
        if missing:
            raise SpecError(f"{where}: missing {', '.join(missing)}; fields: {', '.join(fields)}.")
        return cls(**values)


def to_plain(value: Any) -> Any:
    """Convert specs, arrays, tuples and other iterables to dicts, lists and scalars."""
    if isinstance(value, Spec):
        return value.to_dict()
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
        return [to_plain(item) for item in value]
    return value


@cache
def _field_types(cls: type[Spec]) -> dict[str, Any]:
    """Return the fields of a spec with their evaluated annotations."""
    hints = typing.get_type_hints(cls)
    return {f.name: hints[f.name] for f in dataclasses.fields(cls)}  # type: ignore[arg-type]


def _convert(value: Any, hint: Any, where: str) -> Any:
    """Convert a JSON, YAML or NumPy value to the type of a field's annotation."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin in (Union, types.UnionType):
        return _convert_union(value, arguments, hint, where)
    if origin is typing.Literal:
        if value not in arguments:
            raise SpecError(f"{where}: unknown value {value!r}{did_you_mean(value, map(str, arguments))}")
        return value
    if origin is tuple:
        return _convert_tuple(value, arguments, hint, where)
    if origin is not None and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise SpecError(f"{where}: expected a mapping, got {_describe(value)}.")
        return {str(key): _convert(item, arguments[1], f"{where}.{key}") for key, item in value.items()}
    if isinstance(hint, type) and issubclass(hint, Spec):
        try:
            return hint.from_dict(value)
        except SpecError as error:
            raise SpecError(f"{where}: {error}") from error
    if hint is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError as error:
            raise SpecError(f"{where}: expected a number that fits into a float, got one that is too large.") from error
    if hint is int and isinstance(value, float) and value.is_integer():
        return int(value)
    if (isinstance(value, bool) and hint is not bool) or not isinstance(value, hint):
        raise SpecError(f"{where}: expected {_name(hint)}, got {_describe(value)}.")
    return value


def _convert_union(value: Any, arguments: tuple[Any, ...], hint: Any, where: str) -> Any:
    if value is None and type(None) in arguments:
        return None
    errors: list[str] = []
    for argument in arguments:
        if argument is type(None):
            continue
        try:
            return _convert(value, argument, where)
        except SpecError as error:
            errors.append(str(error))
    if len(errors) == 1:
        raise SpecError(errors[0])
    raise SpecError(f"{where}: expected {_name(hint)}, got {_describe(value)}.")


def _convert_tuple(value: Any, arguments: tuple[Any, ...], hint: Any, where: str) -> tuple[Any, ...]:
    many = len(arguments) == 2 and arguments[1] is Ellipsis
    if many and isinstance(arguments[0], type) and issubclass(arguments[0], Spec):
        value = [value] if isinstance(value, (Spec, Mapping, str)) else value  # one spec stands for a list of it
    if not isinstance(value, Iterable) or isinstance(value, (str, bytes, Mapping)):
        raise SpecError(f"{where}: expected a list, got {_describe(value)}.")
    value = list(value)
    if many:
        return tuple(_convert(item, arguments[0], f"{where}[{i}]") for i, item in enumerate(value))
    if len(value) != len(arguments):
        raise SpecError(f"{where}: expected {len(arguments)} values, got {len(value)}: {list(value)!r}.")
    return tuple(_convert(item, a, f"{where}[{i}]") for i, (item, a) in enumerate(zip(value, arguments, strict=True)))


def _name(hint: Any) -> str:
    return hint.__name__ if isinstance(hint, type) else str(hint).replace("typing.", "").replace("shape_obs.", "")


def _describe(value: Any) -> str:
    return f"{value!r} ({type(value).__name__})"
