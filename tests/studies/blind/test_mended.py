"""Trials that an earlier verdict misjudged, each for a reason of its own; seeds that were design since then."""

from __future__ import annotations

import pytest

from tepm_opt.studies.blind.judged import Judged
from tepm_opt.studies.blind.run import examine_trial
from tepm_opt.studies.blind.trial import Trial

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("seed", "number"),
    [
        pytest.param(101003, 119, id="a leak of a third of the valve, which is no gain"),
        pytest.param(101003, 293, id="a weak muscle and a tilted base, which are no scatter"),
        pytest.param(101003, 459, id="scatter, which is no weak muscle and load"),
        pytest.param(101003, 475, id="a tracker whose drift ends"),
        pytest.param(101003, 480, id="a tendon that lost its whole tension"),
        pytest.param(120001, 187, id="creep, of which first order promises a tenth, and a clock"),
        pytest.param(120001, 243, id="an offset that leaves an eighth of the squared noise beside a turned tracker"),
        pytest.param(130001, 123, id="a dead zone and a weak muscle, which are no scatter about another mean"),
        pytest.param(130001, 128, id="scatter beside a payload and rigid plates, which is no weak muscle"),
        pytest.param(130001, 131, id="masses beside warm-up and friction, whose rival had been fitted better"),
        pytest.param(150001, 7, id="a payload put on before the fourth run, which are no masses missing before"),
        pytest.param(170001, 19, id="valves that choke, whose lag had been fitted as if they did not"),
        pytest.param(170001, 27, id="a shifted muscle beside warm-up and hardening, which is no scatter"),
        pytest.param(170001, 99, id="a weak muscle and a load beside warm-up, which are no scatter"),
    ],
)
def test_it_is_right_now(seed: int, number: int) -> None:
    judged = Judged(examine_trial(Trial.from_number(seed, number)))
    assert judged.right, (judged.truth, judged.listed)
