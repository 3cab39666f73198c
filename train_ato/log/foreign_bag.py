"""Bags of ``ros2 bag record`` as one MCAP file: folders of any name, split, compressed, SQLite.

A bag that is not a single plain MCAP file is copied once per process into a temporary one, with all its messages.
"""

import re
import shlex
import shutil
import sqlite3
import struct
import tempfile
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import zstandard
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from plant_sim.data_text import parse_yaml
from train_ato.log.bag_layout import METADATA, not_a_run
from train_ato.log.definitions import definition
from train_ato.log.mcap_records import RawMessage, stream
from train_ato.log.mcap_writer import MAGIC

BAG = "rosbag2_bagfile_information"
"""Top-level key of ``metadata.yaml``."""
SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
ROS_1 = b"#ROSBAG V"
SQLITE = b"SQLite format 3\0"
JOURNALS = ("-wal", "-journal")
"""Ends of the names of the files beside an SQLite file in which a killed recorder leaves its last messages."""
PACKED = b"\x28\xb5\x2f\xfd"
"""First bytes of a Zstandard frame; a CDR message begins with 0."""
_BY_MESSAGE = re.compile(r"compression_mode:\s*['\"]?message", re.IGNORECASE)
_SQLITE_HEAD = struct.Struct(">16xH10xI")
"""Size and number of the pages of an SQLite file."""
_FROM = "SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid >= ? ORDER BY rowid"
"""Rows from a number on, without the index, which may be damaged."""
_copies: dict[tuple[Any, ...], Path] = {}
_bags: dict[Path, Path] = {}
_scratch = ExitStack()
"""Folder of the copies; it is removed at the end of the process."""


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag in their order: those that ``metadata.yaml`` of a folder names, else all of them.

    Parameters
    ----------
    path
        Folder, or a file of a bag.

    Raises
    ------
    ValueError
        If ``metadata.yaml`` names a file that is missing.
    """
    if not path.is_dir():
        return [path]
    names = _information(path).get("relative_file_paths")
    if not isinstance(names, list) or not names:
        return sorted((file for file in path.iterdir() if file.name.endswith(SUFFIXES)), key=_number)
    files = [path / Path(str(name)).name for name in names]  # version 1 to 3 of the metadata: with the folder
    for file in files:
        if not file.is_file():
            raise ValueError(
                f"{path / METADATA}: relative_file_paths: {file.name} is missing; "
                "copy it back, or name the other files one by one"
            )
    return files


def _number(file: Path) -> tuple[int, str]:
    """Return the number of a file of a split bag and its name."""
    found = re.search(r"_(\d+)\.", file.name)
    return (int(found[1]) if found else 0), file.name


def _information(folder: Path) -> dict[str, Any]:
    """Return the bag information of a folder, empty without a readable one."""
    try:
        found = parse_yaml((folder / METADATA).read_text(encoding="utf-8"))
        return dict(found[BAG])
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _packed_by_message(folder: Path) -> bool:
    """Return True if every message of a bag is compressed."""
    with suppress(OSError, UnicodeDecodeError):
        return bool(_BY_MESSAGE.search((folder / METADATA).read_text(encoding="utf-8")))
    return False


def as_mcap(path: Path) -> Path:
    """Return the MCAP file with the messages of a bag: its own file, or a copy.

    Parameters
    ----------
    path
        Folder of a bag, or a file of one.
    """
    files = bag_files(path)
    if not files:
        raise not_a_run(path, "no such log; name the folder of a run or of `ros2 bag record`")
    empty = [file for file in files if file.is_file() and not file.stat().st_size]
    if empty == files:
        raise ValueError(f"{files[0]}: is empty; nothing was recorded in it")
    files = [file for file in files if file not in empty]
    if len(files) == 1 and head_of(files[0]) == MAGIC and not _packed_by_message(files[0].parent):
        return files[0]
    key = tuple((file.resolve(), file.stat().st_size, file.stat().st_mtime_ns) for file in files)
    if key not in _copies:
        folder = tempfile.TemporaryDirectory(prefix="train_ato_bag_", ignore_cleanup_errors=True)
        _scratch.enter_context(folder)
        _copies[key] = _copied(files, path.name.partition(".")[0], Path(folder.name))
        _bags[_copies[key]] = path
    return _copies[key]


def original(log: Path) -> Path:
    """Return the bag of a copy for the user, any other log as it is."""
    return _bags.get(log, log)


def head_of(file: Path) -> bytes:
    """Return the first bytes of a file of a format; an unknown format has those of MCAP."""
    try:
        with file.open("rb") as stream:
            begin = stream.read(16)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror})") from None
    return next((known for known in (SQLITE, PACKED, ROS_1) if begin.startswith(known)), MAGIC)


def _copied(files: list[Path], name: str, folder: Path) -> Path:
    """Write the messages of several files into one MCAP file of a folder."""
    numbers: dict[tuple[str, str], int] = {}
    copy = folder / f"{name or 'bag'}.mcap"
    with copy.open("wb") as out:
        writer = Writer(out, compression=CompressionType.NONE)
        writer.start("ros2", "train_ato")
        for place, file in enumerate(files):
            for channel, schema, publish_ns, log_ns, data in _messages(file, folder / f"part_{place}"):
                key = (channel.topic, schema.name)
                if key not in numbers:
                    kind = writer.register_schema(schema.name, schema.encoding, schema.data) if schema.id else 0
                    numbers[key] = writer.register_channel(
                        channel.topic, channel.message_encoding, kind, channel.metadata
                    )
                if data.startswith(PACKED):
                    data = zstandard.ZstdDecompressor().decompressobj().decompress(data)
                writer.add_message(numbers[key], log_ns, data, publish_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return copy


def _messages(file: Path, part: Path) -> Iterator[RawMessage]:
    """Read the messages of a file, unpacked into ``part`` if it is compressed."""
    head = head_of(file)
    if head == ROS_1:
        raise ValueError(f"{file}: a bag of ROS 1; convert it: `rosbags-convert --src {file} --dst {file.stem}`")
    if head == PACKED:
        unpack(file, part)
        try:
            yield from _messages(part, part.with_suffix(".again"))
        except ValueError as error:
            raise ValueError(str(error).replace(str(part), str(file))) from None
        finally:
            part.unlink()
    elif head == SQLITE:
        yield from of_sqlite(file)
    else:
        yield from stream(file)


def unpack(file: Path, target: Path) -> None:
    """Decompress a file as far as it is readable."""
    with file.open("rb") as source, target.open("wb") as out, suppress(zstandard.ZstdError):
        frames = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
        while data := frames.read(1 << 16):
            out.write(data)


def of_sqlite(file: Path) -> Iterator[RawMessage]:
    """Read the messages of an SQLite bag of any version."""
    try:
        with _settled(file) as address, closing(sqlite3.connect(address, uri=True)) as database:
            kinds = {row["id"]: _kind(row, database) for row in _rows(database, "topics")}
            for topic, stamp, data in database.execute(
                "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp"
            ):
                yield RawMessage(*kinds[topic], stamp, stamp, data)
    except (sqlite3.Error, KeyError) as error:
        with tempfile.TemporaryDirectory(prefix="train_ato_bag_") as folder:
            some = any(True for _ in of_damaged_sqlite(file, Path(folder)))
        command = f"`train-ato recover {shlex.quote(str(file))}`"
        saved = f"{command} saves the readable part" if some else "no message in it is readable"
        what = f"the table topics has no topic {error}" if isinstance(error, KeyError) else error
        raise ValueError(f"{file}: damaged or no bag ({what}); {saved}") from None


def of_damaged_sqlite(file: Path, folder: Path) -> Iterator[RawMessage]:
    """Read the messages of an SQLite bag outside of its damaged pages, from a copy in a folder."""
    whole = folder / "whole.db3"
    for end in ("", *JOURNALS):
        if Path(f"{file}{end}").is_file():
            shutil.copyfile(f"{file}{end}", f"{whole}{end}")
    with whole.open("r+b") as copy:  # SQLite opens no file that is shorter than its head says
        head = copy.read(_SQLITE_HEAD.size)
        page, pages = _SQLITE_HEAD.unpack(head) if len(head) == _SQLITE_HEAD.size else (0, 0)
        copy.truncate(max(file.stat().st_size, (page if page > 1 else 1 << 16) * pages))  # 1 is 65 536
    with suppress(sqlite3.Error), _settled(whole) as address, closing(sqlite3.connect(address, uri=True)) as database:
        kinds = {row["id"]: _kind(row, database) for row in _rows(database, "topics")}
        begin: int | None = 0
        while begin is not None:
            with suppress(sqlite3.Error):
                for number, topic, stamp, data in database.execute(_FROM, (begin,)):
                    if topic in kinds:
                        yield RawMessage(*kinds[topic], stamp, stamp, data)
                    begin = number + 1
                return
            begin = _next_readable(database, begin)


def _next_readable(database: sqlite3.Connection, damaged: int) -> int | None:
    """Return the number from which the rows after a damaged one are readable; None without such rows."""

    def readable(begin: int) -> bool:
        with suppress(sqlite3.Error):
            database.execute(_FROM, (begin,)).fetchone()
            return True
        return False

    step = next((step for power in range(62) if readable(damaged + (step := 1 << power))), None)
    if step is None:
        return None
    return damaged + 1 + bisect_left(range(damaged + 1, damaged + step), True, key=readable)


@contextmanager
def _settled(file: Path) -> Iterator[str]:
    """Yield the address of an SQLite file; one with a journal is copied, because SQLite writes the journal into it."""
    left = [journal for end in JOURNALS if (journal := Path(f"{file}{end}")).is_file() and journal.stat().st_size]
    if not left:
        yield f"file:{quote(str(file.resolve()))}?mode=ro&immutable=1"
        return
    with tempfile.TemporaryDirectory(prefix="train_ato_bag_") as folder:
        for path in (file, *left):
            shutil.copyfile(path, Path(folder, path.name))
        yield f"file:{quote(str(Path(folder, file.name)))}"


def _rows(database: sqlite3.Connection, table: str) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table by column, none of a table that the version of the bag does not have."""
    known = database.execute("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?", (table,)).fetchone()
    if known or table == "topics":
        found = database.execute(f"SELECT * FROM {table}")
        names = [column[0] for column in found.description]
        yield from (dict(zip(names, row, strict=True)) for row in found)


def _kind(topic: Mapping[str, Any], database: sqlite3.Connection) -> tuple[Channel, Schema]:
    """Return channel and schema of a topic; bags before Iron have no definitions of messages."""
    name, text, encoding = topic["type"], "", ""
    for row in _rows(database, "message_definitions"):
        if row["topic_type"] == name:
            text, encoding = row["encoded_message_definition"], row["encoding"]
    if not text:
        with suppress(KeyError, ValueError):  # a type that is not known here
            text, encoding = definition(name).text, "ros2msg"
    metadata = {"offered_qos_profiles": topic.get("offered_qos_profiles") or "[]"}
    metadata["topic_type_hash"] = topic.get("type_description_hash") or ""
    channel = Channel(topic["id"], topic["name"], topic["serialization_format"], metadata, 1)
    return channel, Schema(id=1, data=text.encode(), encoding=encoding, name=name)
