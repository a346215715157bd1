"""MCAP files (https://mcap.dev/spec) that outlive whatever happens to who writes them.

No chunks: every record is whole on its own as soon as it is written, so a file that breaks off
anywhere holds all that came before. Files of other tools, with chunks, are read as well.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.frame import SourceError

MAGIC = b"\x89MCAP0\r\n"
SYNC = 1.0  # s between times that the disk is made to keep what it was given
MOST_CHANNELS = 65_535  # their numbers have 16 bits
LARGEST = 64 << 20  # bytes of a record, or of a chunk's content, that are taken into memory
_HEAD = struct.Struct("<BQ")  # of a record: kind, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; then the data


@dataclass(frozen=True, slots=True)
class Schema:
    """What the messages of a channel are. text: in words, or a JSON schema."""

    name: str
    encoding: str
    text: str


class Message(NamedTuple):
    """Times in nanoseconds since 1970."""

    channel: records.Channel
    log_time: int
    publish_time: int
    data: bytes


class McapWriter:
    """Writes a new file, each record at once. What cannot be written is an OSError: the file then
    ends with the last whole record, and the next one tries again.
    """

    def __init__(self, path: Path, profile: str, library: str, clock: Clock = SYSTEM_CLOCK) -> None:
        """Raises OSError, FileExistsError for a file that is there."""
        self.path = path
        self.messages = 0
        self._clock = clock
        self._synced = clock.now()
        self._schemas: dict[Schema, int] = {}
        self._channels: dict[int, records.Channel] = {}
        self._metadata: list[records.MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._first, self._last = 2**64 - 1, 0
        self._end = 0
        # Not buffered: what is written is the kernel's, and stays when this process is killed.
        self._file: int | None = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        try:
            self._append(MAGIC + _bytes(records.Header(profile, library)))
        except OSError:
            os.close(self._file)
            path.unlink()
            raise

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        data = _bytes(records.Metadata(name, dict(values)))
        start = self._end
        self._append(data)
        self._metadata.append(records.MetadataIndex(start, len(data), name))

    def channel(self, topic: str, encoding: str, schema: Schema, about: Mapping[str, str]) -> int:
        """The number of a new channel; it is written together with its first message.

        A topic may have several channels: `about`, their metadata, tells one from the other.
        """
        number = len(self._channels) + 1
        if number > MOST_CHANNELS:
            raise OSError(f"{self.path}: more than {MOST_CHANNELS} channels")
        schema_id = self._schemas.setdefault(schema, len(self._schemas) + 1)
        self._channels[number] = records.Channel(
            id=number,
            topic=topic,
            message_encoding=encoding,
            metadata=dict(about),
            schema_id=schema_id,
        )
        return number

    def add(self, channel: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Writes a message; times are nanoseconds since 1970."""
        count = self._counts[channel]
        self._append(
            (b"" if count else self._definition(channel))
            + _HEAD.pack(Opcode.MESSAGE, _MESSAGE.size + len(data))
            + _MESSAGE.pack(channel, count & 0xFFFFFFFF, log_time, publish_time)
            + data
        )
        self._counts[channel] += 1
        self.messages += 1
        self._first, self._last = min(self._first, log_time), max(self._last, log_time)
        if self._clock.now() - self._synced >= SYNC:
            self._sync()

    def close(self) -> None:
        """Writes what lists the content. Raises OSError where there is no room for it: the file is
        readable all the same. A second call does nothing.
        """
        if self._file is None:
            return
        try:
            self._append(self._summary())
            self._sync()
        finally:
            os.close(self._file)
            self._file = None

    def _append(self, data: bytes) -> None:
        """All of it or nothing."""
        if self._file is None:
            raise OSError(f"{self.path} is closed")
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError:
            os.ftruncate(self._file, self._end)
            os.lseek(self._file, self._end, os.SEEK_SET)
            raise
        self._end += len(data)

    def _sync(self) -> None:
        assert self._file is not None
        self._synced = self._clock.now()
        os.fsync(self._file)

    def _definition(self, channel: int) -> bytes:
        """A channel and its schema, as they come before the first message."""
        record = self._channels[channel]
        schema = next(one for one, number in self._schemas.items() if number == record.schema_id)
        return _bytes(_schema(record.schema_id, schema)) + _bytes(record)

    def _summary(self) -> bytes:
        """The end of the file: all that it holds, listed."""
        end = _bytes(records.DataEnd(0))
        channels = [one for number, one in self._channels.items() if self._counts[number]]
        used = {channel.schema_id for channel in channels}
        schemas = [_schema(i, one) for one, i in self._schemas.items() if i in used]
        statistics = records.Statistics(
            attachment_count=0,
            channel_count=len(channels),
            channel_message_counts=dict(self._counts),
            chunk_count=0,
            message_count=self.messages,
            message_start_time=min(self._first, self._last),
            message_end_time=self._last,
            metadata_count=len(self._metadata),
            schema_count=len(schemas),
        )
        found = (*schemas, *channels, statistics, *self._metadata)
        listed = b"".join(_bytes(record) for record in found)
        start = self._end + len(end)
        footer = _HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, 0)
        crc = struct.pack("<I", zlib.crc32(listed + footer))
        return end + listed + footer + crc + MAGIC


def _bytes(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _schema(number: int, schema: Schema) -> records.Schema:
    return records.Schema(
        id=number, name=schema.name, encoding=schema.encoding, data=schema.text.encode()
    )


class McapFile:
    """A file as far as it is whole, read from its beginning each time it is iterated.

    Lengths are checked before anything is read: a hostile file takes no more memory than LARGEST.
    profile and metadata (by name) are those of the iteration so far, and so are `cut`, the bytes at
    its end that are no whole records, and `damaged`, records that could not be read.
    """

    def __init__(self, path: Path) -> None:
        """Raises SourceError for what is no MCAP file."""
        self.path = path
        self.profile = ""
        self.metadata: dict[str, dict[str, str]] = {}
        self.cut = self.damaged = 0
        try:
            with path.open("rb") as file:
                start = file.read(len(MAGIC))
        except OSError as error:
            raise SourceError(f"cannot read {path}: {error.strerror}") from error
        if start != MAGIC:
            what = "is empty" if not start else "is no MCAP file"
            raise SourceError(f"{path} {what}: markerbridge writes one with --to log:FILE")

    def __iter__(self) -> Iterator[Message]:
        """The messages in the order they were written. Raises SourceError where the disk fails."""
        self.cut = self.damaged = 0
        self.metadata = {}
        channels: dict[int, records.Channel] = {}
        try:
            for kind, body in self._records():
                try:
                    message = self._read(kind, body, channels)
                except (McapError, ValueError, struct.error):
                    self.damaged += 1
                    continue
                if message:
                    yield message
        except OSError as error:
            raise SourceError(f"cannot read {self.path}: {error.strerror}") from error

    def _read(self, kind: int, body: bytes, channels: dict[int, records.Channel]) -> Message | None:
        """Takes in a record. Raises ValueError, McapError or struct.error for a damaged one."""
        if kind == Opcode.MESSAGE:
            number, _, log_time, publish_time = _MESSAGE.unpack_from(body)
            if number not in channels:
                raise ValueError("a message of an unknown channel")
            return Message(channels[number], log_time, publish_time, body[_MESSAGE.size :])
        stream = ReadDataStream(BytesIO(body))
        if kind == Opcode.CHANNEL:
            channel = records.Channel.read(stream)
            channels.setdefault(channel.id, channel)
        elif kind == Opcode.METADATA:
            found = records.Metadata.read(stream)
            self.metadata[found.name] = found.metadata
        elif kind == Opcode.HEADER:
            self.profile = records.Header.read(stream).profile
        return None

    def _records(self) -> Iterator[tuple[int, bytes]]:
        """Kind and body of each record up to the end of the data, those of chunks among them."""
        with self.path.open("rb", buffering=1 << 20) as file:
            size = os.fstat(file.fileno()).st_size
            file.seek(len(MAGIC))
            for kind, body in _whole_records(file, size):
                if kind == Opcode.DATA_END:
                    return
                if kind != Opcode.CHUNK:
                    yield kind, body
                    continue
                try:
                    content = _content(body)
                except (McapError, ValueError, RuntimeError, struct.error, zstandard.ZstdError):
                    self.damaged += 1
                    continue
                yield from _whole_records(BytesIO(content), len(content))
            self.cut = size - file.tell()


def _whole_records(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Kind and body of each record, up to one that is longer than the `size` bytes there are.

    The file is left at the end of the last whole one. What would not fit into memory is skipped.
    """
    at = file.tell()
    while size - at >= _HEAD.size:
        kind, length = _HEAD.unpack(file.read(_HEAD.size))
        end = at + _HEAD.size + length
        if end > size or kind == 0:
            break
        if length > LARGEST:
            file.seek(end)
        else:
            yield kind, file.read(length)
        at = end
    file.seek(at)


def _content(body: bytes) -> bytes:
    """A chunk's records. Raises ValueError for more than LARGEST, for another check sum, and what
    the libraries raise for bytes that are none of theirs.
    """
    chunk = records.Chunk.read(ReadDataStream(BytesIO(body)))
    if chunk.uncompressed_size > LARGEST:
        raise ValueError("too large a chunk")
    if chunk.compression == "zstd":
        # By its stream: the size that the bytes themselves tell could be anything.
        reader = zstandard.ZstdDecompressor(max_window_size=LARGEST).stream_reader(chunk.data)
        content = reader.read(chunk.uncompressed_size)
    elif chunk.compression == "lz4":
        inflater = lz4.frame.LZ4FrameDecompressor()
        content = inflater.decompress(chunk.data, max_length=chunk.uncompressed_size)
    elif chunk.compression == "":
        content = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression} is not known")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("the check sum of a chunk is wrong")
    return bytes(content)
