"""Faults that a rig file lists: what each does to the samples, what is refused, and how a closed loop ends."""

from __future__ import annotations

import numpy as np
import pytest

from tepm_opt.control.loop import close_loop
from tepm_opt.control.mpc.controller import Mpc
from tepm_opt.control.references.reference import Reference, approach, reference_of, sample_tips
from tepm_opt.data.documents import validate
from tepm_opt.errors import InputError
from tepm_opt.hw.simulation.faults import Fault, FaultInjector
from tepm_opt.hw.simulation.rig import SimulatedRig
from tepm_opt.hw.simulation.rigfile import RigFile, load_rig_file
from tepm_opt.hw.simulation.rigtext import rig_text
from tepm_opt.models.compile import CompiledModel
from tepm_opt.models.layout import Layout
from tepm_opt.models.robot import load_robot
from tepm_opt.solvers.planning.trajectories import circle
from tests.hw.test_freshness import samples

LAYOUT = Layout.from_robot(load_robot("kang2017"))


def faulty(*faults: dict[str, object]) -> RigFile:
    """The virtual prototype with faults."""
    return load_rig_file().model_copy(update={"faults": tuple(Fault.model_validate(fault) for fault in faults)})


def through(count: int = 100, **fault: object):
    """Samples without and with a fault."""
    clean = samples(count)
    injector = FaultInjector([Fault.model_validate(fault)], LAYOUT, 1)
    return clean, [injector.apply(sample) for sample in clean]


def test_each_kind():
    """From 0.5 s on, until 0.8 s where that is said."""
    clean, read = through(kind="freeze", of="s2", from_s=0.5, until_s=0.8)
    assert all(np.array_equal(a.points, b.points) for a, b in zip(clean[:50] + clean[80:], read[:50] + read[80:], strict=True))
    assert all(np.array_equal(sample.points[1], clean[49].points[1]) for sample in read[50:80])
    clean, read = through(kind="repeat", every=3, of="tension_21")
    assert [k for k in range(1, 100) if read[k].tensions[3] == read[k - 1].tensions[3]] == list(range(2, 100, 3))
    clean, read = through(kind="drop", probability=0.3)
    assert 15 < sum(np.isnan(sample.points).all() for sample in read) < 45
    clean, read = through(kind="delay", seconds=0.05, of="pressure_13")
    assert all(read[k].pressures[2] == clean[k - 5].pressures[2] for k in range(5, 100))
    clean, read = through(kind="swap", of="s1", **{"with": "s4"})
    assert np.array_equal(read[7].points, clean[7].points[[3, 1, 2, 0]])
    _, read = through(kind="invalid", of="s4")
    assert np.isnan(read[3].points[3]).all()


REFUSED = [
    ({"kind": "frozen"}, "unknown kind 'frozen'"),
    ({"kind": "repeat"}, "needs the key 'every'"),
    ({"kind": "freeze", "every": 2}, "has no key 'every'; valid: kind, of, from_s, until_s"),
    ({"kind": "freeze", "from": 1.0}, "unknown key 'from'"),
    ({"kind": "swap", "of": "s1", "wth": "s2"}, "valid: every, from_s, kind, of, probability, seconds, until_s, with"),
    ({"kind": "freeze", "from_s": 2.0, "until_s": 1.0}, "is not after from_s"),
    ({"kind": "swap", "with": "s2"}, "two different points"),
]


@pytest.mark.parametrize(("entry", "says"), REFUSED)
def test_refused_entries(entry, says):
    """With what is valid."""
    with pytest.raises(InputError, match=says.replace("(", r"\(")):
        validate(RigFile, {"name": "x", "robot": "kang2017", "faults": [entry]}, "rig.toml")


@pytest.mark.parametrize("entry", [{"of": "s5"}, {"of": "pressure_31"}, {"kind": "swap", "of": "s1", "with": "tension_11"}])
def test_what_the_robot_has_not(entry):
    """A point or gauge that is not there."""
    with pytest.raises(InputError, match="faults, entry 1: unknown"):
        SimulatedRig(faulty({"kind": "freeze", **entry}))


def test_text_reads_back(tmp_path):
    """A rig file with faults is written and read back equal."""
    file = faulty({"kind": "swap", "of": "s2", "with": "s3", "from_s": 1.0}, {"kind": "drop", "probability": 0.3})
    (tmp_path / "rig.toml").write_text(rig_text(file, "kang2017"), encoding="utf-8")
    assert load_rig_file(tmp_path / "rig.toml") == file


def test_an_unwatched_rig_gives_what_a_watched_one_withholds() -> None:
    """A frozen point is read on as it was; all samples before the fault are the same, bit by bit."""
    file = faulty({"kind": "freeze", "of": "s2", "from_s": 0.5})
    watched, raw = (SimulatedRig(file, watched=each).read_many(100) for each in (True, False))
    first = next(k for k, sample in enumerate(watched) if np.isnan(sample.points).any())
    assert all(np.array_equal(a.points, b.points) for a, b in zip(watched[:first], raw[:first], strict=True))
    assert 0.5 <= raw[first].time < 0.6
    assert all(np.array_equal(sample.points[1], raw[first].points[1]) for sample in raw[first:])


@pytest.fixture(scope="module")
def path(kang: CompiledModel) -> Reference:
    """To the circle in 2 s and 1.5 s along it."""
    tips = sample_tips(circle(400))[0][:150]
    return reference_of(kang, np.vstack([approach(kang, tips[0], 2.0), tips]), np.arange(350) >= 200)


CLOSED = [
    ({"kind": "freeze"}, "tracker frozen", False),
    ({"kind": "freeze", "of": "s4"}, "s4 frozen", False),
    ({"kind": "freeze", "of": "s2"}, "s2 frozen", True),
    ({"kind": "repeat", "every": 2}, "tracker repeats frames", True),
    ({"kind": "drop", "probability": 0.3}, "tracker drops frames", True),
    ({"kind": "swap", "of": "s2", "with": "s3"}, "s2 and s3 are swapped", True),
    ({"kind": "invalid", "of": "s2"}, "s2 lost", True),
    ({"kind": "freeze", "of": "pressure_13"}, "pressure gauge 13 frozen", False),
    ({"kind": "freeze", "of": "tension_21"}, "dynamometer 21 frozen", False),
]


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "name", "goes_on"), CLOSED)
def test_closed_loop(kang: CompiledModel, path: Reference, fault, name, goes_on):
    """Told by its name within 0.3 s; the tip stays within 20 mm of what it was; the loop goes on only where it can see its tip."""
    rig = SimulatedRig(faulty({**fault, "from_s": 2.5}))
    done = close_loop(rig, Mpc(kang, path), kang.robot)
    told = {about: now for now, row in reversed(list(zip(done.time, done.telemetry, strict=True))) for about in row.doubts}
    assert 2.5 <= told[name] <= 2.8
    off, when = np.linalg.norm(np.array(done.truth) - done.targets, axis=1), np.array(done.time)
    assert off[when >= 2.5].max() <= off[(when >= 2.0) & (when < 2.5)].max() + 0.020
    assert done.outcome.solved == goes_on
    assert goes_on or name in done.outcome.message
