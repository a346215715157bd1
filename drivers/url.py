"""Addresses of sources and sinks: `scheme:rest?option=value`, checked when they are taken apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar
from urllib.parse import parse_qsl, quote, urlsplit

from drivers.errors import UsageError

T = TypeVar("T")
_PLAIN = "/:,*"  # read well in an address and mean nothing in its options


class UrlError(UsageError):
    """An address that cannot be meant; the message names it and the part that is wrong.

    option: the name of the option that is wrong, if one is. problem: what is wrong with it, for
    whoever names it otherwise, as a session file does.
    """

    def __init__(self, message: str, option: str = "", problem: str = "") -> None:
        super().__init__(message)
        self.option, self.problem = option, problem


@dataclass(slots=True)
class Url:
    """A parsed address. Options are taken one by one; what nobody took is an error."""

    text: str
    scheme: str
    path: str
    host: str
    port: int | None
    options: dict[str, str] = field(default_factory=dict)
    known: list[str] = field(default_factory=list)

    @classmethod
    def parse(cls, text: str) -> Url:
        """Takes apart `scheme:path`, `scheme:///path` or `scheme://host:port`, with `?a=b&c=d`.

        Raises UrlError for a missing scheme, a bad port, an option without a value or given twice.
        """
        scheme, colon, rest = text.partition(":")
        if not colon or not scheme:
            raise UrlError(f"'{text}' has no scheme: write for example serial:/dev/ttyUSB0")
        rest, _, query = rest.partition("?")
        try:
            found = parse_qsl(query, keep_blank_values=True, strict_parsing=True) if query else []
        except ValueError:
            raise UrlError(f"'{text}': options are written ?name=value&name=value") from None
        options = dict(found)
        if len(options) < len(found):
            names = [name for name, _ in found]
            twice = next(name for name in options if names.count(name) > 1)
            raise UrlError(f"'{text}': option {twice} is given twice", twice, "it is given twice")
        host, port, path = "", None, rest
        if rest.startswith("//"):
            try:
                parts = urlsplit("x:" + rest)
                host, port = parts.hostname or "", parts.port
            except ValueError:
                raise UrlError(
                    f"'{text}': write HOST:PORT, the port being a number from 0 to 65535"
                ) from None
            path = rest[2 + len(parts.netloc) :]
        return cls(text, scheme, path, host, port, options)

    def adding(self, options: Mapping[str, str]) -> Url:
        """This address with further options. UrlError for one that it has already."""
        for name in options:
            if name in self.options:
                raise UrlError(
                    f"'{self.text}': option {name} is given twice", name, f"'{self.text}' has it"
                )
        head, _, query = self.text.partition("?")
        written = [query] if query else []
        written += [f"{quote(name)}={quote(value, safe=_PLAIN)}" for name, value in options.items()]
        return Url.parse(f"{head}?{'&'.join(written)}" if written else head)

    def without(self, *names: str) -> Url:
        """This address without some options."""
        kept = {name: value for name, value in self.options.items() if name not in names}
        return self if kept == self.options else Url.parse(short(self.text)).adding(kept)

    def take(self, name: str, default: T, read: Callable[[str], T]) -> T:
        """Option `name` through `read`, or `default`. UrlError where `read` raises ValueError."""
        self.known.append(name)
        raw = self.options.pop(name, None)
        if raw is None:
            return default
        try:
            return read(raw)
        except ValueError as error:
            raise UrlError(
                f"'{self.text}': option {name}={raw} is wrong: {error}", name, f"'{raw}': {error}"
            ) from None

    def take_path(self) -> str:
        """What stands behind HOST:PORT, without slashes around it; empty where nothing does."""
        path, self.path = self.path.strip("/"), ""
        return path

    def address(self, default_port: int | None = None) -> tuple[str, int]:
        """Host and port; UrlError where the port is needed and missing, or something else is there.

        `vmc:10.0.0.7` would mean this machine else, without a word.
        """
        if self.path.strip("/"):
            raise UrlError(f"'{self.text}': write {self.scheme}://HOST:PORT")
        port = self.port if self.port is not None else default_port
        if port is None:
            raise UrlError(f"'{self.text}' names no port: write {self.scheme}://127.0.0.1:9100")
        return self.host or "127.0.0.1", port

    def file_path(self) -> str:
        """The path; UrlError when it is empty."""
        if not self.path or self.host:
            raise UrlError(f"'{self.text}' names no path: write {self.scheme}:PATH")
        return self.path

    def finish(self) -> None:
        """UrlError for options that nobody took."""
        if self.options:
            unknown = sorted(self.options)
            known = f"(known: {', '.join(self.known) or 'none'})"
            raise UrlError(
                f"'{self.text}': unknown option {', '.join(unknown)} {known}",
                unknown[0],
                f"unknown key {known}",
            )


def short(address: str) -> str:
    """An address without its options, which may be long."""
    return address.partition("?")[0]
