"""What a tracking server says about its poses: only what is exactly valid is one, in every form of the metadata."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tepm_opt.hw.trackers.frames import FrameAssembler
from tepm_opt.hw.trackers.kinds.openigtlink import is_valid
from tests.hw.igtl import DEVICES, link, pose_message, still
from tests.hw.test_hostile_tracker import Fed, unstarted

TIP = DEVICES[3]
LOST = (
    "MISSING",
    "OUT_OF_VIEW",
    "OUT_OF_VOLUME",
    "SWITCH_IS_ON",
    "INVALID",
    "UNKNOWN",
    "REQ_TIMEOUT",
    "ok",
    "Ok",
    "OK ",
    "",
    "0",
    "LEARNED",
)
"""Values of a status: those that PlusLib writes beside OK, and others that it does not know."""


@pytest.mark.parametrize("key", ["TransformStatus", f"{TIP}TransformStatus", f"{TIP}Status", "Status", "transformstatus"])
def test_a_status(key):
    """Each key, with and without the device's name."""
    assert is_valid({key: "OK"}, TIP)
    assert not any(is_valid({key: value}, TIP) for value in LOST)


@pytest.mark.parametrize("key", ["TransformValid", f"{TIP}TransformValid"])
def test_validity(key):
    """True in any case of letters; everything else is not."""
    assert all(is_valid({key: value}, TIP) for value in ("true", "True", "TRUE"))
    assert not any(is_valid({key: value}, TIP) for value in ("false", "False", "", "yes", "OK", "truth"))


def test_what_contradicts_itself():
    """One key that says no is enough; another device's status does not count where the device has its own."""
    assert not is_valid({"TransformValid": "True", "TransformStatus": "MISSING"}, TIP)
    assert not is_valid({"TransformValid": "False", "TransformStatus": "OK"}, TIP)
    assert is_valid({f"{TIP}TransformStatus": "OK", f"{DEVICES[0]}TransformStatus": "MISSING"}, TIP)
    assert not is_valid({f"{DEVICES[0]}TransformStatus": "MISSING"}, TIP)


def test_no_status_is_a_plain_pose():
    """No metadata, or none about the status."""
    assert is_valid({}, TIP)
    assert is_valid({"FrameNumber": "7", "IGTL_DEVICE_NAME": TIP}, TIP)


@given(st.dictionaries(st.sampled_from(["TransformStatus", "TransformValid", "Status"]), st.text(max_size=12), min_size=1))
def test_nothing_but_the_known_values_is_valid(metadata):
    """Over any values: valid only where each one is exactly what it has to be."""
    wanted = all(value.lower() == "true" if "Valid" in key else value == "OK" for key, value in metadata.items())
    assert is_valid(metadata, TIP) == wanted


SENT = [
    ({"TransformStatus": "MISSING", "TransformValid": "False"}, 2, False),
    ({"TransformStatus": "MISSING"}, 3, False),
    ({"TransformStatus": "OK", "TransformValid": "True"}, 2, True),
    ({}, 1, True),
]


@pytest.mark.parametrize(("status", "version", "seen"), SENT)
def test_over_the_line(status, version, seen):
    """The pose of a tip that is MISSING is never given, in every version of the header that has metadata."""
    taken = []
    frames = FrameAssembler(link())
    frames.take = lambda device, stamp, pose, received: taken.append((device, pose))  # type: ignore[method-assign]
    client = unstarted(frames)
    data = b"".join(pose_message(device, still(0)[i], status if i == 3 else {}, version) for i, device in enumerate(DEVICES))
    with pytest.raises(OSError, match="closed by the server"):
        client._listen(Fed(data, 1 << 16))
    assert [device for device, _ in taken] == list(DEVICES)
    assert all(pose is not None and np.isfinite(pose).all() for _, pose in taken[:3])
    assert (taken[3][1] is not None) == seen
