"""Frames of the poses that come in from a tracker's server, on the host's clock, with dropouts and jumps flagged."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, replace

import numpy as np

from tepm_opt.models.hardware import TrackerLink

WAIT_PERIODS, STALE_PERIODS = 1.5, 5.0
"""Sample periods that a frame waits for its missing sensors, and after which a pose is too old to be given."""
SERVER_STEP_S, OFFSET_RISE, SETTLING_FRAMES = 0.5, 5e-4, 5
"""A server's clock that jumps by more than the first begins anew; the clocks drift apart slower than the second (s/s)."""
LARGEST_CROWD = 100
"""Names of devices that are remembered besides the link's own."""
JUMP_FRAMES, MISSED_FRAMES = 5, 10
"""Frames after which a new place is believed; most missed frames for which a sensor may have moved on."""
ORTHONORMAL, IDENTITY, LOST = 1e-3, np.eye(4), np.full((4, 4), np.nan)
"""Largest element of RᵀR − 1 in a rotation; what is sent in place of a pose; what is given then."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The poses of all sensors at one time.

    Attributes:
        time: on the host's clock when the poses were true, in s.
        points: reference points in G, (points, 3) in m; NaN where a sensor is lost.
        transforms: poses of the sensors in G, (points, 4, 4) in m; NaN where one is lost.
        status: "ok", or what is wrong: "tracker lost s2, s3", "tracker: jump of s4", "tracker was silent for 1.20 s".
        age: in s between `time` and when the frame was returned.
    """

    time: float
    points: np.ndarray
    transforms: np.ndarray
    status: str
    age: float = np.nan

    def __repr__(self) -> str:
        seen = int(np.isfinite(self.points).all(axis=1).sum())
        return f"Frame({self.time:.3f} s, {seen} of {len(self.points)} points, {self.status})"


@dataclass(frozen=True)
class TrackerStatistics:
    """Counts of all that came in so far."""

    received: int = 0  # messages of the robot's sensors
    frames: int = 0  # made of them
    incomplete: int = 0  # frames to which a sensor sent nothing
    lost: int = 0  # poses missing from frames, not sent or not valid
    jumps: int = 0  # poses taken out because they were too far from the last one
    moved: int = 0  # jumps that stayed where they were and were believed
    dropped_old: int = 0  # messages whose stamp was not newer than the last one's, frames whose time was not
    dropped_stale: int = 0  # frames that were too old when they arrived or when they were to be read
    settling: int = 0  # frames used only to align the clocks, after each connection
    malformed: int = 0  # messages that could not be unpacked, or whose stamp no other message agrees with
    reconnects: int = 0  # connections after the first
    clock_offset: float = np.nan  # host's clock − server's clock in s, with the least network delay; NaN before the first message


class ServerClock:
    """Host's clock − server's clock (`offset` in s), from when messages with the server's stamps arrive.

    Delays only add: the offset is the lower envelope of arrival − stamp. It falls at once, and rises no faster than clocks drift, so that
    messages held up on their way cannot make their poses look fresh, however many come. It is `settled` after some frames in which it did
    not fall by more than `tolerance` in s; a backlog that a server sends first does not settle it.
    """

    def __init__(self, tolerance: float) -> None:
        self.tolerance, self.offset, self._at, self._first, self._frames = tolerance, np.nan, np.nan, np.nan, 0
        self._doubted = np.nan

    @property
    def settled(self) -> bool:
        """Whether the offset can be used."""
        return self._frames >= SETTLING_FRAMES

    def believes(self, stamp: float, received: float) -> bool:
        """Whether a stamp fits the offset, or the last message's stamp if that did not either: a single wild one sets no clock."""
        seen = received - stamp
        if not seen <= self.offset - SERVER_STEP_S:
            return True
        doubted, self._doubted = self._doubted, seen
        return abs(seen - doubted) < SERVER_STEP_S

    def update(self, stamp: float, received: float) -> None:
        """A new frame's stamp on the server's clock and its arrival on the host's, in s."""
        seen = received - stamp
        if not seen > self.offset - SERVER_STEP_S:
            self.offset, self._first, self._at, self._frames = seen, seen, received, 0
        self.offset = min(seen, self.offset + OFFSET_RISE * max(received - self._at, 0))
        self._at, self._frames = received, self._frames + 1
        if not self.settled and self.offset < self._first - self.tolerance:
            self._first, self._frames = self.offset, 1


@dataclass
class _Sensor:
    """Place at which a sensor's point was last believed to be, and the new place it may have jumped to."""

    place: list[float] | None = None
    time: float = 0.0
    candidate: list[float] | None = None
    count: int = 0

    def judge(self, point: list[float], now: float, step: float, period: float) -> float | None:
        """Distance that the point moved if that is believed (0 for an ordinary motion), None for a jump; lengths in m, times in s."""
        missed = min(max(round((now - self.time) / period), 1), MISSED_FRAMES)
        moved = math.dist(point, self.place or point)
        if moved > step * missed:
            near = self.candidate is not None and math.dist(point, self.candidate) <= step
            self.count, self.candidate = self.count + 1 if near else 1, point
            if self.count < JUMP_FRAMES:
                self.time = now - (missed - 1) * period  # a jump is not a missed frame
                return None
        self.place, self.time, self.candidate, self.count = point, now, None, 0
        return moved if moved > step * missed else 0.0


class FrameAssembler:
    """Makes frames of messages: no threads, no sockets, no clock of its own.

    Args:
        link: names, holders, units, rate.
        stale_periods: sample periods after which a pose is too old to be given (`latency_s` comes on top).

    Attributes:
        pending: poses of the frame that still waits for some of its sensors, by device.
        ready: frames to be returned, oldest first.
        seen: names of the devices that sent a pose; of others than the link's the first ones only.
        markers: devices that sent positions without rotations.
        progress: arrival of the last message that was neither late nor old, in s; a connection without progress is worth nothing.
        arrival: of the newest frame's first message in s; −∞ before there is one.
        counts: of what `TrackerStatistics` names.
    """

    def __init__(self, link: TrackerLink, stale_periods: float = STALE_PERIODS) -> None:
        self.link, self.names, self.period = link, tuple(f"s{i + 1}" for i in range(len(link.devices))), 1 / link.rate_hz
        self.stale = stale_periods * self.period + link.latency_s
        self.clock = ServerClock(self.period / 2)
        self.seen, self.markers = set[str](), set[str]()
        self.progress, self.arrival = -np.inf, -np.inf
        self.counts: Counter[str] = Counter()
        self._sensors, self._holders = [_Sensor() for _ in self.names], np.array(link.holders_m or np.zeros((len(self.names), 3)))
        self.pending: dict[str, np.ndarray | None] = {}
        self.ready: deque[Frame] = deque()
        self._stamp, self._received, self._time = -np.inf, np.nan, -np.inf

    def restart(self, now: float) -> None:
        """A new connection at the host's time `now` in s: another clock may come with it. What is ready stays."""
        self.pending, self._stamp, self.progress = {}, -np.inf, now
        self.clock = ServerClock(self.period / 2)

    def take(self, device: str, stamp: float, pose: np.ndarray | None, received: float) -> None:
        """Take a message of a device; devices that are not the link's are only remembered as seen.

        Args:
            device: its name.
            stamp: on the server's clock in s; 0 where it has none, then the arrival stands for it.
            pose: (4, 4), or the position (3,) of a marker, in the server's units; None where the server says that it is not valid.
            received: when it arrived, on the host's clock in s.
        """
        if device not in self.link.devices:
            self.progress = received
            if len(self.seen) < LARGEST_CROWD:
                self.seen.add(device)
            return
        self.seen.add(device)
        self.counts["received"] += 1
        stamp = stamp if stamp > 0 else received
        near = abs(stamp - self._stamp) < self.period / 2
        joins = bool(self.pending) and device not in self.pending and near
        if not joins and stamp <= self._stamp + self.period / 10:
            self.counts["dropped_old"] += 1
            return
        if not joins and not self.clock.believes(stamp, received):
            self.counts["malformed"] += 1
            return
        if not joins:
            self._close()
            self.clock.update(stamp, received)
            self._stamp, self._received = stamp, received
            if received - stamp - self.clock.offset <= self.stale:
                self.progress = received
        if pose is not None and pose.shape == (3,):
            self.markers.add(device)
            pose = np.block([[np.full((3, 3), np.nan), pose[:, None]], [0.0, 0.0, 0.0, 1.0]])
        self.pending[device] = pose
        if len(self.pending) == len(self.names):
            self._close()

    def flush(self, now: float) -> None:
        """Give up what has been missing for too long at the host's time `now` in s."""
        if self.pending and now - self._received > WAIT_PERIODS * self.period:
            self._close()

    def next(self, now: float) -> Frame | None:
        """The next frame, if there is one that is not stale at the host's time `now` in s."""
        self._drop_stale(now)
        return replace(self.ready[0], age=now - self.ready.popleft().time) if self.ready else None

    def _close(self) -> None:
        """Make a frame of what is there, unless clocks are not aligned, or it is late or out of order."""
        poses, self.pending = self.pending, {}
        time = self._stamp + self.clock.offset - self.link.latency_s
        if not poses:
            return
        if not self.clock.settled:
            self.counts["settling"] += 1
        elif self._received - time > self.stale:
            self.counts["dropped_stale"] += 1
        elif time <= self._time:
            self.counts["dropped_old"] += 1
        else:
            self._drop_stale(self._received)
            self.ready.append(self._frame(poses, time))
            self._time, self.arrival = time, self._received

    def _drop_stale(self, now: float) -> None:
        while self.ready and now - self.ready[0].time > self.stale:
            self.ready.popleft()
            self.counts["dropped_stale"] += 1

    def _frame(self, sent: dict[str, np.ndarray | None], time: float) -> Frame:
        poses = [sent.get(device) for device in self.link.devices]
        transforms = np.array([LOST if pose is None else pose for pose in poses], dtype=float)
        positions = transforms[:, :3, 3] / self.link.units_per_m
        transforms[~_are_poses(transforms)] = np.nan
        transforms[:, :3, 3] /= self.link.units_per_m
        points = (transforms[:, :3, :3] @ self._holders[:, :, None])[:, :, 0] + transforms[:, :3, 3]
        bare = [device in self.markers for device in self.link.devices]
        points[bare] = np.where(np.isfinite(positions[bare]).all(axis=1, keepdims=True), positions[bare], np.nan)
        lost, jumps, moves, gap = [], [], [], time - self._time
        for i, (name, sensor, point) in enumerate(zip(self.names, self._sensors, points.tolist(), strict=True)):
            if point[0] != point[0]:
                lost.append(name)
            elif (moved := sensor.judge(point, time, self.link.largest_step_m, self.period)) is None:
                jumps.append(name)
                points[i], transforms[i] = np.nan, np.nan
            elif moved:
                moves.append(f"tracker: {name} moved by {1e3 * moved:.0f} mm and stays there")
        words = [f"tracker was silent for {gap:.2f} s"] if STALE_PERIODS * self.period < gap < np.inf else []
        words += [f"tracker lost {', '.join(lost)}"] if lost else []
        words += [f"tracker: jump of {', '.join(jumps)}"] if jumps else []
        self.counts.update(frames=1, incomplete=int(len(sent) < len(self.names)), lost=len(lost), jumps=len(jumps), moved=len(moves))
        return Frame(time, points, transforms, "; ".join(words + moves) or "ok")


def _are_poses(transforms: np.ndarray) -> np.ndarray:
    """Mask of poses among (points, 4, 4), (points,): finite, with a rotation, and not the identity that is sent in place of one."""
    finite = np.isfinite(transforms)
    rotations = np.where(finite, transforms, 0.0)[:, :3, :3]
    skew = np.abs(rotations.transpose(0, 2, 1) @ rotations - IDENTITY[:3, :3]).max(axis=(1, 2))
    proper = (skew <= ORTHONORMAL) & (np.linalg.det(rotations) > 0)
    return proper & finite.all(axis=(1, 2)) & np.not_equal(transforms, IDENTITY).any(axis=(1, 2))
