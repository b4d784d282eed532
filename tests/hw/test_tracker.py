"""The tracker: frames from messages (with a clock of the test's own), then over a socket against a stand-in for PlusServer."""

from __future__ import annotations

import socket
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
from pyigtl import StringMessage
from scipy.spatial.transform import Rotation

from tepm_opt.errors import InputError
from tepm_opt.hw.trackers import open_link
from tepm_opt.hw.trackers.frames import OFFSET_RISE, SETTLING_FRAMES
from tepm_opt.models.hardware import TrackerLink
from tests.hw.igtl import AHEAD, DELAY, DEVICES, PERIOD, RATE, Feed, PlusServer, SteppedServer, link, read_for, still


def test_points_go_with_the_holder_arms():
    """R h + t, with 40 mm arms that turn with the sensors, mm on the wire and m here: closed form of a quarter turn about z."""
    feed = Feed(holders_m=[[0.04, 0, 0], [0, 0.04, 0], [0, 0, 0.04], [0.04, 0, 0]], largest_step_m=1.0).settle()
    before = feed.poses[:, :3, :3].copy()
    assert feed.sample()[0].points[0] == pytest.approx(before[0] @ [0.04, 0, 0] + [0, -0.005, 0.1], abs=1e-12)
    feed.poses[:, :3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    (frame,) = feed.sample()
    arms = [[0, 0.04, 0], [-0.04, 0, 0], [0, 0, 0.04], [0, 0.04, 0]]
    assert frame.points == pytest.approx(np.array(arms) + [[0.01 * i, -0.005, 0.1 * (i + 1)] for i in range(4)], abs=1e-12)
    assert frame.transforms[2, :3, 3] == pytest.approx([0.02, -0.005, 0.3])
    assert frame.status == "ok"


def test_time_is_the_hosts():
    """A server 1000 s ahead: a pose's time is the host's when it was stamped (the network's 0.2 ms cannot be told), less the latency."""
    feed = Feed(latency_s=0.01).settle()
    for _ in range(20):
        (frame,) = feed.sample()
        assert frame.time == pytest.approx(feed.k * PERIOD + DELAY - 0.01, abs=1e-9)
        assert frame.age == pytest.approx(0.01, abs=1e-9)
    assert feed.frames.clock.offset == pytest.approx(DELAY - AHEAD, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("drift", [2e-4, -2e-4])
def test_drift_is_followed_under_delays(drift):
    """200 ppm for a minute (12 ms in all) with delays of 1 ms on average: times stay within 0.3 ms of the truth."""
    random = np.random.default_rng(0)
    feed, errors = Feed().settle(), []
    for _ in range(round(60 * RATE)):
        delay = min(DELAY + random.exponential(1e-3), 0.9 * PERIOD)
        errors += [frame.time - feed.k * PERIOD - DELAY for frame in feed.sample(delay=delay, ahead=AHEAD + drift * feed.k * PERIOD)]
    assert len(errors) > 0.999 * 60 * RATE
    assert np.abs(errors[round(RATE) :]).max() < 3e-4


@pytest.mark.parametrize("late", [0.05, 3.0])
def test_what_was_held_up_is_not_fresh(late):
    """A network that holds messages up, for whatever time and however many: none is returned, and the time is the truth's after."""
    feed = Feed().settle()
    for _ in range(round(2 * RATE)):
        assert feed.sample(delay=late) == []
    dropped = feed.frames.counts["dropped_stale"]
    assert dropped == round(2 * RATE)
    assert feed.k * PERIOD + late - feed.frames.progress > 1.0  # the client gives such a connection up
    (frame,) = feed.sample()
    assert frame.time == pytest.approx(feed.k * PERIOD + DELAY, abs=1e-9)
    assert frame.status.startswith("tracker was silent for 2.0")


def test_a_backlog_does_not_set_the_clock():
    """A server that first sends a second of old samples in one piece: nothing of that is returned."""
    feed = Feed()
    for k in range(240):
        for device, pose in zip(DEVICES, feed.poses, strict=True):
            feed.frames.take(device, AHEAD + (k - 240) * PERIOD, pose, 0.0)
    assert feed.read(0.0) == []
    assert len(feed.settle().sample()) == 1
    assert feed.sample()[0].time == pytest.approx(feed.k * PERIOD + DELAY, abs=1e-9)


def test_clock_steps():
    """The server's clock set forward: begins anew within frames; set back: nothing, until a new connection begins anew."""
    feed = Feed().settle()
    gone = [feed.sample(ahead=AHEAD + 60) for _ in range(10)]
    assert [len(frames) for frames in gone] == [0] * 4 + [1] * 6
    assert gone[-1][0].time == pytest.approx(feed.k * PERIOD + DELAY, abs=1e-9)
    old = feed.frames.counts["dropped_old"]
    assert not any(feed.sample(ahead=AHEAD) for _ in range(300))
    assert feed.frames.counts["dropped_old"] == old + 4 * 300
    assert feed.k * PERIOD - feed.frames.progress > 1.0
    feed.frames.restart(feed.k * PERIOD)
    back = [feed.sample(ahead=AHEAD) for _ in range(6)]
    assert [len(frames) for frames in back] == [0] * 4 + [1] * 2
    assert back[4][0].status == f"tracker was silent for {305 * PERIOD:.2f} s"
    assert back[5][0].status == "ok"


def test_no_stamps():
    """Stamps of zero: the time of arrival stands for them."""
    feed = Feed()
    frames = [frame for _ in range(20) for frame in feed.sample(ahead=-np.inf)]
    assert len(frames) == 16
    assert frames[-1].time == pytest.approx(feed.k * PERIOD + DELAY, abs=1e-12)


def test_incomplete_frames():
    """A sensor that sends nothing: its frame waits for the next one's stamp, or for 1.5 periods, and says who is missing."""
    feed = Feed().settle()
    assert feed.sample(lost=(1, 2)) == []
    first, second = feed.sample()
    assert (first.status, second.status) == ("tracker lost s2, s3", "ok")
    assert np.isnan(first.points).any(axis=1).tolist() == [False, True, True, False]
    assert np.isnan(first.transforms[1:3]).all()
    assert np.isfinite(first.transforms[[0, 3]]).all()
    assert first.time == pytest.approx(second.time - PERIOD)
    feed.sample(lost=(3,))
    now = feed.k * PERIOD + DELAY
    feed.frames.flush(now + 1.4 * PERIOD)
    assert feed.read(now + 1.4 * PERIOD) == []
    feed.frames.flush(now + 1.6 * PERIOD)
    assert [frame.status for frame in feed.read(now + 1.6 * PERIOD)] == ["tracker lost s4"]
    assert (feed.frames.counts["incomplete"], feed.frames.counts["lost"]) == (2, 3)


@pytest.mark.parametrize("how", ["identity", "nan", "infinite", "skew", "mirrored", "status"])
def test_what_is_no_pose_is_lost(how):
    """What servers send where a sensor is out of sight, or garbage, is not taken for a pose."""
    feed = Feed().settle()
    pose = feed.poses[2].copy()
    if how == "identity":
        pose = np.eye(4)
    elif how in ("nan", "infinite"):
        pose[1, 3] = {"nan": np.nan, "infinite": np.inf}[how]
    elif how == "skew":
        pose[:3, 0] *= 1.001
    elif how == "mirrored":
        pose[:3, 0] *= -1
    feed.poses = [*feed.poses[:2], None if how == "status" else pose, feed.poses[3]]
    (frame,) = feed.sample()
    assert frame.status == "tracker lost s3"
    assert np.isnan(frame.points).all(axis=1).tolist() == [False, False, True, False]
    assert np.isnan(frame.transforms[2]).all()


def test_duplicates_and_old_stamps():
    """Nothing is returned twice or out of order."""
    feed = Feed().settle()
    (frame,) = feed.sample()
    old = feed.frames.counts["dropped_old"]
    feed.k -= 1
    assert feed.sample() == []
    feed.k -= 3
    assert feed.sample() == []
    assert feed.frames.counts["dropped_old"] == old + 8
    feed.k += 2
    (after,) = feed.sample()
    assert after.time == pytest.approx(frame.time + PERIOD)


def test_a_reader_that_sleeps():
    """Frames of the last five periods wait for it; older ones are dropped and counted."""
    feed = Feed().settle()
    for k in range(1, 101):
        now = (feed.k + k) * PERIOD
        for device, pose in zip(DEVICES, feed.poses, strict=True):
            feed.frames.take(device, now + AHEAD, pose, now + DELAY)
    assert len(feed.frames.ready) <= 7
    frames = feed.read(now + DELAY + PERIOD / 4)
    assert [frame.age for frame in frames] == pytest.approx([(4.25 - k) * PERIOD for k in range(5)], abs=1e-9)
    assert feed.frames.counts["dropped_stale"] == 95


def test_jumps():
    """60 mm in one frame is a jump: NaN and named, others untouched; back again, or far away for five frames and then believed."""
    feed = Feed().settle()
    home = feed.poses[3, 0, 3]
    feed.poses[3, 0, 3] = home + 60
    (frame,) = feed.sample()
    assert frame.status == "tracker: jump of s4"
    assert np.isnan(frame.points).all(axis=1).tolist() == [False, False, False, True]
    feed.poses[3, 0, 3] = home
    assert feed.sample()[0].status == "ok"
    feed.poses[3, 0, 3] = home + 200
    frames = [feed.sample()[0] for _ in range(6)]
    assert [frame.status for frame in frames] == [*["tracker: jump of s4"] * 4, "tracker: s4 moved by 200 mm and stays there", "ok"]
    assert frames[4].points[3, 0] == pytest.approx((home + 200) / 1000)
    assert (feed.frames.counts["jumps"], feed.frames.counts["moved"]) == (5, 1)


@pytest.mark.parametrize("millimetres", [120.0, 1000.0])
def test_wild_values_are_never_believed(millimetres):
    """Jumps to places that do not agree with each other stay jumps, however long they go on."""
    feed = Feed().settle()
    home = feed.poses[0, 0, 3]
    for k in range(50):
        feed.poses[0, 0, 3] = home + millimetres * (-1) ** k
        assert feed.sample()[0].status == "tracker: jump of s1"
    feed.poses[0, 0, 3] = home
    assert feed.sample()[0].status == "ok"


def test_missed_frames_allow_a_longer_way():
    """After three frames without it, a sensor may be three times as far away, and a bit more is a jump."""
    for millimetres, status in ((195, "ok"), (205, "tracker: jump of s1")):
        feed = Feed().settle()
        for _ in range(3):
            feed.sample(lost=(0,))
        feed.poses[0, 1, 3] += millimetres
        assert [frame.status for frame in feed.sample()] == ["tracker lost s1", status]


def test_every_sample_arrives_in_order():
    """Two seconds at 240 Hz with the server's clock 1000 s ahead: all but those that set the clock, once each, at the host's time."""
    with SteppedServer() as server, server.tracker() as tracker:
        frames = server.samples(tracker, 480)
    assert [frame.time for frame in frames] == pytest.approx(server.sent[SETTLING_FRAMES - 1 :], abs=1e-6)
    assert {frame.status for frame in frames} == {"ok"}
    assert frames[-1].transforms[:, :3, :3] == pytest.approx(still(0)[:, :3, :3], abs=1e-6)
    assert frames[-1].transforms[:, :3, 3] == pytest.approx(still(0)[:, :3, 3] / 1000, abs=1e-6)
    assert tracker.statistics.clock_offset == pytest.approx(-AHEAD, abs=1e-6)
    assert tracker.statistics.settling == SETTLING_FRAMES - 1


@pytest.mark.study
def test_240_hz_without_loss_and_under_a_millisecond():
    """Ten seconds of real time, 4 sensors, on a quiet machine: no sample is lost, and the median age from the server's stamp is 1 ms."""
    with PlusServer(RATE) as server, open_link(link(port=server.port)) as tracker:
        frames, ages = [tracker.first()], []
        end = time.monotonic() + 10
        while time.monotonic() < end:
            if frame := tracker.read(0.1):
                frames.append(frame)
                ages.append(time.monotonic() - frame.time)
    stamps = np.array(server.sent) - server.shift
    first, last = (np.abs(stamps - frames[end].time).argmin() for end in (0, -1))
    assert len(frames) == last - first + 1
    hidden = np.median(np.array([frame.time for frame in frames]) - stamps[first : last + 1])  # what no clock can tell
    assert np.median(ages) + hidden <= 1e-3
    assert tracker.statistics.incomplete == tracker.statistics.dropped_stale == tracker.statistics.dropped_old == 0


def test_stopped_and_restarted():
    """None and a status while the server is away; afterwards frames again, flagged once, with the new server's clock."""
    with SteppedServer() as server, server.tracker() as tracker:
        last = server.samples(tracker, 60)[-1].time
        server.stop()
        server.now += 0.5
        assert tracker.read(0) is None
        assert tracker.silent_for == pytest.approx(0.5)
        assert tracker.status.startswith("tracker silent for 0.50 s")
        server.shift = -5.0
        server.start()
        server.accept()
        frames = server.samples(tracker, 60)
        assert [frame.time for frame in frames] == pytest.approx(server.sent[60 + SETTLING_FRAMES - 1 :], abs=1e-6)
        assert [frame.status for frame in frames] == [f"tracker was silent for {frames[0].time - last:.2f} s"] + ["ok"] * (len(frames) - 1)
        assert tracker.status == "ok"
        assert tracker.statistics.reconnects == 1
        assert tracker.statistics.clock_offset == pytest.approx(5, abs=1e-6)


def test_a_server_that_hangs():
    """Open connection, nothing sent: None; then a new connection, and frames as soon as there are some."""
    with SteppedServer() as server, server.tracker() as tracker:
        server.samples(tracker, 60)
        server.now += 0.9
        assert tracker.read(0) is None
        server.now += 0.2
        server.accept()
        frames = server.samples(tracker, SETTLING_FRAMES)
        assert tracker.statistics.reconnects == 1
        assert [frame.status for frame in frames] == ["tracker was silent for 1.12 s"]


def test_samples_held_back_are_not_returned():
    """Half a second of samples sent late in one piece: none of the late ones is returned as if it were new."""
    with SteppedServer() as server, server.tracker() as tracker:
        server.samples(tracker, 60)
        server.held = True
        assert server.samples(tracker, 120) == []
        server.held = False
        frames = server.sample(tracker)
        drifted = 125 * PERIOD * OFFSET_RISE  # what the clocks may have drifted apart meanwhile
        assert [frame.age for frame in frames] == pytest.approx([k * PERIOD for k in (5, 4, 3, 2, 1, 0)], abs=drifted)
        assert [frame.time for frame in frames] == pytest.approx(server.sent[-6:], abs=drifted)
        assert tracker.statistics.dropped_stale == 120 - 5


def test_dropouts_and_jumps_over_the_wire():
    """A sensor of which nothing comes, and one that jumps, in the statuses and in the counts."""
    with SteppedServer() as server, server.tracker() as tracker:
        server.samples(tracker, 60)
        server.lost = (1,)
        lost = server.samples(tracker, 20)
        server.lost = ()
        lost += server.samples(tracker, 20)
        assert [frame.status for frame in lost] == ["tracker lost s2"] * 20 + ["ok"] * 20
        server.jump = np.array([[0, 0, 0]] * 3 + [[0, 300.0, 0]])
        statuses = [frame.status for frame in server.samples(tracker, 20)]
        assert statuses == ["tracker: jump of s4"] * 4 + ["tracker: s4 moved by 300 mm and stays there"] + ["ok"] * 15
        statistics = tracker.statistics
        assert (statistics.jumps, statistics.moved, statistics.incomplete, statistics.lost) == (4, 1, 20, 20)


def test_only_other_names():
    """A device that nobody sends: the error names it and what there is."""
    with (
        PlusServer(RATE) as server,
        open_link(link(port=server.port, devices=[*DEVICES[:3], "TopToTracker"])) as tracker,
        pytest.raises(InputError, match=rf"127.0.0.1:{server.port}: no poses of TopToTracker within 0.5 s; valid: .*{DEVICES[3]}"),
    ):
        tracker.first(0.5)


def test_nobody_there():
    """A port at which nothing listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        with (
            open_link(link(port=port)) as tracker,
            pytest.raises(InputError, match=f"{port}: nothing listens there .*refused.*; valid: host and port"),
        ):
            tracker.first(0.3)


def test_messages_in_pieces_and_of_other_kinds():
    """Headers and bodies that come in pieces, text between poses, and a body that is too short: no pose is lost, the garbage is counted."""
    text = StringMessage("on air", timestamp=1.0, device_name="Words").pack()
    short = bytearray(text)
    short[2:14] = b"TRANSFORM".ljust(12, b"\0")
    with SteppedServer(rate=20) as server, server.tracker() as tracker:
        frames = [server.sample(tracker, pieces=(20, 70, 300), garbage=text + bytes(short)) for _ in range(12)]
        assert [bool(frame) for frame in frames] == [False] * 4 + [True] * 8
        statistics = tracker.statistics
        assert (statistics.received, statistics.malformed, statistics.incomplete) == (48, 12, 0)


def test_closing_while_messages_come():
    """It ends within moments, also at a rate at which pyigtl's own client never looks whether it shall stop; twice does nothing."""
    with PlusServer(RATE) as server:
        tracker = open_link(link(port=server.port), stale_periods=60)
        tracker.first()
        tracker.close()
        tracker.close()
        assert "tracker" not in {thread.name for thread in threading.enumerate()}
        read_for(tracker, 0.1)
        assert tracker.read(0.2) is None


@pytest.mark.parametrize(
    ("kind", "module", "options"), [("webcam", "cv2", {"calibration": "none.toml", "tag_m": 0.03}), ("ndi", "ndicapy", {})]
)
def test_a_package_that_is_not_installed_is_named(kind: str, module: str, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """With the extra that installs it; the kind itself can be listed without."""
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"tracker {kind} needs {module}, which is not installed: pip install 'tepm-opt\[{kind}\]'"):
        open_link(TrackerLink(kind=kind, options=options, devices=("tag 0",)))
