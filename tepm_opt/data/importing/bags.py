"""ROS bags (ROS 2 folders, `.db3`, `.mcap`, ROS 1 `.bag`) as columns: topic/field, each topic with its own time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.errors import InputError

TIME = "time"  # of a topic: when its messages were written
LONGEST = 256  # numbers in a list; what is longer is a picture


def bag_columns(path: Path, highlevel: Any) -> tuple[dict[str, np.ndarray], dict[str, str], dict[str, str]]:
    """Columns of a bag by topic and field, the column of time of each, and words about topics that cannot be decoded.

    Types that the bag does not describe are read from `PACKAGE/msg/TYPE.msg` beside it.

    Numbers of lists count from 1; a header's stamp is one column in s; a field that a message lacks is NaN.

    Args:
        path: of the bag.
        highlevel: the module `rosbags.highlevel`.

    Raises:
        InputError: not a bag, or one whose messages cannot be read.
    """
    from rosbags.typesys import Stores, get_typestore

    rows: dict[str, list[dict[str, float]]] = {}
    foreign: dict[str, tuple[str, int]] = {}  # topics of types that the bag does not describe, and their messages
    store = get_typestore(Stores.LATEST)
    _register_beside(path, store)
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            for connection, stamp, raw in reader.messages():
                try:
                    if connection.topic in foreign:
                        raise KeyError(connection.msgtype)
                    message = reader.deserialize(raw, connection.msgtype)
                except Exception:
                    foreign[connection.topic] = (connection.msgtype, foreign.get(connection.topic, ("", 0))[1] + 1)
                    continue
                rows.setdefault(connection.topic, []).append({TIME: stamp // 10**9 + stamp % 10**9 / 1e9, **dict(_fields(message))})
    except Exception as error:  # a library's readers raise whatever damaged bytes make them
        raise InputError(f"{path}: is not a ROS bag that can be read: {' '.join(str(error).split())[:120]}") from error
    columns, clocks = {}, {}
    for topic, messages in rows.items():
        names = list(dict.fromkeys(name for message in messages for name in message))
        for name in names:
            columns[f"{topic}/{name}"] = np.array([message.get(name, np.nan) for message in messages])
            clocks[f"{topic}/{name}"] = f"{topic}/{TIME}"
    undecoded = {
        topic: f"topic {topic!r}: {count} messages of type {kind} cannot be decoded, the bag does not describe it; "
        f"valid: its definition as {path.parent / kind}.msg"
        for topic, (kind, count) in sorted(foreign.items())
    }
    if not columns:
        unknown = f"; {'; '.join(undecoded.values())}" if foreign else ""
        raise InputError(f"{path}: holds no messages with numbers{unknown}")
    return columns, clocks, undecoded


def _register_beside(path: Path, store: Any) -> None:
    """Add the definitions `PACKAGE/msg/TYPE.msg` that lie beside a bag to the known types.

    Raises:
        InputError: a file that is no definition.
    """
    from rosbags.typesys import get_types_from_msg

    found: dict[str, Any] = {}
    for file in sorted(path.parent.glob("*/msg/*.msg")):
        try:
            found |= get_types_from_msg(file.read_text(encoding="utf-8"), f"{file.parts[-3]}/msg/{file.stem}")
        except Exception as error:  # of a grammar, of whatever kind
            raise InputError(f"{file}: is no definition of a message: {' '.join(str(error).split())[:120]}") from error
    if found := {name: kind for name, kind in found.items() if name not in store.types}:
        store.register(found)


def _fields(message: Any, before: str = "") -> Iterator[tuple[str, float]]:
    """Numbers within a message by their paths."""
    if hasattr(message, "sec") and hasattr(message, "nanosec"):
        yield before.rstrip("/"), message.sec + message.nanosec / 1e9
        return
    for name in getattr(message, "__dataclass_fields__", ()):
        if name == "__msgtype__":
            continue
        value, place = getattr(message, name), before + name
        if isinstance(value, bool | int | float | np.number):
            yield place, float(value)
        elif isinstance(value, list | np.ndarray):
            if len(value) > LONGEST:
                continue
            for k, each in enumerate(value):
                yield from (
                    [(f"{place}/{k + 1}", float(each))] if isinstance(each, int | float | np.number) else _fields(each, f"{place}/{k + 1}/")
                )
        else:
            yield from _fields(value, f"{place}/")
