"""Trials that an earlier verdict misjudged, each for a reason of its own; seeds that were design since then."""

from __future__ import annotations

import pytest

from tepm_opt.studies.blind.judged import Judged
from tepm_opt.studies.blind.run import examine_trial
from tepm_opt.studies.blind.trial import Trial

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(119, id="a leak of a third of the valve, which is no gain"),
        pytest.param(293, id="a weak muscle and a tilted base, which are no scatter"),
        pytest.param(459, id="scatter, which is no weak muscle and load"),
        pytest.param(475, id="a tracker whose drift ends"),
        pytest.param(480, id="a tendon that lost its whole tension"),
    ],
)
def test_it_is_right_now(number: int) -> None:
    judged = Judged(examine_trial(Trial.from_number(101003, number)))
    assert judged.right, (judged.truth, judged.listed)
