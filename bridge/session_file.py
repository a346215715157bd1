"""What `markerbridge run` is to do: from its command line, or written down in a session file.

A session file is TOML (docs/session.md). Both ways make the same plan, checked by the same rules;
what is wrong in a file is named by file, line and key.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails

from bridge.model import DEFAULT
from bridge.status_server import Endpoint, parse_endpoint
from bridge.terminal import LINE_EVERY
from bridge.watch import LOG_EVERY
from drivers.errors import UsageError
from drivers.performers import parse_name, parse_names
from drivers.toml_lines import line_of
from drivers.url import Url, UrlError

LONGEST = 1 << 16  # bytes: a file larger than that is no session file

_WORDS = {
    "missing": "it is missing",
    "string_type": 'it is text: write it in "quotes"',
    "bool_type": "it is true or false",
    "too_short": "it is empty",
    "list_type": 'it is a list: ["...", "..."]',
    "model_type": "it is a table",
    "finite_number": "it is a number",
    "float_type": "it is a number",
    "float_parsing": "it is a number",
    "greater_than": "it is a number above {gt:g}",
    "greater_than_equal": "it is a number from {ge:g}",
    "literal_error": "known are {expected}",
}


@dataclass(frozen=True)
class Origin:
    """Where a plan is written: a file and its text; nowhere for a command line."""

    path: str = ""
    text: str = ""
    several: bool = False  # whether its source is a list

    def written(self, keys: tuple[str | int, ...]) -> tuple[str | int, ...]:
        """The keys of an entry as they stand there: a lone source is no list."""
        return keys if self.several or keys[:1] != ("source",) else (keys[0], *keys[2:])

    def at(self, keys: tuple[str | int, ...]) -> str:
        """`session.toml, line 7: source.frame: `, or as much of it as there is."""
        name = ".".join(key for key in keys if isinstance(key, str))
        where = self.path
        if self.path:
            # What is missing has no line: the one of the table that lacks it.
            wholes = (keys[:end] for end in range(len(keys), 0, -1))
            lines = (line_of(self.text, whole) for whole in wholes)
            if line := next(filter(None, lines), None):
                where += f", line {line}"
        return "".join(f"{part}: " for part in (where, name) if part)

    def holds(self, keys: tuple[str | int, ...]) -> bool:
        return bool(self.text) and line_of(self.text, keys) is not None


def _option(value: object) -> str:
    """A value of a TOML file as an address has it: lists as `a,b`, tables as `a:b,c:d`."""
    match value:
        case bool():
            text = str(value).lower()
        case str() | int() | float():
            text = str(value)
        case list():
            text = ",".join(map(_item, value))
        case dict():
            text = ",".join(f"{_item(name)}:{_item(to)}" for name, to in value.items())
        case _:
            raise ValueError("it is text, a number, a list or a table")
    if not text:
        raise ValueError("it is empty: leave it out")
    return text


def _item(value: object) -> str:
    if not isinstance(value, str | int | float) or "," in str(value):
        raise ValueError(f"'{value}' is no text without a comma, and no number")
    return str(value)


def _endpoint(value: object) -> object:
    if isinstance(value, tuple):  # a command line's has been read
        return value
    return parse_endpoint(str(value))


class SourcePlan(BaseModel):
    """Where the markers come from. Further keys are the options of the address."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, Annotated[str, BeforeValidator(_option)]]

    url: str

    @model_validator(mode="before")
    @classmethod
    def _alone(cls, value: object) -> object:
        if isinstance(value, str):
            return {"url": value}
        if not isinstance(value, dict):
            raise ValueError("it is an address, or a table with a url and its options")
        return value

    @property
    def address(self) -> str:
        """The address with all options. Raises UrlError."""
        return Url.parse(self.url).adding(self.__pydantic_extra__).text


@dataclass(frozen=True)
class Role:
    """A source's address, and who is in it: one performer `alone`, whose name may be empty, or
    several, whose labels begin with their names. keys: where it stands in a session file.
    """

    address: str
    performers: tuple[str, ...]
    alone: bool
    keys: tuple[str | int, ...]


class LogPlan(BaseModel):
    """What is said on standard error. every: seconds between sums of what went wrong. lines:
    seconds between lines on the state, where the output is no terminal; 0 for none."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    level: Literal["debug", "info", "warning", "error"] = "info"
    every: float = Field(default=LOG_EVERY, gt=0, allow_inf_nan=False, strict=True)
    lines: float = Field(default=LINE_EVERY, ge=0, allow_inf_nan=False, strict=True)


class SessionPlan(BaseModel):
    """A session: its source, or those of several performers, model, sinks, how it is watched.

    seconds: after which it ends. status: host and port where its state is asked for. wait: whether
    a source that is not there is waited for.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    source: list[SourcePlan] = Field(min_length=1)
    model: str = DEFAULT
    sinks: list[str] = []
    truth: str | None = None
    seconds: float | None = Field(default=None, gt=0, allow_inf_nan=False, strict=True)
    status: Annotated[Endpoint | None, BeforeValidator(_endpoint)] = None
    wait: bool = Field(default=False, strict=True)
    log: LogPlan = LogPlan()
    _origin: Origin = PrivateAttr(default_factory=Origin)

    @field_validator("sinks")
    @classmethod
    def _different(cls, sinks: list[str]) -> list[str]:
        if len(set(sinks)) < len(sinks):
            raise ValueError("a sink is named twice: each address is taken once")
        return sinks

    @field_validator("source", mode="before")
    @classmethod
    def _one_or_several(cls, value: object) -> object:
        return value if isinstance(value, list) else [value]

    @property
    def title(self) -> str:
        """The addresses of all sources."""
        return " ".join(source.url for source in self.source)

    @property
    def roles(self) -> list[Role]:
        """Sources, and who is in them. Raises UsageError for performers that cannot be meant."""
        roles = []
        for number, source in enumerate(self.source):
            keys = self._origin.written(("source", number))
            with self.naming(*keys):
                roles.append(_role(source.address, keys, several=len(self.source) > 1))
        known: set[str] = set()
        for role in roles:
            with self.naming(*role.keys):
                for name in role.performers:
                    if name in known:
                        raise UrlError(f"two sources are of performer {name}: each is named once")
                    known.add(name)
        with self.naming("truth"):
            if self.truth and len(known) > 1:
                raise UrlError(f"'{self.truth}': truth is for a performer alone")
        return roles

    @property
    def folder(self) -> Path | None:
        """What the paths of a session file are relative to; None for a command line."""
        return Path(self._origin.path).absolute().parent if self._origin.path else None

    @contextmanager
    def naming(self, *keys: str | int) -> Iterator[None]:
        """An address that is wrong is named by where it is written."""
        try:
            yield
        except UrlError as error:
            if not self._origin.path:
                raise
            option = (*keys, error.option)
            if error.option and self._origin.holds(option):
                raise UsageError(f"{self._origin.at(option)}{error.problem}") from error
            raise UsageError(f"{self._origin.at(keys)}{error}") from error


def _role(address: str, keys: tuple[str | int, ...], *, several: bool) -> Role:
    """Who is in a source. Raises UrlError."""
    url = Url.parse(address)
    alone = url.take("performer", "", parse_name)
    nobody: tuple[str, ...] = ()
    together = url.take("performers", nobody, parse_names)
    if alone and together:
        raise UrlError(f"'{address}': performer and performers: one of the two")
    if several and not (alone or together):
        raise UrlError(
            f"'{address}': of several sources each says whose it is: performer=NAME, or "
            "performers=NAME,NAME where labels begin with NAME:"
        )
    bare = Url.parse(address).without("performer", "performers").text
    return Role(bare, together or (alone,), not together, keys)


def plan_session(values: Mapping[str, Any], origin: Origin | None = None) -> SessionPlan:
    """A plan from what a command line or a session file says. Raises UsageError."""
    origin = replace(origin or Origin(), several=isinstance(values.get("source"), list))
    try:
        plan = SessionPlan.model_validate(values)
    except ValidationError as errors:
        _refuse(errors.errors(), origin)
    plan._origin = origin
    return plan


def read_session(path: str | Path) -> SessionPlan:
    """The plan that a session file holds. Raises UsageError: file, line, key and what to do."""
    try:
        with Path(path).open("rb") as file:
            content = file.read(LONGEST + 1)
    except OSError as error:
        raise UsageError(f"{path}: cannot read the session file: {error.strerror}") from error
    if len(content) > LONGEST:
        raise UsageError(f"{path}: no session file: it is larger than {LONGEST >> 10} KiB")
    try:
        text = content.decode()
        return plan_session(tomllib.loads(text), Origin(str(path), text))
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise UsageError(f"{path}, line {line}: no text (UTF-8)") from error
    except RecursionError as error:
        raise UsageError(f"{path}: no session file: nested too deeply") from error
    except tomllib.TOMLDecodeError as error:
        found = re.fullmatch(r"(.*) \(at (?:line (\d+), column \d+|end of document)\)", str(error))
        problem, at = found.groups() if found else (str(error), None)
        line = int(at) if at else text.count("\n") + 1
        raise UsageError(f"{path}, line {line}: no TOML: {problem}") from error


def _refuse(errors: list[ErrorDetails], origin: Origin) -> NoReturn:
    """Raises UsageError for the first of them."""
    error = errors[0]
    keys, kind, context = origin.written(error["loc"]), error["type"], error.get("ctx", {})
    if kind == "extra_forbidden":
        known = LogPlan if keys[0] == "log" else SessionPlan
        problem = f"unknown key (known: {', '.join(known.model_fields)})"
    elif kind == "value_error":
        problem = str(context["error"])
    else:
        problem = _WORDS[kind].format(**context) if kind in _WORDS else error["msg"]
    raise UsageError(f"{origin.at(keys)}{problem}") from None
