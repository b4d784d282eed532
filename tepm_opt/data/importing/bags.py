"""ROS bags (ROS 2 folders, `.db3`, `.mcap`, ROS 1 `.bag`) as columns: topic/field, each topic with its own time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tepm_opt.errors import InputError

TIME = "time"  # of a topic: when its messages were written
LONGEST = 256  # numbers in a list; what is longer is a picture


def bag_columns(path: Path, highlevel: Any) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Columns of a bag by topic and field, and the column of time of each.

    Numbers of lists count from 1; a header's stamp is one column in s; a field that a message lacks is NaN.

    Args:
        path: of the bag.
        highlevel: the module `rosbags.highlevel`.

    Raises:
        InputError: not a bag, or one whose messages cannot be read.
    """
    from rosbags.typesys import Stores, get_typestore

    rows: dict[str, list[dict[str, float]]] = {}
    foreign: set[str] = set()  # topics of types that the bag does not describe
    try:
        with highlevel.AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            for connection, stamp, raw in reader.messages():
                if connection.topic in foreign:
                    continue
                try:
                    message = reader.deserialize(raw, connection.msgtype)
                except Exception:
                    foreign.add(connection.topic)
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
    if not columns:
        unknown = f"; messages of unknown types: {', '.join(sorted(foreign))}" if foreign else ""
        raise InputError(f"{path}: holds no messages with numbers{unknown}")
    return columns, clocks


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
